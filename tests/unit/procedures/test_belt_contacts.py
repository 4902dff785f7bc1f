"""What a run of picking tells of its contacts, beside the twin's truth, on a belt that stops at random."""

from pathlib import Path

import numpy as np

from bench.latency import pick, world
from fakes.object import run_virtual
from tests.kit.picking_cell import contact_errors, picking_cell, picking_config


def test_counts_of_after_tell_how_far_items_were_beside_the_tool_at_contact(tmp_path: Path) -> None:
    config = picking_config(
        tmp_path, {"dwell_s": 0.05, "standing_s": 3.0}, world(102, late=False), real=True, sections={}
    )

    async def scene() -> None:
        async with picking_cell(config) as cell:
            await pick(cell, 7.0)
            off = np.linalg.norm(contact_errors(cell), axis=1)
            found = cell.result(1)
            answer = found["result"]
            # The belt brakes while the tool comes down to the second item: touched 4.5 mm beside its middle.
            assert off.max() > 0.003
            assert abs(answer["contact_off_largest_m"] - off.max()) < 0.001
            assert answer["contact_off_rms_m"] < answer["contact_off_largest_m"]
            assert "belt.contact-off" in [warning["code"] for warning in found["warnings"]]

    run_virtual(scene())
