"""``cellward compare`` of two calibrated arms: by where they put a reflector, not by their parameters.

Parameters stand for each other, and the base of an arm is known only as far as readings tell it. So the
second arm's places are brought to the first's by the rigid motion that suits them best; what is left is
the difference. It is held against what chance makes of it by the covariances of both, with the same motion
left out.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.identification.model import REGISTRATION
from calibration.identification.registration import register
from calibration.quadratic_forms import size_beyond
from calibration.tool_frame.meeting import detectable
from cell.errors import CellError, error
from cell.poses import Array
from procedures.comparison import Compared, odds_line
from procedures.tracker.calibrated_model import calibrated_model, covariance_of, freedom_of
from procedures.tracker.judging import places
from procedures.tracker.result import KincalResult
from procedures.words import mm

_SAME_KG = 1e-3


@dataclass(frozen=True)
class ArmComparison:
    """Distances (m) between the two arms' places of ``reflector`` at ``count`` joints of the first."""

    reflector: str
    count: int
    rms: float
    largest: float
    explained: float  # RMS that the uncertainties of both explain
    limit: float  # RMS that chance alone is beyond in ``false_alarm`` of all comparisons
    detectable: float  # RMS of a change that is found beyond the limit with 99 % at least
    false_alarm: float

    @property
    def significant(self) -> bool:
        return self.rms > self.limit

    def as_dict(self) -> dict[str, Any]:
        return {
            "name": "kinematics",
            "reflector": self.reflector,
            "places": self.count,
            "rms_m": self.rms,
            "max_m": self.largest,
            "explained_rms_m": self.explained,
            "limit_rms_m": self.limit,
            "significant": self.significant,
            "false_alarm": self.false_alarm,
            "detectable_m": self.detectable,
        }

    def rows(self) -> list[Compared]:
        """How far apart (RMS) they put the reflector."""
        return [
            Compared("apart_rms", "m", self.rms, self.explained),
            Compared("apart_max", "m", self.largest),
        ]

    def text(self, first: str, second: str) -> str:
        """What a person wants to know."""
        verdict = (
            "they differ by more than their uncertainties explain"
            if self.significant
            else "the difference is within what their uncertainties explain"
        )
        return "\n".join(
            [
                f"kinematics: {second} against {first}, place of reflector {self.reflector} at {self.count} "
                "joints of the first",
                f"  they put it {mm(self.rms, 4)} from each other (RMS; at most {mm(self.largest, 4)}), the "
                "base registered anew",
                f"  their uncertainties explain {mm(self.explained, 4)} (RMS; limit {mm(self.limit, 4)})",
                f"  {verdict}",
                f"  ({odds_line(self.false_alarm, 'change (RMS)', self.detectable)})",
            ]
        )


def compare_arms(first: KincalResult, second: KincalResult, false_alarm: float) -> ArmComparison:
    """``PAYLOAD_DIFFERS`` for different loads; ``ARGUMENT_INVALID`` for arms that cannot be compared."""
    load, other = first.inputs.payload_kg, second.inputs.payload_kg
    if load is not None and other is not None and abs(load - other) > _SAME_KG:
        raise error("PAYLOAD_DIFFERS", f"one run was made with {load:g} kg, the other with {other:g} kg")
    if (load is None) != (other is None):
        raise error("ARGUMENT_INVALID", "one of the results does not say its payload_kg, so it may differ")
    robots = first.result.robot, second.result.robot
    common = sorted({*first.inputs.targets} & {*second.inputs.targets})
    if not common:
        raise error("ARGUMENT_INVALID", "the two runs have no reflector in common")
    sure = first.uncertainty.predicted_95
    if sure is None:
        raise _no_uncertainty()
    samples = [{"q": place.q, "target": common[0]} for place in sure.workspace.places]
    try:
        p, q = (places(robot, samples) for robot in robots)
    except ValueError as exc:
        raise error("ARGUMENT_INVALID", "the two runs are of arms with different joints") from exc
    best = register(p.T, q.T, np.ones(len(p)))
    off = np.linalg.norm(best.to_tracker(q.T).T - p, axis=1)
    cov, freedom = _by_chance(first, second, np.array([s["q"] for s in samples]), common[0])
    limit = size_beyond(np.maximum(np.linalg.eigvalsh(cov), 0.0), false_alarm, freedom)
    return ArmComparison(
        reflector=common[0],
        count=len(off),
        rms=float(np.sqrt(np.mean(off**2))),
        largest=float(off.max()),
        explained=float(np.sqrt(np.trace(cov))),
        limit=limit,
        detectable=detectable(cov, limit),
        false_alarm=false_alarm,
    )


def _by_chance(first: KincalResult, second: KincalResult, Q: Array, reflector: str) -> tuple[Array, float]:
    """Covariance (3n, 3n) of all numbers of the difference at joints ``Q`` (n, j), over n, so that their
    squares add up to the mean square distance; and the degrees of freedom that its size is known with.

    What the rigid motion between both takes up is out of it, and with it all that readings leave open of the
    tracker's place. Of two estimated sizes the degrees of freedom are those of Welch and Satterthwaite.
    """
    parts, freedoms, rigid = list[Array](), list[float](), np.zeros((3 * len(Q), REGISTRATION))
    for k, found in enumerate((first, second)):
        model = calibrated_model(found)
        if (cov := covariance_of(found, model)) is None:
            raise _no_uncertainty()
        target = np.full(len(Q), model.targets.index(reflector), dtype=np.int64)
        J = model.linearised(model.nominal, Q, target)[1].reshape(len(cov), -1)
        if k == 0:
            rigid = np.linalg.qr(J[-REGISTRATION:].T)[0]
        J = J - (J @ rigid) @ rigid.T
        parts.append(J.T @ cov @ J / len(Q))
        freedoms.append(freedom_of(found))
    sizes = np.array([np.trace(part) for part in parts])
    unsure = float(np.sum(sizes**2 / np.array(freedoms)))
    return parts[0] + parts[1], float(np.sum(sizes)) ** 2 / unsure if unsure > 0.0 else np.inf


def _no_uncertainty() -> CellError:
    return error(
        "ARGUMENT_INVALID", "one of the results has no covariance of its numbers, so nothing can be weighed"
    )
