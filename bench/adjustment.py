"""Hand-eye on arms, lenses and boards that are not as their models: does the stated 95 % hold?

``python -m bench.adjustment [RUNS] [--arm MM] [--lens exact|off|estimated] [--board exact|scale|bow]
[--plan cone|diverse|branches]``; without options every combination. UR10e, 0.2 px, 0.03 mm and 0.05 mrad;
noise levels are not given, priors are the defaults. The true X is the one that serves best with the nominal
arm over all its joints. A row: RMS error and stated one in mm, mean NEES (6 is right) and the share of
errors inside the stated 95 % in translation and rotation; for the whole adjustment, and for X with noise
alone. Then the RMS error of OpenCV's Park and Daniilidis, for an exact arm the bound (Cramer-Rao, of the
problem with this arm and the priors of lens and target), and the processor time of the adjustment.
"""

import argparse
import itertools
import time
from dataclasses import dataclass, field

import cv2
import numpy as np
from scipy.stats import chi2

from calibration.adjustment.hand_eye import adjust
from calibration.adjustment.lens_terms import LensPrior
from calibration.adjustment.unknowns import ArmKnown
from calibration.hand_eye import se3
from calibration.hand_eye.classic import solve_classic
from calibration.hand_eye.solution import Solution, solve
from calibration.intrinsics import estimate_intrinsics
from cell.poses import Array
from tests.kit.imperfect_cell import ARM, CAMERA, MODEL, WHOLE_PLANS, capture, world

PEERS = ("park", "daniilidis")
UNKNOWN = LensPrior(focal=0.05, aspect=0.01, centre_px=50.0, radial=0.2, tangential=0.01)


@dataclass
class Tally:
    """Squared errors and stated variances of the translation, NEES, and what lay inside the stated 95 %."""

    t: list[float] = field(default_factory=list)
    stated: list[float] = field(default_factory=list)
    nees: list[float] = field(default_factory=list)
    inside_t: list[bool] = field(default_factory=list)
    inside_r: list[bool] = field(default_factory=list)

    def add(self, X: Array, cov: Array, truth: Array) -> None:
        e = se3.log(se3.inverse(X) @ truth)
        self.t.append(float(e[:3] @ e[:3]))
        self.stated.append(float(np.trace(cov[:3, :3])))
        self.nees.append(float(e @ np.linalg.solve(cov, e)))
        limit = chi2.ppf(0.95, 3)
        self.inside_t.append(bool(e[:3] @ np.linalg.solve(cov[:3, :3], e[:3]) < limit))
        self.inside_r.append(bool(e[3:] @ np.linalg.solve(cov[3:, 3:], e[3:]) < limit))

    def row(self) -> str:
        rms, stated = 1e3 * np.sqrt(np.mean(self.t)), 1e3 * np.sqrt(np.mean(self.stated))
        return (
            f"{rms:7.3f}{stated:8.3f}{np.mean(self.nees):8.1f}"
            f"{100 * np.mean(self.inside_t):6.0f}{100 * np.mean(self.inside_r):5.0f}"
        )


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("runs", nargs="?", type=int, default=20)
    parser.add_argument("--arm", type=float, action="append", help="mm, of a length of the chain")
    parser.add_argument("--lens", choices=("exact", "off", "estimated"), action="append")
    parser.add_argument("--board", choices=("exact", "scale", "bow"), action="append")
    parser.add_argument("--plan", choices=WHOLE_PLANS, action="append")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    head = f"{'rms':>7}{'stated':>8}{'NEES':>8}{'t %':>6}{'r %':>5}"
    peers = "".join(f"{name:>11}" for name in PEERS)
    title = f"{'arm mm':>6} {'lens':9} {'board':6} {'plan':9}"
    print(f"{title}{head}   noise alone{head}{peers}{'bound':>7}{'ms':>6}")
    for arm, lens, board, plan in itertools.product(
        options.arm or (0.0, 0.06, 0.2),
        options.lens or ("exact", "off", "estimated"),
        options.board or ("exact", "scale", "bow"),
        options.plan or WHOLE_PLANS,
    ):
        row = Row()
        for seed in range(options.runs):
            one(np.random.default_rng([seed, 5]), arm, lens, board, plan, row)
        title = f"{arm:6.2f} {lens:9} {board:6} {plan:9}"
        print(f"{title}{row.text()}", flush=True)


@dataclass
class Row:
    """What is counted of one combination."""

    ours: Tally = field(default_factory=Tally)
    alone: Tally = field(default_factory=Tally)
    peers: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in PEERS})
    bound: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    def text(self) -> str:
        peers = "".join(f"{1e3 * np.sqrt(np.mean(squared)):11.3f}" for squared in self.peers.values())
        bound = f"{1e3 * np.sqrt(np.mean(self.bound)):7.3f}" if self.bound else f"{'':7}"
        milliseconds = 1e3 * np.mean(self.seconds)
        return f"{self.ours.row()}              {self.alone.row()}{peers}{bound}{milliseconds:6.0f}"


def one(rng: np.random.Generator, arm: float, lens: str, board: str, plan: str, row: Row) -> None:
    """One capture solved in all ways."""
    cell = world(rng, 1e-3 * arm, lens, board)
    measured, Q = capture(rng, cell, plan)
    camera, prior = CAMERA, LensPrior()
    if lens == "estimated":
        views = [v for v in measured.views if v is not None]
        found = estimate_intrinsics(views, CAMERA.width, CAMERA.height, CAMERA)
        if found is None:
            raise ValueError("the views do not determine a camera")
        camera, prior = found.camera, UNKNOWN
    first = solve(measured, camera, {})
    if not isinstance(first, Solution):
        raise TypeError(f"refused: {first}")
    row.alone.add(first.at.X, first.cov, cell.X)
    for name, squared in row.peers.items():
        if (X := solve_classic(first.problem, name)) is not None:
            squared.append(float(np.sum((X - cell.X)[:3, 3] ** 2)))
    began = time.process_time()
    answer = adjust(measured, first, camera, ArmKnown(MODEL, Q, ARM.joint_limits), prior)
    row.seconds.append(time.process_time() - began)
    row.ours.add(answer.X, answer.cov, cell.X)
    if arm == 0.0:
        exact = adjust(measured, first, camera, None, prior)
        row.bound.append(float(np.trace(exact.cov[:3, :3])) / exact.excess)


if __name__ == "__main__":
    main()
