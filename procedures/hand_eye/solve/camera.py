"""Which intrinsics a capture is solved with: the given ones if they fit its images, else estimated ones."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.adjustment.image_misfit import explained_by_parts
from calibration.hand_eye.pnp_start import first_guesses
from calibration.hand_eye.views import CornerSet, undistort
from calibration.intrinsics import (
    MIN_CORNERS,
    MIN_VIEWS,
    EstimatedIntrinsics,
    check_intrinsics,
    estimate_robustly,
    select_views,
)
from cell.devices import Intrinsics
from cell.errors import error
from procedures.hand_eye.known_parts import known_lens
from procedures.hand_eye.result import Intrinsics as WrittenIntrinsics
from procedures.hand_eye.solve.capture import CaptureSet

CODE = "camera.intrinsics"
MISFIT = "images.misfit"
_AS_WELL = 1.03  # times the reprojection error of a free camera
_LEAST_PX = 0.02  # of noise; fewer are beyond any detector
_EXPECTED, _MOST_FOCAL = 3.0, 6e-3  # times its standard deviation; of the focal length
_PLAIN = 5  # distortion coefficients of the usual model
_START_PX = 50.0  # RMS error of a start pose beyond which it is thrown away


@dataclass(frozen=True)
class CameraChoice:
    """The camera in use (None when there are no corners), what was estimated, and what to warn of."""

    camera: Intrinsics | None
    estimated: WrittenIntrinsics | None
    warnings: tuple[tuple[str, str], ...] = ()


def choose_camera(loaded: CaptureSet, adjusts: bool = True) -> CameraChoice:
    """Check the given intrinsics against the views, or estimate them where they are missing or wrong.

    A few images that fit no camera do not decide; they are warned of. Intrinsics that are off by no more
    than was to be expected stay where the lens is an unknown of what follows (``adjusts``).
    """
    rows = [k for k, v in enumerate(loaded.views) if v is not None]
    # a start pose may be wrong, which is no fault of the camera
    views = [replace(v, start=None) for v in loaded.views if v is not None]
    if not views:
        return CameraChoice(loaded.camera, None)
    given = loaded.camera
    if given is None:
        return _without_intrinsics(loaded, rows, views)
    check = check_intrinsics(views, given)
    if check is None:
        return CameraChoice(given, None)
    misfits = _misfits(loaded, [rows[k] for k in check.left_out])
    if check.fits:
        return CameraChoice(given, None, misfits)
    K, free = check.free.camera.K, check.free
    kept = select_views([v for k, v in enumerate(views) if k not in check.left_out])
    if adjusts and _as_expected(loaded, given, kept, free.rms_px):
        return CameraChoice(given, None, misfits)
    text = (
        f"the given intrinsics do not fit the images: reprojection {check.rms_given_px:.3f} px RMS, with "
        f"estimated ones {free.rms_px:.3f} px (fx {given.K[0]:.1f} -> {K[0]:.1f}, fy {given.K[1]:.1f} -> "
        f"{K[1]:.1f}, cx {given.K[2]:.1f} -> {K[2]:.1f}, cy {given.K[3]:.1f} -> {K[3]:.1f})"
    )
    if not free.useful:
        text += "; these images do not determine better ones, so the given ones were used"
        return CameraChoice(given, None, ((CODE, text), *misfits))
    text += "; the estimated ones were used"
    estimated = _written(free, "the given ones do not fit the images")
    return CameraChoice(free.camera, estimated, ((CODE, text), *misfits))


def _as_expected(loaded: CaptureSet, given: Intrinsics, views: list[CornerSet], free_px: float) -> bool:
    """Whether a lens that is off by little, as such lenses are, and a bent target explain the images too."""
    if len(given.dist) > _PLAIN:
        return False
    stated = None if loaded.capture.camera is None else loaded.capture.camera.sigma
    lens, _ = known_lens(None if stated is None else stated.model_dump())
    rms, off = explained_by_parts(views, given, lens, max(free_px, _LEAST_PX))
    limits = _EXPECTED * lens.sigma()
    limits[0] = min(limits[0], _MOST_FOCAL)
    return bool(rms < _AS_WELL * free_px and np.all(np.abs(off) < limits))


def _misfits(loaded: CaptureSet, rows: list[int]) -> tuple[tuple[str, str], ...]:
    """The warning that names images which fit neither the given camera nor the one of the other images."""
    if not rows:
        return ()
    named = ", ".join(str(loaded.indices[k]) for k in rows)
    text = (
        f"the corners of observation {named} fit the target far worse than the others' with any camera: they "
        "had no say about the intrinsics; look for a shifted or damaged image, or misread corners"
    )
    return ((MISFIT, text),)


def _without_intrinsics(loaded: CaptureSet, rows: list[int], views: list[CornerSet]) -> CameraChoice:
    if loaded.size is not None:
        width, height = loaded.size
    else:  # corners only: the image is at least as large as what was seen in it
        far = np.max([v.corners.max(axis=0) for v in views], axis=0)
        width, height = int(far[0]) + 2, int(far[1]) + 2
    free, left_out = estimate_robustly(views, width, height)
    if free is None or not free.useful:
        raise error(
            "DATA_INVALID",
            f"{loaded.path}: camera is null and the images do not determine the intrinsics "
            f"({MIN_VIEWS} views or more of a flat target at different tilts, each with {MIN_CORNERS} "
            "corners or more, are needed); give camera.K and camera.dist",
        )
    text = (
        f"no intrinsics were given; they were estimated from the images with {free.rms_px:.3f} px RMS, and "
        "their error is part of the result's"
    )
    misfits = _misfits(loaded, [rows[k] for k in left_out])
    return CameraChoice(free.camera, _written(free, "none were given"), ((CODE, text), *misfits))


def _written(found: EstimatedIntrinsics, why: str) -> WrittenIntrinsics:
    camera = found.camera
    return WrittenIntrinsics(
        width=camera.width,
        height=camera.height,
        K=list(camera.K),
        dist=list(camera.dist),
        sigma_K=found.sigma_K.tolist(),
        rms_px=found.rms_px,
        why=why,
    )


def check_views(loaded: CaptureSet, camera: Intrinsics | None) -> None:
    """Mark views that no pose explains, and throw start poses away that are far from their corners."""
    if camera is None:
        return
    for k, view in enumerate(loaded.views):
        if view is None:
            continue
        if view.start is not None and not _plausible(view, view.start, camera):
            loaded.views[k] = CornerSet(view.points, view.corners, view.count)
    rows = [k for k, v in enumerate(loaded.views) if v is not None]
    views = [v for v in loaded.views if v is not None]
    guesses = first_guesses(views, camera)
    for k, guess in zip(rows, guesses, strict=True):
        if np.any(np.isnan(guess)):
            loaded.views[k] = None
            loaded.unusable[k] = "no pose of the target before the camera explains the corners"


def _plausible(view: CornerSet, start: NDArray[Any], camera: Intrinsics) -> bool:
    p = view.points @ start[:3, :3].T + start[:3, 3]
    if np.any(p[:, 2] <= 0.0):
        return False
    error_px = (p[:, :2] / p[:, 2:] - undistort(view.corners, camera)) * np.array(camera.K[:2])
    return bool(np.sqrt(np.mean(np.sum(error_px**2, axis=1))) < _START_PX)
