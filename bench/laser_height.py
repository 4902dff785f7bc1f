"""The crossed-beam jobs beside the twin's truth: errors, coverage of what is stated, and the gates' verdicts.

``python -m bench.laser_height [COUNT] [CELL]... [--first SEED] [--keep FILE]`` runs whole jobs on virtual
time, 15 to 20 s of processor time each: a reference, a bump, an update, a check of the tool as it then is,
and a check after one more bump by the size that the first check says is found, which is no larger than what
``cellward check`` promises. A cell is the tool's end, the arm's
standard deviation of one axis in um, and ``late`` when one poll of ten comes up to 40 ms late: ``round-14``,
``flat-30-late``; those that are late have no checks. The world is the scenario ``laser`` as it is shipped,
with gears, sag, and links that the arm's kinematics do not know, and a tool that leans; ``flat-30-ideal`` has
none of that. With ``--keep FILE`` a bench that was ended goes on where it was. Heights of the beams, leans
and bumps are drawn anew each time. ``bench.laser_height_wire`` does the same in real time.
"""

import argparse
import asyncio
import sys
import tempfile
import time
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

import daemon.results
import procedures.laser.solve.solver
from bench._laser_fixture import scenario
from bench._laser_tally import Tally
from cell.calibrations import laser_reference, tool_calibration
from cell.poses import Array, from_pose6, to_pose6
from daemon.config import CellConfig
from fakes.object import VirtualClock, run_virtual
from tests.kit.object_cell import ObjectCell, on_disk, open_cell, write_config

TOOL, COUNT = "pin", 3
USUAL = ("round-14", "round-30", "flat-14", "flat-30")
CELLS = (*USUAL, *(f"{cell}-late" for cell in USUAL))
LATE_GAP_S = 0.1


def config_of(folder: Path, cell: str, seed: int) -> CellConfig:
    """The cell's configuration on the object face."""
    kind, sigma, *ways = cell.split("-")
    path = folder / "fixture.toml"
    path.write_text(scenario(kind, 1e-6 * float(sigma), seed, "ideal" in ways), "utf-8")
    beams: dict[str, Any] = {"poll_period_s": 0.005}
    jobs: dict[str, dict[str, Any]] = {"laser-update": {"accept": {"auto": True}}}
    if "late" in ways:
        beams["driver"] = "bench._late_inputs:LateInputs"
        jobs["laser-reference"] = {"max_poll_gap_s": LATE_GAP_S}
    arm = {"state_period_s": 0.02}
    return write_config(folder, str(path), jobs=jobs, arm_keys=arm, beams_keys=beams)


async def one(folder: Path, cell: str, seed: int, tally: Tally) -> None:
    """One fixture: reference, bump, update, check, bump, check."""
    rng = np.random.default_rng([seed, 77])
    async with open_cell(config_of(folder, cell, seed), VirtualClock(), "laser-reference") as subject:
        if not await _done(subject, "laser-reference", tally):
            return
        (row,) = subject.ledger.results(laser_reference(TOOL))
        await subject.engine.decisions.accept(row["id"], "bench")
        _bump(subject, rng.uniform(-1e-3, 1e-3, 3), rng.uniform(-8e-3, 8e-3, 2))
        began = subject.clock.now()
        if not await _done(subject, "laser-update", tally):
            return
        tally.seconds.append(subject.clock.now() - began)
        passes = await asyncio.to_thread((subject.folder(2).path / "passes.jsonl").read_text, "utf-8")
        tally.ways.append(passes.count("\n"))
        answer = subject.result(2)
        tally.take(answer["result"], _truth(subject))
        if not answer["inputs"].get("update", {}).get("committed"):
            tally.refused.append("; ".join(answer["reasons"]))
        elif "late" not in cell.split("-") and await _done(subject, "laser-check", tally):
            await _checked(subject, rng, tally)


async def _checked(subject: ObjectCell, rng: np.random.Generator, tally: Tally) -> None:
    """The verdict of the check that was made, and of one after a bump by what it promises to find."""
    test = subject.result(3)["result"]["moved"]
    tally.checks += 1
    tally.called_moved += test["moved"]
    way = rng.standard_normal(3)
    frame = on_disk(subject.ledger.effective, tool_calibration(TOOL), None).value
    # Counted from the frame in effect, so that the tool is off it by just that size.
    off = from_pose6(_truth(subject)).translation - from_pose6(frame).translation
    _bump(subject, test["detectable_m"] * way / np.linalg.norm(way) - off, np.zeros(2))
    if await _done(subject, "laser-check", tally):
        tally.bumps += 1
        tally.found += subject.result(4)["result"]["moved"]["moved"]


async def _done(subject: ObjectCell, job: str, tally: Tally) -> bool:
    """Whether the job came to an answer."""
    run_id = await subject.start(job=job)
    end = await subject.finished(run_id)
    if end["outcome"] == "complete" and subject.result(run_id)["result"] is not None:
        return True
    tally.failed.append(f"{job}: {(end.get('error') or {}).get('text') or end['outcome']}")
    return False


def _bump(subject: ObjectCell, shift: Array, turn: Array) -> None:
    subject.plant.world.tool.bend(subject.clock.now(), shift.tolist(), [*turn.tolist(), 0.0])


def _truth(subject: ObjectCell) -> list[float]:
    return [float(v) for v in to_pose6(subject.plant.world.T_flange_tool_at(subject.clock.now()))]


async def _no_report(run: object) -> None:
    """Nobody reads the reports of hundreds of runs."""


def _none_held_out(*_of: object) -> None:
    """Nor what they say of edges that were held out, for which each scan is solved five more times."""


def tell(cell: str, began: float, tally: Tally) -> bool:
    """Print the figures of a cell; whether they are as wanted."""
    short = tally.as_wanted(int(cell.split("-")[1]))
    print(f"{cell}, {time.monotonic() - began:.0f} s: {'; '.join(short) or 'as wanted'}")
    print("".join(f"    {line}\n" for line in tally.lines()), flush=True)
    return not short


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m bench.laser_height", description=__doc__)
    parser.add_argument("count", type=int, nargs="?", default=COUNT)
    parser.add_argument("cells", nargs="*", default=CELLS, help="such as round-14 or flat-30-late")
    parser.add_argument("--first", type=int, default=0, help="seed of the first; others follow it")
    parser.add_argument("--keep", type=Path, help="file of fixtures: new ones are added, old ones not run")
    options = parser.parse_args(arguments)
    daemon.results._write_report = _no_report  # noqa: SLF001
    procedures.laser.solve.solver.held_out = _none_held_out  # type: ignore[attr-defined, assignment]
    cells, began = list(dict.fromkeys(options.cells)), time.monotonic()
    kept = {cell: Tally.of_file(options.keep, cell) if options.keep else {} for cell in cells}
    tallies = {cell: Tally() for cell in cells}
    # Seed by seed, so that a bench that is ended early has as many of each cell.
    for seed, cell in product(range(options.first, options.first + options.count), cells):
        own = kept[cell].get(seed)
        if own is None:
            own = Tally()
            with tempfile.TemporaryDirectory() as folder:
                run_virtual(one(Path(folder), cell, seed, own))
            if options.keep:
                own.keep(options.keep, cell, seed)
        tallies[cell].add(own)
    as_wanted = all([tell(cell, began, tally) for cell, tally in tallies.items()])
    print(f"as wanted: {'yes' if as_wanted else 'NO'}")
    return 0 if as_wanted else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
