"""What every encoder on CAN has: the link, its watch, and counts from positions."""

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Coroutine, Sequence
from typing import Any

import can

from cell.clock import Clock
from cell.devices import EncoderState, Identity
from cell.errors import CellError, error
from cell.samples import Quality, Sample, Stream
from drivers.can_bus.link import CanLink
from drivers.can_encoder.config import BusConfig
from drivers.can_encoder.counts import Missing, Unwrap
from drivers.can_encoder.stamps import Stamps, stamps_for
from drivers.can_encoder.suspicions import Flood, TwoSenders
from drivers.life import SampledDevice

_LOOKS_BEFORE_LOST = 5  # the watch looks so often within lost_after_s


class CanEncoder(SampledDevice, ABC):
    """``cell.devices.Encoder`` without the words of a particular encoder.

    Reconnecting is the supervisor's business: after an error ``close`` and ``open`` again. A sample's number
    is that of its frame, lost ones included, so ``counts.gaps`` tells how many did not come.
    """

    def __init__(self, name: str, config: BusConfig, clock: Clock, modulus: int) -> None:
        self.modulus = modulus
        self.period_s = config.period_s
        self.counts: Stream[EncoderState] = Stream(name, clock, keep=16384)
        super().__init__(name, clock, self.counts, config.time_offset_s)
        self._bus_config = config
        self._link: CanLink | None = None
        self._stamps: Stamps = stamps_for(config.address, config.period_s, clock)
        self._unwrap, self._missing = Unwrap(modulus), Missing(config.period_s)
        self._two, self._flood = TwoSenders(), Flood(config.period_s)
        self._seq = 0
        self._short = 0  # frames with too few bytes for a position, of this connection
        self._running = False  # positions are believed
        self._heard = 0.0
        self._watching: asyncio.Task[None] | None = None
        self._quality = Quality.GOOD

    # -- Device

    async def open(self) -> None:
        """Open the bus and bring the encoder to sending; ``DEVICE_UNREACHABLE`` and what a setup raises."""
        await self.close()
        self._life.begin()
        self._short = 0
        self.counts.new_epoch()
        self._link = link = CanLink(
            self.name, self._bus_config.bus, self._ids(), self._take, self._lose, self._clock
        )
        try:
            await link.open(self._bus_config.connect_timeout_s)
            self._identity = await self._unless_lost(self._begin())
        except BaseException:
            await self.close()
            raise
        self._start_counting()
        self._watching = self._spawn(self._watch(link), "watch")

    async def close(self) -> None:
        """End everything, the encoder itself excepted: it goes on sending to others."""
        self._lose(error("DEVICE_LOST", f"{self.name} was closed"))
        watching, self._watching = self._watching, None
        if watching is not None:
            watching.cancel()
            await asyncio.wait([watching])
        link, self._link = self._link, None
        if link is not None:
            await link.close()

    def health(self) -> dict[str, Any]:
        """Count, age (s), frames, gaps, frames that were too short, lines that were none, refused stamps."""
        last, link = self.counts.last(), self._link
        return {
            "connected": self._life.good,
            "age_s": None if last is None else self._clock.now() - last.t,
            "count": None if last is None else last.value.count,
            "raw": None if last is None else last.value.raw,
            "modulus": self.modulus,
            "frames": 0 if link is None else link.frames,
            "gaps": self.counts.gaps,
            "too_short": self._short,
            "malformed": 0 if link is None else link.malformed,
            "error_frames": 0 if link is None else link.error_frames,
            "stamps_refused": self._stamps.refused,
            "dt_s": None if last is None else last.dt,
            "epoch": self.counts.epoch,
        }

    # -- what an encoder adds

    @abstractmethod
    def _ids(self) -> list[tuple[int, bool]]:
        """Identifiers of interest, and whether each is extended."""

    @abstractmethod
    async def _begin(self) -> Identity:
        """Bring the encoder to sending."""

    @abstractmethod
    def _position(self, message: can.Message) -> int | None:
        """The raw position in a frame, None when it is none."""

    def _other(self, message: can.Message) -> None:
        """Take a frame that carries no position."""

    def _look(self, now: float) -> None:
        """Look after more than the positions, every now and then."""

    # -- frames

    async def _unless_lost(self, work: Coroutine[Any, Any, Identity]) -> Identity:
        """The result of ``work``; what broke the link as soon as that happens."""
        working, lost = asyncio.ensure_future(work), asyncio.ensure_future(self._life.wait_lost())
        try:
            await asyncio.wait([working, lost], return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in (working, lost):
                task.cancel()
            await asyncio.wait([working, lost])
        self._life.require()
        return working.result()

    def _spawn(self, work: Coroutine[Any, Any, None], what: str) -> asyncio.Task[None]:
        """A task whose failure for no reason of the link is a defect, and ends the link."""

        def ended(task: asyncio.Task[None]) -> None:
            if not task.cancelled() and (failure := task.exception()) is not None:
                self._lose(error("INTERNAL", f"{task.get_name()}: {failure!r}"))

        task = asyncio.create_task(work, name=f"{self.name} {what}")
        task.add_done_callback(ended)
        return task

    def _start_counting(self) -> None:
        """Count from zero, in an epoch that has just begun."""
        self._unwrap, self._missing = Unwrap(self.modulus), Missing(self.period_s)
        self._two, self._flood = TwoSenders(), Flood(self.period_s)
        self._heard = self._clock.now()
        self._running = True

    def _take(self, messages: Sequence[can.Message], looked: float, now: float) -> None:
        positions: list[tuple[can.Message, int]] = []
        for message in messages:
            if message.is_remote_frame:
                continue
            raw = self._position(message)
            if raw is not None:
                positions.append((message, raw))
                continue
            self._push(positions, looked, now)  # another frame may end the epoch
            positions = []
            self._other(message)
        self._push(positions, looked, now)

    def _push(self, positions: Sequence[tuple[can.Message, int]], looked: float, now: float) -> None:
        if not positions or not self._running or not self._life.good:
            return
        self._heard = now
        stamps = self._stamps.take([message for message, _ in positions], looked, now)
        last = self.counts.last()
        earliest = -1.0 if last is None else last.t
        for (_, raw), stamp in zip(positions, stamps, strict=True):
            earliest = t = max(stamp.t - self._bus_config.time_offset_s, earliest)
            try:
                count = self._unwrap.take(raw)
            except ValueError as exc:
                self._lose(error("ENCODER_RANGE", f"{self.name}: position {exc}"))
                return
            if (strange := self._strange(count, stamp.heard)) is not None:
                self._lose(strange)
                return
            self._seq += 1 + self._missing.add(stamp.heard)
            self.counts.push(Sample(EncoderState(count, raw), t, stamp.dt, self._seq, self._quality))

    def _strange(self, count: int, heard: float) -> CellError | None:
        """What no single encoder at its timer sends."""
        if self._two.seen(count):
            return error(
                "ENCODER_TWO_SENDERS",
                f"{self.name} on {self._bus_config.bus}: the positions go to and fro between two places",
            )
        if (rate := self._flood.seen(heard)) is not None:
            return error(
                "ENCODER_FLOOD",
                f"{self.name} on {self._bus_config.bus}: {rate:.0f} frames a second, its timer would send "
                f"{1.0 / self.period_s:.0f}",
            )
        return None

    # -- loss

    async def _watch(self, link: CanLink) -> None:
        """Nobody else tells that frames have ended: not the gateway, not the adapter, not the bus."""
        limit = self._bus_config.lost_after_s
        while self._life.good:
            await self._clock.sleep(limit / _LOOKS_BEFORE_LOST)
            now = self._clock.now()
            if self._running and now - self._heard > limit:
                heard, why = self._heard, await link.why_silent()
                if self._heard == heard:
                    self._lose(self._silence(now, why))
            self._look(now)

    def _silence(self, now: float, why: str) -> CellError:
        last = self.counts.last()
        heard = "none was received" if last is None else f"the last was {last.value.raw}"
        return error(
            "CAN_BUS_OFF" if "bus error" in why else "DEVICE_LOST",
            f"{self.name} on {self._bus_config.bus}: no position for {now - self._heard:.3f} s, {heard}"
            + (f"; {self._short} frames were too short for a position" if self._short else "")
            + (f"; the adapter reports {why}" if why else ""),
        )

    def _lose(self, failure: CellError) -> None:
        self._running = False
        self._life.lose(failure)
