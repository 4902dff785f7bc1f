"""Stated uncertainty of captures without joints, beside the same with the arm taken as exact.

``python -m bench.no_joints [RUNS] [--arm MM]... [--plan PLAN]...``: simulated captures with a lens off by
0.3 % and a board bowed by 0.2 mm. A row, for the arm as exact and for errors that neighbouring poses share:
RMS error of X and its stated standard deviation (mm), mean NEES (6 is right), the share of errors inside the
stated 95 % in translation and rotation; then the time of the second. All before the covariance is enlarged
for what leaving out observations shows.
"""

import argparse
import itertools
import time

import cv2
import numpy as np

from bench.adjustment import Tally
from calibration.adjustment.hand_eye import Adjusted, adjust
from calibration.adjustment.lens_terms import LensPrior
from calibration.adjustment.shared_errors import shared_errors
from calibration.hand_eye.solution import Solution, solve
from cell.poses import Array
from tests.kit.imperfect_cell import CAMERA, capture, capture_eye_to_hand, world

PLANS = ("cone", "diverse", "branches", "eye-to-hand")
ARMS_MM = (0.0, 0.06, 0.2)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("runs", nargs="?", type=int, default=8)
    parser.add_argument("--arm", type=float, action="append", help="mm, of a length of the chain")
    parser.add_argument("--plan", choices=PLANS, action="append")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    head = f"{'rms':>7}{'stated':>8}{'NEES':>8}{'t %':>6}{'r %':>5}"
    print(f"{'plan':12}{'arm mm':>7}{head}   shared{head}{'ms':>7}")
    for plan, arm in itertools.product(options.plan or PLANS, options.arm or ARMS_MM):
        exact, shared, took_s = Tally(), Tally(), 0.0
        for seed in range(options.runs):
            took_s += _one(plan, 1e-3 * arm, seed, exact, shared)
        milliseconds = 1e3 * took_s / options.runs
        print(f"{plan:12}{arm:7.2f}{exact.row()}         {shared.row()}{milliseconds:7.0f}", flush=True)


def _one(plan: str, arm_m: float, seed: int, exact: Tally, shared: Tally) -> float:
    """Add one capture to both; the processor time (s) of the adjustment with shared errors."""
    rng = np.random.default_rng([seed, 5])
    cell = world(rng, arm_m, "off", "bow")
    if plan == "eye-to-hand":
        measured, _, X = capture_eye_to_hand(rng, cell)
    else:
        measured, X = capture(rng, cell, plan)[0], cell.X
    first = solve(measured, CAMERA, {})
    if not isinstance(first, Solution):
        raise SystemExit(f"{plan}, seed {seed}: {first}")
    _add(exact, adjust(measured, first, CAMERA, None, LensPrior()), X)
    begun = time.process_time()
    found = adjust(measured, first, CAMERA, shared_errors(measured.F[first.used]), LensPrior())
    took_s = time.process_time() - begun
    _add(shared, found, X)
    return took_s


def _add(tally: Tally, found: Adjusted, X: Array) -> None:
    tally.add(found.X, found.cov - found.by_leaving_out.added, X)


if __name__ == "__main__":
    main()
