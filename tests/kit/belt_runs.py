"""Whole runs of a belt's calibration below a camera whose pose is known, beside the truth."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fakes.object import run_virtual
from tests.kit.picking_cell import picking_cell, picking_config

JOB = "belt-calibration"
KNOWN = {"camera_turn_95_rad": 0, "distance_95_m": 0}  # nothing is wrong that no sighting shows
BELTS: dict[str, dict[str, str]] = {
    "steady": {},
    "ripple": {
        "profile": "[{ speed_m_s = 0.15 }]\nripple = [{ amplitude = 0.03, hz = 0.7 }, "
        "{ amplitude = 0.01, hz = 2.3 }]"
    },
    "stop-start": {"profile": "[{ speed_m_s = 0.25 }]\nstops = {}"},
    "1 mm a count": {"m_per_count": "1.013e-3"},
}


@dataclass(frozen=True)
class Found:
    """As shares of the true scale: how far off it was, and half of its 95 % interval."""

    off: float
    half: float


def calibrated(folder: Path, seed: int, belt: Mapping[str, str]) -> Found:
    """One run in ``folder``; feed and noise are those of ``seed``, which also says when it begins."""
    world = {"m_per_count": "1.013e-4", "dir": "[0.9992, 0.03, 0.02]", "seed": str(1000 + seed), **belt}
    config = picking_config(folder, world=world, sections={JOB: KNOWN})

    async def main() -> Found:
        async with picking_cell(config) as cell:
            cell.job = JOB
            await cell.clock.sleep(0.037 * seed)
            run_id = await cell.start()
            end = await cell.finished(run_id)
            assert end["outcome"] == "complete", end["error"]
            result, truth = cell.result(run_id), cell.plant.world.belt
            assert truth is not None
            scale = truth.truth.m_per_count
            off = result["result"]["m_per_count"] / scale - 1.0
            return Found(off, result["uncertainty"]["half_m_per_count"] / abs(scale))

    return run_virtual(main())
