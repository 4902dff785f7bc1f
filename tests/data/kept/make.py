"""Make the samples of one version: ``python -P make.py FOLDER``, its sources first on PYTHONPATH.

FOLDER is new. Each cell on virtual time leaves its ``cell.toml``, ledger, ``calibrations.json`` and run
folders in a folder of FOLDER. README.md says what is done with them then. It runs with the tests of every
commit since a63d25e.
"""

import json
import sys
from dataclasses import asdict
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

WHO = "operator"
FINE = {
    "search_speed_m_s": 0.3,
    "measure_speed_m_s": 0.05,
    "passes": 2,
    "z_resolution_m": 0.0001,
    "lead_m": 0.003,
    "settle_s": 0.0,
}
BEND = ([0.0012, -0.0007, 0.0005], [0.006, -0.008, 0.0])  # 1.48 mm, 10 mrad


def helper(name: str) -> Any:
    """A module of the tests, wherever that version has it."""
    places = ("tests.kit", "tests.unit", "tests", "tests.unit.procedures", "tests.unit.daemon")
    return import_module(next(f"{p}.{name}" for p in places if find_spec(p) and find_spec(f"{p}.{name}")))


async def done(cell: Any, job: str, accept: str = "", **how: Any) -> None:
    """Run ``job`` to its end; what it found that is called ``accept...`` takes effect."""
    end = await cell.run_job(job=job, **how)
    print(f"{job}: {end['outcome']}, {end['verdict']}")
    assert end["outcome"] == "complete", end
    if accept:
        rows = [r for r in cell.ledger.results() if r["state"] == "proposed" and r["name"].startswith(accept)]
        await cell.engine.decisions.accept(rows[0]["id"], WHO)


async def hand_eye(folder: Path) -> None:
    objects = helper("object_cell")
    config = objects.write_config(folder, job={"placements": 2, "poses_per_placement": 8})
    clock = import_module("fakes.object").VirtualClock()
    async with objects.open_cell(config, clock) as cell:
        await done(cell, "cone-capture", "T_flange_camera")
    cell = objects.ObjectCell(config, clock)
    await cell.open()
    await helper("test_engine_adoption").cut_short(cell, 2)


async def laser(folder: Path) -> None:
    lasers, objects = helper("laser_cell"), helper("object_cell")
    jobs = {
        "laser-reference": FINE,
        "laser-update": {"accept": {"auto": True}},
        "latency-calibration": {"speeds_m_s": [0.02, 0.08], "passes": 6},
    }
    arm, beams = {"state_period_s": 0.02}, {"poll_period_s": 0.005}
    config = objects.write_config(
        folder, "laser", jobs=jobs, limits=lasers.BRISK, arm_keys=arm, beams_keys=beams
    )
    async with lasers.laser_cell(config, "laser-reference") as cell:
        await done(cell, "laser-reference", "laser_reference")
        await done(cell, "latency-calibration")
        cell.plant.world.tool.bend(cell.clock.now(), *BEND)
        await done(cell, "laser-check")
        await done(cell, "laser-update")


async def tracker(folder: Path) -> None:
    config = helper("tracker_cell").tracker_config(folder, {"poses": 44})
    async with helper("object_cell").open_cell(config) as cell:
        await done(cell, "tracker-sampling", "kinematics")


async def iso9283(folder: Path) -> None:
    config = helper("test_iso9283_job").iso_config(folder)
    async with helper("object_cell").open_cell(config) as cell:
        await done(cell, "iso9283")


async def picking(folder: Path) -> None:
    pickings = helper("picking_cell")
    async with pickings.picking_cell(pickings.picking_config(folder, {"picks": 2})) as cell:
        await done(cell, "belt-calibration", "belt")
        await done(cell, "belt-tracking")


def main(folder: Path) -> None:
    async def drawn(run: Any) -> None:  # a report is some megabytes
        ...

    results: Any = import_module("daemon.results")
    assert hasattr(results, "_write_report")
    results._write_report = drawn
    table = asdict(import_module("daemon.modbus.table").register_table())
    folder.mkdir(parents=True)
    (folder / "registers.json").write_text(json.dumps(table, indent=1), "utf-8")
    virtual = import_module("fakes.object")
    for scene in (hand_eye, laser, tracker, iso9283, picking):
        where = folder / scene.__name__
        where.mkdir()
        virtual.run_virtual(scene(where))


if __name__ == "__main__":
    main(Path(sys.argv[1]).absolute())
