"""Picking from a belt with the speed slider below full speed ends by that name, in every world."""

from pathlib import Path

import numpy as np
import pytest

from fakes.object import run_virtual
from tests.kit.object_cell import ObjectCell, no_report
from tests.kit.picking_cell import picking_cell, picking_config
from tests.kit.picking_truth import agrees_with_the_world, truth_of

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")


def slide(cell: ObjectCell) -> None:
    cell.plant.plant("arm").inject("speed-slider", {"fraction": 0.5})


@pytest.mark.parametrize("real", [False, True])
@pytest.mark.parametrize("state", [None, "approach", "descend", "grip", "lift", "place"])
def test_a_slider_at_half_ends_the_job_with_its_code_and_no_pick_goes_wrong(
    tmp_path: Path, real: bool, state: str | None
) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, {"picks": 3}, real=real)) as cell:
            truth_of(cell)
            if state is None:
                slide(cell)
            run_id = await cell.start()
            if state is not None:
                await cell.until_state(state)
                slide(cell)
            end = await cell.finished(run_id)
            assert (end["outcome"], end["error"]["name"]) == ("aborted", "ARM_SPEED_SCALED")
            assert "runs at 50 % of full speed" in end["error"]["text"]
            assert cell.at_rest()
            agrees_with_the_world(cell, run_id)
            gripper = cell.plant.world.gripper
            assert gripper is not None
            off = [np.hypot(*c.off_m) for c in gripper.contacts if c.off_m is not None]
            assert len(off) <= 1
            assert all(one < 0.5e-3 for one in off)

    run_virtual(scene())
