"""A reference is made of the tool that is in place: a person says first that it is the good one."""

from pathlib import Path

import pytest

from fakes.object import run_virtual
from tests.kit.laser_cell import laser_cell, laser_config
from tests.kit.laser_made import Solved, solved
from tests.kit.object_cell import WHO, no_report

__all__ = ["no_report", "solved"]

pytestmark = pytest.mark.usefixtures("no_report")


@pytest.mark.parametrize("asks", [True, False])
def test_nothing_moves_before_the_good_tool_is_confirmed(tmp_path: Path, solved: Solved, asks: bool) -> None:
    config = laser_config(tmp_path, reference={"ask_for_tool": asks})

    async def main() -> None:
        async with laser_cell(config, "laser-reference") as cell:
            run_id = await cell.start(placed=False)
            if asks:
                await cell.until(lambda: cell.engine.status()["prompt"], "a question")
                assert "tool 'pin'" in cell.engine.status()["prompt"]["text"]
                await cell.clock.sleep(60.0)
                assert cell.engine.status()["state"] == "prepare"
                assert not cell.notes(run_id, "move_linear") + cell.notes(run_id, "move_joints")
                await cell.engine.confirm(cell.engine.status()["prompt"]["id"], WHO)
            await cell.until_state("sweep")
            assert (await cell.finished(run_id))["outcome"] == "complete"

    run_virtual(main())


def test_a_question_that_is_not_answered_is_finished_without_a_move(tmp_path: Path, solved: Solved) -> None:
    config = laser_config(tmp_path)

    async def main() -> None:
        async with laser_cell(config, "laser-reference") as cell:
            run_id = await cell.start(placed=False)
            await cell.until(lambda: cell.engine.status()["prompt"], "a question")
            await cell.engine.finish(WHO)
            await cell.finished(run_id)
            assert not cell.notes(run_id, "move_linear") + cell.notes(run_id, "move_joints")

    run_virtual(main())
