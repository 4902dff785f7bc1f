"""No item of a belt is lost from the counters: what passes while the job waits is counted and told."""

from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from daemon.plc import PlcFace
from fakes.object import run_virtual
from procedures.belt.items import Outcome
from tests.kit.object_cell import ObjectCell, no_report
from tests.kit.picking_cell import picking_cell, picking_config
from tests.kit.picking_truth import agrees_with_the_world, counted

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

OF_NOW = ("belt_speed_m_s", "belt_position_m", "queue_length")


def registers(cell: ObjectCell) -> dict[str, Any]:
    return PlcFace(cell.config, cell.engine).snapshot()


def scene(tmp_path: Path, script: Callable[[ObjectCell], Awaitable[None]], **job: Any) -> None:
    async def main() -> None:
        async with picking_cell(picking_config(tmp_path, job)) as cell:
            await script(cell)

    run_virtual(main())


async def held(cell: ObjectCell) -> int:
    """A run that was paused after its first pick."""
    run_id = await cell.start()
    await cell.until(lambda: counted(cell, run_id)["picked"], "a pick")
    await cell.engine.pause("test")
    await cell.until(lambda: cell.engine.packml.name == "HELD", "held", 30.0)
    return run_id


def test_items_that_pass_while_the_job_holds_are_missed_by_name(tmp_path: Path) -> None:
    async def script(cell: ObjectCell) -> None:
        run_id = await held(cell)
        missed = registers(cell)["misses"]
        await cell.clock.sleep(15.0)
        assert registers(cell)["misses"] > missed, "they are counted as they pass"
        await cell.engine.resume("test")
        end = await cell.finished(run_id)
        assert (end["outcome"], end["verdict"]) == ("complete", "warn")
        assert counted(cell, run_id)[Outcome.OUT_OF_ZONE] >= 4
        agrees_with_the_world(cell, run_id)

    scene(tmp_path, script, picks=2)


def test_items_that_creep_out_of_the_zone_while_the_belt_as_good_as_stands_are_missed_by_name(
    tmp_path: Path,
) -> None:
    async def script(cell: ObjectCell) -> None:
        run_id = await cell.start()
        await cell.until(lambda: cell.engine.status()["live"].get("queue_length", 0) > 1, "items")
        belt = cell.plant.world.belt
        assert belt is not None
        belt.run(cell.clock.now(), 0.04)
        await cell.until(lambda: cell.engine.packml.name == "SUSPENDED", "suspended", 30.0)
        before = registers(cell)["misses"]
        await cell.clock.sleep(40.0)
        assert cell.engine.packml.name == "SUSPENDED"
        assert registers(cell)["belt_speed_m_s"] == pytest.approx(0.04, rel=0.05)
        assert registers(cell)["misses"] > before
        await cell.engine.finish("test")
        assert (await cell.finished(run_id))["outcome"] == "complete"
        agrees_with_the_world(cell, run_id)

    scene(tmp_path, script, standing_m_s=0.05)


def test_registers_of_a_job_that_holds_are_of_now(tmp_path: Path) -> None:
    async def script(cell: ObjectCell) -> None:
        await held(cell)
        belt = cell.plant.world.belt
        assert belt is not None
        before = registers(cell)["belt_position_m"]
        await cell.clock.sleep(1.0)
        assert registers(cell)["belt_position_m"] > before + 0.1
        belt.run(cell.clock.now(), 0.0)
        await cell.clock.sleep(2.0)
        assert registers(cell)["belt_speed_m_s"] == pytest.approx(0.0, abs=1e-3)

    scene(tmp_path, script)


@pytest.mark.parametrize("way", ["finish", "abort"])
def test_after_the_end_only_the_counters_stay_to_be_read(tmp_path: Path, way: str) -> None:
    async def script(cell: ObjectCell) -> None:
        run_id = await cell.start()
        await cell.until(lambda: counted(cell, run_id)["picked"], "a pick")
        assert all(registers(cell)[name] for name in OF_NOW)
        await getattr(cell.engine, way)("test")
        await cell.finished(run_id)
        shown = registers(cell)
        assert shown["picks"] >= 1
        assert not any(name in shown for name in OF_NOW)
        agrees_with_the_world(cell, run_id)

    scene(tmp_path, script)


def test_hands_at_the_belt_during_a_pause_do_not_end_the_job(tmp_path: Path) -> None:
    async def script(cell: ObjectCell) -> None:
        run_id = await held(cell)
        cell.plant.plant("belt").inject("stuck", {"for_s": 4.0})  # pictures and counts do not agree
        await cell.clock.sleep(8.0)
        assert cell.engine.packml.name == "HELD"
        await cell.engine.resume("test")
        end = await cell.finished(run_id)
        assert end["outcome"] == "complete"

    scene(tmp_path, script, picks=2)
