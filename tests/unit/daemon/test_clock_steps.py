"""Somebody sets the PC's clock by an hour while a job runs: it goes by a clock that nobody sets."""

import json
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from cell.store.ledger import Ledger
from cell.store.runs import RunFolder, list_runs
from fakes.object import run_virtual
from tests.kit.hand_eye_made import quick_solver
from tests.kit.object_cell import no_report, open_cell, write_config

__all__ = ["no_report", "quick_solver"]
pytestmark = pytest.mark.usefixtures("no_report", "quick_solver")

HOUR_S = 3600.0
NOON = 1_790_000_000.0


class Wall:
    """A time of day that somebody sets."""

    def __init__(self) -> None:
        self.now, self.set_by = NOON, list[float]()

    def __call__(self) -> float:
        self.now += 1.0
        return self.now

    def set(self, by_s: float) -> None:
        self.now += by_s
        self.set_by.append(by_s)


def run_with(folder: Path, steps: tuple[float, ...], patch: pytest.MonkeyPatch) -> tuple[Any, Any, list[int]]:
    """Journal and answer of the second of two captures, in which the clock is set; the numbers of both."""
    wall = Wall()
    patch.setattr(RunFolder, "create", partial(RunFolder.create, wall=wall))
    folder.mkdir()

    async def main() -> tuple[Any, Any, list[int]]:
        async with open_cell(write_config(folder)) as cell:
            cell.ledger._wall = wall
            await cell.run_job()
            left = list(steps)

            def step() -> None:
                if left:
                    wall.set(left.pop(0))

            cell.at_state("move", step, times=len(steps))
            end = await cell.run_job()
            assert end["outcome"] == "complete"
            journal = [
                {k: v for k, v in line.items() if k in ("seq", "t", "kind", "state", "event", "packml")}
                for line in cell.journal(2)
            ]
            assert wall.set_by == list(steps)
            return journal, cell.result(2)["result"], [run.run_id for run in list_runs(cell.runs)]

    return run_virtual(main())


def test_a_run_goes_on_as_if_the_clock_had_not_been_set(tmp_path: Path) -> None:
    found: list[Any] = []
    for name, steps in (("steady", ()), ("set", (-HOUR_S, 2 * HOUR_S, -3 * HOUR_S))):
        with pytest.MonkeyPatch.context() as patch:
            found.append(run_with(tmp_path / name, steps, patch))
    steady, stepped = found
    assert json.dumps(steady[0]) == json.dumps(stepped[0])
    assert json.dumps(steady[1]) == json.dumps(stepped[1])
    assert stepped[2] == [1, 2]


def test_runs_and_trends_keep_their_order(tmp_path: Path) -> None:
    wall: Callable[[], float] = iter([NOON, NOON + 1.0, NOON - HOUR_S, NOON - HOUR_S + 1.0]).__next__
    with closing(Ledger(tmp_path / "ledger.sqlite", wall)) as subject:
        for value in (1.0, 2.0, 3.0, 4.0):
            subject.add_trend("tool", value)
        assert [value for _, value in subject.trend("tool")] == [1.0, 2.0, 3.0, 4.0]
        assert [value for _, value in subject.trend("tool", 2)] == [3.0, 4.0]
