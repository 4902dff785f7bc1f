"""An arm calibrated from a printed board alone: its position error where nothing was measured.

``python -m bench.board_kinematics [RUNS] [--plan NAME]``: UR10e with links off by 0.3 to 2.5 times 0.2 mm and
0.3 mrad (standard deviations), 0.2 px, 0.03 mm and 0.05 mrad of repeatability; noise levels are not given. A
row is one kind of cell: what is off in it, and how well lens and board are stated to be known (certified:
0.01 %; of a printer: 0.2 %). Gears are 50 urad, sag 300 urad; all at once has a lens off by 0.3 % and 3 px
and a board off by 0.01 % and bowed by 0.2 mm besides. Errors are of the flange's place, mm RMS, before,
after, and as stated: after the best base and tool offset at 200 poses of ten other placements (workspace),
and after the best base and flange over all joints. Ratios are stated over true, 1 is right; ``below`` is how
many errors in the workspace are below the stated 95 %, and ``bound`` is the least error there that the
pictures allow, with noise levels and the arms' quality known. Plan ``planned`` is what the product's planner
makes of three placements of 60 poses, for the lens and the board as they are stated, in a cell without
obstacles; the others are drawn at random.
"""

import argparse
import time
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from bench._board_bound import Drawn, bound
from calibration.adjustment.arm_accuracy import arm_accuracy, corrected_arm, position_accuracy
from calibration.adjustment.arm_terms import reference_joints
from calibration.adjustment.gauge import apart
from calibration.adjustment.hand_eye import adjust
from calibration.adjustment.lens_terms import LensPrior, TargetPrior
from calibration.adjustment.unknowns import ArmKnown
from calibration.hand_eye import se3
from calibration.hand_eye.solution import Solution, solve
from cell.poses import Array
from tests.kit.imperfect_cell import ARM, CAMERA, MODEL, PLANS, capture, world
from tests.kit.planned_cell import Placed, capture_planned, planned

PLANNED, BY_PLANNER = "planned", (3, 60)
SURE_LENS = LensPrior(1e-5, 1e-5, 0.02, 1e-5, 1e-6)
EXACT_BOARD, CERTIFIED = TargetPrior(1e-5, 1e-6), TargetPrior(scale=1e-4)


@dataclass(frozen=True)
class Cell:
    """One kind of cell: what is wrong in it, and what is known of its lens and its board."""

    name: str
    lens: str
    board: str
    gear_rad: float
    sag_rad: float
    known_lens: LensPrior
    known_board: TargetPrior


GEARS, SAG = 5e-5, 3e-4
CELLS = (
    Cell("links; all stated exact", "exact", "exact", 0.0, 0.0, SURE_LENS, EXACT_BOARD),
    Cell("gear, sag; all stated exact", "exact", "exact", GEARS, SAG, SURE_LENS, EXACT_BOARD),
    Cell("gear, sag; board stated exact", "exact", "exact", GEARS, SAG, LensPrior(), EXACT_BOARD),
    Cell("gear, sag; board certified", "exact", "exact", GEARS, SAG, LensPrior(), CERTIFIED),
    Cell("all at once; board certified", "off", "slight", GEARS, SAG, LensPrior(), CERTIFIED),
    Cell("all at once; board of a printer", "off", "slight", GEARS, SAG, LensPrior(), TargetPrior()),
)


@dataclass
class Tally:
    """Of runs: true errors and stated ones in m, RMS; before, after, stated, each for both sets of joints."""

    near: list[tuple[float, float, float]]
    everywhere: list[tuple[float, float, float]]
    below: list[float]
    bound: list[float]
    seconds: list[float]

    def text(self) -> str:
        columns = ""
        for runs in (self.near, self.everywhere):
            before, after, stated = 1e3 * np.sqrt(np.mean(np.square(runs), axis=0))
            columns += f"{before:9.3f}{after:8.3f}{stated:8.3f}{stated / after:7.2f}"
        bound = 1e3 * _rms(np.array(self.bound))
        return f"{columns}{100 * np.mean(self.below):7.0f}%{bound:8.3f}{1e3 * np.mean(self.seconds):7.0f}"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("runs", nargs="?", type=int, default=20)
    parser.add_argument("--plan", choices=(*PLANS, PLANNED), default=PLANNED)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    places, each = PLANS.get(options.plan, BY_PLANNER)
    half = f"{'before':>9}{'after':>8}{'stated':>8}{'ratio':>7}"
    print(f"plan {options.plan}: {places} placements, {each} poses each; {options.runs} arms a row")
    print(f"{'':38}{'workspace':>20}{'':12}{'all joints':>20}")
    print(f"{'cell':38}{half}{half}{'below':>8}{'bound':>8}{'ms':>7}")
    for cell in CELLS:
        tally = Tally([], [], [], [], [])
        for seed in range(options.runs):
            one(seed, cell, options.plan, tally)
        print(f"{cell.name:38}{tally.text()}", flush=True)


@cache
def _plans(seed: int, lens: LensPrior, board: TargetPrior) -> list[Placed]:
    return planned(np.random.default_rng([seed, 29]), *BY_PLANNER, lens, board)


def one(seed: int, cell: Cell, plan: str, tally: Tally) -> None:
    """One arm calibrated and judged."""
    rng = np.random.default_rng([seed, 23])
    length_m = 2e-4 * rng.uniform(0.3, 2.5)
    true = world(rng, length_m, cell.lens, cell.board, cell.gear_rad, cell.sag_rad)
    if plan == PLANNED:
        placed = _plans(seed, cell.known_lens, cell.known_board)
        measured, Q = capture_planned(rng, true, placed)
    else:
        measured, Q = capture(rng, true, plan)
    _, elsewhere = capture(rng, true, "diverse")
    known = ArmKnown(MODEL, Q, ARM.joint_limits)
    first = solve(measured, CAMERA, {})
    if not isinstance(first, Solution):
        raise TypeError(f"refused: {first}")
    began = time.process_time()
    found = adjust(measured, first, CAMERA, known, cell.known_lens, cell.known_board)
    tally.seconds.append(time.process_time() - began)
    starts = np.array([v.start for v in measured.views if v is not None])
    drawn = Drawn(length_m, cell.gear_rad, cell.sag_rad, cell.known_lens, cell.known_board)
    tally.bound.append(bound(true, Q, measured.group, starts, drawn, elsewhere))
    arm, values = corrected_arm(found, known)
    chain = arm.chain(values)
    near = position_accuracy(found, known, elsewhere)
    before, after = (_left(of.flange(elsewhere), true.true_flange(elsewhere)) for of in (MODEL.base, chain))
    tally.near.append((_rms(before), _rms(after), near.after))
    tally.below.append(float(np.mean(after < near.after95)))
    joints = reference_joints(ARM.joint_limits, seed=1234)
    flange = true.true_flange(joints)
    errors = [np.linalg.norm(apart(of.flange(joints), flange)[:, :3], axis=1) for of in (MODEL.base, chain)]
    stated = arm_accuracy(found, known).corrected.t
    tally.everywhere.append((_rms(errors[0]), _rms(errors[1]), stated))


def _left(model: Array, true: Array) -> Array:
    """(n,) m between places after the best base and the best tool offset; both (n, 4, 4)."""
    R, places = model[:, :3, :3], model[:, :3, 3]
    own = np.concatenate([np.tile(np.eye(3), (len(R), 1, 1)), -se3.hat(places), R], axis=2).reshape(-1, 9)
    off = (true[:, :3, 3] - places).ravel()
    return np.asarray(
        np.linalg.norm((off - own @ np.linalg.lstsq(own, off, rcond=None)[0]).reshape(-1, 3), axis=1)
    )


def _rms(e: Array) -> float:
    return float(np.sqrt(np.mean(np.square(e))))


if __name__ == "__main__":
    main()
