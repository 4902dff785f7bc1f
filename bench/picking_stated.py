"""Contacts of picking beside the 95 % that is stated of each.

``python -m bench.picking_stated [RUNS] [SECONDS] [--row N] [--unmeasured]``: runs (6 of 14 s) of the shipped
scenario ``picking`` on virtual time, as it is, with a camera that exposes by itself in less and less light
(the scenario ``picking_auto_exposure`` has 100 lx), on a belt with ripple and on one that stops. In each run
camera, belt and the camera's delay are off by what is drawn from the uncertainty that their calibrations
state, and the arm by what nothing states. ``95 % mm`` is what 95 of 100 contacts were within, ``stated``
the same as the result has it, ``camera`` its ``camera_95_m`` alone, ``inside`` the share of contacts within
the figure of their own record. The contacts of a run share the errors of its calibrations, so many runs say
more than long ones. With ``--unmeasured`` no delay was measured, and camera, encoder and arm are as late as
``cell/usual_delays.py`` has it.
"""

import argparse
import logging
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tests.kit.contacts_stated import StatedRun, stated_run

RUNS, SECONDS = 6, 14.0
LEAST, MOST = 0.90, 0.99
JOB = {"dwell_s": 0.05, "standing_s": 3.0}
RIPPLE = "ripple = [{ amplitude = 0.02, hz = 0.7 }, { amplitude = 0.006, hz = 2.3 }]"
STOPS = "stops = { every_s = [1.0, 3.0], accel_m_s2 = [0.3, 1.2], held_s = [0.2, 1.0] }"


def by_itself(light_lux: float) -> dict[str, str]:
    return {"exposure_s": f"0.004\nauto_exposure = {{ light_lux = {light_lux} }}"}


def running(how: str) -> dict[str, str]:
    return {"profile": f"[{{ speed_m_s = 0.15 }}]\n{how}"}


ROWS: dict[str, dict[str, str]] = {
    "as shipped": {},
    "exposes by itself, 300 lx": by_itself(300.0),
    "exposes by itself, 100 lx": by_itself(100.0),
    "exposes by itself, 60 lx": by_itself(60.0),
    "ripple": running(RIPPLE),
    "stop and start": running(STOPS),
}


def line(title: str, runs: list[StatedRun]) -> tuple[str, float]:
    """A row of the table, and the share of contacts inside."""
    contacts = [contact for run in runs for contact in run.contacts]
    answers = [run.answer for run in runs if run.answer.get("contact_95_m") is not None]
    if not contacts or not answers:
        return f"{title:28s}no contact", 0.0
    off = np.array([float(np.linalg.norm(contact.off)) for contact in contacts])
    inside = float(np.mean([contact.inside for contact in contacts]))
    stated, camera = (
        float(np.sqrt(np.mean(np.square([answer[key] for answer in answers]))))
        for key in ("contact_95_m", "camera_95_m")
    )
    shares: dict[str, float] = {}
    for answer in answers:
        for name, share in answer["contact_95_shares"].items():
            shares[name] = shares.get(name, 0.0) + share / len(answers)
    most = ", ".join(f"{name} {100 * share:.0f}" for name, share in sorted(shares.items(), key=_last)[:3])
    ends = sorted({run.outcome for run in runs} - {"complete"})
    text = (
        f"{title:28s}{len(off):5d}{1e3 * np.sqrt(np.mean(off**2)):8.3f}{1e3 * np.quantile(off, 0.95):8.3f}"
        f"{1e3 * stated:8.3f}{1e3 * camera:8.3f}{100 * inside:9.1f}  {most}  {', '.join(ends)}"
    )
    return text, inside


def _last(part: tuple[str, float]) -> float:
    return -part[1]


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("runs", nargs="?", type=int, default=RUNS)
    parser.add_argument("seconds", nargs="?", type=float, default=SECONDS)
    parser.add_argument("--row", type=int, action="append", help="only this row, from 0")
    parser.add_argument("--unmeasured", action="store_true", help="no delay was measured")
    options = parser.parse_args()
    logging.disable(logging.ERROR)
    begun = time.perf_counter()
    print(f"{options.runs} runs of {options.seconds:g} s each")
    print(
        f"{'':28s}{'n':>5s}{'RMS mm':>8s}{'95 % mm':>8s}{'stated':>8s}{'camera':>8s}{'inside %':>9s}"
        "  share of the stated square, %"
    )
    found: list[tuple[int, float]] = []
    for number, (title, world) in enumerate(ROWS.items()):
        if options.row and number not in options.row:
            continue
        runs = []
        for seed in range(options.runs):
            with tempfile.TemporaryDirectory() as folder:
                at = 100 * number + seed
                measured = not options.unmeasured
                runs.append(stated_run(Path(folder), at, world, JOB, options.seconds, measured))
        text, inside = line(title, runs)
        found.append((sum(len(run.contacts) for run in runs), inside))
        print(text, flush=True)
    counts, inside = np.array(found).T
    pooled = float(np.average(inside, weights=np.maximum(counts, 1e-9)))
    good = min(inside) >= LEAST and pooled <= MOST
    print(
        f"\nof all contacts {100 * pooled:.1f} % are inside, 90 to 99 wanted: {'yes' if good else 'NO'}",
        end="",
    )
    print(f"   ({time.perf_counter() - begun:.0f} s)")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
