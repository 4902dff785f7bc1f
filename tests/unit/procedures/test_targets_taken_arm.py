"""An arm that somebody takes, or that is stopped, among the targets of a check of a fixed camera."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cell.errors import error
from cell.guard import MotionGuard
from cell.poses import Array
from cell.procedure import Run
from fakes.object import run_virtual
from tests.chaos.matrix import inject_at, kind, put_right
from tests.kit.check_cell import STEPS, check_cell, config, driven_run, wanted
from tests.kit.object_cell import ObjectCell, no_report
from tests.kit.solved import solve_axbc

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

TAKEN = {"foreign-program": "ARM_PROGRAM_RUNNING", "register-in-use": "ARM_REGISTER_CONFLICT"}
BACK_FROM = {"move": 2, "return": 1}  # so many targets


def among_targets(cell: ObjectCell, state: str, seen: int = 1) -> Callable[[Run], bool]:
    """In ``state`` once so many targets were seen."""
    return lambda run: cell.state == state and len(cell.notes(run.id, "target seen")) == seen


def require_kept(cell: ObjectCell, run_id: int, name: str) -> dict[str, Any]:
    """The run was aborted by ``name`` and its check was kept; the ``driven`` of the result."""
    end, result = cell.end(run_id), cell.result(run_id)
    assert end["error"] is not None, end
    assert (end["outcome"], end["error"]["name"]) == ("aborted", name), end
    assert end["verdict"] == result["verdict"]
    assert len(result["result"]["places"]) >= 12
    assert solve_axbc(cell.folder(run_id).path)["result"] == result["result"]
    driven: dict[str, Any] = result["result"]["driven"]
    return driven


@pytest.mark.parametrize("state", BACK_FROM)
@pytest.mark.parametrize(("fault", "name"), TAKEN.items())
def test_an_arm_that_is_taken_on_its_way_ends_the_run_by_the_name_of_that(
    fault: str, name: str, state: str, tmp_path: Path
) -> None:
    async def main() -> None:
        targets = wanted(*STEPS[: BACK_FROM[state]])
        async with check_cell(config(tmp_path, poses=14, targets=targets)) as cell:
            struck = inject_at(cell, kind("arm", fault, name, set()), state, 0.05, among_targets(cell, state))
            run_id, _ = await driven_run(cell)
            assert struck == [state]
            driven = require_kept(cell, run_id, name)
            assert driven["targets"][0]["before"]
            assert driven["lost"] == ["target 2 as given: the run ended before"][: len(targets) - 1]
            assert "stands" not in driven
            await put_right(cell)

    run_virtual(main())


def test_a_program_that_begins_in_a_silence_at_a_target_ends_the_run_by_its_own_name(tmp_path: Path) -> None:
    async def main() -> None:
        targets = wanted(*STEPS[:2])
        async with check_cell(config(tmp_path, poses=14, targets=targets)) as cell:
            loop, at_second = asyncio.get_running_loop(), among_targets(cell, "capture")

            def here(run: Run) -> bool:
                if found := at_second(run):
                    loop.call_later(0.45, cell.plant.controller.inject, "foreign-program")
                return found

            silent = kind("arm", "silence", "", set(), duration_s=1.0)
            struck = inject_at(cell, silent, "capture", 0.05, here)
            run_id, _ = await driven_run(cell)
            assert struck == ["capture"]
            driven = require_kept(cell, run_id, "ARM_PROGRAM_RUNNING")
            assert driven["lost"] == ["target 2 as given: the run ended before"]
            await put_right(cell)

    run_virtual(main())


def test_an_arm_that_cannot_go_on_between_two_targets_is_told_to_stand_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        targets = wanted(*STEPS[:2])
        async with check_cell(config(tmp_path, poses=14, targets=targets)) as cell:
            genuine = MotionGuard.check_path_joints

            def check(self: MotionGuard, q0: Array, q1: Array) -> None:
                genuine(self, q0, q1)
                run = cell.engine.run
                if run is not None and cell.notes(run.id, "interrupted"):
                    raise error("MOTION_COLLISION", "a box that came in the silence")

            monkeypatch.setattr(MotionGuard, "check_path_joints", check)
            silent = kind("arm", "silence", "", set(), duration_s=1.0)
            struck = inject_at(cell, silent, "move", 0.3, among_targets(cell, "move"))
            run_id, _ = await driven_run(cell)
            assert struck == ["move"]
            assert cell.end(run_id)["outcome"] == "complete", cell.end(run_id)
            driven = cell.result(run_id)["result"]["driven"]
            (lost,) = driven["lost"]
            assert lost.startswith("target 2 as given: ")
            assert driven["stands"].startswith(
                "the arm stands between target 1 as given and target 2 as given: "
            )

    run_virtual(main())
