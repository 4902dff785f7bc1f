"""Whether the interval of a belt's scale holds the truth as often as it says, over whole runs of the job."""

from pathlib import Path

import numpy as np
import pytest

from tests.kit.belt_runs import BELTS, calibrated
from tests.kit.object_cell import no_report

__all__ = ["no_report"]
pytestmark = [pytest.mark.usefixtures("no_report"), pytest.mark.soak]
RUNS = 40


@pytest.mark.parametrize("belt", BELTS)
def test_the_intervals_of_forty_runs_hold_the_true_scale(belt: str, tmp_path: Path) -> None:
    found = []
    for seed in range(RUNS):
        folder = tmp_path / str(seed)
        folder.mkdir()
        found.append(calibrated(folder, seed, BELTS[belt]))
    held = np.mean([abs(run.off) <= run.half for run in found])
    assert held >= 0.85, held  # 95 %, three standard deviations less
    noise = 1.96 * np.sqrt(np.mean([run.off**2 for run in found]))
    assert np.median([run.half for run in found]) < 2.0 * noise
