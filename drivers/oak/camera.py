"""The camera as the daemon sees it: frames with corners, and files on request."""

import asyncio
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from cell.clock import Clock
from cell.devices import DepthCamera, Frame, Identity
from cell.errors import error
from cell.own_delay import busy_words
from cell.samples import Sample, Stream
from drivers.life import SampledDevice
from drivers.oak.config import OakConfig
from drivers.oak.link import ChildLink, identity_fields
from drivers.oak.protocol import Message, frame_from_json

_TARGET_TIMEOUT_S = 5.0
_CAPTURE_TIMEOUT_S = 5.0  # beside the time that the frames themselves take
_FRAME_FILES_S = 2.0  # to write one frame on a slow disk and a busy machine
_FUTURE_S = 0.05  # a stamp further ahead than this is not of our clock
_WATCH_PERIOD_S = 0.05


class OakCamera(SampledDevice):
    """An OAK, or a frame server in its place, behind a supervised child process.

    The child holds depthai and the detectors, and dies with the daemon. A child that dies is a camera that
    dropped: :meth:`wait_lost` says ``CHILD_DIED``, and a new :meth:`open` starts another one. What was chosen
    by :meth:`set_target` and :meth:`set_items` outlives the connection.
    """

    Config = OakConfig
    PLAYS = (DepthCamera,)

    def __init__(
        self, name: str, config: OakConfig, clock: Clock, child_module: str = "daemon.vision_child"
    ) -> None:
        self.config = config
        self.frames: Stream[Frame] = Stream(name, clock, keep=256)
        super().__init__(name, clock, self.frames, config.time_offset_s)
        self._child_module = child_module
        self._link: ChildLink | None = None
        self._target: dict[str, Any] | None = None
        self._items: dict[str, Any] | None = None
        self._mean_grey: float | None = None
        self._repeated = 0

    # -- Device

    async def open(self) -> None:
        """Start the child and wait for the first frame.

        ``DEVICE_UNREACHABLE`` when there is no camera or no frame within ``open_timeout_s``, ``CHILD_DIED``
        when the child could not even report that.
        """
        await self.close()
        self.frames.new_epoch()
        self._life.begin()
        self._identity = None
        self._ready: asyncio.Future[Identity] = asyncio.get_running_loop().create_future()
        self._link = ChildLink(self.name, self._life, self._take)
        try:
            async with asyncio.timeout(self.config.open_timeout_s):
                await self._link.start(self._child_module)
                config = self.config.model_dump()
                chosen = {"target": self._target, "items": self._items}
                self._link.send({"type": "configure", "config": config, **chosen})
                await self._first_frame()
        except TimeoutError:
            await self.close()
            raise error(
                "DEVICE_UNREACHABLE",
                f"{self.name}: no frame from {self.config.source} within {self.config.open_timeout_s:.0f} s",
            ) from None
        except BaseException:
            await self.close()
            raise
        self._life.keep_going(self._watch_frames(self._link), "watch")

    async def close(self) -> None:
        """End the child; harmless when there is none."""
        link, self._link = self._link, None
        await self._life.end()
        if link is not None:
            await link.close()

    def health(self) -> dict[str, Any]:
        """Frames received and missed; age (s), corners, items, brightness of the newest; the child's pid."""
        last = self.frames.last()
        board = last.value.board if last else None
        return {
            "frames": self.frames.received,
            "gaps": self.frames.gaps,
            "repeated": self._repeated,
            "age_s": None if last is None else self._age_s(last),
            "corners": None if board is None else len(board.ids),
            "items": None if last is None or last.value.items is None else len(last.value.items),
            "mean_grey": self._mean_grey,
            "child_pid": self._link.pid if self._link else None,
        }

    # -- DepthCamera

    async def set_target(self, target: dict[str, Any] | None) -> None:
        """Look for ``target`` from the next frame on; its error when the detector refuses the table.

        Without a connection the choice is kept for the next one.
        """
        before, self._target = self._target, target
        try:
            await self._choose({"type": "target", "target": target}, refusable=target is not None)
        except BaseException:
            self._target = before
            raise

    async def set_items(self, spec: dict[str, Any] | None) -> None:
        """Look for items by ``spec`` from the next frame on; its error when the detector refuses it.

        Without a connection the choice is kept for the next one.
        """
        before, self._items = self._items, spec
        try:
            await self._choose({"type": "items", "items": spec}, refusable=spec is not None)
        except BaseException:
            self._items = before
            raise

    async def capture(self, count: int, folder: Path, stem: str, after: float) -> Sequence[Frame]:
        """See :meth:`cell.devices.DepthCamera.capture`; the child writes the files."""
        if count < 1:
            raise error("ARGUMENT_INVALID", f"{self.name}: a capture of {count} frames")
        link = self._connected()
        last = self.frames.last()
        period = 1.0 / self.config.fps if last is None else max(1.0 / self.config.fps, 2.0 * last.dt)
        timeout = max(after - self._clock.now(), 0.0) + _CAPTURE_TIMEOUT_S + count * (period + _FRAME_FILES_S)
        request = {"type": "capture", "count": count, "folder": str(folder), "stem": stem, "after": after}
        answer = await link.request(request, timeout)
        return [frame_from_json(frame) for frame in answer["frames"]]

    # -- inside

    async def _choose(self, message: Message, refusable: bool) -> None:
        """Tell the child. One that still opens its camera answers only then: where it cannot refuse, nobody
        waits for that."""
        if self._link is None:
            return
        if refusable or self._ready.done():
            await self._link.request(message, _TARGET_TIMEOUT_S)
        else:
            self._link.tell(message)

    def _connected(self) -> ChildLink:
        if self._link is None:
            raise error("DEVICE_LOST", f"{self.name} is not open")
        self._life.require()
        return self._link

    async def _first_frame(self) -> None:
        await self._life.wait_for(self._ready)
        self._identity = self._ready.result()
        await self.wait_fresh(self.config.open_timeout_s)

    def _take(self, message: Message) -> None:
        """A message of the child that is no answer."""
        if message["type"] == "ready" and not self._ready.done():
            self._ready.set_result(Identity(**identity_fields(message)))
        elif message["type"] == "frame":
            self._mean_grey = float(message["mean_grey"])
            self._push(frame_from_json(message["frame"]))

    def _push(self, frame: Frame) -> None:
        ahead = frame.t_exposure + self.config.time_offset_s - self._clock.now()
        if ahead > _FUTURE_S:
            raise error("PROTOCOL_VIOLATION", f"{self.name}: frame {frame.seq} is {ahead:.3f} s ahead of now")
        last = self.frames.last()
        if last is not None and (frame.seq <= last.seq or frame.t_exposure <= last.t):
            self._repeated += 1
            return
        self.frames.push(Sample(frame, frame.t_exposure, 0.5 * frame.exposure_s, frame.seq))

    async def _watch_frames(self, link: ChildLink) -> None:
        """End the link when the newest exposure is too old: silence, a frozen picture and delay alike."""
        limit = self.config.frame_timeout_s
        while self._life.good:
            last = self.frames.last()
            if last is not None and self._age_s(last) > limit:
                link.lose(
                    error("DEVICE_LOST", f"{self.name}: no new frame for {limit:.1f} s{self._newest()}")
                )
            await self._clock.sleep(_WATCH_PERIOD_S)

    def _newest(self) -> str:
        last = self.frames.last()
        if last is None:
            return ", none since the connection"
        words = busy_words(self._clock.now())
        return f", the newest is number {last.seq}, {self._age_s(last):.1f} s old{words}"

    def _age_s(self, sample: Sample[Frame]) -> float:
        """By the stamp without the offset, which says when something was and not whether the link is good."""
        return self._clock.now() - sample.t - self.config.time_offset_s
