"""How well a rehearsal tells what comes: each job on many twins of the example cell, on virtual time.

``python -m bench.rehearsal [TWINS] [JOB ...] [--first SEED] [--keep FILE]`` (10 twins, all jobs). A row a
job: in how many twins it ended well, in how many the result's errors were all below the 95 % limits stated
for them, with the exact 95 % interval of that share, the cell's time, the computer's (its processor's), and
the longest time that a person waits. Below it are each error that has a limit with a unit beside that limit
(both RMS over the twins) and in how many it was inside by itself, the twins that took more than the minute
that a rehearsal may take, those in which it did not end well, and those outside: each error there in units of
its limit. A job with a word behind a slash is rehearsed with that source. The cell is
``deploy/cell.toml`` with every part that is commented out there, its palletizer for corrected-targets alone.
With ``--keep FILE`` a bench that was ended goes on where it was, and the table is made of all twins in the
file.
"""

import argparse
import contextlib
import io
import json
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import betaincinv

from daemon.config import load_config
from daemon.rehearsal.play import RehearsedRun, rehearse
from tests.kit.example_cell import ENCODER_DELAY, LASER_TRACKER, palletizer_example, whole_example

JOBS = (
    "cone-capture",
    "laser-reference",
    "laser-check",
    "laser-update",
    "latency-calibration",
    "latency-calibration/belt",
    "tracker-sampling",
    "iso9283",
    "corrected-targets",
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
CHANGED = {
    "belt-calibration": BELT,
    "belt-tracking": BELT,
    "tracker-sampling": LASER_TRACKER,
    "iso9283": LASER_TRACKER,
    "latency-calibration/belt": ENCODER_DELAY,
}
MINUTE_S = 60.0
UNITS = {"m": ("mm", 1e3), "rad": ("mrad", 1e3), "s": ("ms", 1e3), "1": ("%", 100.0)}  # for people's eyes


@dataclass(frozen=True)
class Played:
    """A job in one twin, the processor time (s) that it took, and the time that a person waits; None of a
    twin that was kept before that was measured."""

    job: str
    outcome: RehearsedRun
    computer_s: float
    wall_s: float | None = None

    def as_json(self) -> str:
        """One line."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, line: str) -> "Played":
        """Of what :meth:`as_json` gave."""
        found: Mapping[str, Any] = json.loads(line)
        known = {f.name for f in fields(RehearsedRun)}
        outcome = {name: value for name, value in found["outcome"].items() if name in known}
        return cls(found["job"], RehearsedRun(**outcome), found["computer_s"], found.get("wall_s"))


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.rehearsal", description=__doc__)
    parser.add_argument("twins", nargs="?", type=int, default=10)
    parser.add_argument("jobs", nargs="*", metavar="JOB", help=", ".join(JOBS))
    parser.add_argument("--first", type=int, default=1, help="seed of the first; others follow it")
    parser.add_argument("--keep", type=Path, help="file of twins: new ones are added, old ones not run")
    options = parser.parse_args(arguments)
    jobs = list(dict.fromkeys(options.jobs or JOBS))
    kept = _kept(options.keep) if options.keep else []
    done = {(played.job, played.outcome.seed) for played in kept}
    # Seed by seed, so that a bench that is ended early has as many of each job.
    for seed, job in product(range(options.first, options.first + options.twins), jobs):
        if (job, seed) in done:
            continue
        kept.append(_play(job, seed))
        if options.keep:
            with options.keep.open("a", encoding="utf-8") as file:
                file.write(kept[-1].as_json() + "\n")
    print(
        f"{'job':26}{'twins':>6}{'ended well':>12}{'inside 95 %':>24}{'cell, s':>9}{'computer, s':>13}"
        f"{'longest wait, s':>17}"
    )
    for job in jobs:
        for line in lines_of([played for played in kept if played.job == job]):
            print(line, flush=True)


def lines_of(of_job: Sequence[Played]) -> Iterator[str]:
    """The row of one job, and its twins that did not end well or were outside."""
    if not of_job:
        return
    outcomes = [played.outcome for played in sorted(of_job, key=lambda p: p.outcome.seed)]
    stated = [o.inside95 for o in outcomes if o.inside95 is not None]
    inside = "-"
    if stated:
        low, high = exact_interval(sum(stated), len(stated))
        inside = f"{sum(stated)}/{len(stated)} ({100 * low:.1f} to {100 * high:.1f} %)"
    cell = sorted(o.seconds for o in outcomes)[len(outcomes) // 2]
    well = sum(o.succeeded for o in outcomes)
    computer = sum(played.computer_s for played in of_job) / len(of_job)
    waited = {played.outcome.seed: played.wall_s for played in of_job if played.wall_s is not None}
    wall = f"{max(waited.values()):17.1f}" if waited else f"{'-':>17}"
    yield f"{of_job[0].job:26}{len(outcomes):6}{well:12}{inside:>24}{cell:9.0f}{computer:13.1f}{wall}"
    for seed, wall_s in sorted(waited.items()):
        if wall_s > MINUTE_S:
            yield f"    twin {seed}: MORE THAN A MINUTE, {wall_s:.0f} s"
    for name in dict.fromkeys(name for o in outcomes for name in o.limits95):
        of = [(o.of95[name], *o.limits95[name]) for o in outcomes if name in o.limits95]
        off, stated95 = (_rms(v) for v in zip(*((share * size, size) for share, size, _ in of), strict=True))
        unit, per = UNITS[of[0][2]]
        within = sum(share <= 1.0 for share, _, _ in of)
        yield (
            f"    {name}: {per * off:.4f} {unit} off (RMS), {per * stated95:.4f} {unit} stated (95 %, RMS), "
            f"{within}/{len(of)} inside"
        )
    for outcome in outcomes:
        if not outcome.succeeded:
            why = "; ".join(outcome.why) or f"{outcome.off} off, {outcome.stated} stated"
            yield f"    twin {outcome.seed}: {outcome.ended} {outcome.verdict} {why}"
        if outcome.inside95 is False:
            errors = ", ".join(f"{name} {share:.2f}" for name, share in outcome.of95.items())
            yield f"    twin {outcome.seed}: outside; of the 95 % limits: {errors}"


def _rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def exact_interval(inside: int, of: int) -> tuple[float, float]:
    """95 % interval of a share of which ``inside`` of ``of`` were seen, by Clopper and Pearson (1934)."""
    low = float(betaincinv(inside, of - inside + 1, 0.025)) if inside else 0.0
    high = float(betaincinv(inside + 1, of - inside, 0.975)) if inside < of else 1.0
    return low, high


def _kept(path: Path) -> list[Played]:
    lines = path.read_text("utf-8").splitlines() if path.exists() else []
    return [Played.from_json(line) for line in lines]


def _play(job: str, seed: int) -> Played:
    began, clock = time.process_time(), time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="cellward-rehearsal-") as folder:
        cell = palletizer_example if job == "corrected-targets" else whole_example
        path = cell(Path(folder), CHANGED.get(job, {}))
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            outcome = rehearse(load_config(path), path, job.partition("/")[0], seed, Path(folder))
    return Played(job, outcome, time.process_time() - began, time.perf_counter() - clock)


if __name__ == "__main__":
    main(sys.argv[1:])
