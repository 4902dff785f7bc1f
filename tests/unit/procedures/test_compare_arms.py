"""Two calibrations of one arm are called different as seldom as was asked for."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.errors import CellError
from procedures.comparison import compare_results
from procedures.tracker.comparison import ArmComparison
from tests.kit.kincal_scene import SIGMA0, SIGMA_PER_M, Scene, joints, make_scene
from tests.kit.solved import solve_kincal

PAIRS, POSES = 12, 60


def measured_again(scene: Scene, seed: int, folder: Path, given: bool) -> dict[str, Any]:
    """The result of other poses of the same arm, with noise of their own."""
    rng = np.random.default_rng(seed)
    Q = joints("ur10e", rng, POSES)
    p = scene.truth.p_tracker(Q, ["smr1"] * POSES)
    p += rng.normal(size=p.shape) * (SIGMA0 + SIGMA_PER_M * np.linalg.norm(p, axis=1))[:, None]
    samples = [
        {"q": q.tolist(), "p_tracker": at.tolist(), "target": "smr1"} for q, at in zip(Q, p, strict=True)
    ]
    noise = {"sigma0": SIGMA0, "sigma_per_m": SIGMA_PER_M} if given else None
    other = scene.changed(samples=samples, payload_kg=1.0, noise=noise)
    return solve_kincal(other.write(folder, f"{seed}.json"))


def compared(first: dict[str, Any], second: dict[str, Any], chance: float | None = None) -> ArmComparison:
    found = compare_results(first, second, false_alarm=chance)
    assert isinstance(found, ArmComparison)
    return found


def test_like_arms_differ_by_what_is_explained_and_half_of_them_by_the_limit_of_one_in_two(
    tmp_path: Path,
) -> None:
    arms = [make_scene("ur10e", seed) for seed in range(PAIRS)]
    pairs = [[measured_again(a, 2 * k + i, tmp_path, True) for i in (0, 1)] for k, a in enumerate(arms)]
    found = [compared(*pair, 0.5) for pair in pairs]
    share = np.mean([(c.rms / c.explained) ** 2 for c in found])
    assert share == pytest.approx(1.0, abs=0.3)  # some 25 numbers a pair: 0.08 by chance
    assert 2 <= sum(c.significant for c in found) <= PAIRS - 2
    assert not any(compared(*pair).significant for pair in pairs)


def test_the_level_is_in_words_and_figures_and_a_rarer_false_alarm_asks_for_more(tmp_path: Path) -> None:
    arm = make_scene("ur10e")
    first, second = (measured_again(arm, seed, tmp_path, given) for seed, given in ((1, True), (2, False)))
    usual, lax = compared(first, second), compared(first, second, 0.05)
    assert "in 1 of 300 comparisons, a change (RMS) of" in usual.text("run 1", "run 2")
    assert "in 1 of 20 comparisons" in lax.text("run 1", "run 2")
    figures = lax.as_dict()
    assert figures["false_alarm"] == 0.05
    assert figures["explained_rms_m"] < figures["limit_rms_m"] < usual.as_dict()["limit_rms_m"]
    assert figures["limit_rms_m"] < figures["detectable_m"] < usual.as_dict()["detectable_m"]
    second["uncertainty"]["cov"] = None
    with pytest.raises(CellError, match="no covariance of its numbers"):
        compared(first, second)
