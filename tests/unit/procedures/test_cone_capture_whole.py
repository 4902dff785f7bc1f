"""The whole job on virtual time: from the start command to a proposed result, judged against the truth."""

from pathlib import Path

import numpy as np
import pytest

from cell.poses import from_pose6, log_xi
from fakes.object import run_virtual
from tests.kit.object_cell import ObjectCell, no_report, open_cell, write_config

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

MAHALANOBIS_LIMIT = 20.1  # 99.7 % of a chi-squared with 6 degrees of freedom
SETUPS = {
    "eye-in-hand": ("hand_eye", "T_flange_camera"),
    "as in a workshop": ("workshop", "T_flange_camera"),
    "eye-to-hand": ("hand_eye_to_hand", "T_base_camera"),
}
FILES = {"run.json", "journal.jsonl", "poses.jsonl", "capture.json", "result.json", "end.json"}


def off_in_sigmas_squared(cell: ObjectCell, run_id: int, name: str) -> float:
    """Squared Mahalanobis distance of the result from the twin's truth."""
    result = cell.result(run_id)
    xi = log_xi(from_pose6(cell.plant.world.truth()[name]).inv() * from_pose6(result["result"][name]))
    return float(xi @ np.linalg.solve(np.array(result["uncertainty"]["cov"]), xi))


@pytest.mark.parametrize("setup", SETUPS)
def test_a_job_finds_the_truth_within_its_own_uncertainty(setup: str, tmp_path: Path) -> None:
    scenario, name = SETUPS[setup]
    config = write_config(
        tmp_path, scenario, {"placements": 2, "poses_per_placement": 6, "frames_per_pose": 5}
    )

    async def main() -> None:
        async with open_cell(config) as cell:
            run_id = await cell.start()
            end = await cell.finished(run_id)
            assert (end["outcome"], end["packml"], end["verdict"]) == ("complete", "COMPLETE", "pass")
            assert off_in_sigmas_squared(cell, run_id, name) <= MAHALANOBIS_LIMIT
            assert {f.name for f in cell.folder(run_id).path.iterdir()} >= FILES
            assert {o["group"] for o in cell.poses(run_id)} == {0, 1}
            assert len(cell.poses(run_id)) == 12
            assert len(cell.notes(run_id, "prompt")) == len(cell.notes(run_id, "confirm")) == 2
            assert cell.journal(run_id)[-1]["terminal"] is True
            (known,) = cell.notes(run_id, "known so far")  # after the first placement
            assert known["error95_t_m"] > cell.result(run_id)["uncertainty"]["error95_t_m"]
            _, rows = cell.engine.run.traces["known"].since(0, 9)  # what the page draws against the limit
            assert rows == [(1, known["error95_t_m"], 0.0005)]
            first, asked = cell.notes(run_id, "prompt")
            assert first["text"].startswith("Placement 1 of 2: ")
            assert "So far the camera's pose is known to" in asked["text"]
            assert len(cell.notes(run_id, "standstill")) == 2
            assert cell.at_rest()

    run_virtual(main())


def test_the_same_run_gives_the_same_answer_bit_by_bit(tmp_path: Path) -> None:
    async def main(folder: Path) -> object:
        async with open_cell(write_config(folder)) as cell:
            await cell.run_job()
            return cell.result(1)["result"]

    for name in "ab":
        (tmp_path / name).mkdir()
    assert run_virtual(main(tmp_path / "a")) == run_virtual(main(tmp_path / "b"))


def test_a_dry_run_lists_the_plan_without_a_move_and_takes_no_lease(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            before = cell.plant.world.track.at(cell.clock.now())[0]
            shown = await cell.dry_run()
            plan = shown["plan"]
            assert len(plan["poses"]) == 4
            assert all(pose["checks"] for pose in plan["poses"])
            assert plan["predicted"]["error95_t_m"] > 0.0
            assert np.array_equal(cell.plant.world.track.at(cell.clock.now())[0], before)
            assert not [n for n in cell.journal(shown["run_id"]) if n["kind"] == "motion"]
            assert cell.folder(shown["run_id"]).read_end() is not None
            assert not cell.engine.active

    run_virtual(main())
