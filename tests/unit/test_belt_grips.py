"""What picking makes of items and grips that are not as they should be, on virtual time."""

from pathlib import Path

import numpy as np
import pytest

from fakes.object import run_virtual
from tests.object_cell import no_report
from tests.unit.picking_cell import contact_errors, picking_cell, picking_config
from tests.unit.picking_truth import agrees_with_the_world, counted

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")


def test_items_that_lie_closer_than_the_spacing_are_picked_one_by_one(tmp_path: Path) -> None:
    job = {"picks": 4, "items": {"min_size_m": 0.01}}
    world = {
        "size_m": "[0.015, 0.01, 0.03]", "spacing_m": "0.025", "jitter_m": "0.0", "lateral_m": "0.0"
    }  # fmt: skip

    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, job, world)) as cell:
            run_id = await cell.start()
            assert (await cell.finished(run_id))["outcome"] == "complete"
            off = np.linalg.norm(contact_errors(cell), axis=1)
            assert len(off) == 4
            assert off.max() < 0.5e-3
            outcomes = counted(cell, run_id)
            assert outcomes["picked"] == 4
            assert not outcomes["grip failed"]
            agrees_with_the_world(cell, run_id)

    run_virtual(scene())
