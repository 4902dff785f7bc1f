"""``cellward compare``: do two results differ by more than their uncertainties explain?"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import chdtrc, chdtri

from cell.errors import error
from cell.poses import Array, from_pose6, log_xi
from daemon.cli.compare_arms import ArmComparison, compare_arms
from daemon.cli.compare_iso9283 import IsoComparison, compare_iso9283
from daemon.cli.result_text import calibration_name, sigma_text
from procedures.words import deg, mm

SIGNIFICANT_P = 0.05


@dataclass(frozen=True)
class Comparison:
    """The second result less the first; of two poses ``T_first exp(xi) = T_second``."""

    name: str
    frame: str  # that ``xi`` is given in; empty for that of the first pose
    xi: Array  # (6,) m and rad, translation first
    cov: Array  # (6, 6) of xi
    degrees_of_freedom: int
    m2: float  # squared Mahalanobis distance; chi-square with so many degrees of freedom if nothing changed
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
            "degrees_of_freedom": self.degrees_of_freedom,
            "p": self.p,
            "significant": self.significant,
        }


AnyComparison = Comparison | ArmComparison | IsoComparison


def compare_results(first: Mapping[str, Any], second: Mapping[str, Any]) -> AnyComparison:
    """Compare two result documents; ``ARGUMENT_INVALID`` when they do not hold the same kind of answer."""
    kinds = [str(document.get("kind")) for document in (first, second)]
    if kinds[0] != kinds[1]:
        raise error("ARGUMENT_INVALID", f"one run holds a {kinds[0]} result, the other a {kinds[1]} result")
    compare = _COMPARED.get(kinds[0])
    answers = [document.get("result") or {} for document in (first, second)]
    if compare is None or not all(answers):
        raise error("ARGUMENT_INVALID", f"only {' and '.join(_COMPARED)} results with an answer are compared")
    if kinds[0] in ("hand-eye", "laser") and any(answer.get("cov") is None for answer in answers):
        raise error("ARGUMENT_INVALID", "one of the results has no covariance, so nothing can be weighed")
    return compare(first, second)


def _hand_eye(first: Mapping[str, Any], second: Mapping[str, Any]) -> Comparison:
    answers = first["result"], second["result"]
    names = [calibration_name(answer) for answer in answers]
    if None in names:
        raise error("ARGUMENT_INVALID", "a hand-eye result without a pose cannot be compared")
    if names[0] != names[1]:
        raise error("ARGUMENT_INVALID", f"one run holds {names[0]}, the other {names[1]}")
    a, b = (from_pose6(answer[names[0]]) for answer in answers)
    between = a.inv() * b
    # An error exp(e) on the right of T_first is exp(-Ad(between^-1) e) on the right of the difference.
    carried = adjoint(between.inv().as_matrix())
    cov_a, cov_b = (np.array(answer["cov"]) for answer in answers)
    return _weighed(str(names[0]), "", log_xi(between), carried @ cov_a @ carried.T + cov_b, np.eye(6))


def _laser(first: Mapping[str, Any], second: Mapping[str, Any]) -> Comparison:
    """Tilts are small, so that their rotation vectors are subtracted; without both, only the point counts."""
    tools = [(document.get("inputs") or {}).get("tool") for document in (first, second)]
    if tools[0] != tools[1]:
        raise error("ARGUMENT_INVALID", f"one run measured tool '{tools[0]}', the other '{tools[1]}'")
    answers = first["result"], second["result"]
    turned = [answer.get("drot_flange") for answer in answers]
    xi, cov = np.zeros(6), np.sum([np.array(answer["cov"]) for answer in answers], axis=0)
    xi[:3] = np.subtract(answers[1]["dp_flange"], answers[0]["dp_flange"])
    seen = np.eye(6)[:, :3]
    if None in turned:
        cov[3:, :] = cov[:, 3:] = 0.0
    else:
        xi[3:] = np.subtract(turned[1], turned[0])
        seen = np.zeros((6, 5))
        seen[:3, :3] = np.eye(3)
        # The spin about the tool's axis is in no measurement; it is the direction without any error.
        seen[3:, 3:] = np.linalg.eigh(cov[3:, 3:])[1][:, 1:]
    return _weighed("dp_flange", "the flange", xi, cov, seen)


def _weighed(name: str, frame: str, xi: Array, cov: Array, seen: Array) -> Comparison:
    """``seen`` (6, k) has the directions that were measured."""
    along = seen.T @ xi
    m2 = float(along @ np.linalg.solve(seen.T @ cov @ seen, along))
    return Comparison(name, frame, xi, cov, seen.shape[1], m2, float(chdtrc(seen.shape[1], m2)))


def adjoint(T: Array) -> Array:
    """(6, 6) with ``T exp(xi) T^-1 = exp(Ad(T) xi)``, translation first (Barfoot 2017, eq. 7.45)."""
    R, (x, y, z) = T[:3, :3], T[:3, 3]
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.block([[R, skew @ R], [np.zeros((3, 3)), R]])


def comparison_text(comparison: AnyComparison, first: str, second: str) -> str:
    """What a person wants to know: how much, against what, and whether it means anything."""
    if isinstance(comparison, ArmComparison | IsoComparison):
        return comparison.text(first, second)
    xi = comparison.xi
    t, r = float(np.linalg.norm(xi[:3])), float(np.linalg.norm(xi[3:]))
    axes = ", ".join(f"{1e3 * v:.4f}" for v in xi[:3])
    turns = ", ".join(f"{np.degrees(v):.5f}" for v in xi[3:])
    verdict = (
        "they differ by more than their uncertainties explain"
        if comparison.significant
        else "the difference is within what their uncertainties explain"
    )
    frame = comparison.frame or f"the frame of {first}"
    dof = comparison.degrees_of_freedom
    return "\n".join(
        [
            f"{comparison.name}: {second} against {first}",
            f"  difference {mm(t, 4)}, {deg(r, 5)}",
            f"  x, y, z {axes} mm; about x, y, z {turns} deg (in {frame})",
            f"  standard uncertainty of the difference {sigma_text(comparison.cov.tolist())}",
            f"  squared Mahalanobis distance {comparison.m2:.1f} with {dof} degrees of freedom "
            f"(95 % below {chdtri(dof, 0.05):.1f}), p = {comparison.p:.3g}",
            f"  {verdict}",
            "  (the uncertainties are taken as independent; an error common to both runs does not show)",
        ]
    )


_COMPARED: dict[str, Callable[[Mapping[str, Any], Mapping[str, Any]], AnyComparison]] = {
    "hand-eye": _hand_eye,
    "laser": _laser,
    "kincal": compare_arms,
    "iso9283": compare_iso9283,
}
