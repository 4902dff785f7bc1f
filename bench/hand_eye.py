"""Hand-eye: ours beside OpenCV's four solvers, on the same simulated captures, in one process.

First table: RMS error over the Cramer-Rao bound (1.00 is the limit that the data set), and mean NEES of the
covariance (6 is right) with noise levels that the solver had to find. Second table: time of one solution.
OpenCV's solvers get the same target poses, from one placement, since they know of one only.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from bench._expected import expect
from calibration.hand_eye import se3
from calibration.hand_eye.classic import METHODS, solve_classic
from calibration.hand_eye.problem import Problem, Setup
from calibration.hand_eye.solution import Measurements, Solution, prepare, solve
from calibration.hand_eye.views import CornerSet
from cell.devices import Intrinsics
from cell.poses import Array

CAMERA = Intrinsics(1280, 800, (900.0, 905.0, 640.0, 400.0), (-0.12, 0.08, 0.001, -0.0005, 0.0))
POINTS = np.array([[0.025 * x, 0.025 * y, 0.0] for y in range(1, 7) for x in range(1, 10)])
X_TRUE = RigidTransform.from_components([0.02, -0.08, 0.05], Rotation.from_rotvec([0.1, -0.2, 0.3]))
RUNS = 200


@dataclass(frozen=True)
class Case:
    """A kind of capture: number of poses and placements, noise in pixels, metres and radians."""

    setup: Setup
    poses: int
    placements: int
    px: float = 0.2
    flange_t: float = 2e-4
    flange_r: float = 2e-4

    @property
    def noise(self) -> dict[str, float]:
        return {"sigma_px": self.px, "sigma_flange_t": self.flange_t, "sigma_flange_r": self.flange_r}

    @property
    def title(self) -> str:
        levels = f"{self.px} px, {self.flange_t * 1e3} mm, {self.flange_r * 1e3} mrad"
        return f"{self.setup}, {self.poses} poses in {self.placements} placement(s), {levels}"


CASES = (
    Case("eye-in-hand", 20, 1),
    Case("eye-to-hand", 20, 1),
    Case("eye-in-hand", 60, 3, px=0.3, flange_t=5e-5, flange_r=5e-5),
    Case("eye-to-hand", 60, 3, px=0.1, flange_t=1e-4, flange_r=5e-4),
    Case("eye-in-hand", 200, 10),
)


def simulate(case: Case, seed: int, start: bool = False) -> Measurements:
    """Corners and flange poses with noise: cone poses about the board, 0.44 rad wide, at 0.5 m."""
    rng = np.random.default_rng(seed)
    each = case.poses // case.placements
    F, views, group = [], [], []
    for g in range(case.placements):
        W = RigidTransform.from_components(
            rng.normal(size=3) * 0.3, Rotation.from_rotvec(rng.normal(size=3) * 0.4)
        )
        for k in range(each):
            f, b = 2 * np.pi * k / each, 0.44 * rng.uniform(0.6, 1.1)
            R = Rotation.from_rotvec([b * np.sin(f), -b * np.cos(f), 0.2 * rng.normal()])
            C = RigidTransform.from_components(
                [0, 0, 0.5 * rng.uniform(0.9, 1.1)] - R.apply(POINTS.mean(axis=0)), R
            )
            true = W * C.inv() * X_TRUE.inv() if case.setup == "eye-in-hand" else X_TRUE * C * W.inv()
            off = RigidTransform.from_components(
                rng.normal(size=3) * case.flange_t, Rotation.from_rotvec(rng.normal(size=3) * case.flange_r)
            )
            uv, _ = cv2.projectPoints(
                POINTS, C.rotation.as_rotvec(), C.translation, CAMERA.matrix, np.array(CAMERA.dist)
            )
            uv = uv.reshape(-1, 2) + rng.normal(size=(len(POINTS), 2)) * case.px
            F.append((true * off).as_matrix())
            views.append(CornerSet(POINTS, uv, np.ones(len(POINTS)), C.as_matrix() if start else None))
            group.append(g)
    C0 = np.tile(np.eye(4), (len(F), 1, 1))
    return Measurements(case.setup, np.array(F), np.array(group), views, C0, np.eye(4)[None])


def error_of(X: Array) -> Array:
    return se3.log(se3.inverse(X) @ X_TRUE.as_matrix())


def accuracy(case: Case) -> dict[str, tuple[float, float, float]]:
    """Per solver: RMS error over the bound in translation and rotation, and mean NEES (NaN without)."""
    squares: dict[str, list[Array]] = {"ours": [], **{m: [] for m in METHODS}}
    bounds, nees = [], []
    for seed in range(RUNS):
        measured = simulate(case, seed)
        ours = expect(Solution, solve(measured, CAMERA, {}))
        bound = expect(Solution, solve(measured, CAMERA, case.noise))
        e = error_of(ours.at.X)
        nees.append(e @ np.linalg.solve(ours.cov, e))
        squares["ours"].append(e**2)
        bounds.append(np.diag(bound.cov) / bound.excess)
        for method in METHODS:
            X = solve_classic(one_placement(ours.problem), method)
            squares[method].append(np.full(6, np.nan) if X is None else error_of(X) ** 2)
    limit = np.mean(bounds, axis=0)
    out = {}
    for name, values in squares.items():
        mean = np.nanmean(values, axis=0)
        t, r = np.sqrt(mean[:3].sum() / limit[:3].sum()), np.sqrt(mean[3:].sum() / limit[3:].sum())
        out[name] = (float(t), float(r), float(np.mean(nees)) if name == "ours" else float("nan"))
    return out


def one_placement(problem: Problem) -> Problem:
    return problem.take(problem.group == 0)


def shortest(call: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Shortest wall and processor time in seconds."""
    times = []
    for _ in range(repeats):
        wall, cpu = time.perf_counter(), time.thread_time()
        call()
        times.append((time.perf_counter() - wall, time.thread_time() - cpu))
    return min(t[0] for t in times), min(t[1] for t in times)


def print_accuracy() -> bool:
    good = True
    print(f"{RUNS} captures each; x CRLB in translation / rotation, mean NEES\n")
    for case in CASES:
        print(case.title)
        table = accuracy(case)
        for name, (t, r, n) in table.items():
            note = "" if np.isnan(n) else f"   NEES {n:.2f}"
            print(f"  {name:11s} {t:6.2f} / {r:5.2f}{note}")
        t, r, n = table["ours"]
        good &= t <= 1.10 and r <= 1.10 and 5.0 < n < 7.5
    return good


def print_times() -> None:
    print("\n600 poses of 54 corners, lens distortion on; shortest wall (processor) time in ms")
    rows: list[tuple[str, tuple[float, float]]] = []
    for placements in (1, 30):
        case = Case("eye-in-hand", 600, placements)
        for start in (True, False):
            measured = simulate(case, 1, start)
            label = f"ours, PnP from {'given poses' if start else 'nothing'}, {placements} placement(s)"
            rows.append((label, shortest(partial(solve, measured, CAMERA, {}), 7)))
    problem = prepare(simulate(Case("eye-in-hand", 600, 1), 1), CAMERA)
    for method in METHODS:
        label = f"OpenCV {method} (target poses given)"
        rows.append((label, shortest(partial(solve_classic, problem, method), 1)))
    best = rows[0][1][1]
    for label, (wall, cpu) in rows:
        print(f"  {label:48s} {wall * 1e3:8.1f} ({cpu * 1e3:8.1f})   {cpu / best:5.1f} x")


def main() -> int:
    cv2.setNumThreads(1)
    good = print_accuracy()
    print_times()
    print(f"\nwithin 1.10 x CRLB and NEES in 5..7.5: {'yes' if good else 'NO'}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
