"""Whatever ends a sampling, its finished poses can be solved: nothing that was measured is lost."""

from pathlib import Path
from typing import Any

import pytest

from cell.errors import CellError
from cell.store.files import read_json
from fakes.object import run_virtual
from procedures.tracker.config import TrackerSamplingConfig
from procedures.tracker.record import SampleRecord
from procedures.tracker.solve.data import read_kincal
from procedures.tracker.stored import load_stored
from procedures.tracker.visiting import Visitor
from tests.kit.object_cell import ObjectCell, no_report, open_cell
from tests.kit.solved import solve_kincal
from tests.kit.tracker_cell import JOB, monuments, reflectors, tracker_config

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")
POSES, STOPPED_AT = 14, 12
SMALL = {"poses": POSES, "held_out_share": 0.1, "monument_every": 4}


def stopped(folder: Path, prepare: Any = None) -> tuple[Path, dict[str, Any]]:
    """The folder and the end of a run that was aborted after some poses, or that ``prepare`` lets end."""

    async def main() -> tuple[Path, dict[str, Any]]:
        async with open_cell(tracker_config(folder, SMALL), job=JOB) as cell:
            run_id = await cell.start()
            if prepare is None:
                await cell.until(lambda: measured(cell) >= STOPPED_AT, "enough poses", 300.0)
                await cell.engine.abort("test")
            return cell.folder(run_id).path, await cell.finished(run_id)

    return run_virtual(main())


def measured(cell: ObjectCell) -> int:
    return int(cell.engine.status()["step"])


def indices(path: Path) -> list[int]:
    return [s["index"] for s in read_json(path)["samples"]]


@pytest.fixture(scope="module")
def aborted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("daemon.results._write_report", _drawn)
        return stopped(tmp_path_factory.mktemp("aborted"))[0]


async def _drawn(run: Any) -> None: ...


def test_an_abort_leaves_the_data_sets_of_all_finished_poses(aborted: Path) -> None:
    record = SampleRecord.read(aborted)
    assert STOPPED_AT <= len(record.samples) < POSES
    solved, aside = indices(aborted / "kincal.json"), indices(aborted / "heldout.json")
    assert sorted(solved + aside) == [s["index"] for s in record.samples]
    assert aside == [s["index"] for s in record.samples if s["held_out"]]


def test_a_bug_leaves_the_data_sets_of_all_finished_poses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keep = Visitor.keep

    async def sometimes(self: Visitor, *args: Any) -> None:
        await keep(self, *args)
        if len(self._record.samples) == 3:
            raise ZeroDivisionError

    monkeypatch.setattr(Visitor, "keep", sometimes)
    folder, end = stopped(tmp_path, prepare=True)
    assert end["error"]["name"] == "INTERNAL"
    assert len(indices(folder / "kincal.json") + indices(folder / "heldout.json")) == 3


def test_what_a_kill_leaves_is_solved_as_the_data_set_would_have_been(aborted: Path, tmp_path: Path) -> None:
    lines = (aborted / "samples.jsonl").read_bytes()
    (tmp_path / "samples.jsonl").write_bytes(lines + b'{"kind": "sample", "q": [0.1')
    whole, left = solve_kincal(aborted), solve_kincal(tmp_path)
    assert left["result"]["parameters"] == whole["result"]["parameters"]  # type: ignore[index]
    (warning,) = [w for w in left["warnings"] if w["code"] == "samples.interrupted"]  # type: ignore[attr-defined]
    aside = len(indices(aborted / "heldout.json"))
    assert f"of its {len(SampleRecord.read(aborted).samples)} finished poses {aside} were" in warning["text"]
    assert "samples.interrupted" not in [w["code"] for w in whole["warnings"]]  # type: ignore[attr-defined]


def test_poses_that_a_look_at_the_monuments_speaks_against_are_not_solved(
    aborted: Path, tmp_path: Path
) -> None:
    record = SampleRecord.read(aborted)
    other = SampleRecord(tmp_path)
    other.begin(record.header, record)
    look = record.looks[0]
    points = {
        name: {**p, "p_tracker": [p["p_tracker"][0] + 0.002, *p["p_tracker"][1:]]}
        for name, p in look["points"].items()
    }
    other.add_look({"after": len(other.samples), "t": 1e4, "points": points})
    doubted = len(other.samples) - other.looks[-2]["after"]
    assert doubted > 0
    _, data = read_kincal(tmp_path)
    assert data.notes["doubted"] == doubted
    aside = [s for s in other.samples[:-doubted] if s["held_out"]]
    assert len(data.samples) == len(other.samples) - doubted - len(aside)


def test_a_killed_run_can_be_the_stored_set_of_another(aborted: Path, tmp_path: Path) -> None:
    (tmp_path / "samples.jsonl").write_bytes((aborted / "samples.jsonl").read_bytes())
    header = SampleRecord.read(tmp_path).header
    config = TrackerSamplingConfig.model_validate(
        {
            "reflectors": reflectors("tracker", "smr1"),
            "monuments": monuments("tracker"),
            "with_set": str(tmp_path / "kincal.json"),
        }
    )
    stored = load_stored(str(config.with_set), config, header["robot"], header["payload_kg"])
    assert stored is not None
    assert len(stored.samples) == len(indices(aborted / "kincal.json"))
    told = read_json(aborted / "kincal.json")["notes"]["sampling"]["monument_points"]
    assert set(stored.monuments) == set(told)


def test_a_folder_with_another_jobs_lines_is_no_data_set(tmp_path: Path) -> None:
    (tmp_path / "samples.jsonl").write_text('{"pose": "P1", "cycle": 1}\n', "utf-8")
    with pytest.raises(CellError, match=r"samples\.jsonl:1: no line of a tracker's samples") as caught:
        read_kincal(tmp_path)
    assert caught.value.name == "FILE_UNREADABLE"
