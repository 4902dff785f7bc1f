"""Which term of a predicted uncertainty is the largest, and that it is the one that helps."""

from functools import cache

import numpy as np
import pytest

from calibration.tool_frame.budget import END, HELPS, POLLS, REPEATABILITY, budget, dominating
from calibration.tool_frame.prediction import ExpectedComparison, predict

PAIRS = 4.0


@cache
def predicted(noise_m: float, speed_m_s: float = 0.02) -> ExpectedComparison:
    return predict(speed_m_s, 0.005, 4, 2e-5, noise_m=noise_m, height_pairs=PAIRS)


@pytest.mark.parametrize(("noise_m", "speed_m_s", "term"), [(2e-5, 0.02, REPEATABILITY), (1e-6, 0.05, POLLS)])
def test_the_term_that_is_named_is_the_one_that_makes_the_prediction_better(
    noise_m: float, speed_m_s: float, term: str
) -> None:
    perfect = predicted(0.0, speed_m_s)
    parts = budget(predicted(noise_m, speed_m_s), perfect, noise_m, PAIRS)
    assert dominating(parts) == term
    assert set(parts) == {POLLS, REPEATABILITY, END} == set(HELPS)
    assert sum(parts.values()) == pytest.approx(
        float(np.trace(predicted(noise_m, speed_m_s).cov[:3, :3])), rel=1e-6
    )


def test_an_arm_that_repeats_perfectly_leaves_polls_alone() -> None:
    parts = budget(predicted(0.0), predicted(0.0), 0.0, PAIRS)
    assert parts[REPEATABILITY] == parts[END] == 0.0
