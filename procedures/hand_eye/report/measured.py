"""The poses behind a result, measured again from its data set, so that any X can be judged by them."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.hand_eye import se3
from calibration.hand_eye.ambiguity import turns
from calibration.hand_eye.views import CornerSet
from cell.devices import Intrinsics
from cell.poses import Array
from procedures.hand_eye.result import HandEyeAnswer
from procedures.hand_eye.result import Intrinsics as EstimatedIntrinsics
from procedures.hand_eye.solve.capture import load_capture
from procedures.report.numbers import matrix4


@dataclass(frozen=True)
class MeasuredPoses:
    """n observations: flange poses ``F`` (n, 4, 4), ``index`` and ``group`` (n,), and T_camera_target ``C``.

    ``C`` (n, 4, 4) is NaN where nothing was measured. ``outline`` (4, 3) is the target's rectangle (m, in
    the target's frame), ``aspect`` (2,) half the camera's field of view as tangents.
    """

    setup: str
    F: Array
    index: NDArray[np.int64]
    group: NDArray[np.int64]
    C: Array
    outline: Array
    aspect: Array

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(n,) where C is known."""
        return np.isfinite(self.C[:, 0, 0])

    def target_poses(self, X: Array) -> Array:
        """The target (n, 4, 4) where each observation alone puts it with camera pose X: base, or flange."""
        G = self.F if self.setup == "eye-to-hand" else se3.inverse(self.F)
        return se3.inverse(G) @ X @ self.C


def measure(data: Path, answer: HandEyeAnswer | None) -> MeasuredPoses:
    """Read ``data`` and find T_camera_target of each observation, starting where ``answer`` expects it.

    Without an answer only the flange poses are known. Raises what reading a data set raises.
    """
    loaded = load_capture(data)
    used = None if answer is None else answer.intrinsics
    camera = loaded.camera if used is None else _intrinsics(used)
    setup = loaded.capture.setup
    pose = None if answer is None else answer.pose()
    X = None if pose is None else matrix4(pose[1])
    W = {} if answer is None else answer.targets()
    C = np.full((len(loaded.F), 4, 4), np.nan)
    motions = turns(loaded.target.points, loaded.target.symmetries)
    for k, (view, bare) in enumerate(zip(loaded.views, loaded.poses, strict=True)):
        if bare is not None:
            C[k] = bare
        place = matrix4(W.get(str(int(loaded.group[k]))))
        if view is None or camera is None or X is None or place is None:
            continue
        G = loaded.F[k] if setup == "eye-to-hand" else se3.inverse(loaded.F[k])
        C[k] = _pose(view, camera, se3.inverse(X) @ G @ place, motions)
    return MeasuredPoses(
        setup=setup,
        F=loaded.F,
        index=np.array(loaded.indices, dtype=np.int64),
        group=loaded.group,
        C=C,
        outline=_outline(loaded.target.points),
        aspect=_aspect(camera),
    )


def _intrinsics(used: EstimatedIntrinsics) -> Intrinsics:
    fx, fy, cx, cy = used.K
    return Intrinsics(used.width, used.height, (fx, fy, cx, cy), tuple(used.dist))


def _pose(view: CornerSet, camera: Intrinsics, expected: Array, motions: Array) -> Array:
    """T_camera_target (4, 4) by OpenCV's iterative PnP from the best of the ``expected @ motions``.

    The motions (k, 4, 4) turn a symmetric target onto itself: one of them is how this image numbered it.
    """
    fx, fy, cx, cy = camera.K
    K, dist = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), np.array(camera.dist or (0.0,) * 4)
    starts = expected @ motions
    off = [np.linalg.norm(_project(view.points, T, K, dist) - view.corners) for T in starts]
    best = int(np.argmin(off))
    rotation, _ = cv2.Rodrigues(starts[best][:3, :3])
    _, rvec, tvec = cv2.solvePnP(
        view.points,
        view.corners,
        K,
        dist,
        rotation,
        starts[best][:3, 3:].copy(),
        useExtrinsicGuess=True,
        flags=cv2.SOLVEPNP_ITERATIVE,
    )
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(rvec)[0], np.ravel(tvec)
    return np.asarray(T @ se3.inverse(motions[best]))


def _project(points: Array, T: Array, K: Array, dist: Array) -> Array:
    rvec, _ = cv2.Rodrigues(T[:3, :3])
    pixels, _ = cv2.projectPoints(points, rvec, T[:3, 3], K, dist)
    return np.asarray(pixels, dtype=float).reshape(-1, 2)


def _outline(points: Array) -> Array:
    """Corners (4, 3) of the rectangle round the points in the target's x-y plane."""
    low, high = points.min(axis=0), points.max(axis=0)
    z = float(points[:, 2].mean())
    return np.array([[low[0], low[1], z], [high[0], low[1], z], [high[0], high[1], z], [low[0], high[1], z]])


def _aspect(camera: Intrinsics | None) -> Array:
    if camera is None:
        return np.array([0.5, 0.375])
    return np.array([camera.width / camera.K[0], camera.height / camera.K[1]]) / 2.0
