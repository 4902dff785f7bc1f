"""Two hand-eye calibrations against each other."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from cell.errors import error
from cell.poses import adjoint, from_pose6, log_xi
from procedures.comparison import Compared
from procedures.hand_eye.result import HandEyeAnswer, HandEyeResult
from procedures.hand_eye.words import spread_lines
from procedures.pose_comparison import PoseComparison, require_covariances, weighed

_SPREADS = ("spread_within", "spread_across", "neighbour_spread")


@dataclass(frozen=True)
class HandEyeComparison:
    """The poses against each other, and the spreads beside each other."""

    pose: PoseComparison
    answers: tuple[HandEyeAnswer, HandEyeAnswer]

    def as_dict(self) -> dict[str, Any]:
        spreads = [
            {key: None if (of := getattr(answer, key)) is None else of.model_dump() for key in _SPREADS}
            for answer in self.answers
        ]
        return self.pose.as_dict() | {"spreads": spreads}

    def rows(self) -> list[Compared]:
        """The pose's axes, then the spreads that both have."""
        return self.pose.rows() + [row for key in _SPREADS[:2] for row in self._spread(key)]

    def _spread(self, key: str) -> list[Compared]:
        a, b = (getattr(answer, key) for answer in self.answers)
        if a is None or b is None:
            return []
        return [
            Compared(f"{key}_t", "m", b.t_norm - a.t_norm, None, a.t_norm, b.t_norm),
            Compared(f"{key}_r", "rad", b.r - a.r, None, a.r, b.r),
        ]

    def text(self, first: str, second: str) -> str:
        lines = [self.pose.text(first, second)]
        for name, answer in zip((first, second), self.answers, strict=True):
            lines += [f"  {name}: {line}" for line in spread_lines(answer)]
        return "\n".join(lines)


def compare_hand_eye(first: HandEyeResult, second: HandEyeResult, false_alarm: float) -> HandEyeComparison:
    """``ARGUMENT_INVALID`` for results without covariance, or of different poses."""
    cov_a, cov_b = require_covariances(first.result.cov, second.result.cov)
    held_a, held_b = first.result.pose(), second.result.pose()
    if held_a is None or held_b is None:
        raise error("ARGUMENT_INVALID", "a hand-eye result without a pose cannot be compared")
    (name, pose_a), (other, pose_b) = held_a, held_b
    if name != other:
        raise error("ARGUMENT_INVALID", f"one run holds {name}, the other {other}")
    a, b = from_pose6(pose_a), from_pose6(pose_b)
    between = a.inv() * b
    # An error exp(e) on the right of T_first is exp(-Ad(between^-1) e) on the right of the difference.
    carried = adjoint(between.inv().as_matrix())
    cov = carried @ cov_a @ carried.T + cov_b
    pose = weighed(name, "", log_xi(between), cov, np.eye(6), false_alarm)
    return HandEyeComparison(pose, (first.result, second.result))
