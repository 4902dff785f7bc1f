"""What many measured tools came to beside the truth: errors, coverage of what was stated, and verdicts."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from calibration.lengths import length_beyond
from cell.poses import Array, from_pose6

Z = np.array([0.0, 0.0, 1.0])
COVERED, NEES, OF_100 = (0.90, 0.98), (2.0, 4.2), 1  # what is wanted, and how many wrong verdicts of 100
MAX_RMS_Z_M = {14: 8e-6, 30: 14e-6}  # by the arm's standard deviation of one axis, um
MANY = 100  # fewer do not show that what is stated is too large


@dataclass
class Tally:
    """One entry a run. Points are in m and tilts in rad, in the flange.

    ``beams`` (3,) m is how far off a reference has the point that both beams fix, ``ways`` how many a first
    scan took and ``near`` how many of them near the tool's end.
    """

    point: list[Array] = field(default_factory=list)
    cov: list[Array] = field(default_factory=list)
    tilt: list[Array] = field(default_factory=list)
    tilt_cov: list[Array] = field(default_factory=list)
    beams: list[Array] = field(default_factory=list)
    beams_cov: list[Array] = field(default_factory=list)
    near: list[int] = field(default_factory=list)
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

    def add(self, other: "Tally") -> None:
        """Take in what another one holds."""
        for name in (f.name for f in fields(self)):
            setattr(self, name, getattr(self, name) + getattr(other, name))

    def as_json(self) -> str:
        """One line."""
        return json.dumps(asdict(self), default=np.ndarray.tolist)

    @classmethod
    def from_json(cls, found: Mapping[str, Any]) -> "Tally":
        """Of what :meth:`as_json` gave."""
        arrays = ("point", "cov", "tilt", "tilt_cov", "beams", "beams_cov")
        return cls(**{**found, **{name: [np.array(v) for v in found[name]] for name in arrays}})

    @classmethod
    def of_file(cls, path: Path, cell: str) -> dict[int, "Tally"]:
        """Those of one cell that :meth:`keep` has put into a file, by their seeds."""
        lines = path.read_text("utf-8").splitlines() if path.exists() else []
        found = [json.loads(line) for line in lines]
        return {f["seed"]: cls.from_json(f["tally"]) for f in found if f["cell"] == cell}

    def keep(self, path: Path, cell: str, seed: int) -> None:
        """Add this one to a file, so that a bench that is ended loses nothing."""
        with path.open("a", encoding="utf-8") as file:
            file.write(f'{{"cell": "{cell}", "seed": {seed}, "tally": {self.as_json()}}}\n')

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
        lines = [
            f"n {len(self.point)}; RMS um {_um(rms)}, stated {_um(stated)}; largest in height "
            f"{1e6 * max(abs(float(p[2])) for p in self.point):.0f}",
            f"within the stated 95 / 99 %: {self._cover('point', 'height', 'tilt')}; NEES of the point "
            f"{self.nees:.2f}, of the height {self.nees_height:.2f}",
        ]
        if self.beams:
            beams = np.sqrt(np.mean(np.square(self.beams), axis=0))
            lines.append(
                f"{len(self.beams)} references: RMS um {_um(beams)}; within the stated 95 / 99 %: "
                f"{self._cover('beams', 'beams height')}; NEES {nees(self.beams, self.beams_cov):.2f}"
            )
        near = f", {np.mean(self.near):.0f} of them near the end," if self.near else ","
        return [
            *lines,
            verdicts,
            f"ways of a first scan {np.mean(self.ways):.0f}{near} in {np.mean(self.seconds):.0f} s",
            *told,
        ]

    def as_wanted(self, sigma_um: int) -> list[str]:
        """What is not as it should be; of ``sigma_um`` see ``MAX_RMS_Z_M``."""
        if not self.point:
            return ["no answer"]
        many = len(self.point) >= MANY
        found = []
        for name in ("point", "height", "tilt"):
            share = self.within(name, 0.95)
            if share < COVERED[0] or (many and share > COVERED[1]):
                found.append(f"{100 * share:.1f} % of {name} inside its 95 %")
        if self.nees > NEES[1] or (many and self.nees < NEES[0]):
            found.append(f"NEES {self.nees:.2f}")
        if self.rms[2] > MAX_RMS_Z_M.get(sigma_um, np.inf):
            found.append(f"RMS of the height {1e6 * self.rms[2]:.1f} um")
        wrong = {
            "refused": (len(self.refused), len(self.point)),
            "called moved": (self.called_moved, self.checks),
            "bumps not found": (self.bumps - self.found, self.bumps),
        }
        found += [
            f"{n} {name} of {of}" for name, (n, of) in wrong.items() if 100 * n > OF_100 * max(of, MANY)
        ]
        return found

    def _cover(self, *names: str) -> str:
        return ", ".join(
            f"{name} {100 * self.within(name, 0.95):.1f} / {100 * self.within(name, 0.99):.1f} %"
            for name in names
        )

    @property
    def rms(self) -> Array:
        """(3,) m."""
        found: Array = np.sqrt(np.mean(np.square(self.point), axis=0))
        return found

    @property
    def nees(self) -> float:
        """Mean squared error of the point in units of its covariance; 3 is right."""
        return nees(self.point, self.cov)

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
            "beams": (self.beams, self.beams_cov),
            "beams height": ([e[2:] for e in self.beams], [c[2:, 2:] for c in self.beams_cov]),
        }[name]
        pairs = zip(errors, covs, strict=True)
        return sum(bool(np.linalg.norm(e) > length_beyond(c, 1.0 - level)) for e, c in pairs)

    def within(self, name: str, level: float) -> float:
        """Share of errors within what is stated for ``level``."""
        of = len(self.beams if name.startswith("beams") else self.point)
        return 1.0 - self.outside(name, level) / of


def nees(errors: list[Array], covs: list[Array]) -> float:
    """Mean squared error (k,) in units of its covariance (k, k); k is right."""
    return float(np.mean([e @ np.linalg.solve(c, e) for e, c in zip(errors, covs, strict=True)]))


def _um(values: Array) -> str:
    return " ".join(f"{axis} {1e6 * float(v):.1f}" for axis, v in zip("xyz", values, strict=True))
