"""A run that was cut short, and the run that takes its finished poses over."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from daemon.config import CellConfig
from fakes.object import VirtualClock, run_virtual
from tests.kit.object_cell import ObjectCell, no_report, open_cell, refused, write_config

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")


async def cut_short(cell: ObjectCell, after_poses: int) -> int:
    """A run whose daemon is killed after so many finished poses; what is on disk then has no end."""
    run_id = await cell.start()

    def enough() -> bool:
        journal = cell.folder(run_id).path / "journal.jsonl"
        return journal.exists() and journal.read_text("utf-8").count('"pose taken"') >= after_poses

    while not enough():
        await cell.answer()
        await cell.clock.sleep(0.05)
    await cell.kill()
    folder = cell.folder(run_id).path
    (folder / "end.json").unlink()
    journal = folder / "journal.jsonl"
    lines = [line for line in journal.read_text("utf-8").splitlines() if "terminal" not in json.loads(line)]
    journal.write_text("\n".join(lines) + "\n", "utf-8")
    return run_id


def finished_poses(cell: ObjectCell, run_id: int) -> list[dict[str, Any]]:
    lines = (cell.folder(run_id).path / "poses.jsonl").read_text("utf-8").splitlines()
    return [pose for pose in map(json.loads, lines) if pose["kind"] == "pose"]


def two_lives(
    config: CellConfig,
    after_poses: int,
    second_life: Callable[[ObjectCell, int], Any],
    second_config: CellConfig | None = None,
) -> None:
    """Kill a run, begin again on the same world with the same files, and see what the second life does."""

    async def main() -> None:
        clock = VirtualClock()
        first = ObjectCell(config, clock)
        await first.open()
        run_id = await cut_short(first, after_poses)
        await clock.sleep(5.0)
        async with open_cell(second_config or config, clock) as cell:
            await second_life(cell, run_id)

    run_virtual(main())


def test_an_interrupted_run_is_reported_and_nothing_moves_by_itself(tmp_path: Path) -> None:
    async def look(cell: ObjectCell, run_id: int) -> None:
        before = cell.plant.world.track.at(cell.clock.now())[0]
        assert cell.engine.status()["interrupted"] == [run_id]
        end = cell.end(run_id)
        assert (end["outcome"], end["error"]["name"]) == ("interrupted", "RUN_INTERRUPTED")
        await cell.clock.sleep(30.0)
        assert (cell.plant.world.track.at(cell.clock.now())[0] == before).all()

    two_lives(write_config(tmp_path), 2, look)


@pytest.mark.parametrize("after_poses", [1, 2, 4, 5, 7, 8])
def test_adopting_goes_on_in_the_interrupted_placement_and_loses_no_pose(
    after_poses: int, tmp_path: Path
) -> None:
    async def adopt(cell: ObjectCell, run_id: int) -> None:
        kept = finished_poses(cell, run_id)
        assert len(kept) >= after_poses
        adopted = await cell.start(adopt=run_id)
        end = await cell.finished(adopted)
        assert (end["outcome"], end["verdict"]) == ("complete", "pass"), end["error"]
        poses = finished_poses(cell, adopted)
        assert poses[: len(kept)] == kept
        assert len(poses) == 8
        assert sorted(p["planned"] for p in poses if p["group"] == 0) == [0, 1, 2, 3]
        assert {p["group"] for p in poses} == {0, 1}
        assert cell.notes(adopted, "adopted")[0]["poses"] == len(kept)

    two_lives(write_config(tmp_path, job={"placements": 2}), after_poses, adopt)


@pytest.mark.parametrize(("after_poses", "poses"), [(1, 5), (3, 7)])
def test_a_board_that_was_moved_meanwhile_gets_a_placement_of_its_own(
    after_poses: int, poses: int, tmp_path: Path
) -> None:
    async def adopt(cell: ObjectCell, run_id: int) -> None:
        assert len(finished_poses(cell, run_id)) == after_poses
        cell.plant.world.operator.move_on(cell.clock.now())
        adopted = await cell.start(adopt=run_id)
        end = await cell.finished(adopted)
        assert end["outcome"] == "complete", end["error"]
        assert len(cell.notes(adopted, "board moved since its last pose")) == 1
        asked = 1  # a placement with too few poses does not count, so one more is asked for
        assert len(cell.notes(adopted, "prompt")) == asked
        taken = finished_poses(cell, adopted)
        assert [p["group"] for p in taken].count(0) == after_poses
        assert len(taken) == poses

    placements = 1 if after_poses < 3 else 2
    two_lives(write_config(tmp_path, job={"placements": placements}), after_poses, adopt)


ROOM = {"min": [-1.3, -1.3, 0.0], "max": [1.3, 1.3, 1.6]}


@pytest.mark.parametrize(
    ("job", "limits"),
    [({"distance_m": 0.45}, None), ({}, {"speed_m_s": 0.2, "workspace": [ROOM]})],
    ids=["job edited", "limits edited"],
)
def test_adopting_under_another_configuration_is_refused(
    job: dict[str, Any], limits: dict[str, Any] | None, tmp_path: Path
) -> None:
    async def adopt(cell: ObjectCell, run_id: int) -> None:
        assert (await refused(cell.start(adopt=run_id))).name == "IDENTITY_DIFFERS"
        assert not cell.engine.active
        assert len(list(cell.runs.iterdir())) == 1

    first = write_config(tmp_path)
    edited = write_config(tmp_path, job=job, **({"limits": limits} if limits else {}))
    two_lives(first, 1, adopt, edited)


def test_adopting_after_another_calibration_was_committed_is_refused(tmp_path: Path) -> None:
    async def adopt(cell: ObjectCell, run_id: int) -> None:
        await cell.run_job()
        (proposed,) = cell.ledger.results()
        await cell.engine.decisions.accept(proposed["id"], "test")
        assert (await refused(cell.start(adopt=run_id))).name == "IDENTITY_DIFFERS"

    two_lives(write_config(tmp_path), 1, adopt)


def test_adopting_with_another_camera_is_refused(tmp_path: Path) -> None:
    async def adopt(cell: ObjectCell, run_id: int) -> None:
        cell.plant.camera.inject("reboot", {"serial": "99992200009"})
        await cell.until(lambda: not cell.all_ready(), "the loss")
        await cell.until(cell.all_ready, "the other camera", 20.0)
        assert (await refused(cell.start(adopt=run_id))).name == "IDENTITY_DIFFERS"

    config = write_config(tmp_path)
    for device in config.device.values():
        device.__dict__["expect_serial"] = None
    two_lives(config, 1, adopt)


def test_adopting_a_run_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            assert (await refused(cell.start(adopt=77))).name == "NOT_FOUND"

    run_virtual(main())


def test_a_damaged_line_of_the_old_poses_is_named(tmp_path: Path) -> None:
    async def adopt(cell: ObjectCell, run_id: int) -> None:
        path = cell.folder(run_id).path / "poses.jsonl"
        first, _, rest = path.read_text("utf-8").partition("\n")
        path.write_text(f"{first[:-5]}\n{rest}", "utf-8")
        end = await cell.finished(await cell.start(adopt=run_id))
        assert end["error"]["name"] == "FILE_UNREADABLE"
        assert "poses.jsonl:1" in end["error"]["text"]

    two_lives(write_config(tmp_path), 2, adopt)
