"""The camera of the object face: corners straight from the world, and pictures where a rack is looked at."""

import asyncio
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from pydantic import Field

from cell.clock import Clock
from cell.devices import DepthCamera, Frame, Identity
from cell.errors import CellError, error
from cell.formats.reading import Strict
from fakes.object._lazy import LazyStream
from fakes.object._plant import ObjectDevice
from fakes.object.registry import cell_of
from fakes.world.camera.autofocus import lens_position


class ObjectCameraConfig(Strict):
    """Keys of a device with ``driver = "fakes.object:ObjectCamera"``."""

    scenario: str = Field(description="scenario file, or the name of a shipped one")
    expect_serial: str | None = None
    lost_after_s: float = Field(default=1.0, gt=0, le=10)
    row_time_s: float | None = Field(
        default=None, ge=0, le=0.0002, description="what is believed of the shutter; absent: what is so"
    )


class ObjectCamera(ObjectDevice):
    """``cell.devices.DepthCamera`` on virtual time. Frames have files where the world has a rack and no board
    is looked for."""

    Config = ObjectCameraConfig
    PLAYS = (DepthCamera,)

    def __init__(self, name: str, config: ObjectCameraConfig, clock: Clock) -> None:
        self._cell = cell_of(config.scenario, clock)
        self.head = self._cell.camera
        super().__init__(name, clock, self.head, config.lost_after_s)
        self.config = config
        self.world = self._cell.world
        truth = self.world.camera
        self._exposure_s = truth.exposure().time_s
        self._delay_s = self._exposure_s / 2.0 + truth.row_time_s * truth.height + truth.latency_s
        self._lens_timer: asyncio.TimerHandle | None = None
        self.frames: LazyStream[Frame] = LazyStream(
            f"{name}.frames",
            clock,
            truth.period_s,
            self._expose,
            dt=self._exposure_s / 2.0,
            delay_s=self._delay_s,
            keep=512,
        )
        self.stream = self.frames
        self._target: dict[str, Any] | None = None
        self._items: dict[str, Any] | None = None

    async def open(self) -> None:
        """Connect; ``DEVICE_UNREACHABLE`` while the camera refuses."""
        await super().open()
        self._cell.start()
        if self.world.camera.autofocus:
            self._watch_lens(self.clock.now())

    def _watch_lens(self, first: float) -> None:
        """The link ends with the first frame whose lens is elsewhere than at that of ``first``, as a driver
        ends it that looks at every frame."""
        held, moved = lens_position(first), first
        while lens_position(moved) == held:
            moved += self.frames.period_s
        self._lens_timer = asyncio.get_running_loop().call_later(
            moved - first + self._delay_s, self._tell_lens, held, lens_position(moved)
        )

    def _tell_lens(self, held: int, found: int) -> None:
        self.lose(error("CAMERA_LENS_MOVED", f"the lens is at {found} of 255, and it was at {held}"))

    def lose(self, why: CellError) -> None:
        super().lose(why)
        if self._lens_timer is not None:
            self._lens_timer.cancel()
            self._lens_timer = None

    async def identify(self) -> Identity:
        if self.lost is not None:
            raise error(self.lost.name, self.lost.detail)
        return Identity("object-camera", self.head.serial)

    async def set_target(self, target: dict[str, Any] | None) -> None:
        """Look for this board from now on."""
        self.frames.fill()
        self._target = None if target is None else dict(target)

    async def set_items(self, spec: dict[str, Any] | None) -> None:
        """Look for items by this table from now on; ``CAMERA_FAULT`` without depth and without a height."""
        if spec is not None and not self.world.camera.depth and spec.get("height_m") is None:
            raise error("CAMERA_FAULT", "items are looked for by depth, and this camera has none")
        self.frames.fill()
        self._items = None if spec is None else dict(spec)

    async def capture(self, count: int, folder: Path, stem: str, after: float) -> Sequence[Frame]:
        """``count`` frames exposed wholly after ``after``; this face writes files where there is a rack, of
        which it is the picture that is looked at, and not while a board is looked for: its corners come with
        the frame. ``DISK_FAILED`` without the folder."""
        if not await asyncio.to_thread(folder.is_dir):
            raise error("DISK_FAILED", f"{folder}: there is no such folder")
        frames: list[Frame] = []
        self.frames.leave_out(after - self._exposure_s - 2.0 * self.frames.period_s)
        while len(frames) < count:
            if self.lost is not None:
                raise error(self.lost.name, f"{self.lost.detail}, {len(frames)} of {count} frames taken")
            frames = [
                sample.value
                for sample in self.frames.between(after, self.clock.now())
                if sample.value.t_exposure - sample.value.exposure_s / 2.0 >= after
            ][:count]
            if len(frames) < count:
                await self.wait_change(self.frames.period_s / 2.0)
        if self.world.rack is None or self._target is not None:
            return frames
        return [await asyncio.to_thread(self._drawn, f, folder, f"{stem}-{k}") for k, f in enumerate(frames)]

    def _drawn(self, frame: Frame, folder: Path, stem: str) -> Frame:
        """``frame`` with its pictures on disk; blocks."""
        colour, depth = self.head.pictures(frame.t_exposure - self.world.camera.stamp_late_s, frame.seq)
        colour_file, depth_file = folder / f"{stem}.png", folder / f"{stem}-depth.png"
        cv2.imwrite(str(colour_file), colour)
        if not self.world.camera.depth:
            return replace(frame, colour_file=colour_file)
        cv2.imwrite(str(depth_file), depth)
        return replace(frame, colour_file=colour_file, depth_file=depth_file)

    def inject(self, kind: str, **arguments: object) -> None:
        """Begin a fault of the camera, by its name in the vocabulary."""
        self.head.inject(kind, arguments)

    def _expose(self, t: float, tick: int) -> Frame:
        number, camera = round(t / self.frames.period_s), self.world.camera
        jitter = np.random.default_rng([self.world.config.seed, number, 0x57A]).standard_normal()
        exposed = t - camera.stamp_late_s
        return Frame(
            seq=tick,
            t_exposure=t + camera.stamp_jitter_s * float(jitter),
            exposure_s=self._exposure_s,
            intrinsics=self.world.told_intrinsics,
            board=self.head.view(exposed, number, self._target),
            serial=self.head.serial,
            items=self.head.items(exposed, number, self._items),
            row_time_s=camera.row_time_s if self.config.row_time_s is None else self.config.row_time_s,
        )
