"""Time and memory of a hand-eye solution, beside SciPy and OpenCV in the same process.

``python -m bench.hand_eye_times``: the fixed-arm problem (corners to X with covariance, noise estimated and
blunders looked for) for 600 poses in any number of placements and for 5000, then 200 poses with arm, gears,
lens and target as unknowns. Of ours, `pnp` are the poses from the corners, `rest` all that follows (for every
block: from the fixed-arm answer). Peers on the same corners: OpenCV's PnP for every view with Park's solver,
a placement at a time; SciPy's ``least_squares`` over X and all target poses from our PnP poses (to be held
against `rest`), without covariance. Times are those of the processor, which all of them use on one thread, in
the fastest of nine calls, which other programs disturb least. Memory is what the process grew by at most.
The last line is ``cellward solve hand-eye`` of 5000 poses as a program: all that it took, start and file too.
"""

import resource
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from calibration.adjustment.hand_eye import adjust
from calibration.adjustment.unknowns import ArmKnown
from calibration.hand_eye import se3
from calibration.hand_eye.classic import solve_classic
from calibration.hand_eye.closed_form import closed_form
from calibration.hand_eye.problem import Problem
from calibration.hand_eye.solution import Solution, prepare, solve
from calibration.hand_eye.views import CornerSet
from cell.poses import Array
from tests.kit import imperfect_cell
from tests.kit.hand_eye_scene import CAMERA, make_scene

CALLS = 9
MOST_OF_PEERS = 600  # poses; Park's solver takes the square of them
_LEVER_M = 0.3
# A process counts as its own what its parent had in memory when it began, so the parent is a small one.
_SMALL = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, used.ru_maxrss)
"""


def main() -> None:
    cv2.setNumThreads(1)
    print(
        f"{'poses':>6}{'placements':>12}   {'problem':12}{'ours':>9}{'pnp':>9}{'rest':>9}"
        f"{'SciPy':>9}{'OpenCV':>9}{'grew by':>10}"
    )
    for poses, placements in ((60, 3), (600, 1), (600, 10), (600, 60), (5000, 10)):
        _fixed_arm(poses, placements)
    _every_block()
    _as_a_program(5000, 10)


def _fixed_arm(poses: int, placements: int) -> None:
    measured = make_scene(1, count=poses, groups=placements).measurements()
    before = _memory()
    ours = _milliseconds(lambda: solve(measured, CAMERA, {}))
    grew = _memory() - before
    pnp = _milliseconds(lambda: prepare(measured, CAMERA))
    scipy = opencv = None
    if poses <= MOST_OF_PEERS:
        problem = prepare(measured, CAMERA)
        views = [v for v in measured.views if v is not None]
        scipy = _milliseconds(lambda: _by_scipy(problem))
        opencv = _milliseconds(lambda: _by_opencv(views, problem))
    _row(poses, placements, "fixed arm", grew, ours, pnp, ours - pnp, scipy, opencv)


def _every_block() -> None:
    rng = np.random.default_rng(3)
    cell = imperfect_cell.world(rng, 2e-4, "off", "bow")
    measured, Q = imperfect_cell.capture(rng, cell, "diverse")
    known = ArmKnown(imperfect_cell.MODEL, Q, imperfect_cell.ARM.joint_limits)

    def first() -> Solution:
        found = solve(measured, imperfect_cell.CAMERA, {})
        if not isinstance(found, Solution):
            raise TypeError(f"refused: {found}")
        return found

    before = _memory()
    whole = _milliseconds(lambda: adjust(measured, first(), imperfect_cell.CAMERA, known))
    grew = _memory() - before
    pnp = _milliseconds(lambda: prepare(measured, imperfect_cell.CAMERA))
    answer = first()
    rest = _milliseconds(lambda: adjust(measured, answer, imperfect_cell.CAMERA, known))
    _row(len(Q), 10, "every block", grew, whole, pnp, rest)


def _as_a_program(poses: int, placements: int) -> None:
    with TemporaryDirectory() as folder:
        path = make_scene(1, count=poses, groups=placements).write(Path(folder))
        cellward = str(Path(sys.executable).with_name("cellward"))
        command = [sys.executable, "-c", _SMALL, cellward, "solve", "hand-eye", str(path), "--json"]
        seconds, most = subprocess.run(command, capture_output=True, check=True).stdout.split()
    print(
        f"{poses:6}{placements:12}   cellward solve: {float(seconds):.1f} s of the processor, "
        f"{float(most) / 1024.0:.0f} MB at most"
    )


def _row(poses: int, placements: int, problem: str, grew: float, *milliseconds: float | None) -> None:
    """Columns that are not given, or None, are shown as a dash."""
    columns = [*milliseconds, None, None][:5]
    times = "".join(f"{'-':>9}" if t is None else f"{t:6.0f} ms" for t in columns)
    print(f"{poses:6}{placements:12}   {problem:12}{times}{grew:7.0f} MB", flush=True)


def _milliseconds(call: Callable[[], object]) -> float:
    seconds = []
    for _ in range(CALLS):
        began = time.process_time()
        call()
        seconds.append(time.process_time() - began)
    return 1e3 * min(seconds)


def _memory() -> float:
    """Largest so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def _by_opencv(views: Sequence[CornerSet], problem: Problem) -> None:
    for view in views:
        cv2.solvePnP(view.points, view.corners, CAMERA.matrix, np.array(CAMERA.dist))
    for g in range(problem.groups):
        solve_classic(problem.take(problem.group == g), "park")


def _by_scipy(problem: Problem) -> Array:
    """X (4, 4) by ``least_squares`` from the closed form, equal weights, a turn by its lever."""
    start = closed_form(problem)
    scale = np.array([1.0] * 3 + [_LEVER_M] * 3)
    sparsity = np.zeros((problem.n, 6, 6 + 6 * problem.groups), dtype=bool)
    sparsity[:, :, :6] = True
    for i, g in enumerate(problem.group):
        sparsity[i, :, 6 + 6 * g : 12 + 6 * g] = True

    def moved(x: Array) -> tuple[Array, Array]:
        parts = x.reshape(-1, 6)
        step = np.tile(np.eye(4), (len(parts), 1, 1))
        step[:, :3, :3], step[:, :3, 3] = Rotation.from_rotvec(parts[:, 3:]).as_matrix(), parts[:, :3]
        return start.X @ step[0], start.W @ step[1:]

    def residuals(x: Array) -> Array:
        X, W = moved(x)
        predicted = se3.inverse(X) @ problem.G @ W[problem.group]
        return np.asarray((se3.log(problem.C @ se3.inverse(predicted)) * scale).ravel())

    found = least_squares(
        residuals,
        np.zeros(6 + 6 * problem.groups),
        jac_sparsity=sparsity.reshape(6 * problem.n, -1) if problem.groups > 1 else None,
    )
    return moved(found.x)[0]


if __name__ == "__main__":
    main()
