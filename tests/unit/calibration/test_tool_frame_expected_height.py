"""How well a height will be known, before anything moves, beside searches of which the height is known."""

import numpy as np
import pytest

from calibration.tool_frame.expected_height import SearchPlan, expected_height
from calibration.tool_frame.height import first_contact, mixed
from calibration.tool_frame.repeatability import scatter_of
from calibration.tool_frame.tip import ENDS
from tests.kit import height_scene
from tests.kit.height_scene import CHORD_M, FAST, FLAT_END, SLOW, VIEW, searched

SIGMA_M, STEP_M, PAIRS = 1e-5, 5e-3, 8
SCATTER = scatter_of(np.sqrt(2.0) * SIGMA_M, SIGMA_M)


def plan(period_s: float, fingers: bool = False) -> SearchPlan:
    return SearchPlan(FAST, SLOW, period_s, PAIRS, STEP_M, 0.0, CHORD_M, fingers)


@pytest.mark.parametrize("period_s", [0.005, 0.02])
def test_what_is_predicted_is_about_what_searches_come_to(
    monkeypatch: pytest.MonkeyPatch, period_s: float
) -> None:
    monkeypatch.setattr(height_scene, "PERIOD_S", period_s)
    rng = np.random.default_rng(5)
    errors, stated = [], []
    for _ in range(8):
        found, truth = searched(rng, FLAT_END, SIGMA_M, PAIRS, STEP_M)
        density = first_contact(found.belief.glimpses, VIEW, ENDS, SCATTER, 0.0, STEP_M)
        mean, cov, _ = mixed([density], ENDS, SCATTER)
        errors.append(float(mean[0]) - truth)
        stated.append(float(np.sqrt(cov[0, 0])))
    expected = np.sqrt(expected_height(plan(period_s), SIGMA_M).variance)
    assert np.median(np.abs(errors)) < 1.2 * expected
    assert 0.6 * expected < np.median(stated) < 1.6 * expected


def test_polls_that_are_far_apart_cost_what_a_known_shape_would_spare() -> None:
    near, far = (expected_height(plan(period_s), SIGMA_M) for period_s in (0.005, 0.02))
    assert near.variance < 1.6 * near.known_end
    assert far.variance > 4.0 * far.known_end
    assert far.known_end < 2.0 * near.known_end


def test_of_fingers_hits_alone_tell_and_slower_polls_tell_less() -> None:
    near, far = (expected_height(plan(period, fingers=True), SIGMA_M) for period in (0.005, 0.02))
    assert 0.0 < near.variance < far.variance


def test_few_passes_and_an_arm_that_scatters_are_told_worse() -> None:
    usual, few, bad = (
        np.sqrt(expected_height(SearchPlan(FAST, SLOW, 0.005, n, STEP_M, 0.0, CHORD_M), s).variance)
        for n, s in ((PAIRS, SIGMA_M), (4, SIGMA_M), (PAIRS, 3e-5))
    )
    assert few > 2.0 * usual
    assert bad > 1.5 * usual
