"""Stated uncertainty against errors that were not fitted, on data sets of real cells.

``python -m bench.left_out_poses DATA_SET...``: each pose of a capture is left out in turn, everything is
solved again without it (noise levels, lens, target and X), and the target's pose is predicted there. A row:
poses used, mean distance and angle of the target from its prediction, the standard deviations stated for them
(RMS), the mean squared Mahalanobis distance (6 is right), and the share of errors inside the stated 95 % in
translation and in rotation. Then the same for all usable poses, those counted that the solution rejects. What
is stated is the uncertainty of X, target, lens and numbers with that of the pose itself: its corners and its
flange, by the noise levels found.
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.stats import chi2

from calibration.adjustment.hand_eye import Adjusted, adjust, numbered_alike
from calibration.adjustment.lens_terms import moved_camera
from calibration.adjustment.unknowns import LENS_BLOCK, TARGET_BLOCK
from calibration.hand_eye import se3
from calibration.hand_eye.noise import shapes, variances
from calibration.hand_eye.normal import linearise
from calibration.hand_eye.pnp import refine_poses
from calibration.hand_eye.problem import Estimate, Problem
from calibration.hand_eye.solution import Measurements, Solution, solve
from calibration.hand_eye.views import CornerSet
from cell.devices import Intrinsics
from cell.poses import Array, adjoint
from procedures.hand_eye.known_parts import KnownParts, known_parts
from procedures.hand_eye.solve.camera import CameraChoice, check_views, choose_camera
from procedures.hand_eye.solve.capture import CaptureSet, load_capture
from procedures.hand_eye.solve.solver import given_noise, measurements

_STEP = 1e-6


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
    """One pose that is left out: T_base_flange ``F`` (4, 4), its place among the solved groups, its view."""

    F: Array
    group: int
    view: CornerSet


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("sets", nargs="+", type=Path)
    cv2.setNumThreads(1)
    head = f"{'poses':>6}{'mean mm':>9}{'deg':>8}{'stated mm':>11}{'deg':>8}{'m2':>7}{'t %':>6}{'r %':>6}"
    print(f"{'':44}{head}")
    for path in parser.parse_args().sets:
        errors = list(left_out(path))
        print(f"{path.name:34}{'used':>10}{row([one for one in errors if one.used])}")
        print(f"{'':34}{'all':>10}{row(errors)}", flush=True)


def row(errors: list[PredictionError]) -> str:
    e = np.array([one.e for one in errors])
    variance = np.array([np.diag(one.cov) for one in errors])
    t, r = (np.linalg.norm(e[:, part], axis=1).mean() for part in (slice(3), slice(3, 6)))
    stated = [np.sqrt(variance[:, part].sum(axis=1).mean()) for part in (slice(3), slice(3, 6))]
    limit = chi2.ppf(0.95, 3)
    inside = [np.mean([o.squared(part) < limit for o in errors]) for part in (slice(3), slice(3, 6))]
    return (
        f"{len(errors):6}{1e3 * t:9.3f}{np.degrees(r):8.3f}{1e3 * stated[0]:11.3f}"
        f"{np.degrees(stated[1]):8.3f}{np.mean([o.squared(slice(6)) for o in errors]):7.1f}"
        f"{100 * inside[0]:6.0f}{100 * inside[1]:6.0f}"
    )


def left_out(path: Path) -> Iterator[PredictionError]:
    """Every usable pose of one capture that still has others of its placement."""
    loaded = load_capture(path)
    camera = choose_camera(loaded, adjusts=True)
    check_views(loaded, camera.camera)
    rows = loaded.usable()
    whole = _solved(measurements(loaded, rows), loaded, camera)
    known = _known(loaded, camera)
    for k in range(len(rows)):
        others = np.delete(np.arange(len(rows)), k)
        if loaded.group[rows[k]] not in loaded.group[rows[others]]:
            continue
        measured = measurements(loaded, rows[others])
        first = _solved(measured, loaded, camera)
        if camera.camera is None:
            raise ValueError("a capture without a camera has no corners to adjust")
        found = adjust(measured, first, camera.camera, None, known.lens, known.target)
        view = measurements(loaded, rows[[k]]).views[0]
        if view is not None:
            group = int(np.searchsorted(np.unique(loaded.group[rows[others]]), loaded.group[rows[k]]))
            own = OnePose(loaded.F[rows[k]], int(np.searchsorted(first.groups, group)), view)
            e, cov = _predicted(own, measured, camera.camera, first, found)
            yield PredictionError(e, cov, bool(whole.used[k]))


def _solved(measured: Measurements, loaded: CaptureSet, camera: CameraChoice) -> Solution:
    found = solve(measured, camera.camera, given_noise(loaded))
    if not isinstance(found, Solution):
        sys.exit(f"refused: {found.words}")
    return found


def _known(loaded: CaptureSet, camera: CameraChoice) -> KnownParts:
    given = None if loaded.capture.camera is None else loaded.capture.camera.sigma
    return known_parts(
        loaded.capture.target.model_dump(),
        None if given is None else given.model_dump(),
        None,
        from_images=camera.estimated is not None,
    )


def _predicted(
    pose: OnePose, measured: Measurements, camera: Intrinsics, first: Solution, found: Adjusted
) -> tuple[Array, Array]:
    """Error (6,) of ``pose`` by ``found``, which was solved without it, and its covariance."""
    g = pose.group
    G = pose.F if measured.setup == "eye-to-hand" else se3.inverse(pose.F)
    start = se3.inverse(found.X) @ G @ found.W[g]
    (view,) = numbered_alike([pose.view], start[None], found.camera, measured.motions)
    names = len(found.names)

    def problem(numbers: Array) -> Problem:
        printed = replace(view, points=found.shape.moved(view.points, numbers[found.blocks[TARGET_BLOCK]]))
        poses = refine_poses([printed], moved_camera(camera, numbers[found.blocks[LENS_BLOCK]]), start[None])
        one = np.zeros(1, dtype=np.int64)
        return Problem(measured.setup, G[None], poses.C, one, poses.cov, poses.sse, np.zeros(1))

    def residual(x: Array) -> Array:
        at = Estimate(found.X @ se3.exp(x[:6]), (found.W[g] @ se3.exp(x[6:12]))[None])
        r: Array = linearise(problem(found.numbers + x[12:]), at).r[0]
        return r

    J = np.stack(
        [(residual(_STEP * u) - residual(-_STEP * u)) / (2 * _STEP) for u in np.eye(12 + names)], axis=1
    )
    cov = np.zeros((12 + names, 12 + names))
    others = np.r_[0:6, 12 : 12 + names]
    cov[np.ix_(others, others)] = np.block([[found.cov, found.cross], [found.cross.T, found.cov_numbers]])
    cov[6:12, 6:12] = found.cov_W[g]
    cov[6:12, others] = found.cross_W[g]
    cov[np.ix_(others, range(6, 12))] = cov[6:12, others].T
    lin = linearise(problem(found.numbers), Estimate(found.X, found.W[g : g + 1]))
    noise = replace(first.noise, sigma=dict(found.components.sigma))
    own = variances(noise, shapes(lin, tuple(noise.sigma)))[0]
    into_target = adjoint(se3.inverse(lin.predicted[0]))
    return into_target @ lin.r[0], into_target @ (J @ cov @ J.T + found.excess * own) @ into_target.T


if __name__ == "__main__":
    main()
