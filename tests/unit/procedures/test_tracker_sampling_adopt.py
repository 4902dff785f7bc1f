"""What a killed or stopped sampling leaves is taken over, as long as the tracker stands where it did."""

import json
from pathlib import Path

import pytest

from cell.errors import CellError
from fakes.object import run_virtual
from procedures.tracker.record import SampleRecord
from tests.kit.object_cell import no_report, open_cell
from tests.kit.tracker_cell import JOB, tracker_config
from tests.unit.procedures.test_tracker_sampling_faults import at_pose

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")


def test_finished_poses_survive_a_kill_and_are_taken_over(tmp_path: Path) -> None:
    config = tracker_config(tmp_path, {"poses": 14, "monument_every": 4}, scenario="palletizer:ideal")

    async def main() -> None:
        async with open_cell(config, job=JOB) as cell:
            clock = cell.clock
            run_id = await cell.start()
            await cell.until(lambda: cell.engine.status()["step"] >= 6, "six poses", 300.0)
            await cell.kill()
            kept = SampleRecord.read(cell.folder(run_id).path)
            assert len(kept.samples) >= 6
            assert cell.folder(run_id).read_end() is None or cell.end(run_id)["outcome"] != "complete"
        async with open_cell(config, clock, job=JOB) as cell:
            second = await cell.start(adopt=run_id)
            end = await cell.finished(second)
            assert (end["outcome"], end["error"]) == ("complete", None)
            after = SampleRecord.read(cell.folder(second).path)
            assert after.samples[: len(kept.samples)] == kept.samples
            assert len(after.samples) == 14
            assert sum(s["held_out"] for s in after.samples) == 3
            assert not cell.notes(second, "located"), "the tracker's place is taken over, too"
            assert cell.result(second)["heldout"]["set_aside"]["rms"]["calibrated"] < 0.0003

    run_virtual(main())


def test_poses_are_not_taken_over_when_the_stand_was_moved_meanwhile(tmp_path: Path) -> None:
    config = tracker_config(tmp_path, {"poses": 14, "monument_every": 4}, scenario="palletizer:ideal")

    async def main() -> None:
        async with open_cell(config, job=JOB) as cell:
            run_id = await cell.start()
            await cell.until(lambda: cell.engine.status()["step"] >= 6, "six poses", 300.0)
            await cell.engine.abort("test")
            await cell.finished(run_id)
            cell.plant.plants["tracker"].inject("stand-moved", {"dx": 0.002})
            second = await cell.start(adopt=run_id)
            end = await cell.finished(second)
            assert end["error"]["name"] == "TRACKER_MOVED"
            assert "the tracker's stand moved" in end["error"]["text"]

    run_virtual(main())


def test_poses_before_a_look_that_found_the_stand_moved_are_not_taken_over(tmp_path: Path) -> None:
    """It was put back, so the next look is a good one; when it moved is unknown."""
    config = tracker_config(tmp_path, {"poses": 14, "monument_every": 4}, scenario="palletizer:ideal")

    async def main() -> None:
        async with open_cell(config, job=JOB) as cell:
            stand = cell.plant.plants["tracker"]
            at_pose(5, "tracker", "stand-moved", 0.5, dx=0.0008)(cell)
            end = await cell.run_job()
            assert end["error"]["name"] == "TRACKER_MOVED"
            left = SampleRecord.read(cell.folder(1).path)
            assert [look["after"] for look in left.looks] == [0, 4, 8]
            stand.inject("stand-moved", {"dx": -0.0008})
            end = await cell.run_job(adopt=1)
            assert end["outcome"] == "complete", end
            (dropped,) = cell.notes(2, "not adopted")
            assert dropped["poses"] == 4
            found = cell.result(2)["inputs"]["sampling"]
            assert found["measured"] == 14
            assert not found["monuments"]["beyond_limit"]
            kept = SampleRecord.read(cell.folder(2).path)
            assert kept.samples[:4] == left.samples[:4]
            assert not {s["t"] for s in kept.samples} & {s["t"] for s in left.samples[4:]}

    run_virtual(main())


# -- what is on disk

LINES = [
    {"kind": "header", "schema": "cellward.tracker-samples/1", "payload_kg": 1.0},
    {"kind": "sample", "index": 0, "q": [0.0], "p_tracker": [1, 2, 3], "target": "a", "held_out": False},
]


def test_a_line_that_a_kill_tore_is_left_out(tmp_path: Path) -> None:
    whole = "".join(json.dumps(line) + "\n" for line in LINES)
    (tmp_path / "samples.jsonl").write_text(whole + '{"kind": "sample", "ind', "utf-8")
    record = SampleRecord.read(tmp_path)
    assert record.header == {"payload_kg": 1.0}
    assert [s["index"] for s in record.samples] == [0]


def test_a_damaged_line_is_named(tmp_path: Path) -> None:
    (tmp_path / "samples.jsonl").write_text(json.dumps(LINES[0]) + "\nnonsense\n", "utf-8")
    with pytest.raises(CellError, match=r"samples\.jsonl:2: no line") as caught:
        SampleRecord.read(tmp_path)
    assert caught.value.name == "FILE_UNREADABLE"


def test_a_run_without_finished_poses_leaves_nothing_to_take_over(tmp_path: Path) -> None:
    assert SampleRecord.read(tmp_path).samples == []
