"""A capture data set in memory: poses, and the corners of each observation, measured or detected."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye import se3
from calibration.hand_eye.views import CornerSet
from calibration.targets import Target, make_target
from cell.devices import Intrinsics
from cell.errors import InputError, error
from cell.formats.capture import SCHEMA, Capture, Observation
from cell.formats.pixel_list import pixel_list
from cell.formats.reading import parse, read_json
from cell.poses import Array, from_pose6
from procedures.hand_eye.solve.images import other_size, read_grey, resolve_inside
from procedures.solving import Progress

FILE_NAME = "capture.json"
UNITS_T = "units.translation"
FAR_T, _FAR_Q = 20.0, 4.0 * np.pi
_FEW_CORNERS = 6  # of targets that have more; four of many are most often a misreading


@dataclass
class CaptureSet:
    """What a capture says and shows. Row k of every list is ``capture.observations[k]``.

    ``views[k]`` are the corners, or None; ``poses[k]`` is a given T_camera_target (4, 4), or None;
    ``unusable`` says why a row has neither.
    """

    path: Path
    capture: Capture
    target: Target
    F: Array
    group: NDArray[np.int64]
    views: list[CornerSet | None]
    poses: list[Array | None]
    unusable: dict[int, str] = field(default_factory=dict)
    warnings: list[tuple[str, str]] = field(default_factory=list)
    size: tuple[int, int] | None = None

    @cached_property
    def indices(self) -> list[int]:
        return [o.index for o in self.capture.observations]

    @property
    def camera(self) -> Intrinsics | None:
        """The given intrinsics."""
        return None if self.capture.camera is None else self.capture.camera.intrinsics()

    def usable(self) -> NDArray[np.int64]:
        """Rows with a measurement."""
        return np.array([k for k in range(len(self.F)) if k not in self.unusable], dtype=np.int64)


def load_capture(path: Path, progress: Progress | None = None) -> CaptureSet:
    """Read and check a data set (its folder or its JSON file) and find the target in its images.

    Raises an ``InputError`` that names file, field and fix.
    """
    file = path / FILE_NAME if path.is_dir() else path
    loaded = measured_capture(
        file, parse(Capture, read_json(file, _with_pixel_list), SCHEMA, str(file)), progress
    )
    loaded.capture = _without_corners(loaded.capture)
    return loaded


def _with_pixel_list(table: dict[str, Any]) -> dict[str, Any]:
    return table | {"corners": pixel_list(table["corners"])} if "corners" in table else table


def _without_corners(capture: Capture) -> Capture:
    """``capture`` less what is in the views, where it takes a tenth of the memory."""
    observations = [
        o.model_copy(
            update={"corners": None, "frames": [f.model_copy(update={"corners": None}) for f in o.frames]}
        )
        for o in capture.observations
    ]
    return capture.model_copy(update={"observations": observations})


def measured_capture(file: Path, capture: Capture, progress: Progress | None = None) -> CaptureSet:
    """What ``capture``, read from ``file``, says and shows; as :func:`load_capture`."""
    try:
        target = make_target(capture.target.model_dump())
    except InputError as exc:
        raise error(exc.name, f"{file}: {exc.detail}") from exc
    loaded = CaptureSet(
        path=file,
        capture=capture,
        target=target,
        F=np.array([_matrix(o.T_base_flange) for o in capture.observations]).reshape(-1, 4, 4),
        group=np.array([o.group for o in capture.observations], dtype=np.int64),
        views=[],
        poses=[],
    )
    loaded.warnings.extend(_unit_warnings(capture.observations))
    for k, observation in enumerate(capture.observations):
        if progress is not None:
            progress("detect", k, len(capture.observations))
        _measure(loaded, k, observation)
    if progress is not None:
        progress("detect", len(capture.observations), len(capture.observations))
    return loaded


def _matrix(pose: Sequence[float]) -> Array:
    return se3.matrices(from_pose6(pose))


def _unit_warnings(observations: Sequence[Observation]) -> list[tuple[str, str]]:
    out = []
    far = [o.index for o in observations if np.linalg.norm(o.T_base_flange[:3]) > FAR_T]
    if far:
        text = f"T_base_flange of observation {far[0]} is more than {FAR_T:.0f} m from the base"
        out.append((UNITS_T, f"{text} ({len(far)} such): are the translations in millimetres?"))
    turned = [
        o.index
        for o in observations
        if np.linalg.norm(o.T_base_flange[3:]) > _FAR_Q or max(map(abs, o.q or [0.0])) > _FAR_Q
    ]
    if turned:
        text = f"an angle of observation {turned[0]} is beyond 4 pi rad"
        out.append(("units.rotation", f"{text} ({len(turned)} such): are the angles in degrees?"))
    return out


def _measure(loaded: CaptureSet, k: int, observation: Observation) -> None:
    """Fill row k: corners that are written down come first, then images, then the bare pose."""
    view, reason = _view(loaded, k, observation)
    pose = None if observation.T_camera_target is None else _matrix(observation.T_camera_target)
    if view is not None and pose is not None:
        view = CornerSet(view.points, view.corners, view.count, pose)
    if view is None and (pose is None or reason):
        loaded.unusable[k] = reason or "there is nothing measured"
    loaded.views.append(view)
    loaded.poses.append(None if view is not None else pose)


def _view(loaded: CaptureSet, k: int, observation: Observation) -> tuple[CornerSet | None, str]:
    where = f"observations[{k}]"
    lists = []
    if observation.corners is not None:
        lists = [_given(loaded, f"{where}.corners", observation.corners)]
    elif any(f.corners is not None for f in observation.frames):
        lists = [
            _given(loaded, f"{where}.frames[{i}].corners", f.corners)
            for i, f in enumerate(observation.frames)
            if f.corners is not None
        ]
    else:
        names = [(f"{where}.frames[{i}].image", f.image) for i, f in enumerate(observation.frames) if f.image]
        if not names and observation.image:
            names = [(f"{where}.image", observation.image)]
        lists = [_detect(loaded, field, name) for field, name in names]
    if not lists:
        return None, ""
    return _combine(loaded.target.points, np.stack(lists))


def _given(loaded: CaptureSet, where: str, corners: Sequence[Sequence[float] | None]) -> Array:
    """Corners (n, 2) from a list, NaN where unseen."""
    points = len(loaded.target.points)
    if len(corners) != points:
        raise error(
            "DATA_INVALID",
            f"{loaded.path}: {where} has {len(corners)} entries, the target has {points} points; give one "
            "entry a point, null where it is not seen",
        )
    return np.array([(np.nan, np.nan) if c is None else c for c in corners], dtype=float)


def _detect(loaded: CaptureSet, where: str, name: str) -> Array:
    """Corners (n, 2) found in an image, NaN where unseen; the size must be the camera's."""
    field = f"{loaded.path}: {where}"
    camera = loaded.capture.camera
    wanted = loaded.size if camera is None else (camera.width, camera.height)
    grey = read_grey(resolve_inside(loaded.path.parent, name, field), field, wanted)
    size = (grey.shape[1], grey.shape[0])
    if wanted is not None and size != wanted:
        raise error("DATA_INVALID", other_size(field, name, size, wanted))
    loaded.size = size
    out = np.full((len(loaded.target.points), 2), np.nan)
    found = loaded.target.detect(grey)
    if found is not None:
        out[found.ids] = found.corners
    return out


def _combine(points: Array, corners: Array) -> tuple[CornerSet | None, str]:
    """Mean over frames (f, n, 2) of each corner, with the number of frames that saw it."""
    seen = ~np.isnan(corners[..., 0])
    count = seen.sum(axis=0)
    ids = np.flatnonzero(count)
    needed = min(_FEW_CORNERS, len(points)) if len(points) >= 4 else 4
    if not len(ids):
        return None, "the target was not found"
    if len(ids) < needed:
        return None, f"only {len(ids)} of {len(points)} corners were found; {needed} are needed"
    mean = np.nansum(corners, axis=0)[ids] / count[ids, None]
    extent = np.linalg.svd(points[ids] - points[ids].mean(axis=0), compute_uv=False)
    if extent[1] < 1e-6 * extent[0]:
        return None, f"the {len(ids)} corners found lie on one line"
    own = points if len(ids) == len(points) else points[ids]  # thousands of views share those of all corners
    return CornerSet(own, mean, count[ids].astype(float)), ""
