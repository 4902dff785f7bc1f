"""Stated uncertainty against errors that were not fitted, on data sets of real cells.

``python -m bench.left_out_poses DATA_SET...``: each pose of a capture is left out in turn, everything is
solved again without it (noise levels, lens, target, arm or shared errors, and X), and the target's pose is
predicted there. A row: poses used, mean and RMS distance and angle of the target from its prediction, the
standard deviations stated for them (RMS), the mean squared Mahalanobis distance (6 is right), and the share
of errors inside the stated 95 % in translation and in rotation. Then the same for all usable poses, those
counted that the solution rejects; and, where there are several placements, for each placement left out as a
whole: the target's pose there as one image has it, predicted for the next image. What is stated is the
uncertainty of X, target, lens and numbers with that of the pose itself: its corners and its flange, by the
noise levels found. ``--equal-weights`` weighs every pose alike in place of that, whatever its image tells: by
a noise of the flange that is three times what the corners leave open of the worst image, 1 mm and 3 mrad at
least (less rejects poses). Lens and print are found with the corners' noise that our weights have; of
the arm's errors less is found beside so much noise, and what is stated is that noise.
"""

import argparse
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from calibration.adjustment.arm_accuracy import flange_errors
from calibration.adjustment.hand_eye import Adjusted, adjust, numbered_alike
from calibration.adjustment.lens_terms import moved_camera
from calibration.adjustment.shared_errors import SharedErrors, shared_errors
from calibration.adjustment.unknowns import LENS_BLOCK, TARGET_BLOCK, ArmKnown
from calibration.hand_eye import se3
from calibration.hand_eye.noise import shapes, variances
from calibration.hand_eye.normal import Linearised, linearise
from calibration.hand_eye.pnp import Poses, refine_poses, solve_pnp
from calibration.hand_eye.problem import Estimate, Problem, flange_adjoint
from calibration.hand_eye.solution import Measurements, Solution, solve
from calibration.hand_eye.views import CornerSet
from cell.devices import Intrinsics
from cell.poses import Array, adjoint
from procedures.hand_eye.known_parts import KnownParts, known_parts
from procedures.hand_eye.solve.arm import JOINTS, given_arm
from procedures.hand_eye.solve.camera import check_views, choose_camera
from procedures.hand_eye.solve.capture import CaptureSet, load_capture
from procedures.hand_eye.solve.solver import given_noise, measurements

_STEP = 1e-6
_EQUAL_NOISE, _EQUAL_T, _EQUAL_R = 3.0, 1e-3, 3e-3  # of the worst image's; at least so much in m and in rad


@dataclass(frozen=True)
class PredictionError:
    """Error ``e`` (6,) of a predicted target pose, in the target, and its covariance (6, 6) as stated."""

    e: Array
    cov: Array
    used: bool

    def squared(self, part: slice) -> float:
        return float(self.e[part] @ np.linalg.solve(self.cov[part, part], self.e[part]))


@dataclass(frozen=True)
class OnePose:
    """One pose that was left out: T_base_flange ``F`` (4, 4) by what was found of the arm, its view, what a
    change of the arm's numbers moves that flange by, ``twists`` (6, a), and the covariance (6, 6) of what
    those leave of the flange's errors."""

    F: Array
    view: CornerSet
    twists: Array
    left: Array


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("sets", nargs="+", type=Path)
    parser.add_argument("--equal-weights", action="store_true")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    head = f"{'poses':>6}{'mean mm':>9}{'deg':>8}{'RMS mm':>9}{'deg':>8}"
    head += f"{'stated mm':>11}{'deg':>8}{'m2':>7}{'t %':>6}{'r %':>6}"
    print(f"{'':48}{head}")
    for path in options.sets:
        capture = _capture(path, options.equal_weights)
        errors = list(left_out(capture))
        print(f"{path.name:34}{'used':>14}{row([one for one in errors if one.used])}")
        print(f"{'':34}{'all':>14}{row(errors)}", flush=True)
        if unseen := list(left_out_placements(capture)):
            print(f"{'':34}{'by placement':>14}{row(unseen)}", flush=True)


def row(errors: list[PredictionError]) -> str:
    e = np.array([one.e for one in errors])
    variance = np.array([np.diag(one.cov) for one in errors])
    parts = (slice(3), slice(3, 6))
    away = [np.linalg.norm(e[:, part], axis=1) for part in parts]
    mean, rms = [np.mean(a) for a in away], [np.sqrt(np.mean(a**2)) for a in away]
    stated = [np.sqrt(variance[:, part].sum(axis=1).mean()) for part in parts]
    limit = chi2.ppf(0.95, 3)
    inside = [np.mean([o.squared(part) < limit for o in errors]) for part in parts]
    return (
        f"{len(errors):6}{1e3 * mean[0]:9.3f}{np.degrees(mean[1]):8.3f}{1e3 * rms[0]:9.3f}"
        f"{np.degrees(rms[1]):8.3f}{1e3 * stated[0]:11.3f}{np.degrees(stated[1]):8.3f}"
        f"{np.mean([o.squared(slice(6)) for o in errors]):7.1f}"
        f"{100 * inside[0]:6.0f}{100 * inside[1]:6.0f}"
    )


@dataclass(frozen=True)
class Capture:
    """A data set, its camera, the usable ``rows`` (n,), and the joints of each of them where it has any; the
    ``noise`` levels that are given."""

    loaded: CaptureSet
    camera: Intrinsics
    known: KnownParts
    rows: NDArray[np.int64]
    arm: ArmKnown | None
    noise: Mapping[str, float]


def _capture(path: Path, equal_weights: bool = False) -> Capture:
    loaded = load_capture(path)
    choice = choose_camera(loaded, adjusts=True)
    check_views(loaded, choice.camera)
    if choice.camera is None:
        sys.exit(f"{path}: a capture without a camera has no corners to adjust")
    rows = loaded.usable()
    given, _ = given_arm(loaded, rows)
    sigma = None if loaded.capture.camera is None else loaded.capture.camera.sigma
    known = known_parts(
        loaded.capture.target.model_dump(),
        None if sigma is None else sigma.model_dump(),
        None if given is None else given.spec.robot,
        from_images=choice.estimated is not None,
    )
    arm = None
    if given is not None:
        arm = ArmKnown(given.spec.arm, given.Q, np.tile([-np.pi, np.pi], (JOINTS, 1)), known.arm)
    capture = Capture(loaded, choice.camera, known, rows, arm, given_noise(loaded))
    if not equal_weights:
        return capture
    whole = _without(capture, np.zeros(0, dtype=np.int64)).found
    px = whole.components.sigma["sigma_px"]
    worst = px * np.sqrt(np.diagonal(whole.problem.cov_px, axis1=1, axis2=2).max(axis=0))
    t = max(_EQUAL_NOISE * float(worst[:3].max()), _EQUAL_T)
    r = max(_EQUAL_NOISE * float(worst[3:].max()), _EQUAL_R)
    return replace(capture, noise={"sigma_px": px, "sigma_flange_t": t, "sigma_flange_r": r})


@dataclass(frozen=True)
class WithoutSome:
    """The adjustment of some observations, and what is wanted of the others."""

    measured: Measurements
    first: Solution
    found: Adjusted
    camera: Intrinsics
    others: dict[int, OnePose]


def _without(capture: Capture, out: NDArray[np.int64]) -> WithoutSome:
    """Everything solved without the usable poses ``out`` (k,)."""
    loaded, rows = capture.loaded, capture.rows
    kept = np.delete(np.arange(len(rows)), out)
    measured = measurements(loaded, rows[kept])
    first = _solved(measured, capture)
    arm: ArmKnown | SharedErrors
    if capture.arm is None:
        arm = shared_errors(measured.F[first.used], capture.known.arm)
    else:
        arm = replace(capture.arm, Q=capture.arm.Q[kept])
    found = adjust(measured, first, capture.camera, arm, capture.known.lens, capture.known.target)
    others = {}
    for k in out.tolist():
        F, view = loaded.F[rows[k]], loaded.views[rows[k]]
        left = np.zeros((6, 6))
        if isinstance(arm, SharedErrors):
            sizes = np.repeat(arm.sizes(found.components.scale), 3)
            left = float(arm.unexplained(F[None])[0]) * np.diag(sizes**2)
            twists = arm.twists(F[None])
            columns = twists.columns(slice(0, 1))
            error = columns @ found.numbers[: twists.numbers]
        elif capture.arm is not None:
            error, columns = flange_errors(found, arm, capture.arm.Q[k : k + 1])
        if view is not None:
            others[k] = OnePose(F @ se3.exp(error)[0], view, columns[0], left)
    return WithoutSome(measured, first, found, capture.camera, others)


def left_out(capture: Capture) -> Iterator[PredictionError]:
    """Every usable pose of one capture that still has others of its placement."""
    loaded, rows = capture.loaded, capture.rows
    whole = _solved(measurements(loaded, rows), capture)
    for k in range(len(rows)):
        others = np.delete(rows, k)
        if loaded.group[rows[k]] not in loaded.group[others]:
            continue
        without = _without(capture, np.array([k]))
        if k in without.others:
            group = int(np.searchsorted(np.unique(loaded.group[others]), loaded.group[rows[k]]))
            g = int(np.searchsorted(without.first.groups, group))
            yield _predicted(without, without.others[k], g, bool(whole.used[k]))


def left_out_placements(capture: Capture) -> Iterator[PredictionError]:
    """The poses of every placement, by all other placements and the pose before it in its own."""
    group = capture.loaded.group[capture.rows]
    whole = _solved(measurements(capture.loaded, capture.rows), capture)
    for g in np.unique(group) if len(np.unique(group)) > 1 else []:
        without = _without(capture, np.flatnonzero(group == g))
        seen = [k for k in without.others if whole.used[k]]
        for before, k in pairwise(seen):
            yield _predicted(without, without.others[k], without.others[before], True)


def _solved(measured: Measurements, capture: Capture) -> Solution:
    found = solve(measured, capture.camera, capture.noise)
    if not isinstance(found, Solution):
        sys.exit(f"refused: {found.words}")
    return found


class _Seen:
    """One image of a left-out pose, as camera, target and arm are with any numbers."""

    def __init__(self, of: WithoutSome, pose: OnePose, camera: Intrinsics, start: Array) -> None:
        self._of, self._pose, self._camera, self._start = of, pose, camera, start
        found = of.found
        (self._view,) = numbered_alike([pose.view], start[None], found.camera, of.measured.motions)
        self._images = slice(pose.twists.shape[1], len(found.names))
        self._known: tuple[Array, Poses] | None = None

    def problem(self, numbers: Array) -> Problem:
        of, found = self._of, self._of.found
        own = numbers[self._images]
        if self._known is None or not np.array_equal(self._known[0], own):
            points = found.shape.moved(self._view.points, numbers[found.blocks[TARGET_BLOCK]])
            camera = moved_camera(self._camera, numbers[found.blocks[LENS_BLOCK]])
            self._known = own, refine_poses([replace(self._view, points=points)], camera, self._start[None])
        poses = self._known[1]
        twist = self._pose.twists @ (numbers - found.numbers)[: self._images.start]
        F = self._pose.F @ se3.exp(twist[None])[0]
        G = F if of.measured.setup == "eye-to-hand" else se3.inverse(F)
        one = np.zeros(1, dtype=np.int64)
        return Problem(of.measured.setup, G[None], poses.C, one, poses.cov, poses.sse, np.zeros(1))

    def own(self, lin: Linearised) -> Array:
        """(6, 6) covariance of this image's own residual."""
        found = self._of.found
        noise = replace(self._of.first.noise, sigma=dict(found.components.sigma))
        carried = flange_adjoint(lin.problem, lin.at, lin.predicted)[0]
        out: Array = found.excess * variances(noise, shapes(lin, tuple(noise.sigma)))[0]
        out = out + carried @ self._pose.left @ carried.T
        return out


def _predicted(of: WithoutSome, pose: OnePose, target: int | OnePose, used: bool) -> PredictionError:
    """Error of ``pose`` by the solution ``of`` others; its ``target`` is that of a group which was solved,
    or as another pose that was left out sees it."""
    found, camera = of.found, of.camera
    names = len(found.names)
    other: _Seen | None = None
    if isinstance(target, OnePose):
        other = _Seen(of, target, camera, _start(target, camera))
        W = other.problem(found.numbers).target_poses(found.X)[0]
    else:
        W = found.W[target]
    G = pose.F if of.measured.setup == "eye-to-hand" else se3.inverse(pose.F)
    image = _Seen(of, pose, camera, se3.inverse(found.X) @ G @ W)

    def residual(x: Array) -> Array:
        numbers, X = found.numbers + x[12 : 12 + names], found.X @ se3.exp(x[:6])
        at = W @ se3.exp(x[6:12])
        if other is not None:
            own = other.problem(numbers)
            at = replace(own, C=se3.exp(x[6:12])[None] @ own.C).target_poses(X)[0]
        r: Array = linearise(image.problem(numbers), Estimate(X, at[None])).r[0]
        return r

    J = np.stack(
        [(residual(_STEP * u) - residual(-_STEP * u)) / (2 * _STEP) for u in np.eye(12 + names)], axis=1
    )
    cov = np.zeros((12 + names, 12 + names))
    rest = np.r_[0:6, 12 : 12 + names]
    cov[np.ix_(rest, rest)] = np.block([[found.cov, found.cross], [found.cross.T, found.cov_numbers]])
    if other is not None:
        cov[6:12, 6:12] = other.own(linearise(other.problem(found.numbers), Estimate(found.X, W[None])))
    elif isinstance(target, int):
        cov[6:12, 6:12] = found.cov_W[target]
        cov[6:12, rest] = found.cross_W[target]
        cov[np.ix_(rest, range(6, 12))] = cov[6:12, rest].T
    lin = linearise(image.problem(found.numbers), Estimate(found.X, W[None]))
    into_target = adjoint(se3.inverse(lin.predicted[0]))
    return PredictionError(
        into_target @ lin.r[0], into_target @ (J @ cov @ J.T + image.own(lin)) @ into_target.T, used
    )


def _start(pose: OnePose, camera: Intrinsics) -> Array:
    poses, _ = solve_pnp([pose.view], camera)
    best: Array = poses.C[int(np.argmin(poses.sse))]
    return best


if __name__ == "__main__":
    main()
