"""When frames were on the bus, in CLOCK_MONOTONIC seconds, and how far that can be trusted."""

import time
from collections.abc import Sequence
from itertools import groupby
from typing import NamedTuple, Protocol

import can

from cell.clock import Clock, ClockModel
from drivers.can_bus.address import BusAddress

_KERNEL_DT_S = 50e-6
_KERNEL_SLACK_S = 0.05  # a stamp further outside its bracket is not believed
_GATEWAY_DT_S = 200e-6
_HOST_DT_S = 250e-6  # a USB adapter's frame of 125 us or 1 ms, and the way to us
_FORGET = 0.98  # of the scatter, from one frame to the next


class Stamp(NamedTuple):
    """When a frame was on the bus (s), give or take ``dt``; ``heard`` is late at times and never early."""

    t: float
    dt: float
    heard: float


class Stamps(Protocol):
    """``take`` stamps each message; all arrived between ``looked`` and ``now``."""

    @property
    def refused(self) -> int:
        """Stamps that cannot be true; the time of arrival took their place."""
        ...

    def take(self, messages: Sequence[can.Message], looked: float, now: float) -> list[Stamp]: ...


def stamps_for(address: BusAddress, period_s: float, clock: Clock) -> Stamps:
    """The best that the interface offers."""
    if address.interface == "socketcan":
        return KernelStamps(clock)
    return GatewayStamps() if address.interface == "socketcand" else HostStamps(period_s)


class KernelStamps:
    """The kernel's stamps are CLOCK_REALTIME, which steps; its offset is read at every look."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self.refused = 0

    def take(self, messages: Sequence[can.Message], looked: float, now: float) -> list[Stamp]:
        before = self._clock.now()
        real = time.time()
        after = self._clock.now()
        offset, dt = 0.5 * (before + after) - real, _KERNEL_DT_S + 0.5 * (after - before)
        return [self._checked(m.timestamp + offset, looked, now, dt) for m in messages]

    def _checked(self, t: float, looked: float, now: float, dt: float) -> Stamp:
        if looked - _KERNEL_SLACK_S <= t <= now + dt:
            return Stamp(min(t, now), dt, min(t, now))
        self.refused += 1
        return Stamp(0.5 * (min(looked, now) + now), max(0.5 * (now - looked), dt), now)


class GatewayStamps:
    """Stamps of a gateway with a clock of its own, seen through :class:`~cell.clock.ClockModel`.

    The shortest way through the network cannot be seen from here: it is in ``time_offset_s``.
    """

    def __init__(self) -> None:
        self._clock = ClockModel()
        self._last: float | None = None

    @property
    def refused(self) -> int:
        return self._clock.resets

    def take(self, messages: Sequence[can.Message], looked: float, now: float) -> list[Stamp]:
        found = []
        for message in messages:
            resets = self._clock.resets
            t = self._clock.observe(message.timestamp, now)
            dt = _GATEWAY_DT_S
            if self._clock.resets > resets or self._last is None:
                dt = max(dt, 0.5 * (now - looked))  # nothing but the arrival is known of it
            self._last = message.timestamp
            found.append(Stamp(t, dt, t))
        return found


class HostStamps:
    """Frames that count from their arrival here, which is in their ``timestamp`` where it was seen.

    Several that were found together came one after the other, a period apart. How much arrivals have lately
    scattered about whole periods is what a single one may be wrong by.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._last: float | None = None
        self._scatter = 0.0
        self.refused = 0

    def take(self, messages: Sequence[can.Message], looked: float, now: float) -> list[Stamp]:
        found: list[Stamp] = []
        for arrival, group in groupby(messages, lambda message: message.timestamp or now):
            since = looked if self._last is None else max(looked, self._last)
            found += self._together(len(list(group)), min(since, arrival), arrival)
        return found

    def _together(self, count: int, floor: float, arrival: float) -> list[Stamp]:
        """``count`` frames that were found at ``arrival``, all of them after ``floor``."""
        if self._last is not None:
            whole = max(round((arrival - self._last) / self._period_s), 1)
            off = abs(arrival - self._last - whole * self._period_s)
            self._scatter = max(_FORGET * self._scatter, min(off, self._period_s))
        self._last = arrival
        waited = 0.5 * min(self._period_s, arrival - floor) if count > 1 else 0.0
        dt = _HOST_DT_S + max(self._scatter, waited)
        return [
            Stamp(max(arrival - k * self._period_s, floor), dt, arrival) for k in range(count - 1, -1, -1)
        ]
