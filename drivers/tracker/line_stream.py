"""A program that sends points as lines of text, as ``cell.laser_tracker.LaserTracker``."""

import asyncio
import logging
from contextlib import AbstractAsyncContextManager
from typing import Any

import numpy as np

from cell.clock import Clock
from cell.devices import Identity
from cell.errors import CellError, error
from cell.laser_tracker import LaserTracker, StablePoint, TrackerNoise, TrackerState
from cell.poses import Array
from cell.samples import Quality, Sample, Stream
from drivers.life import SampledDevice
from drivers.tracker.address import NetAddress
from drivers.tracker.line_config import LineStreamConfig
from drivers.tracker.line_parser import BadLine, LineParser, Parsed
from drivers.tracker.newcomers import Newcomers, newcomers
from drivers.tracker.stable import StableWindow
from drivers.tracker.wire import Lines, Link, connect, listen

log = logging.getLogger("cellward.devices")

_LOOKS_PER_SILENCE = 4


class LineStreamTracker(SampledDevice):
    """Whatever steers the instrument is the sender: ``find`` waits for the point to be where it is expected.

    Lines that cannot be read are counted, the first of a row is logged with its reason, and too many in a row
    end the link.
    """

    Config = LineStreamConfig
    PLAYS = (LaserTracker,)

    def __init__(self, name: str, config: LineStreamConfig, clock: Clock) -> None:
        self.noise = TrackerNoise(config.sigma0_m, config.sigma_per_m)
        self.readings: Stream[TrackerState] = Stream(name, clock)
        super().__init__(name, clock, self.readings, config.time_offset_s)
        self._config = config
        self._parser = LineParser(config)
        self._link: Link | None = None
        self._lines = Lines()
        self._answered = asyncio.Event()  # the request, by any line
        self._read = asyncio.Event()  # a line, for the first time
        self._asked: float | None = None  # when the request was sent that has no answer yet
        self._last_arrival = 0.0
        self._newest: Parsed | None = None
        self._selected: str | None = None
        self._found = False
        self._seq = self._bad = self._bad_in_a_row = self._unasked = 0
        self._reason = ""

    # -- Device

    async def open(self) -> None:
        """Connect and wait for a line that can be read; ``DEVICE_UNREACHABLE`` with what came instead.

        ``DEVICE_LOST`` or ``PROTOCOL_VIOLATION`` when the link ends before there is one.
        """
        await self.close()
        self._life.begin()
        self.readings.new_epoch()
        self._selected, self._found, self._asked = None, False, None
        self._bad_in_a_row, self._reason = 0, ""
        self._lines, self._read, self._last_arrival = Lines(), asyncio.Event(), self._clock.now()
        try:
            self._link = link = await self._connect()
            told = {"told": "serial" in self._config.fields}
            self._identity = Identity(self._config.model, self._config.serial, "", told)
            self._life.keep_going(self._run(link), "reading")
            await self._first_line()
            self._life.require()
        except OSError as exc:
            await self.close()
            what = f"connects, but {self._nothing()}" if isinstance(exc, TimeoutError) else str(exc)
            raise error("DEVICE_UNREACHABLE", f"{self.name} at {self._config.url}: {what}") from exc
        except BaseException:
            await self.close()
            raise

    async def _first_line(self) -> None:
        """Wait for one that can be read; ``TimeoutError`` without it."""
        async with asyncio.timeout(self._config.silence_s):
            await self._read.wait()

    async def close(self) -> None:
        """End the connection."""
        await self._life.end()
        link, self._link = self._link, None
        if link is not None:
            link.close()
            await asyncio.sleep(0)  # an aborted transport closes its socket on the loop's next turn

    def health(self) -> dict[str, Any]:
        """Age (s) of the newest line, lines read and not read, with the reason of the newest of those."""
        last = self.readings.last()
        return {
            "connected": self._life.good,
            "age_s": None if last is None else self._clock.now() - last.t,
            "epoch": self.readings.epoch,
            "reflector": self._selected,
            "status": "" if last is None else last.value.status,
            "lines": self.readings.received,
            "bad_lines": self._bad + self._lines.dropped,
            "bad_reason": self._reason,
            "unasked_lines": self._unasked,
        }

    # -- LaserTracker

    async def select(self, reflector: str) -> None:
        """Add the constant of ``reflector`` to ranges from now on."""
        self._life.require()
        if reflector not in self._config.reflectors:
            known = ", ".join(self._config.reflectors)
            raise error("TRACKER_REFLECTOR_UNKNOWN", f"{self.name} has {known}, but not '{reflector}'")
        self._selected = reflector

    async def find(self, near: Array | None, timeout: float) -> None:
        """Wait until a valid point comes, within ``find_radius_m`` of ``near`` (3,), tracker frame, if given.

        ``TRACKER_NO_TARGET`` when none does within ``timeout`` s; it says how far the nearest one was.
        """
        self._life.require()
        self._found, nearest = False, np.inf
        deadline = self._clock.now() + timeout
        async with self._newcomers() as found:
            while (sample := await found.next(deadline - self._clock.now())) is not None:
                point = sample.value.point
                if point is None:
                    continue
                distance = 0.0 if near is None else float(np.linalg.norm(point - near))
                nearest = min(nearest, distance)
                if distance <= self._config.find_radius_m:
                    self._found = True
                    return
        seen = "no point came" if np.isinf(nearest) else f"the nearest point was {nearest:.3f} m away"
        raise error("TRACKER_NO_TARGET", f"{self.name}: {seen} in {timeout:g} s")

    async def measure(self, window_s: float, max_scatter_m: float, timeout: float) -> Sample[StablePoint]:
        """The mean of lines that were all read after the call and agree; errors as for any tracker."""
        self._require_selected()
        window = StableWindow(window_s, max_scatter_m, self._config.min_readings)
        begin = self._clock.now()
        seen = begin  # when there was a point last
        async with self._newcomers() as found:
            while (left := begin + timeout - self._clock.now()) > 0:
                patience = max(seen + self._config.broken_after_s - self._clock.now(), 0.0)
                sample = await found.next(min(left, patience))
                if sample is not None and sample.value.point is not None:
                    self._found, seen = True, self._clock.now()
                    if window.add(sample.t, sample.dt, sample.value.point, rotation=sample.value.rotation):
                        return window.sample(sample.seq, *self._air())
                    continue
                window.restart()
                if self._clock.now() - seen >= self._config.broken_after_s:
                    raise self._lost_target()
        raise window.unstable(self.name, timeout)

    def _require_selected(self) -> None:
        self._life.require()
        if self._selected is None:
            raise error(
                "TRACKER_SETTING", f"no reflector of {self.name} was selected, so its constant is not known"
            )

    def _lost_target(self) -> CellError:
        name = "TRACKER_BEAM_BROKEN" if self._found else "TRACKER_NO_TARGET"
        last = self.readings.last()
        why = f", and {last.value.status}" if last is not None and last.value.status else ""
        return error(name, f"{self.name}: no point for {self._config.broken_after_s:g} s{why}")

    def _air(self) -> tuple[float | None, float | None]:
        """Temperature (deg C) and pressure (Pa) of the newest line."""
        return (
            (None, None) if self._newest is None else (self._newest.temperature_c, self._newest.pressure_pa)
        )

    def _newcomers(self) -> AbstractAsyncContextManager[Newcomers[TrackerState]]:
        return newcomers(self.readings, self._life, self._clock.now() - self._config.time_offset_s)

    # -- lines

    async def _connect(self) -> Link:
        config, address = self._config, self._config.address
        if config.listens and isinstance(address, NetAddress):
            return await listen(address, self._received, self._dropped, config.only_from)
        return await connect(address, self._received, self._dropped, config.connect_timeout_s)

    async def _run(self, link: Link) -> None:
        """Ask, if there is something to ask with; and see that lines come."""
        config = self._config
        while self._life.good:
            if config.request is None:
                await self._clock.sleep(config.silence_s / _LOOKS_PER_SILENCE)
                if self._clock.now() - self._last_arrival > config.silence_s:
                    self._lose("DEVICE_LOST", f"no line for {config.silence_s:g} s")
                continue
            self._answered.clear()
            begin = self._asked = self._clock.now()
            link.write(config.request.encode())
            try:
                async with asyncio.timeout(config.silence_s):
                    await self._answered.wait()
            except TimeoutError:
                self._lose("DEVICE_LOST", self._nothing())
                return
            await self._clock.sleep(max(begin + config.poll_period_s - self._clock.now(), 0.0))

    def _received(self, data: bytes) -> None:
        now = self._clock.now()
        lines = self._lines.feed(data)
        for index, line in enumerate(lines):
            self._take(line, now, newest=index == len(lines) - 1)
        if lines:
            self._last_arrival = now

    def _take(self, line: bytes, now: float, newest: bool) -> None:
        reflector = self._config.reflectors.get(self._selected or "")
        try:
            parsed = self._parser.parse(line, 0.0 if reflector is None else reflector.constant_m)
        except BadLine as exc:
            self._count_bad(line, exc)
            self._answered.set()
            return
        if parsed is None:
            return
        self._bad_in_a_row = 0
        if self._config.request is not None and self._asked is None:
            self._unasked += 1  # whenever it was measured, it was not between a request and its answer
            return
        self._push(parsed, now, newest)
        self._asked = None
        self._answered.set()
        self._read.set()

    def _push(self, parsed: Parsed, now: float, newest: bool) -> None:
        """Of lines that came together only the newest is known to be new."""
        uncertain = self._config.stamp_uncertainty_s
        begin, end = now - uncertain, now + uncertain
        if self._asked is not None:
            begin, end = self._asked, now
        elif not newest:
            begin = self._last_arrival - uncertain
        self._newest = parsed
        self._seq += 1
        t = 0.5 * (begin + end) - self._config.time_offset_s
        quality = Quality.GOOD if parsed.point is not None else Quality.DEGRADED
        state = TrackerState(parsed.point, parsed.point is not None, parsed.status, parsed.rotation)
        self.readings.push(Sample(state, t, 0.5 * (end - begin), self._seq, quality))

    def _count_bad(self, line: bytes, reason: BadLine) -> None:
        self._bad += 1
        self._bad_in_a_row += 1
        self._reason = str(reason)
        if self._bad_in_a_row == 1:
            log.warning("%s sent a line that cannot be read, as %s: %r", self.name, reason, line[:80])
        if self._bad_in_a_row >= self._config.lost_after_bad:
            self._lose("PROTOCOL_VIOLATION", f"{self._bad_in_a_row} lines in a row cannot be read; {reason}")

    # -- loss

    def _nothing(self) -> str:
        bad = (
            f"; {self._bad_in_a_row} lines could not be read, as {self._reason}" if self._bad_in_a_row else ""
        )
        return f"no line that can be read came in {self._config.silence_s:g} s{bad}"

    def _lose(self, name: str, what: str) -> None:
        self._life.lose(error(name, f"{self.name} at {self._config.url}: {what}"))
        self._read.set()  # whoever opens need not wait any longer

    def _dropped(self, reason: str) -> None:
        self._lose("DEVICE_LOST", reason)
