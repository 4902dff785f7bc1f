"""``cellward compare``: do two hand-eye results differ by more than their uncertainties explain?"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2

from cell.errors import error
from cell.poses import Array, from_pose6, log_xi
from daemon.cli.output import deg, mm
from daemon.cli.result_text import calibration_name, sigma_text

SIGNIFICANT_P = 0.05


@dataclass(frozen=True)
class Comparison:
    """The second pose seen from the first: ``T_first exp(xi) = T_second``."""

    name: str
    xi: Array  # (6,) m and rad, translation first
    cov: Array  # (6, 6) of xi
    m2: float  # squared Mahalanobis distance; chi-square with 6 degrees of freedom if nothing changed
    p: float

    @property
    def significant(self) -> bool:
        return self.p < SIGNIFICANT_P

    def as_dict(self) -> dict[str, Any]:
        return {
            "name": self.name,
            "xi": self.xi.tolist(),
            "cov": self.cov.tolist(),
            "m2": self.m2,
            "degrees_of_freedom": 6,
            "p": self.p,
            "significant": self.significant,
        }


def compare_results(first: Mapping[str, Any], second: Mapping[str, Any]) -> Comparison:
    """Compare two result documents; ``ARGUMENT_INVALID`` when they do not hold the same kind of pose."""
    answers = [document.get("result") or {} for document in (first, second)]
    names = [calibration_name(answer) for answer in answers]
    if None in names:
        raise error("ARGUMENT_INVALID", "only hand-eye results with an answer can be compared")
    if names[0] != names[1]:
        raise error("ARGUMENT_INVALID", f"one run holds {names[0]}, the other {names[1]}")
    if any(answer.get("cov") is None for answer in answers):
        raise error("ARGUMENT_INVALID", "one of the results has no covariance, so nothing can be weighed")
    a, b = (from_pose6(answer[names[0]]) for answer in answers)
    between = a.inv() * b
    xi = log_xi(between)
    # An error exp(e) on the right of T_first is exp(-Ad(between^-1) e) on the right of the difference.
    carried = adjoint(between.inv().as_matrix())
    cov_a, cov_b = (np.array(answer["cov"]) for answer in answers)
    cov = carried @ cov_a @ carried.T + cov_b
    m2 = float(xi @ np.linalg.solve(cov, xi))
    return Comparison(str(names[0]), xi, cov, m2, float(chi2.sf(m2, 6)))


def adjoint(T: Array) -> Array:
    """(6, 6) with ``T exp(xi) T^-1 = exp(Ad(T) xi)``, translation first (Barfoot 2017, eq. 7.45)."""
    R, (x, y, z) = T[:3, :3], T[:3, 3]
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.block([[R, skew @ R], [np.zeros((3, 3)), R]])


def comparison_text(comparison: Comparison, first: str, second: str) -> str:
    """What a person wants to know: how much, against what, and whether it means anything."""
    xi = comparison.xi
    t, r = float(np.linalg.norm(xi[:3])), float(np.linalg.norm(xi[3:]))
    axes = ", ".join(f"{1e3 * v:.4f}" for v in xi[:3])
    turns = ", ".join(f"{np.degrees(v):.5f}" for v in xi[3:])
    verdict = (
        "they differ by more than their uncertainties explain"
        if comparison.significant
        else "the difference is within what their uncertainties explain"
    )
    return "\n".join(
        [
            f"{comparison.name}: {second} against {first}",
            f"  difference {mm(t, 4)}, {deg(r, 5)}",
            f"  x, y, z {axes} mm; about x, y, z {turns} deg (in the frame of {first})",
            f"  standard uncertainty of the difference {sigma_text(comparison.cov.tolist())}",
            f"  squared Mahalanobis distance {comparison.m2:.1f} with 6 degrees of freedom "
            f"(95 % below 12.6), p = {comparison.p:.3g}",
            f"  {verdict}",
            "  (the uncertainties are taken as independent; an error common to both runs does not show)",
        ]
    )
