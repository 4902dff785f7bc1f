"""Which term of a predicted uncertainty is the largest, and that it is the one that helps."""

from functools import cache

import numpy as np
import pytest

from calibration.tool_frame.budget import END, HELPS, POLLS, REPEATABILITY, budget, dominating
from calibration.tool_frame.expected_height import ExpectedHeight, SearchPlan, expected_height
from calibration.tool_frame.prediction import ExpectedComparison, predict

Predicted = tuple[ExpectedComparison, ExpectedHeight]
ENOUGH_M = 2e-5 / float(np.sqrt(12.0))


def plan(period_s: float = 0.005, slow: float = 0.02) -> SearchPlan:
    return SearchPlan(0.05, slow, period_s, 8, 5e-3, ENOUGH_M, 0.006)


@cache
def predicted(noise_m: float, slow: float = 0.02, period_s: float = 0.005) -> Predicted:
    height = expected_height(plan(period_s, slow), noise_m)
    return predict(slow, period_s, 4, height.variance, noise_m=noise_m), height


@pytest.mark.parametrize(
    ("noise_m", "slow", "period_s", "term"),
    [(2e-5, 0.02, 0.005, REPEATABILITY), (1e-6, 0.05, 0.005, POLLS), (8e-6, 0.005, 0.02, END)],
)
def test_the_term_that_is_named_is_the_one_that_makes_the_prediction_better(
    noise_m: float, slow: float, period_s: float, term: str
) -> None:
    expected = predicted(noise_m, slow, period_s)
    parts = budget(*expected, *predicted(0.0, slow, period_s))
    assert dominating(parts) == term
    assert set(parts) == {POLLS, REPEATABILITY, END} == set(HELPS)
    assert all(part >= 0.0 for part in parts.values())
    assert sum(parts.values()) == pytest.approx(float(np.trace(expected[0].cov[:3, :3])), rel=1e-6)
