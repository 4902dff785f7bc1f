"""The crossed-beam jobs beside the twin's truth: errors, coverage of what is stated, and the gates' verdicts.

``python -m bench.laser_height [COUNT] [CELL]...`` runs whole jobs on virtual time, a minute of processor
time each: a reference, a bump, an update, a check of the tool as it then is, and a check after one more bump
by the size that is promised to be found. A cell is the tool's end, the arm's standard deviation of one axis
in um, and ``late`` when one poll of ten comes up to 40 ms late: ``round-14``, ``flat-30-late``. Heights of
the beams and bumps are drawn anew each time. ``bench.laser_height_wire`` does the same in real time.
"""

import asyncio
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

import daemon.results
from bench._laser_fixture import scenario
from bench._laser_tally import Tally
from cell.calibrations import laser_reference, tool_calibration
from cell.poses import Array, from_pose6, to_pose6
from daemon.config import CellConfig
from fakes.object import VirtualClock, run_virtual
from tests.kit.object_cell import ObjectCell, on_disk, open_cell, write_config

TOOL, COUNT = "pin", 3
CELLS = ("round-14", "round-30", "flat-14", "flat-30", "round-14-late", "flat-30-late")
LATE_GAP_S = 0.1


def config_of(folder: Path, cell: str, seed: int) -> CellConfig:
    """The cell's configuration on the object face."""
    kind, sigma, *late = cell.split("-")
    path = folder / "fixture.toml"
    path.write_text(scenario(kind, 1e-6 * float(sigma), seed), "utf-8")
    beams: dict[str, Any] = {"poll_period_s": 0.005}
    jobs: dict[str, dict[str, Any]] = {"laser-update": {"accept": {"auto": True}}}
    if late:
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
        await subject.engine.accept(row["id"], "bench")
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
        elif await _done(subject, "laser-check", tally):
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


def tell(cell: str, began: float, tally: Tally) -> bool:
    """Print the figures of a cell; whether they are as wanted."""
    short = tally.as_wanted(int(cell.split("-")[1]))
    print(f"{cell}, {time.monotonic() - began:.0f} s: {'; '.join(short) or 'as wanted'}")
    print("".join(f"    {line}\n" for line in tally.lines()), flush=True)
    return not short


def main(arguments: list[str]) -> int:
    count = int(arguments[0]) if arguments else COUNT
    daemon.results._write_report = _no_report  # noqa: SLF001
    began, as_wanted = time.monotonic(), True
    for cell in arguments[1:] or CELLS:
        tally = Tally()
        for seed in range(count):
            with tempfile.TemporaryDirectory() as folder:
                run_virtual(one(Path(folder), cell, seed, tally))
        as_wanted = tell(cell, began, tally) and as_wanted
    print(f"as wanted: {'yes' if as_wanted else 'NO'}")
    return 0 if as_wanted else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
