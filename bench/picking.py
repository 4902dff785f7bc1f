"""Picking from a belt on virtual time: ours beside the published method, in one cell and with one feed.

``python -m bench.picking [RUNS] [SECONDS] [--full]``: runs of each belt (2 of 30 s; 20 with ``--full``), at
speeds of 0.1 to 0.3 m/s. A saturated feed brings 2.5 items a second, a sparse one 70 % of what we picked from
that; its runs are 2.5 times as long, so that shares of a per cent mean something. All methods have 50 ms of
dwell and the same place. The published method's moves each begin and end at rest; a row
of its way of meeting items with our way round corners shows how much of the ratio is due to that. Fingers
that would refuse an item that slides would make the comparison meaningless, so those of the saturated runs
take any; the sparse runs have the twin's own, which take nothing that is 3 mm off or slides at 20 mm/s.
The world is the ideal one; ``bench.picking_worlds`` has the real one beside it.

Error is the horizontal distance of the tool's true point and the item's true grasp point at first contact,
RMS over all contacts. ``again`` are closings that took nothing: an item that is followed is tried twice. An
item counts as detected when it was known before it left the zone. ``load %`` is the processor's time of the
whole cell, daemon and twin, over the time that passed in it.
"""

import argparse
import logging
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench._expected import expect
from fakes.object import run_virtual
from fakes.world.belt.gripper import Gripper
from tests.kit.picking_cell import picking_cell, picking_config

FULL = 20
WARM_UP_S = 8.0  # until the belt is known and the first items are in reach
BELTS = ("constant", "ripple", "stop-start")
METHODS: dict[str, dict[str, Any]] = {
    "ours": {"method": "ml", "follow": True, "choice": "soonest"},
    "ours, meet only": {"method": "ml", "follow": False},
    "classic": {"method": "classic"},
    "classic, round corners": {"method": "classic", "straight_m": 0.02},
}
JOB = {"dwell_s": 0.05, "standing_s": 3.0}  # a belt that stops for a second is waited for above it
RATIO, SPARSE, ERROR_M = 1.4, 0.7, 0.5e-3
SPARSE_LASTS = 2.5  # times as long
DETECTED, SUCCESS, DISCARDS = 0.99, 0.98, 0.01


@dataclass
class Tally:
    """What came of the runs of one method on one belt."""

    seconds: float = 0.0
    cell_s: float = 0.0  # from the cell's start to its end, and the processor's time for that
    processor_s: float = 0.0
    picks: int = 0
    failed: int = 0
    missed: int = 0
    unseen: int = 0
    passed: int = 0
    double: int = 0
    again: int = 0
    ends: list[str] = field(default_factory=list)
    off: list[float] = field(default_factory=list)

    @property
    def per_minute(self) -> float:
        return 60.0 * self.picks / self.seconds if self.seconds else 0.0

    @property
    def error_m(self) -> float:
        return float(np.sqrt(np.mean(np.square(self.off)))) if self.off else float("nan")

    @property
    def success(self) -> float:
        return self.picks / max(self.picks + self.failed, 1)

    @property
    def detected(self) -> float:
        return 1.0 - self.unseen / max(self.passed, 1)

    @property
    def load(self) -> float:
        return 100.0 * self.processor_s / max(self.cell_s, 1e-9)

    @property
    def discards(self) -> float:
        return self.missed / max(self.picks + self.failed + self.missed, 1)


def world(belt: str, seed: int, items_per_s: float, lenient: bool) -> dict[str, str]:
    """Lines of the scenario for one run."""
    rng = np.random.default_rng([seed, BELTS.index(belt)])
    v = float(rng.uniform(0.1, 0.3))
    more = ""
    if belt == "ripple":
        slow = f"{{ amplitude = {rng.uniform(0.01, 0.03)}, hz = {rng.uniform(0.4, 1.2)} }}"
        fast = f"{{ amplitude = {rng.uniform(0.003, 0.01)}, hz = {rng.uniform(1.8, 4.0)} }}"
        more = f"\nripple = [{slow}, {fast}]"
    if belt == "stop-start":
        more = "\nstops = { every_s = [1.0, 3.0], accel_m_s2 = [0.3, 1.2], held_s = [0.2, 1.0] }"
    fingers = "\nwithin_m = 0.05\nbelow_m_s = 1.0" if lenient else ""
    spacing = max(v / items_per_s, 0.075)
    return {
        "seed": str(seed),
        "profile": f"[{{ speed_m_s = {v} }}]{more}",
        "spacing_m": str(spacing),
        "jitter_m": str(min(0.1 * spacing, 0.5 * (spacing - 0.074))),
        "confirm": f"7{fingers}",
    }


async def run(tally: Tally, folder: Path, job: dict[str, Any], lines: dict[str, str], seconds: float) -> None:
    """Pick for so long and add what came of it."""
    async with picking_cell(picking_config(folder, {**JOB, **job}, lines)) as cell:
        begun = cell.clock.now()
        run_id = await cell.start()
        await cell.clock.sleep(WARM_UP_S)
        truth = expect(Gripper, cell.plant.world.gripper)
        before, since = len(cell.ledger.items(run_id)), cell.clock.now()
        give_up = since + seconds
        while cell.engine.active and cell.clock.now() < give_up:
            await cell.clock.sleep(0.2)
        tally.seconds += cell.clock.now() - since
        rows = cell.ledger.items(run_id)[before:]
        if cell.engine.active:
            await cell.engine.finish("bench")
        end = await cell.finished(run_id)
        if end["outcome"] != "complete":
            tally.ends.append(end["error"]["name"] if end["error"] else end["outcome"])
        outcomes = [row["outcome"] for row in rows]
        tally.cell_s += cell.clock.now() - begun
        tally.picks += outcomes.count("picked")
        tally.failed += outcomes.count("grip failed") + outcomes.count("lost")
        tally.unseen += outcomes.count("not detected")
        tally.missed += outcomes.count("out of zone")
        tally.passed += len(outcomes)
        taken = [c.item for c in truth.contacts if c.taken]
        tally.double += len(taken) - len(set(taken))
        tally.again += sum(not c.taken for c in truth.contacts)
        tally.off += [float(np.hypot(*c.off_m)) for c in truth.contacts if c.off_m is not None]


def tallied(belt: str, job: dict[str, Any], runs: int, seconds: float, rate: float, lenient: bool) -> Tally:
    tally = Tally()
    begun = time.process_time()
    for seed in range(runs):
        with tempfile.TemporaryDirectory() as folder:
            run_virtual(run(tally, Path(folder), job, world(belt, 100 + seed, rate, lenient), seconds))
    tally.processor_s = time.process_time() - begun
    return tally


def line(title: str, tally: Tally) -> str:
    shares = f"{100 * tally.detected:8.1f}{100 * tally.success:9.1f}{100 * tally.discards:10.1f}"
    ends = f"  {', '.join(tally.ends)}" if tally.ends else ""
    return (
        f"{title:34s}{tally.per_minute:9.1f}{1e3 * tally.error_m:9.3f}{len(tally.off):7d}"
        f"{shares}{tally.again:7d}{tally.double:8d}{tally.load:8.0f}{ends}"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("runs", nargs="?", type=int, default=2)
    parser.add_argument("seconds", nargs="?", type=float, default=30.0)
    parser.add_argument("--full", action="store_true", help=f"{FULL} runs")
    parser.add_argument("--belt", choices=BELTS, action="append")
    options = parser.parse_args()
    runs = FULL if options.full else options.runs
    logging.disable(logging.ERROR)
    begun = time.perf_counter()
    print(f"{runs} runs of {options.seconds:g} s each")
    print(
        f"{'':34s}{'picks/min':>9s}{'error mm':>9s}{'n':>7s}{'seen %':>8s}{'success %':>9s}"
        f"{'missed %':>10s}{'again':>7s}{'double':>8s}{'load %':>8s}"
    )
    good = True
    for belt in options.belt or BELTS:
        found = {}
        for name, job in METHODS.items():
            found[name] = tallied(belt, job, runs, options.seconds, 2.5, True)
            print(line(f"{belt}, saturated, {name}", found[name]), flush=True)
        ours, classic = found["ours"], found["classic"]
        rate, lasts = max(SPARSE * ours.per_minute / 60.0, 0.1), SPARSE_LASTS * options.seconds
        sparse = tallied(belt, METHODS["ours"], runs, lasts, rate, False)
        print(line(f"{belt}, sparse, ours", sparse), flush=True)
        ratio = ours.per_minute / max(classic.per_minute, 1e-9)
        meets = found["ours, meet only"].per_minute / max(classic.per_minute, 1e-9)
        rounded = ours.per_minute / max(found["classic, round corners"].per_minute, 1e-9)
        print(
            f"{belt}: {ratio:.2f} x classic's picks per minute, {meets:.2f} x without following; "
            f"{rounded:.2f} x classic that goes round corners"
        )
        good &= ratio >= RATIO and max(ours.error_m, sparse.error_m) <= ERROR_M and not ours.double
        good &= sparse.detected >= DETECTED and sparse.success >= SUCCESS and sparse.discards <= DISCARDS
        good &= not sparse.double and not ours.ends and not sparse.ends
    print(f"\nwithin all limits: {'yes' if good else 'NO'}   ({time.perf_counter() - begun:.0f} s)")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
