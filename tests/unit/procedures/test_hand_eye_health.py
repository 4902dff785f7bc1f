"""Figures of a hand-eye calibration are kept over the runs, and a camera that moved is noticed."""

from pathlib import Path

import numpy as np
import pytest

from fakes.object import run_virtual
from procedures.documents import read_result
from procedures.hand_eye.health import moved
from procedures.hand_eye.words import hand_eye_lines
from tests.kit.object_cell import no_report, on_disk, open_cell, write_config
from tests.kit.whole_results import made

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")
NAME = "T_flange_camera"


def test_a_second_run_is_held_against_the_version_of_the_first_and_adds_to_its_trends(tmp_path: Path) -> None:
    config = write_config(tmp_path, job={"poses_per_placement": 6, "accept": {"auto": True}})

    async def main() -> None:
        async with open_cell(config) as cell:
            await cell.run_job()
            first = cell.result(1)
            assert "moved" not in first["inputs"]
            await cell.run_job()
            second = cell.result(2)
            assert second["inputs"]["moved"]["version"] == 1
            assert second["inputs"]["moved"]["beyond_uncertainty"] is False
            assert "from version 1, as two such" in "\n".join(hand_eye_lines(read_result(second)))
            trend = second["inputs"]["trend"]
            for quantity in ("noise_px", "spread_within_m", "arm_m"):
                ((_, one), (_, two)) = trend[f"hand_eye.{quantity}.{NAME}"]
                assert min(one, two) > 0.0
            ((_, shift),) = trend[f"hand_eye.moved_m.{NAME}"]
            assert shift == second["inputs"]["moved"]["t"] > 0.0
            assert len(on_disk(cell.ledger.trend, f"hand_eye.noise_px.{NAME}")) == 2

    run_virtual(main())


@pytest.mark.parametrize(("shift_m", "beyond"), [(1e-4, False), (8e-4, True)])
def test_a_shift_counts_when_two_such_results_hardly_differ_by_it(shift_m: float, beyond: bool) -> None:
    cov, pose = (np.diag([1e-4] * 6) ** 2).tolist(), [0.1, 0.0, 0.05, 0.0, 0.0, 0.0]
    answer = made({"kind": "hand-eye", "verdict": "pass", "result": {"cov": cov, NAME: pose}}).result
    found = moved(answer, [0.1 + shift_m, 0.0, 0.05, 0.0, 0.0, 0.0], 3)
    assert found is not None
    assert (found.version, found.t, found.r) == (3, pytest.approx(shift_m), 0.0)
    assert found.beyond_uncertainty is beyond
    assert found.false_alarm == 1e-3
    assert moved(answer.changed(cov=None), [0.0] * 6, 3) is None
