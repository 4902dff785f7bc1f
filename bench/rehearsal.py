"""How well a rehearsal tells what comes: each job on many twins of the example cell, on virtual time.

``python -m bench.rehearsal [TWINS] [JOB ...]`` (10 twins, all jobs). A row a job: in how many twins it ended
well, in how many the result's errors were all below the 95 % limits stated for them, the cell's time, and
the computer's. The cell is ``deploy/cell.toml`` with every part that is commented out there.
"""

import argparse
import contextlib
import io
import tempfile
import time
from pathlib import Path

from daemon.config import load_config
from daemon.rehearsal.play import RehearsedRun, rehearse
from tests.kit.example_cell import LASER_TRACKER, whole_example

JOBS = (
    "cone-capture",
    "laser-reference",
    "laser-check",
    "laser-update",
    "latency-calibration",
    "tracker-sampling",
    "belt-calibration",
    "belt-tracking",
    "touch-test",
    "eye-to-hand-check",
    "slot-insertion",
)
# The example's speeds are for calibrating; picking needs more, as its finding says. Its total station has no
# plan within the limits of tracker-sampling, as its finding says, too.
BELT = {
    "speed_m_s = 0.25\naccel_m_s2 = 0.5\njoint_speed_rad_s = 0.8": (
        "speed_m_s = 1.5\naccel_m_s2 = 6.0\njoint_speed_rad_s = 2.5"
    )
}
CHANGED = {"belt": BELT, "tracker": LASER_TRACKER}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("twins", nargs="?", type=int, default=10)
    parser.add_argument("jobs", nargs="*", metavar="JOB", help=", ".join(JOBS))
    options = parser.parse_args()
    print(f"{'job':22}{'twins':>6}{'ended well':>12}{'inside 95 %':>13}{'cell, s':>9}{'computer, s':>13}")
    for job in options.jobs or JOBS:
        outcomes, seconds = _played(job, options.twins)
        stated = [o.inside95 for o in outcomes if o.inside95 is not None]
        inside = f"{sum(stated)}/{len(stated)}" if stated else "-"
        cell = sorted(o.seconds for o in outcomes)[len(outcomes) // 2]
        well = sum(o.succeeded for o in outcomes)
        row = f"{job:22}{len(outcomes):6}{well:12}{inside:>13}{cell:9.0f}{seconds / len(outcomes):13.1f}"
        print(row, flush=True)
        for outcome in outcomes:
            if not outcome.succeeded:
                why = "; ".join(outcome.why) or f"{outcome.off} off, {outcome.stated} stated"
                print(f"    twin {outcome.seed}: {outcome.ended} {outcome.verdict} {why}", flush=True)


def _played(job: str, twins: int) -> tuple[list[RehearsedRun], float]:
    began, outcomes = time.process_time(), []
    for seed in range(1, twins + 1):
        with tempfile.TemporaryDirectory(prefix="cellward-rehearsal-") as folder:
            path = whole_example(Path(folder), CHANGED.get(job.partition("-")[0], {}))
            with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
                outcomes.append(rehearse(load_config(path), path, job, seed, Path(folder)))
    return outcomes, time.process_time() - began


if __name__ == "__main__":
    main()
