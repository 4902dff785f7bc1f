"""Stated uncertainty of captures without joints, beside the same with the arm taken as exact.

``python -m bench.no_joints [RUNS] [--arm MM]... [--plan PLAN]...``: simulated captures with a lens off by
0.3 % and a board bowed by 0.2 mm. A row, for the arm as exact and for errors that neighbouring poses share:
RMS error of X and its stated standard deviation (mm), mean NEES (6 is right), the share of errors inside the
stated 95 % in translation and rotation; then the time of the second. All before the covariance is enlarged
for what leaving out observations shows.

The plans ``poses-20`` to ``corners-60`` are checks of a fixed camera, of so many poses, by a target whose
place C on the flange is known to 0.1 mm and 0.3 mrad; lens and print are exact. Their X is with the known
place, ``C`` is the place by images and arm alone; of true base and flange, which an arm's errors move, too.
"""

import argparse
import itertools
import time

import cv2
import numpy as np

from bench.adjustment import Tally
from calibration.adjustment.bare_poses import adjust_poses
from calibration.adjustment.hand_eye import Adjusted, adjust
from calibration.adjustment.lens_terms import LensPrior, TargetPrior
from calibration.adjustment.mount import GivenPose, mounted, with_place
from calibration.adjustment.shared_errors import shared_errors
from calibration.hand_eye import se3
from calibration.hand_eye.solution import Measurements, Solution, solve
from calibration.hand_eye.views import CornerSet
from cell.poses import Array
from procedures.eye_to_hand.solve.solver import LENS_AS_GIVEN
from tests.kit.eye_to_hand_scene import POINTS, POSE_R, POSE_T, SIGMA_C_R, SIGMA_C_T, make_scene
from tests.kit.imperfect_cell import CAMERA, capture, capture_eye_to_hand, world

CHECKS = {f"{kind}-{n}": (kind == "poses", n) for kind in ("poses", "corners") for n in (20, 60)}
PLANS = ("cone", "diverse", "branches", "eye-to-hand", *CHECKS)
ARMS_MM = (0.0, 0.06, 0.2)
PRINT = TargetPrior(scale=1e-4, bow=2e-5)


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
        parts = (plan, "  C") if plan in CHECKS else (plan,)
        exact, shared = [Tally() for _ in parts], [Tally() for _ in parts]
        one, took_s = _check if plan in CHECKS else _capture, 0.0
        for seed in range(options.runs):
            took_s += one(plan, 1e-3 * arm, seed, exact, shared)
        for part, before, now in zip(parts, exact, shared, strict=True):
            milliseconds = 1e3 * took_s / options.runs
            print(f"{part:12}{arm:7.2f}{before.row()}         {now.row()}{milliseconds:7.0f}", flush=True)


def _capture(plan: str, arm_m: float, seed: int, exact: list[Tally], shared: list[Tally]) -> float:
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
    _add(exact[0], adjust(measured, first, CAMERA, None, LensPrior()), X)
    begun = time.process_time()
    found = adjust(measured, first, CAMERA, shared_errors(measured.F[first.used]), LensPrior())
    took_s = time.process_time() - begun
    _add(shared[0], found, X)
    return took_s


def _check(plan: str, arm_m: float, seed: int, exact: list[Tally], shared: list[Tally]) -> float:
    """Add X and C of one check to both; the processor time (s) of the adjustment with shared errors."""
    bare, n = CHECKS[plan]
    rng = np.random.default_rng([seed, n, 33])
    scene = make_scene(rng, n, arm_m)
    C = scene.C @ se3.exp(rng.normal(size=(n, 6)) * np.repeat([POSE_T, POSE_R], 3)) if bare else scene.C
    views = [
        None if bare else CornerSet(POINTS, uv, np.ones(len(uv)), T)
        for uv, T in zip(scene.corners, C, strict=True)
    ]
    group = np.zeros(n, dtype=np.int64)
    measured = Measurements("eye-to-hand", scene.F, group, views, C, np.eye(4)[None])
    first = solve(measured, CAMERA, {})
    if not isinstance(first, Solution):
        raise SystemExit(f"{plan}, seed {seed}: {first}")
    sigma = np.repeat([SIGMA_C_T, SIGMA_C_R], 3)
    place = GivenPose(scene.W @ se3.exp(sigma * rng.normal(size=6)), np.diag(sigma**2))
    took_s = 0.0
    for tallies, arm in ((exact, None), (shared, shared_errors(measured.F[first.used]))):
        begun = time.process_time()
        alone = (
            adjust_poses(first, arm)
            if bare
            else mounted(adjust(measured, first, CAMERA, arm, LENS_AS_GIVEN, PRINT), arm)
        )
        took_s = time.process_time() - begun
        standard = with_place(alone, place)
        tallies[0].add(standard.X, standard.cov_X, scene.X)
        tallies[1].add(alone.W, alone.cov_W, scene.W)
    return took_s


def _add(tally: Tally, found: Adjusted, X: Array) -> None:
    tally.add(found.X, found.cov - found.by_leaving_out.added, X)


if __name__ == "__main__":
    main()
