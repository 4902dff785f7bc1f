"""Picking in a real world beside an ideal one.

``python -m bench.picking_worlds [RUNS] [SECONDS] [--full]``: runs (2 of 20 s; 20 with ``--full``) on
virtual time at 0.15 m/s in the shipped scenario ``picking``: as it is, with the other filter of the arm and
the other look-ahead, and as ``picking:ideal``. The published method stands beside ours in the same world,
with fingers that take an item that slides, as the twin's own refuse all that it brings. ``error`` is the
horizontal distance of the tool's true point and the item's true grasp point at first contact, RMS;
``success`` is the share of items that were tried and picked.
"""

import argparse
import logging
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from fakes.object import run_virtual
from tests.kit.picking_cell import contact_errors, picking_cell, picking_config

FULL = 20
SUCCESS, ERROR_M = 0.98, 0.5e-3
ANY_ITEM = {"confirm": "7\nwithin_m = 0.05\nbelow_m_s = 1.0"}  # fingers that take what slides
DELAY, LOW_PASS = '"delay"', '"low-pass"'
ROWS: list[tuple[str, bool, str, float, str]] = [
    ("real, delay, look-ahead 0.05 s", True, DELAY, 0.05, "ml"),
    ("real, delay, look-ahead 0.03 s", True, DELAY, 0.03, "ml"),
    ("real, low-pass, look-ahead 0.05 s", True, LOW_PASS, 0.05, "ml"),
    ("real, low-pass, look-ahead 0.03 s", True, LOW_PASS, 0.03, "ml"),
    ("real, delay, 0.05 s, classic", True, DELAY, 0.05, "classic"),
    ("ideal", False, DELAY, 0.05, "ml"),
    ("ideal, classic", False, DELAY, 0.05, "classic"),
]


@dataclass
class Picked:
    """What came of the runs of one row."""

    seconds: float = 0.0
    picks: int = 0
    failed: int = 0
    ends: list[str] = field(default_factory=list)
    off: list[float] = field(default_factory=list)
    closing_s: list[float] = field(default_factory=list)

    @property
    def success(self) -> float:
        return self.picks / max(self.picks + self.failed, 1)

    @property
    def error_m(self) -> float:
        return float(np.sqrt(np.mean(np.square(self.off)))) if self.off else float("nan")

    @property
    def per_minute(self) -> float:
        return 60.0 * self.picks / self.seconds if self.seconds else 0.0

    @property
    def good(self) -> bool:
        return self.success >= SUCCESS and self.error_m <= ERROR_M and not self.ends


async def run(
    picked: Picked, folder: Path, seed: int, row: tuple[str, bool, str, float, str], s: float
) -> None:
    """Pick for ``s`` seconds and add what came of it."""
    _, real, lag, lookahead_s, method = row
    world = {"seed": str(seed), **({"lag": lag} if real else {}), **(ANY_ITEM if method == "classic" else {})}
    arm = {"servo_lookahead_s": lookahead_s}
    config = picking_config(folder, {"method": method, "dwell_s": 0.05}, world, real=real, arm=arm)
    async with picking_cell(config) as cell:
        run_id, since = await cell.start(), cell.clock.now()
        while cell.engine.active and cell.clock.now() < since + s:
            await cell.clock.sleep(0.2)
        if cell.engine.active:
            await cell.engine.finish("bench")
        end = await cell.finished(run_id)
        picked.seconds += cell.clock.now() - since
        if end["outcome"] != "complete":
            picked.ends.append(end["error"]["name"] if end["error"] else end["outcome"])
        elif (closing_s := cell.result(run_id)["result"]["gripper_closing_s"]) is not None:
            picked.closing_s.append(closing_s)
        outcomes = [row["outcome"] for row in cell.ledger.items(run_id)]
        picked.picks += outcomes.count("picked")
        picked.failed += outcomes.count("grip failed") + outcomes.count("lost")
        picked.off += np.linalg.norm(contact_errors(cell), axis=1).tolist()


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("runs", nargs="?", type=int, default=2)
    parser.add_argument("seconds", nargs="?", type=float, default=20.0)
    parser.add_argument("--full", action="store_true", help=f"{FULL} runs")
    parser.add_argument("--row", type=int, action="append", help="only this row, from 0")
    options = parser.parse_args()
    runs, begun = FULL if options.full else options.runs, time.perf_counter()
    logging.disable(logging.ERROR)
    print(f"{runs} runs of {options.seconds:g} s each, belt at 0.15 m/s")
    print(
        f"{'':36s}{'picks':>6s}{'success %':>10s}{'error mm':>9s}{'most mm':>8s}{'n':>5s}"
        f"{'picks/min':>10s}{'closes s':>9s}"
    )
    good, rates = True, dict[str, float]()
    for number, row in enumerate(ROWS):
        if options.row and number not in options.row:
            continue
        picked = Picked()
        for seed in range(runs):
            with tempfile.TemporaryDirectory() as folder:
                run_virtual(run(picked, Path(folder), 100 + seed, row, options.seconds))
        rates[row[0]] = picked.per_minute
        closes = max(picked.closing_s, default=float("nan"))
        print(
            f"{row[0]:36s}{picked.picks:6d}{100 * picked.success:10.1f}{1e3 * picked.error_m:9.3f}"
            f"{1e3 * max(picked.off, default=float('nan')):8.3f}{len(picked.off):5d}{picked.per_minute:10.1f}"
            f"{closes:9.2f}  {', '.join(picked.ends)}",
            flush=True,
        )
        good &= picked.good or row[4] == "classic"
    for ours, theirs in ((ROWS[0][0], ROWS[4][0]), (ROWS[5][0], ROWS[6][0])):
        if ours in rates and rates.get(theirs):
            print(f"{ours}: {rates[ours] / rates[theirs]:.2f} x classic's picks per minute")
    print(f"\nwithin all limits: {'yes' if good else 'NO'}   ({time.perf_counter() - begun:.0f} s)")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
