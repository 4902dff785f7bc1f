"""Delays of a camera and an encoder, injected in the twin, found by the job, and what a belt's contacts gain.

``python -m bench.latency [RUNS] [SECONDS] [--full]``: runs (2 of 20 s; 10 of 40 s with ``--full``) on virtual
time in the shipped scenario ``picking``, the real world of it, at 0.2 m/s with a belt that starts and stops
as chance has it. The camera stamps 15 ms late and the encoder 8 ms, beside its own jitter. In each run
``latency-calibration`` measures the camera and then the encoder, and items are picked three times in like
worlds: without delays, with them, and with them while what was found is in effect. ``error`` is how far the
tool's true point is from the item's true grasp point at first contact, level, RMS and median of all
contacts: a belt that brakes while the tool comes down makes one of millimetres, with delays and without.
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
from tests.kit.object_cell import ObjectCell, on_disk
from tests.kit.picking_cell import contact_errors, picking_cell, picking_config

CAMERA_S, ENCODER_S = 0.015, 0.008
JITTER_S = 0.0005  # of the scenario's encoder: its mean is part of the delay
WITHIN_S = 0.001
STOPS = "\nstops = { every_s = [1.0, 3.0], accel_m_s2 = [0.3, 1.2], held_s = [0.3, 1.0] }"
# Fingers that take what is beside them: a delay shows as an error, not as an item that is not held.
ANY_ITEM = {"confirm": "7\nwithin_m = 0.05\nbelow_m_s = 1.0"}
JOB = "latency-calibration"


@dataclass
class Found:
    """What the job found of one delay, in all runs."""

    true_s: float
    off: list[float] = field(default_factory=list)
    half: list[float] = field(default_factory=list)

    def line(self, name: str) -> str:
        off, half = np.array(self.off), np.array(self.half)
        inside = int(np.sum(np.abs(off) <= half))
        return (
            f"{name:12s}{1e3 * self.true_s:12.3f}{1e3 * (self.true_s + off.mean()):10.3f}"
            f"{1e3 * np.abs(off).max():12.3f}{1e3 * np.median(half):14.3f}{inside:8d} of {len(off)}"
        )


def world(seed: int, late: bool) -> dict[str, str]:
    lines = {"seed": str(seed), "profile": "[{ speed_m_s = 0.2 }]" + STOPS, **ANY_ITEM}
    if late:
        lines |= {
            "exposure_s": f"0.004\nstamp_late_s = {CAMERA_S}",
            "node": f"5\nlate_s = {ENCODER_S}",
        }
    return lines


async def measure(cell: ObjectCell, source: str, found: Found) -> dict[str, float]:
    """One run of the job; what it found is in effect after."""
    more = {"belt_z_m": 0.15} if source == "belt" else {}
    run_id = await cell.start(job=JOB, params={"source": source, **more})
    end = await cell.finished(run_id)
    if end["outcome"] != "complete":
        raise SystemExit(f"{source}: {end['error']}")
    answer = cell.result(run_id)["result"]
    low, high = answer["interval95_s"]
    found.off.append(answer["time_offset_s"] - found.true_s)
    found.half.append(0.5 * (high - low))
    return {"time_offset_s": answer["time_offset_s"]}


async def pick(cell: ObjectCell, seconds: float) -> list[float]:
    run_id, since = await cell.start(), cell.clock.now()
    while cell.engine.active and cell.clock.now() < since + seconds:
        await cell.clock.sleep(0.2)
    if cell.engine.active:
        await cell.engine.finish("bench")
    end = await cell.finished(run_id)
    if end["outcome"] != "complete":
        print(f"  picking ended: {end['error']}")
    off: list[float] = np.linalg.norm(contact_errors(cell), axis=1).tolist()
    return off


async def run(
    folder: Path, seed: int, case: str, seconds: float, found: dict[str, Found], known: dict[str, float]
) -> list[float]:
    """Contacts (m) of one run; in the case "measured" the job runs first, in a cell of its own."""
    config = picking_config(
        folder,
        {"dwell_s": 0.05, "standing_s": 3.0},
        world(seed, case != "none"),
        real=True,
        sections={JOB: {"accept": {"auto": True}}},
    )
    async with picking_cell(config) as cell:
        if case == "measuring":
            for source, device in (("fixed_camera", "camera"), ("belt", "belt")):
                known[device] = (await measure(cell, source, found[source]))["time_offset_s"]
            return []
        if case == "after":  # as the runs before would have left it, from the same begin of the belt
            for device, offset_s in known.items():
                row = cell.ledger.propose(f"time_offset_s.{device}", offset_s, {}, 0, 0.0)
                on_disk(cell.ledger.accept, row, "bench")
        return await pick(cell, seconds)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("runs", nargs="?", type=int, default=2)
    parser.add_argument("seconds", nargs="?", type=float, default=20.0)
    parser.add_argument("--full", action="store_true", help="10 runs of 40 s")
    options = parser.parse_args()
    runs, seconds = (10, 40.0) if options.full else (options.runs, options.seconds)
    logging.disable(logging.ERROR)
    begun = time.perf_counter()
    found = {"fixed_camera": Found(CAMERA_S), "belt": Found(ENCODER_S + 0.5 * JITTER_S)}
    contacts: dict[str, list[float]] = {"none": [], "before": [], "after": []}
    for seed in range(runs):
        known: dict[str, float] = {}
        for case in ("measuring", "none", "before", "after"):
            with tempfile.TemporaryDirectory() as folder:
                off = run_virtual(run(Path(folder), 100 + seed, case, seconds, found, known))
            if case in contacts:
                contacts[case] += off
    print(f"{runs} runs, {seconds:g} s of picking each, belt at 0.2 m/s that starts and stops at random\n")
    print(
        f"{'':12s}{'injected ms':>12s}{'mean ms':>10s}{'most off ms':>12s}{'95 % +- ms':>14s}{'inside':>10s}"
    )
    for name, one in found.items():
        print(one.line(name))
    print(f"\n{'contacts':24s}{'error mm':>10s}{'median mm':>11s}{'most mm':>10s}{'n':>6s}")
    rms = {}
    for case, title in (
        ("none", "no delay"),
        ("before", "delays, none measured"),
        ("after", "delays measured"),
    ):
        own = np.array(contacts[case])
        rms[case] = float(np.sqrt(np.mean(own**2)))
        middle, most = np.median(own), own.max()
        print(f"{title:24s}{1e3 * rms[case]:10.3f}{1e3 * middle:11.3f}{1e3 * most:10.3f}{len(own):6d}")
    worst = max(max(np.abs(one.off)) for one in found.values())
    good = worst <= WITHIN_S and rms["after"] <= 1.1 * rms["none"]
    print(f"\nfound within {1e3 * WITHIN_S:g} ms, and contacts within 10 % of those without delay: "
          f"{'yes' if good else 'NO'}   ({time.perf_counter() - begun:.0f} s)")  # fmt: skip
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
