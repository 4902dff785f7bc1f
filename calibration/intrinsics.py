"""Do given intrinsics fit the images, and what are they when they do not.

The same views are adjusted twice: poses only with the given camera, and poses with the camera free
(Zhang 2000, OpenCV's implementation). Wrong intrinsics move the whole hand-eye result, and no solver can
see it in the poses. A few images that fit neither camera (a frame shifted, corners misread) must not decide:
they are left out of both adjustments.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye.pnp import solve_pnp
from calibration.hand_eye.views import CornerSet
from cell.devices import Intrinsics
from cell.poses import Array

MIN_VIEWS = 5
MIN_CORNERS = 8
_MOST_VIEWS = 30
_RATIO = 1.2  # reprojection error of the given camera over that of the free one
_FOCAL_SIGMAS, _FOCAL_SHARE = 5.0, 0.005
_USEFUL_FOCAL_SIGMA = 0.01
_OUT_SIGMAS = 5.0  # robust ones above the median: then a view stands out
_LEAST_SIGMA = 0.1  # of the median: views of equal quality differ by that much
_MOST_OUT = 1 / 3  # of the views; when more stand out, it is the camera that is wrong
_ROUNDS = 3
_MODELS = (  # OpenCV's flags and the number of free parameters
    (cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3, 5),
    (cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_FIX_K3, 7),
    (cv2.CALIB_FIX_K3, 8),
    (0, 9),
)


@dataclass(frozen=True)
class EstimatedIntrinsics:
    """A camera found from the views: RMS reprojection error in pixels, standard deviations of K (4,)."""

    camera: Intrinsics
    rms_px: float
    sigma_K: Array

    @property
    def useful(self) -> bool:
        """Whether the views determine the focal lengths to one per cent."""
        return bool(np.all(self.sigma_K[:2] < _USEFUL_FOCAL_SIGMA * np.array(self.camera.K[:2])))


@dataclass(frozen=True)
class IntrinsicsCheck:
    """``fits``, the two RMS reprojection errors in pixels, the free camera, and the views (rows of what was
    checked) that fit neither camera and were left out."""

    fits: bool
    rms_given_px: float
    free: EstimatedIntrinsics
    left_out: tuple[int, ...] = ()


def select_views(views: Sequence[CornerSet]) -> list[CornerSet]:
    """At most 30 views that see enough corners, spread evenly over the set."""
    return [views[k] for k in _select_rows(views)]


def _select_rows(views: Sequence[CornerSet]) -> list[int]:
    rich = [k for k, v in enumerate(views) if len(v.points) >= MIN_CORNERS]
    if len(rich) <= _MOST_VIEWS:
        return rich
    return [rich[i] for i in np.linspace(0, len(rich) - 1, _MOST_VIEWS).round().astype(int)]


def check_intrinsics(views: Sequence[CornerSet], given: Intrinsics) -> IntrinsicsCheck | None:
    """Compare ``given`` with the camera that the views ask for; None when they are too few to tell.

    Given intrinsics do not fit when the free camera lowers the reprojection error by a fifth, or moves a
    focal length by half a per cent and five standard deviations. A misfit is looked at again without the
    few views that stand out under ``given`` and under the camera that the others ask for: one bad image
    bends a free camera, and the gain says nothing about the given one. Views that only ``given`` fails
    to explain stay, since they are what shows that it is wrong.
    """
    rows = _select_rows(views)
    chosen = [views[k] for k in rows]
    check = _compare(chosen, given)
    if check is None or check.fits:
        return check
    out = standing_out(chosen, given)
    if not out.any():
        return check
    others = _compare([v for v, bad in zip(chosen, out, strict=True) if not bad], given)
    out &= standing_out(chosen, (others or check).free.camera)
    if not out.any():
        return check
    left_out = tuple(k for k, bad in zip(rows, out, strict=True) if bad)
    kept = [v for v, bad in zip(chosen, out, strict=True) if not bad]
    again = _compare(kept, given)
    if again is None:  # what is left is too little to speak against the given ones
        return IntrinsicsCheck(True, reprojection_rms(kept, given), check.free, left_out)
    return replace(again, left_out=left_out)


def _compare(chosen: Sequence[CornerSet], given: Intrinsics) -> IntrinsicsCheck | None:
    free = estimate_intrinsics(chosen, given.width, given.height, given)
    if free is None:
        return None
    rms = reprojection_rms(chosen, given)
    shift = np.abs(np.array(free.camera.K[:2]) - np.array(given.K[:2]))
    focal = shift / np.array(given.K[:2])
    moved = np.any((focal > _FOCAL_SHARE) & (shift > _FOCAL_SIGMAS * free.sigma_K[:2]))
    # fewer than 0.02 px are beyond any detector: a ratio of two such numbers says nothing
    worse = rms > _RATIO * free.rms_px and rms > 0.02
    return IntrinsicsCheck(not (worse or bool(moved and worse_than_noise(rms, free.rms_px))), rms, free)


def standing_out(views: Sequence[CornerSet], camera: Intrinsics) -> NDArray[np.bool_]:
    """Which views (n,) have a reprojection error far above the others'; none when they are no minority."""
    rms = view_rms(views, camera)
    known = np.isfinite(rms)
    if not known.any():
        return np.zeros(len(views), dtype=bool)
    median = float(np.median(rms[known]))
    sigma = max(1.4826 * float(np.median(np.abs(rms[known] - median))), _LEAST_SIGMA * max(median, 0.02))
    out = ~known | (np.where(known, rms, 0.0) > median + _OUT_SIGMAS * sigma)
    return out if out.sum() <= _MOST_OUT * len(views) else np.zeros(len(views), dtype=bool)


def worse_than_noise(rms_given: float, rms_free: float) -> bool:
    """Whether freeing the camera gains more than two per cent of the reprojection error."""
    return rms_given > 1.02 * rms_free


def reprojection_rms(views: Sequence[CornerSet], camera: Intrinsics) -> float:
    """RMS distance in pixels over all corners, each view with its own best pose."""
    count = np.array([v.count.sum() for v in views])
    return float(np.sqrt(np.average(view_rms(views, camera) ** 2, weights=count)))


def view_rms(views: Sequence[CornerSet], camera: Intrinsics) -> Array:
    """RMS distance (n,) in pixels over the corners of each view with its own best pose."""
    poses, owner = solve_pnp(views, camera)
    best = poses.take(np.unique(owner, return_index=True)[1])
    return np.asarray(np.sqrt(best.sse / np.array([v.count.sum() for v in views])))


def estimate_robustly(
    views: Sequence[CornerSet], width: int, height: int
) -> tuple[EstimatedIntrinsics | None, tuple[int, ...]]:
    """The intrinsics without the few views that stand out, and the rows of those; None when it fails."""
    rows = _select_rows(views)
    left_out: list[int] = []
    found = estimate_intrinsics([views[k] for k in rows], width, height)
    for _ in range(_ROUNDS):
        if found is None:
            break
        out = standing_out([views[k] for k in rows], found.camera)
        kept = [k for k, bad in zip(rows, out, strict=True) if not bad]
        if not out.any() or len(kept) < MIN_VIEWS:
            break
        left_out += [k for k, bad in zip(rows, out, strict=True) if bad]
        rows = kept
        found = estimate_intrinsics([views[k] for k in rows], width, height)
    return found, tuple(sorted(left_out))


def estimate_intrinsics(
    views: Sequence[CornerSet], width: int, height: int, guess: Intrinsics | None = None
) -> EstimatedIntrinsics | None:
    """K and five distortion coefficients from at least five views of a target; None when it fails.

    Nested models from square pixels and two radial terms up to everything free; the one with the smallest
    BIC is taken, since a free parameter that the images do not ask for moves the poses instead. ``guess``
    is needed for targets that are not planar.
    """
    chosen = select_views(views)
    planar = all(np.ptp(v.points[:, 2]) < 1e-9 for v in chosen)
    if len(chosen) < MIN_VIEWS or (guess is None and not planar):
        return None
    count = 2 * sum(len(v.points) for v in chosen)
    best: EstimatedIntrinsics | None = None
    best_bic = np.inf
    for flags, parameters in _MODELS:
        found = _calibrate(chosen, width, height, guess, flags)
        if found is None:
            continue
        bic = count * np.log(max(found.rms_px, 1e-6) ** 2) + parameters * np.log(count)
        if bic < best_bic:
            best, best_bic = found, bic
    return best


def _calibrate(
    views: Sequence[CornerSet], width: int, height: int, guess: Intrinsics | None, flags: int
) -> EstimatedIntrinsics | None:
    K = np.eye(3)  # its ratio fx : fy is the one that a fixed aspect keeps
    if guess is not None:
        K, flags = guess.matrix.copy(), flags | cv2.CALIB_USE_INTRINSIC_GUESS
        if flags & cv2.CALIB_FIX_ASPECT_RATIO:
            K[0, 0] = K[1, 1]
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
    try:
        rms, K, dist, _, _, deviations, _, _ = cv2.calibrateCameraExtended(
            [v.points.astype(np.float32) for v in views],
            [v.corners.astype(np.float32).reshape(-1, 1, 2) for v in views],
            (width, height),
            K,
            np.zeros(5),
            flags=flags,
            criteria=criteria,
        )
    except cv2.error:
        return None  # parallel views, or too few corners: there is nothing to be found
    if not (np.all(np.isfinite(K)) and np.all(np.isfinite(dist)) and K[0, 0] > 0.0 and K[1, 1] > 0.0):
        return None
    camera = Intrinsics(
        width,
        height,
        (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])),
        tuple(float(x) for x in dist.ravel()[:5]),
    )
    sigma = np.array(deviations, dtype=float).ravel()[:4]
    if flags & cv2.CALIB_FIX_ASPECT_RATIO:
        sigma[0] = sigma[1]  # OpenCV reports the one that it did not vary as exact
    return EstimatedIntrinsics(camera, float(rms), sigma)
