"""Meeting an item without following it, by our forecast and by the classic method; how late an arm is."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fakes.object import run_virtual
from tests.kit.object_cell import no_report
from tests.kit.picking_cell import contact_errors, picking_cell, picking_config

__all__ = ["no_report"]
TOLERANT = {"confirm": "7\nwithin_m = 0.05\nbelow_m_s = 1.0"}  # fingers that take what slides


@pytest.mark.usefixtures("no_report")
@pytest.mark.parametrize("job", [{"method": "classic"}, {"method": "ml", "follow": False}])
def test_an_item_that_is_met_and_not_followed_slides_under_the_tool(
    tmp_path: Path, job: dict[str, Any]
) -> None:
    async def scene() -> None:
        config = picking_config(tmp_path, {"picks": 1, **job}, TOLERANT)
        async with picking_cell(config) as cell:
            run_id = await cell.start()
            end = await cell.finished(run_id)
            assert end["outcome"] == "complete"
            assert cell.result(run_id)["result"]["method"] == job["method"]
            gripper = cell.plant.world.gripper
            assert gripper is not None
            (contact,) = [c for c in gripper.contacts if c.taken]
            assert contact.slide_m_s == pytest.approx(0.15, abs=0.01)
            assert np.linalg.norm(contact_errors(cell)) < 0.02

    run_virtual(scene())
