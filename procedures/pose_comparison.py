"""Do two poses differ by more than their covariances explain?"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtrc, chdtri, ndtri

from calibration.odds import FOUND
from cell.errors import error
from cell.formats.result import Covariance
from cell.poses import Array
from procedures.comparison import Compared, odds_line
from procedures.words import deg, mm, sigma_text

AXES = ("x", "y", "z", "about_x", "about_y", "about_z")


@dataclass(frozen=True)
class PoseComparison:
    """The second result less the first; of two poses ``T_first exp(xi) = T_second``."""

    name: str
    frame: str  # that ``xi`` is given in; empty for that of the first pose
    xi: Array  # (6,) m and rad, translation first
    cov: Array  # (6, 6) of xi
    degrees_of_freedom: int
    m2: float  # squared Mahalanobis distance; chi-square with so many degrees of freedom if nothing changed
    p: float
    false_alarm: float  # how often two measurements of the same pose are called different
    places: tuple[Sequence[float], ...] = ()  # both (3,) m, where the difference of their numbers is ``xi``

    @property
    def significant(self) -> bool:
        return self.p < self.false_alarm

    @property
    def detectable_m(self) -> float:
        """A shift that is called different with 99 % at least, whichever way it points."""
        worst = float(np.sqrt(np.max(np.linalg.eigvalsh(self.cov[:3, :3]))))
        limit = float(np.sqrt(chdtri(self.degrees_of_freedom, self.false_alarm)))
        return worst * (limit + float(ndtri(FOUND)))

    def as_dict(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "xi": self.xi.tolist(),
            "cov": self.cov.tolist(),
            "m2": self.m2,
            "degrees_of_freedom": self.degrees_of_freedom,
            "p": self.p,
            "significant": self.significant,
            "false_alarm": self.false_alarm,
            "detectable_m": self.detectable_m,
        }

    def rows(self) -> list[Compared]:
        """Along and about each axis of ``frame``; what neither run measured is left out."""
        sigmas = np.sqrt(np.diag(self.cov)).tolist()
        both = [*zip(*self.places, strict=True), *[(None, None)] * 6]
        return [
            Compared(name, "m" if i < 3 else "rad", float(self.xi[i]), sigmas[i], *both[i])
            for i, name in enumerate(AXES)
            if sigmas[i] > 0.0
        ]

    def text(self, first: str, second: str) -> str:
        """What a person wants to know: how much, against what, and whether it means anything."""
        xi = self.xi
        t, r = float(np.linalg.norm(xi[:3])), float(np.linalg.norm(xi[3:]))
        axes = ", ".join(f"{1e3 * v:.4f}" for v in xi[:3])
        turns = ", ".join(f"{np.degrees(v):.5f}" for v in xi[3:])
        verdict = (
            "they differ by more than their uncertainties explain"
            if self.significant
            else "the difference is within what their uncertainties explain"
        )
        frame = self.frame or f"the frame of {first}"
        dof = self.degrees_of_freedom
        return "\n".join(
            [
                f"{self.name}: {second} against {first}",
                f"  difference {mm(t, 4)}, {deg(r, 5)}",
                f"  x, y, z {axes} mm; about x, y, z {turns} deg (in {frame})",
                f"  standard uncertainty of the difference {sigma_text(self.cov.tolist())}",
                f"  squared Mahalanobis distance {self.m2:.1f} with {dof} degrees of freedom "
                f"(limit {chdtri(dof, self.false_alarm):.1f}), p = {self.p:.3g}",
                f"  {verdict}",
                f"  ({odds_line(self.false_alarm, 'shift', self.detectable_m)})",
                "  (the uncertainties are taken as independent; an error common to both runs does not show)",
            ]
        )


def require_covariances(first: Covariance | None, second: Covariance | None) -> tuple[Array, Array]:
    """Both (6, 6); ``ARGUMENT_INVALID`` when one of the answers has none."""
    if first is None or second is None:
        raise error("ARGUMENT_INVALID", "one of the results has no covariance, so nothing can be weighed")
    return np.array(first), np.array(second)


def weighed(
    name: str,
    frame: str,
    xi: Array,
    cov: Array,
    seen: Array,
    false_alarm: float,
    places: tuple[Sequence[float], ...] = (),
) -> PoseComparison:
    """``seen`` (6, k) has the directions that were measured."""
    along = seen.T @ xi
    m2 = float(along @ np.linalg.solve(seen.T @ cov @ seen, along))
    p = float(chdtrc(seen.shape[1], m2))
    return PoseComparison(name, frame, xi, cov, seen.shape[1], m2, p, false_alarm, places)
