"""Picking with hundreds of items on their way: a camera far upstream, more of them than the arm can pick."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daemon.plc import PlcFace
from fakes.object import run_virtual
from procedures.belt.items import CONTACT, Outcome
from tests.kit.object_cell import ObjectCell, no_report
from tests.kit.picking_cell import contact_errors, picking_cell, picking_config
from tests.kit.picking_truth import agrees_with_the_world, told, truth_of

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

CLOSE_M = 0.03  # from item to item


def feed(far_m: float, count: int, profile: str) -> dict[str, str]:
    """A camera ``far_m`` upstream of where it usually is sees ``count`` items come, then no more."""
    return {
        "T_base_camera": f"[{-0.746 - far_m}, 0.553, 0.952, 3.1275, 0.0218, 0.0163]",
        "origin": f"[{-0.7 - far_m}, {0.55 + 0.02 * far_m}, 0.15]",
        "size_m": "[0.025, 0.02, 0.03]",
        "spacing_m": str(CLOSE_M),
        "jitter_m": "0.002",
        "first_m": f"-0.1\ncount = {count}\ngone_m = {far_m + 3.0}",
        "profile": profile,
    }


@dataclass
class Seen:
    """What a PLC sees of a run while it goes on."""

    longest: int = 0
    picks: list[int] = field(default_factory=list)
    misses: list[int] = field(default_factory=list)

    def watch(self, cell: ObjectCell) -> None:
        face = PlcFace(cell.config, cell.engine)

        def look() -> None:
            shown = face.snapshot()
            self.longest = max(self.longest, int(shown.get("queue_length", 0)))
            self.picks.append(int(shown.get("picks", 0)))
            self.misses.append(int(shown.get("misses", 0)))

        cell.engine.subscribe(look)


async def pick_until_all_have_passed(cell: ObjectCell, count: int) -> tuple[int, Seen]:
    """The run that an operator finishes when nothing is on its way any more."""
    seen = Seen()
    run_id = await cell.start()
    seen.watch(cell)
    await cell.until(
        lambda: seen.misses and seen.picks[-1] + seen.misses[-1] >= count, "the last item", 120.0
    )
    await cell.engine.finish("test")
    end = await cell.finished(run_id)
    assert (end["outcome"], end["error"]) == ("complete", None)
    await cell.clock.sleep(0.5)
    assert cell.at_rest()
    return run_id, seen


def ends_once_and_truly(cell: ObjectCell, run_id: int, count: int, seen: Seen) -> dict[str, int]:
    """Each item that was put on the belt has one outcome, and all who tell of it agree; outcomes by name."""
    agrees_with_the_world(cell, run_id)
    said = told(cell, run_id)
    assert len(said.rows) == count
    assert cell.result(run_id)["result"]["seen"] == count
    assert said.registers.get("queue_length", 0) == 0
    assert said.outcomes["picked"] == len(truth_of(cell).taken)
    for counter in (seen.picks, seen.misses):
        assert counter == sorted(counter)
    return said.outcomes


@pytest.mark.soak
def test_of_three_hundred_items_on_their_way_each_ends_once_and_none_is_picked_twice(tmp_path: Path) -> None:
    count = 330
    profile = "[{ speed_m_s = 0.8, for_s = 11.5 }, { speed_m_s = 0.25, for_s = 10.0 }, { speed_m_s = 0.8 }]"

    async def scene() -> None:
        config = picking_config(tmp_path, {"spacing_m": 0.5 * CLOSE_M}, feed(9.5, count, profile))
        async with picking_cell(config) as cell:
            run_id, seen = await pick_until_all_have_passed(cell, count)
            assert seen.longest >= 300
            outcomes = ends_once_and_truly(cell, run_id, count, seen)
            assert outcomes["picked"] >= 5
            assert outcomes["queue full"] == 0
            assert np.max(np.abs(contact_errors(cell))) < 2e-3

    run_virtual(scene())


def test_what_a_long_queue_does_not_take_is_told_and_never_touched(tmp_path: Path) -> None:
    count, limit = 120, 60
    profile = "[{ speed_m_s = 0.8, for_s = 4.0 }, { speed_m_s = 0.25, for_s = 12.0 }, { speed_m_s = 0.8 }]"
    job: dict[str, Any] = {"spacing_m": 0.5 * CLOSE_M, "queue_limit": limit}

    async def scene() -> None:
        async with picking_cell(picking_config(tmp_path, job, feed(3.5, count, profile))) as cell:
            run_id, seen = await pick_until_all_have_passed(cell, count)
            assert seen.longest == limit
            outcomes = ends_once_and_truly(cell, run_id, count, seen)
            assert outcomes["queue full"] >= 20
            assert outcomes["picked"] >= 3
            refused = [row for row in told(cell, run_id).rows if row["outcome"] == Outcome.QUEUE_FULL]
            assert not any(what == CONTACT for row in refused for _, what in row["detail"]["history"])
            (warning,) = [w for w in cell.result(run_id)["warnings"] if w["code"] == "belt.queue-full"]
            assert warning["text"].startswith(f"{outcomes['queue full']} missed: queue full")

    run_virtual(scene())
