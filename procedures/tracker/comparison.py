"""``cellward compare`` of two calibrated arms: by where they put a reflector, not by their parameters.

Parameters stand for each other, and the base of an arm is known only as far as readings tell it. So the
second arm's places are brought to the first's by the rigid motion that suits them best; what is left is
the difference.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from calibration.identification.registration import register
from cell.errors import error
from procedures.comparison import Compared
from procedures.tracker.judging import places
from procedures.tracker.result import KincalResult
from procedures.words import mm

_SAME_KG = 1e-3
_RMS_OF_95 = 0.62  # of an isotropic normal error in space: sqrt(3) sigma over 2.795 sigma
_CHANCE = 1.3  # 95 % of differences of two like arms stay below this, with some twenty numbers that differ


@dataclass(frozen=True)
class ArmComparison:
    """Distances (m) between the two arms' places of ``reflector`` at ``count`` joints of the first."""

    reflector: str
    count: int
    rms: float
    largest: float
    explained: float  # RMS that the uncertainties of both explain

    @property
    def significant(self) -> bool:
        return self.rms > _CHANCE * self.explained

    def as_dict(self) -> dict[str, Any]:
        return {
            "name": "kinematics",
            "reflector": self.reflector,
            "places": self.count,
            "rms_m": self.rms,
            "max_m": self.largest,
            "explained_rms_m": self.explained,
            "significant": self.significant,
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
                f"  their uncertainties explain {mm(self.explained, 4)} (RMS)",
                f"  {verdict}",
            ]
        )


def compare_arms(first: KincalResult, second: KincalResult) -> ArmComparison:
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
    sure_a, sure_b = first.uncertainty.predicted_95, second.uncertainty.predicted_95
    if sure_a is None or sure_b is None:
        raise error("ARGUMENT_INVALID", "one of the results has no uncertainty, so nothing can be weighed")
    samples = [{"q": place.q, "target": common[0]} for place in sure_a.workspace.places]
    try:
        p, q = (places(robot, samples) for robot in robots)
    except ValueError as exc:
        raise error("ARGUMENT_INVALID", "the two runs are of arms with different joints") from exc
    best = register(p.T, q.T, np.ones(len(p)))
    off = np.linalg.norm(best.to_tracker(q.T).T - p, axis=1)
    explained = _RMS_OF_95 * float(np.hypot(sure_a.workspace.median, sure_b.workspace.median))
    return ArmComparison(common[0], len(off), float(np.sqrt(np.mean(off**2))), float(off.max()), explained)
