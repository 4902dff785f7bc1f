"""An arm that its own program or an operator moves, as ``cell.devices.ObservedArm``.

**We never move this arm.** Reading its joints is all that happens by default. With ``allow_requests = true``
and a handshake in the config, :meth:`ObservedArmReader.request` writes a pose into registers from which the
arm's *own* program may take it: an offer, not a command. Whether, when, how fast and along which path the arm
goes there is decided by its own controller, its own safety functions and its operator; none of our limits,
boxes or stops applies to it, and taking an offer back does not stop an arm that has set out.
"""

import asyncio
import logging
from math import pi
from typing import Any

import numpy as np

from cell.clock import Clock
from cell.devices import JointState, ObservedArm
from cell.errors import CellError, error
from cell.poses import Array
from cell.samples import Sample, Stream
from drivers.life import SampledDevice
from drivers.modbus.link import NoAnswer
from drivers.modbus.ticker import Ticker
from drivers.observed_arm.config import ObservedArmConfig
from drivers.observed_arm.file import FileSource
from drivers.observed_arm.joint_source import JointSource, ObservedJoints
from drivers.observed_arm.registers import RegisterSource
from drivers.observed_arm.rest import RestWatch

log = logging.getLogger("cellward.devices")

PROBABLY_DEGREES = 4.0 * pi


class ObservedArmReader(SampledDevice):
    """Reconnecting is the supervisor's business: after an error ``close`` and ``open`` again.

    From registers every poll is a sample. From a file every new row is one, with the arm at rest; between
    rows there is none, so the age of the newest tells how long ago the arm was seen.
    """

    Config = ObservedArmConfig
    PLAYS = (ObservedArm,)

    def __init__(self, name: str, config: ObservedArmConfig, clock: Clock) -> None:
        self.axes = len(config.joints)
        self.period_s = None if config.is_file else config.poll_period_s
        self.joints: Stream[JointState] = Stream(name, clock)
        self._looks: Stream[None] = Stream(name, clock, keep=2)
        # A look at a file that found no new row is fresh, too: rows are events.
        super().__init__(name, clock, self._looks)
        self._config = config
        self._rest = RestWatch(config.rest_window_s, config.rest_spread_rad, config.poll_period_s)
        self._source: JointSource | None = None
        self._ticker: Ticker | None = None
        self._failures = self._failures_in_a_row = 0

    # -- Device

    async def open(self) -> None:
        """Connect, ask who it is and look once; ``DEVICE_UNREACHABLE``, ``MODBUS_REFUSED`` or 235x."""
        await self.close()
        self._life.begin()
        self.joints.new_epoch()
        self._looks.new_epoch()
        self._rest.begin()
        self._failures_in_a_row = 0
        self._source = self._new_source()
        try:
            self._identity = await self._source.open()
            await self._first_look(self._source)
        except NoAnswer as exc:
            await self.close()
            raise error("DEVICE_UNREACHABLE", f"{self.name} at {self._config.url}: {exc}") from exc
        except BaseException:
            await self.close()
            raise
        self._ticker = Ticker(self._config.poll_period_s)
        self._ticker.start()
        self._life.keep_going(self._poll_on(self._ticker, self._source), "polling")

    async def close(self) -> None:
        """End polling and the connection."""
        await self._life.end()
        if self._ticker is not None:
            self._ticker.stop()
        source, self._source, self._ticker = self._source, None, None
        if source is not None:
            await source.close()
            await asyncio.sleep(0)  # an aborted transport closes its socket on the loop's next turn

    def health(self) -> dict[str, Any]:
        """Counts, the age of the newest joints (s), the joints, and what the source says of itself."""
        last, look, now = self.joints.last(), self._looks.last(), self._clock.now()
        return {
            "connected": self._life.good,
            "age_s": None if last is None else now - last.t,
            "looked_s": None if look is None else now - look.t,
            "samples": self.joints.received,
            "failures": self._failures,
            "epoch": self.joints.epoch,
            "q": None if last is None else last.value.q.tolist(),
            "at_rest": None if last is None else last.value.at_rest,
            "at_pose": None if last is None else last.value.at_pose,
            "requests": self._config.allow_requests,
            **({} if self._source is None else self._source.health()),
        }

    # -- ObservedArm

    async def request(self, number: int, q: Array) -> bool:
        """Offer pose ``number`` with joints ``q`` (n,), rad or m, to the arm's program; 0 takes it back.

        False, and nothing is written, without a handshake or without ``allow_requests``: a person must move
        the arm then. True says that the offer lies in the registers, not that the arm goes there; watch
        ``joints``. ``OBSERVED_REQUEST_LOST``, ``MODBUS_REFUSED``, ``ARGUMENT_INVALID``; ``DEVICE_LOST``
        without an answer: the program may have taken the offer all the same, so ask again with another
        number, or take it back.
        """
        source = self._opened(self._source)
        try:
            asked = await source.request(number, q)
        except (NoAnswer, CellError) as exc:
            self._life.require()  # a link that ended meanwhile is the reason
            if isinstance(exc, CellError):
                raise
            raise error("DEVICE_LOST", self._silence(f"request of pose {number}: {exc}")) from exc
        if asked:
            log.info("%s: %s", self.name, f"pose {number} is asked for" if number else "nothing is asked for")
        return asked

    # -- looking

    def _new_source(self) -> JointSource:
        if self._config.is_file:
            return FileSource(self.name, self._config, self._clock)
        return RegisterSource(self.name, self._config, self._clock, self._disconnected)

    async def _first_look(self, source: JointSource) -> None:
        for attempt in range(self._config.lost_after_failures):
            try:
                await self._look(source, 0)
                break
            except NoAnswer:
                if attempt + 1 == self._config.lost_after_failures:
                    raise
        if not self._life.good:
            raise NoAnswer("the other end closes the connection")
        last = self.joints.last()
        far = [] if last is None else np.flatnonzero(np.abs(last.value.q) > PROBABLY_DEGREES).tolist()
        for joint in far:
            log.warning("%s: joint %d is beyond two turns; compare its unit and scale", self.name, joint + 1)

    async def _poll_on(self, ticker: Ticker, source: JointSource) -> None:
        while self._life.good:
            tick = await ticker.wait()
            try:
                await self._look(source, tick)
                self._failures_in_a_row = 0
            except NoAnswer as exc:
                self._failed(error("DEVICE_LOST", self._silence(str(exc))))
            except CellError as exc:
                if exc.name not in ("MODBUS_REFUSED", "PROTOCOL_VIOLATION"):
                    self._life.lose(exc)
                    return
                self._failed(exc)

    async def _look(self, source: JointSource, tick: int) -> None:
        begin = self._clock.now()
        found = await source.look(tick)
        end = self._clock.now()
        for seen in found:
            self.joints.push(self._sample(seen))
        self._looks.push(Sample(None, 0.5 * (begin + end), 0.5 * (end - begin), tick))

    def _sample(self, seen: ObservedJoints) -> Sample[JointState]:
        rests = seen.rests
        if rests is None:
            rests = self._rest.take(seen.t, seen.q, seen.moving)
        return Sample(JointState(seen.q, rests, seen.pose), seen.t, seen.dt, seen.seq)

    # -- loss

    def _failed(self, exc: CellError) -> None:
        self._failures += 1
        self._failures_in_a_row += 1
        if self._failures_in_a_row >= self._config.lost_after_failures:
            self._life.lose(exc)

    def _disconnected(self) -> None:
        """The request in flight would wait its timeout for a connection that is gone."""
        failure = error("DEVICE_LOST", self._silence("the other end closed the connection"))
        if self._life.lose(failure):
            self._life.stop_work()

    def _silence(self, what: str) -> str:
        look = self._looks.last()
        heard = "never" if look is None else f"{self._clock.now() - look.t:.3f} s ago"
        return f"{self.name} at {self._config.url}: {what}; last received {heard}"
