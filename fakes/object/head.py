"""The camera of the object face as a thing: what an exposure shows, and what can go wrong with it."""

from functools import cached_property, partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.calibrated_lens import calibrated_lens
from cell.clock import Clock
from cell.devices import BoardView, ItemView
from cell.errors import error
from cell.formats.capture import Printed
from cell.poses import Array
from fakes.frames.plates import Image
from fakes.frames.rack_view import RackView
from fakes.object._plant import Plant
from fakes.object.item_detection import Look, items_seen
from fakes.world.camera.autofocus import focal_share
from fakes.world.targets import faces_away, target_points
from fakes.world.world import World

_STEEPEST = np.cos(np.deg2rad(75.0))  # a board seen more edge-on than this is not found


class CameraHead(Plant):
    """Projects the true target into the image; pixel noise is a function of the seed and the tick."""

    def __init__(self, world: World, clock: Clock) -> None:
        super().__init__("camera", clock, world.camera.serial)
        self.world = world
        self._points = world.printed.placed(target_points(world.target))
        self._frozen_at: float | None = None
        self.faults |= {"freeze": self._freeze, "lost-board": self._lose_board}

    def clear(self) -> None:
        """Thaw, bring the board back, and end the faults of the link."""
        self._frozen_at = None
        if self.world.operator.placement_at(self.clock.now()) is None:
            self.world.operator.put_back(self.clock.now())
        super().clear()

    def view(self, t: float, tick: int, target: dict[str, Any] | None) -> BoardView | None:
        """What a search for ``target`` finds in the exposure around ``t``; None when nothing."""
        if self._frozen_at is not None:
            t, tick = self._frozen_at, -1
        if target is None or _told(target) != _told(self.world.target):
            return None
        T = self.world.scene(t).T_camera_target
        if T is None:
            return None
        if self.world.camera.row_time_s:
            late = float(self.world.camera.row_delay_s(T.apply(self._points.mean(axis=0))))
            T = self.world.scene(t + late).T_camera_target
            if T is None:
                return None
        points = np.ascontiguousarray(T.apply(self._points))
        if not self._is_seen(points, T.as_matrix()[:3, 2] * faces_away(target)):
            return None
        camera = self.world.camera
        uv = self._project(points, t)
        rng = np.random.default_rng([self.world.config.seed, tick + 1, 0xCA])
        uv = uv + camera.noise_px * rng.standard_normal(uv.shape)
        # Detectors need a little of the picture around a corner.
        inside = np.all((uv > 5.0) & (uv < np.array([camera.width, camera.height]) - 6.0), axis=1)
        if not inside.any():
            return None
        return BoardView(np.flatnonzero(inside).astype(np.int64), uv[inside], camera.grey)

    def items(self, t: float, tick: int, spec: dict[str, Any] | None) -> tuple[ItemView, ...] | None:
        """What a search for items by ``spec`` finds in the exposure around ``t``; None when nobody looks."""
        if spec is None or self.world.items is None:
            return None
        if self._frozen_at is not None:
            t, tick = self._frozen_at, -1
        camera = self.world.camera
        told = self.world.told_intrinsics
        lens = calibrated_lens(spec.get("lens"), told) or told
        look = Look(partial(self._project, t=t), camera, lens, self.world.config.seed, tick + 1)
        return items_seen(self.world.items, self.world.scene(t).T_base_camera, t, spec, look)

    def pictures(self, t: float, tick: int) -> tuple[Image, NDArray[np.uint16]]:
        """Colour (h, w, 3) and depth (h, w) mm of a rack in the exposure around ``t``."""
        if self._view is None:
            raise error("CONFIG_INVALID", "the scenario has no [world.rack] to take a picture of")
        if self._frozen_at is not None:
            t, tick = self._frozen_at, -1
        return self._view.picture(t, tick)

    @cached_property
    def _view(self) -> RackView | None:
        return None if self.world.rack is None else RackView(self.world, self.world.rack)

    def _is_seen(self, points: Array, into_target: Array) -> bool:
        if points[:, 2].min() < 0.05:
            return False
        sight = points.mean(axis=0)
        return bool(into_target @ sight / np.linalg.norm(sight) > _STEEPEST)

    def _project(self, points: Array, t: float) -> Array:
        intrinsics = self.world.intrinsics
        dist = np.array(intrinsics.dist) if intrinsics.dist else None
        uv, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), intrinsics.matrix, dist)
        out: Array = uv.reshape(-1, 2)
        if self.world.camera.autofocus:
            centre = self.world.camera.K[2:]
            out = centre + focal_share(t) * (out - centre)
        return out

    def _freeze(self, duration_s: float | None = None) -> None:
        self._frozen_at = self.clock.now()
        if duration_s is not None:
            self.later(duration_s, self._thaw)

    def _thaw(self) -> None:
        self.settle_past()
        self._frozen_at = None
        self.announce()

    def _lose_board(self, duration_s: float | None = None) -> None:
        self.world.operator.remove(self.clock.now())
        if duration_s is not None:
            self.later(duration_s, lambda: self.world.operator.put_back(self.clock.now()))


def _told(target: dict[str, Any]) -> dict[str, Any]:
    """What a detector looks for. A flag that is false and one that is left out are the same target, and how
    well its print is known changes nothing of it."""
    return {k: v for k, v in target.items() if v is not False and k not in Printed.model_fields}
