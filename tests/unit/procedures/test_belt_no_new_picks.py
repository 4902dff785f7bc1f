"""A PLC that wants no new picks: the item in hand is finished, and the arm waits above the belt."""

from pathlib import Path

import pytest

from daemon.modbus import ModbusFace
from daemon.plc import PlcFace
from fakes.object import run_virtual
from tests.kit.object_cell import ObjectCell, no_report
from tests.kit.picking_cell import picking_cell, picking_config
from tests.kit.picking_truth import agrees_with_the_world, counted

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

CONTROL, BARRED = 11, 4
PLC = "127.0.0.1"


def face_of(cell: ObjectCell) -> ModbusFace:
    """The face with the cell behind it; nothing is served."""
    plc = PlcFace(cell.config, cell.engine)
    section = cell.config.modbus.model_copy(update={"allow_write": True, "allow_clients": [PLC]})
    return ModbusFace(section, cell.clock, plc.handle, plc.snapshot, on_picks=plc.picks_wanted_changed)


async def waits(cell: ObjectCell) -> None:
    await cell.until(lambda: cell.engine.packml.name == "SUSPENDED", "suspended", 30.0)
    assert cell.engine.status()["state"] == "ready"
    assert cell.at_rest()


def test_the_item_in_hand_is_finished_and_nothing_is_picked_until_the_bit_is_cleared(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, {"picks": 2})) as cell:
            face = face_of(cell)
            run_id = await cell.start()
            await cell.until_state("grip")
            face.write_holding(CONTROL, [BARRED], PLC)
            await waits(cell)
            assert counted(cell, run_id)["picked"] == 1
            await cell.clock.sleep(10.0)
            await waits(cell)
            assert counted(cell, run_id)["picked"] == 1
            face.write_holding(CONTROL, [0], PLC)
            assert (await cell.finished(run_id))["outcome"] == "complete"
            assert counted(cell, run_id)["picked"] == 2
            assert [line["who"] for line in cell.notes(run_id, "no new work")] == [f"PLC {PLC}"]
            agrees_with_the_world(cell, run_id)

    run_virtual(scene())


def test_a_run_that_waits_for_the_bit_can_be_finished_and_the_next_one_waits_as_well(tmp_path: Path) -> None:
    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, {"picks": 1})) as cell:
            face = face_of(cell)
            face.write_holding(CONTROL, [BARRED], PLC)
            first = await cell.start()
            await waits(cell)
            await cell.engine.finish("test")
            assert (await cell.finished(first))["outcome"] == "complete"
            second = await cell.start()
            await waits(cell)
            assert cell.notes(second, "no new work"), "the journal says why"
            face.write_holding(CONTROL, [0], PLC)
            assert (await cell.finished(second))["outcome"] == "complete"
            assert counted(cell, second)["picked"] == 1

    run_virtual(scene())
