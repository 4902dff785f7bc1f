"""What many measured tools came to beside the truth: errors, coverage of what was stated, and verdicts."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calibration.tool_frame.meeting import length_beyond
from cell.poses import Array, from_pose6

Z = np.array([0.0, 0.0, 1.0])


@dataclass
class Tally:
    """One entry a run. Points are in m and tilts in rad, in the flange."""

    point: list[Array] = field(default_factory=list)
    cov: list[Array] = field(default_factory=list)
    tilt: list[Array] = field(default_factory=list)
    tilt_cov: list[Array] = field(default_factory=list)
    ways: list[int] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    failed: list[str] = field(default_factory=list)
    checks: int = 0
    called_moved: int = 0
    bumps: int = 0
    found: int = 0

    def take(self, answer: Mapping[str, Any], T_flange_tool: list[float]) -> None:
        """The frame that an update found, beside the true one (a pose6)."""
        found, true = from_pose6(answer["T_flange_tool"]), from_pose6(T_flange_tool)
        cov = np.array(answer["cov"])
        self.point.append(found.translation - true.translation)
        self.cov.append(cov[:3, :3])
        self.tilt.append(np.cross(true.rotation.apply(Z), found.rotation.apply(Z))[:2])
        self.tilt_cov.append(cov[3:5, 3:5])

    def lines(self) -> list[str]:
        """The figures, in words."""
        verdicts = (
            f"refused {len(self.refused)} of {len(self.point)}; called moved {self.called_moved} of "
            f"{self.checks}; found {self.found} of {self.bumps}; not done {len(self.failed)}"
        )
        told = [*dict.fromkeys((*self.refused, *self.failed))][:4]
        if not self.point:
            return [verdicts, *told]
        rms, stated = self.rms, np.sqrt(np.mean([np.diag(c) for c in self.cov], axis=0))
        names = ("point", "height", "tilt")
        cover = ", ".join(
            f"{name} {100 * self.within(name, 0.95):.0f} / {100 * self.within(name, 0.99):.0f} %"
            for name in names
        )
        return [
            f"n {len(self.point)}; RMS um {_um(rms)}, stated {_um(stated)}; largest in height "
            f"{1e6 * max(abs(float(p[2])) for p in self.point):.0f}",
            f"within the stated 95 / 99 %: {cover}; NEES of the point {self.nees:.2f}, of the height "
            f"{self.nees_height:.2f}",
            verdicts,
            f"ways of a first scan {np.mean(self.ways):.0f}, update {np.mean(self.seconds):.0f} s",
            *told,
        ]

    @property
    def rms(self) -> Array:
        """(3,) m."""
        found: Array = np.sqrt(np.mean(np.square(self.point), axis=0))
        return found

    @property
    def nees(self) -> float:
        """Mean squared error of the point in units of its covariance; 3 is right."""
        return float(np.mean([e @ np.linalg.solve(c, e) for e, c in zip(self.point, self.cov, strict=True)]))

    @property
    def nees_height(self) -> float:
        """The same of the height; 1 is right."""
        return float(np.mean([e[2] ** 2 / c[2, 2] for e, c in zip(self.point, self.cov, strict=True)]))

    def outside(self, name: str, level: float) -> int:
        """How many errors of point, height or tilt are beyond what is stated for ``level``."""
        errors, covs = {
            "point": (self.point, self.cov),
            "height": ([e[2:] for e in self.point], [c[2:, 2:] for c in self.cov]),
            "tilt": (self.tilt, self.tilt_cov),
        }[name]
        pairs = zip(errors, covs, strict=True)
        return sum(bool(np.linalg.norm(e) > length_beyond(c, 1.0 - level)) for e, c in pairs)

    def within(self, name: str, level: float) -> float:
        """Share of errors within what is stated for ``level``."""
        return 1.0 - self.outside(name, level) / len(self.point)


def _um(values: Array) -> str:
    return " ".join(f"{axis} {1e6 * float(v):.1f}" for axis, v in zip("xyz", values, strict=True))
