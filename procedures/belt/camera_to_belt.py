"""From what the camera sees to places on the belt."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.adjustment.lens_terms import lens_prior
from calibration.belt.placing import camera_cov, left_open
from cell.devices import Intrinsics, ItemView
from cell.errors import error
from cell.poses import Array, from_pose6, to_pose6
from cell.run_values import RunValues
from procedures.belt.config import ItemLook
from procedures.hand_eye_in_use import solved_lens
from procedures.kinematics_in_use import require_same_model

NAME = "T_base_camera"


@dataclass(frozen=True)
class SeenItem:
    """One item in one frame: its grasp point (3,) in the base, the yaw of its longer side, rad, and what the
    detector states of the point, m, along the worse axis."""

    point: Array
    yaw: float
    sigma_m: float


class CameraToBelt:
    """A fixed camera above the belt: ``T_base_camera``, and the plane of the belt at height ``z_m``.

    ``BELT_NO_CAMERA`` without a calibrated one, ``KINEMATICS_DIFFER`` when it was made with another model of
    the arm than is in use.
    """

    def __init__(self, values: RunValues, belt_z_m: float, look: ItemLook) -> None:
        known = (values.calibration.get("eye-to-hand") or {}).get("X")
        if known is None or NAME not in values.versions:
            raise error(
                "BELT_NO_CAMERA", "T_base_camera is not calibrated: run cone-capture with setup eye-to-hand"
            )
        require_same_model(values, NAME)
        self.T_base_camera: RigidTransform = from_pose6(known)
        self._values, self._z_m, self._look = values, belt_z_m, look
        #: As the camera told itself, once it has shown an item.
        self.told: Intrinsics | None = None

    def spec(self) -> dict[str, Any]:
        """What the camera's item detector has to know."""
        T = self.T_base_camera.inv()
        normal = T.rotation.apply([0.0, 0.0, 1.0])
        look = self._look
        return {
            "normal": normal.tolist(),
            "offset_m": float(normal @ T.apply([0.0, 0.0, self._z_m])),
            "min_height_m": look.min_height_m,
            "max_height_m": look.max_height_m,
            "size_m": [look.min_size_m, look.max_size_m],
            "height_m": look.height_m,
            "height_sigma_m": look.height_sigma_m,
            "lens": self._stated.get("lens"),
        }

    @property
    def _stated(self) -> Mapping[str, Any]:
        return self._values.uncertainty.get(NAME, {})

    @property
    def _told_sigma(self) -> dict[str, Any] | None:
        given = self._look.camera_sigma
        return None if given is None else given.model_dump(exclude_none=True)

    def camera(self, told: Intrinsics) -> dict[str, Any]:
        """For a data set: the pose, the lens as ``told``, the ``lens`` that items are placed with (None: the
        one that is told), and ``cov`` (14, 14) of pose and lens, None where it is not known."""
        lens = solved_lens(self._values, NAME, told)
        cov = self._cov(lens)
        return {
            "T_base_camera": to_pose6(self.T_base_camera).tolist(),
            "told": {**asdict(told), "sigma": self._told_sigma},
            "lens": None if lens is None else asdict(lens),
            "cov": None if cov is None else np.asarray(cov).tolist(),
        }

    def _cov(self, lens: Intrinsics | None) -> Array | None:
        stated = self._stated
        # Beside a lens that was estimated without an adjustment the covariance takes the arm as exact.
        if "cov" not in stated or (lens is not None and "budget" not in stated):
            return None
        prior = None if lens is not None else lens_prior(self._told_sigma)
        return np.asarray(camera_cov(stated["cov"], stated.get("lens_cov"), prior))

    def left_open(self, points: Array) -> Array | None:
        """(2, 2) m^2 of x, y of an item that was seen at ``points`` (n, 3) m in the base, by pose and lens;
        None where they are not known, or nothing was seen yet."""
        if self.told is None:
            return None
        lens = solved_lens(self._values, NAME, self.told)
        cov = self._cov(lens)
        return None if cov is None else left_open(points, self.T_base_camera, lens or self.told, cov)

    def seen(self, views: Sequence[ItemView]) -> list[SeenItem]:
        """``views`` in the base, all at once: a picture of a full belt must not hold the stream."""
        if not views:
            return []
        points = self.T_base_camera.apply([view.point for view in views])
        axes = self.T_base_camera.rotation.apply([view.axis for view in views])
        yaws = np.arctan2(axes[:, 1], axes[:, 0])
        return [
            SeenItem(point, float(yaw), view.sigma_m)
            for point, yaw, view in zip(points, yaws, views, strict=True)
        ]
