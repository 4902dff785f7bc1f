"""What the devices of a run that failed told in its last seconds is kept in its folder."""

from pathlib import Path
from typing import Any

import pytest

from cell.devices import DigitalInputs, Encoder, EncoderState, InputsState
from cell.errors import error
from cell.samples import Sample, Stream
from cell.store.files import read_json
from cell.store.runs import LAST_SECONDS_FILE
from daemon.last_seconds import LAST_S, MOST_ROWS, last_seconds
from fakes.object import VirtualClock, run_virtual
from procedures.hand_eye.record import CaptureRecord
from tests.kit.hand_eye_made import quick_solver
from tests.kit.object_cell import no_report, open_cell, write_config

__all__ = ["no_report", "quick_solver"]


def full(*args: Any, **kwargs: Any) -> Any:
    raise error("DISK_FULL", "state")


@pytest.mark.usefixtures("no_report", "quick_solver")
def test_a_run_that_failed_has_them_and_one_that_did_not_has_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            with monkeypatch.context() as patch:
                patch.setattr(CaptureRecord, "add_pose", full)
                assert (await cell.run_job())["outcome"] == "aborted"
            q = cell.plant.world.track.at(cell.clock.now())[0]
            assert (await cell.run_job())["outcome"] == "complete"
            failed, good = cell.folder(1).path / LAST_SECONDS_FILE, cell.folder(2).path / LAST_SECONDS_FILE
            told = read_json(failed)["devices"]["arm"]
            assert not good.exists()
        assert [name for name, _ in told["columns"]][:2] == ["joint 1", "joint 2"]
        times = [row[0] for row in told["rows"]]
        assert times == sorted(times)
        assert -LAST_S <= times[0] < times[-1] <= 0.0
        assert times[-1] > -0.1
        assert told["rows"][-1][1:7] == pytest.approx(list(q), abs=1e-3)

    run_virtual(main())


@pytest.mark.usefixtures("no_report", "quick_solver")
def test_what_cannot_be_told_costs_no_run_its_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*args: Any) -> Any:
        raise ValueError("nan is no JSON")

    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            with monkeypatch.context() as patch:
                patch.setattr(CaptureRecord, "add_pose", full)
                patch.setattr("daemon.last_seconds.last_seconds", broken)
                end = await cell.run_job()
            assert (end["outcome"], end["error"]["name"]) == ("aborted", "DISK_FULL")
            assert not (cell.folder(1).path / LAST_SECONDS_FILE).exists()
            assert (await cell.run_job())["outcome"] == "complete"

    run_virtual(main())


class Told:
    """A device that has told ``count`` samples, 10 ms apart, the last one at 100 s."""

    def __init__(self, name: str, values: list[Any]) -> None:
        self.name, self.names = name, ("xs", "ys")
        self.inputs = self.counts = stream = Stream[Any](name, VirtualClock())
        for k, value in enumerate(values):
            stream.push(Sample(value, 100.0 - 0.01 * (len(values) - 1 - k), 0.0, k))


class Inputs(Told):
    PLAYS = (DigitalInputs,)


class Counter(Told):
    PLAYS = (Encoder,)


def test_levels_and_counts_are_told_and_of_many_samples_some() -> None:
    polls = [InputsState((k % 2 == 1, True), (k, 0)) for k in range(3)]
    counts = [EncoderState(7 * k, k) for k in range(2000)]
    devices: Any = [Inputs("beams", polls), Counter("belt", counts), Told("camera", polls)]
    told = last_seconds(devices, 100.0)["devices"]
    assert told["beams"] == {
        "columns": [("xs", ""), ("ys", "")],
        "rows": [[-0.02, 0, 1], [-0.01, 1, 1], [0.0, 0, 1]],
    }
    assert 100 < len(told["belt"]["rows"]) <= MOST_ROWS
    assert told["belt"]["rows"][0][0] == pytest.approx(-LAST_S, abs=0.02)
    assert "camera" not in told
