"""A CANopen encoder of device profile 406: states, heartbeat, emergencies, two PDOs, and its objects."""

import asyncio
from collections.abc import Callable
from enum import IntEnum
from functools import partial
from math import inf
from typing import Protocol

from fakes.can.bus import CanBus, Frame
from fakes.can.objects import OUT_OF_RANGE, Dictionary, Entry, SdoRefusal, constant
from fakes.can.pdo import Tpdo
from fakes.wire.ticker import Ticker

SYNC_ID, EMERGENCY_ID, REQUEST_ID, REPLY_ID, HEARTBEAT_ID = 0x080, 0x080, 0x600, 0x580, 0x700
POSITION, SPEED = 0x6004_00_20, 0x6030_01_10
_MULTI_TURN = 0x0002_0196
_VENDOR, _PRODUCT, _REVISION = 0x9999, 406, 0x0001_0002
_UNITS_PER_TURN, _LEAST_RANGE = 8192, 16


class Shaft(Protocol):
    """What turns the encoder."""

    modulus: int

    def told(self, t: float) -> float: ...
    def raw(self, t: float) -> int: ...
    def speed(self, t: float) -> float: ...
    def preset(self, t: float, position: int) -> None: ...
    def restart(self, t: float) -> None: ...


class State(IntEnum):
    """As the heartbeat tells it; a node without power says nothing."""

    STARTING = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127
    DEAD = -1


class EncoderNode:
    """Lives on a bus between :meth:`power_on` and :meth:`power_off`; times are those of ``now`` (s)."""

    def __init__(
        self,
        bus: CanBus,
        number: int,
        serial: int,
        shaft: Shaft,
        now: Callable[[], float],
        by_events: bool = False,
    ) -> None:
        self.number, self.serial, self.shaft = number, serial, shaft
        self.by_events, self._told_by_event = by_events, (-1, -inf)
        self.state = State.DEAD
        self.silent = False  # positions are not sent, requests are answered
        self._now, self._send = now, bus.join(self._receive).send
        self._range = shaft.modulus
        self._errors: list[int] = []
        self._tickers: list[Ticker] = []
        self._heartbeat: Ticker | None = None
        self._booting: asyncio.TimerHandle | None = None
        self._default()

    # -- power and state

    def power_on(self) -> None:
        """Start, say so and wait for a master, with all settings as delivered."""
        self.power_off()
        self.shaft.modulus = self._range
        self._default()
        self.state = State.PRE_OPERATIONAL
        self._send(Frame(HEARTBEAT_ID + self.number, bytes([State.STARTING])), self._now())

    def power_off(self) -> None:
        """Say nothing more."""
        self.state = State.DEAD
        if self._booting is not None:
            self._booting.cancel()
            self._booting = None
        self._stop_sending()
        if self._heartbeat is not None:
            self._heartbeat.stop()
            self._heartbeat = None

    def restart(self, boot_s: float = 0.05) -> None:
        """Be dead for ``boot_s``, then start."""
        self.power_off()

        def boot() -> None:
            self._booting = None
            self.shaft.restart(self._now())
            self.power_on()

        self._booting = asyncio.get_running_loop().call_later(boot_s, boot)

    def alarm(self, code: int, register: int) -> None:
        """Report an emergency; code and register 0 take it back."""
        self._register = register
        if code:
            self._errors = [code, *self._errors][:4]
        self._send_alive(
            Frame(EMERGENCY_ID + self.number, code.to_bytes(2, "little") + bytes([register, 0, 0, 0, 0, 0]))
        )

    @property
    def position_id(self) -> int:
        """Identifier of the first PDO's frames."""
        return self._tpdos[0].id

    def _default(self) -> None:
        """Settings as delivered."""
        self._register, self._errors, self._operating = 0, [], 0x0004
        self._heartbeat_ms = self._syncs = 0
        readable = {POSITION: self.shaft.raw, SPEED: lambda t: round(self._limited(self.shaft.speed(t)))}
        self._tpdos = [
            Tpdo(0x180 + self.number, 254, [POSITION], readable),
            Tpdo(0x280 + self.number, 1, [POSITION], readable),
        ]
        self.objects = self._dictionary()
        for tpdo in self._tpdos:
            tpdo.changed = self._set_timers

    # -- the bus

    def _receive(self, frame: Frame, t: float) -> None:
        if self.state is State.DEAD or frame.extended or frame.remote:
            return
        if frame.id == 0 and len(frame.data) == 2 and frame.data[1] in (0, self.number):
            self._command(frame.data[0])
        elif frame.id == SYNC_ID and self.state is State.OPERATIONAL:
            self._syncs += 1
            for tpdo in self._tpdos:
                if tpdo.answers_sync(self._syncs):
                    self._send_position(tpdo, t)
        elif frame.id == REQUEST_ID + self.number and self.state is not State.STOPPED:
            reply = self.objects.serve(frame.data)
            if reply is not None:
                self._send(Frame(REPLY_ID + self.number, reply), self._now())

    def _command(self, command: int) -> None:
        states = {1: State.OPERATIONAL, 2: State.STOPPED, 128: State.PRE_OPERATIONAL}
        if command in (129, 130):
            self.restart()
        elif command in states and states[command] is not self.state:
            self.state = states[command]
            self._set_timers()

    def _send_alive(self, frame: Frame) -> None:
        if self.state is not State.DEAD:
            self._send(frame, self._now())

    def _send_position(self, tpdo: Tpdo, t: float) -> None:
        if not self.silent:
            self._send(Frame(tpdo.id, tpdo.data(self.shaft.told(t))), t)

    def _send_event(self, tpdo: Tpdo, t: float) -> None:
        """A new position or the timer, what comes first; one that would end before the next look ends now."""
        position = self.shaft.raw(t)
        before, at = self._told_by_event
        if position != before or t - at + tpdo.inhibit_s > tpdo.period_s + 1e-6:
            self._told_by_event = position, t
            self._send_position(tpdo, t)

    def _set_timers(self) -> None:
        """Send by the timers that now apply; a change begins them anew."""
        self._stop_sending()
        if self.state is not State.OPERATIONAL:
            return
        for tpdo in self._tpdos:
            if tpdo.period_s and self.by_events:
                self._tickers.append(self._ticking(tpdo.inhibit_s, partial(self._send_event, tpdo)))
            elif tpdo.period_s:
                self._tickers.append(self._ticking(tpdo.period_s, partial(self._send_position, tpdo)))

    def _stop_sending(self) -> None:
        for ticker in self._tickers:
            ticker.stop()
        self._tickers = []

    def _set_heartbeat(self, milliseconds: int) -> None:
        self._heartbeat_ms = milliseconds
        if self._heartbeat is not None:
            self._heartbeat.stop()
            self._heartbeat = None
        if milliseconds:
            self._heartbeat = self._ticking(
                milliseconds / 1000.0,
                lambda t: self._send_alive(Frame(HEARTBEAT_ID + self.number, bytes([self.state]))),
            )

    def _ticking(self, period_s: float, act: Callable[[float], None]) -> Ticker:
        ticker = Ticker(1.0 / period_s, act, self._now)
        ticker.start()
        return ticker

    # -- objects

    def _dictionary(self) -> Dictionary:
        objects = Dictionary()
        objects.add(0x1000, constant(4, _MULTI_TURN))
        objects.add(0x1001, Entry(1, lambda: self._register))
        errors = [Entry(4, partial(self._error, k)) for k in range(4)]
        objects.add(0x1003, Entry(1, lambda: len(self._errors), self._forget_errors), *errors)
        objects.add(0x1005, constant(4, SYNC_ID))
        objects.add(0x1014, constant(4, EMERGENCY_ID + self.number))
        objects.add(0x1017, Entry(2, lambda: self._heartbeat_ms, self._set_heartbeat))
        who = (_VENDOR, _PRODUCT, _REVISION, self.serial)
        objects.add(0x1018, constant(1, 4), *(constant(4, value) for value in who))
        for number, tpdo in enumerate(self._tpdos, 1):
            tpdo.publish(objects, number)
        objects.add(0x6000, Entry(2, lambda: self._operating, self._set_operating))
        objects.add(0x6001, Entry(4, lambda: _UNITS_PER_TURN, self._set_units))
        objects.add(0x6002, Entry(4, lambda: self.shaft.modulus, self._set_range))
        objects.add(0x6003, Entry(4, lambda: 0, self._preset))
        objects.add(0x6004, Entry(4, lambda: self.shaft.raw(self._now())))
        speed = Entry(2, lambda: round(self._limited(self.shaft.speed(self._now()))))
        objects.add(0x6030, constant(1, 1), speed)
        objects.add(0x6200, Entry(2, lambda: self._tpdos[0].timer_ms, self._tpdos[0].set_timer))
        objects.add(0x6500, Entry(2, lambda: self._operating))
        objects.add(0x6501, constant(4, _UNITS_PER_TURN))
        objects.add(0x6502, constant(2, 4096))
        objects.add(0x6503, Entry(2, lambda: int(bool(self._register))))
        objects.add(0x6505, constant(2, 0))
        objects.add(0x650B, constant(4, self.serial))
        return objects

    def _error(self, k: int) -> int:
        return self._errors[k] if k < len(self._errors) else 0

    def _forget_errors(self, value: int) -> None:
        if value:
            raise SdoRefusal(OUT_OF_RANGE)
        self._errors = []

    def _set_operating(self, value: int) -> None:
        # The direction of counting is the world's; scaling cannot be switched off.
        if value != self._operating:
            raise SdoRefusal(OUT_OF_RANGE)

    def _set_units(self, value: int) -> None:
        if value != _UNITS_PER_TURN:
            raise SdoRefusal(OUT_OF_RANGE)

    def _set_range(self, value: int) -> None:
        if value < _LEAST_RANGE:
            raise SdoRefusal(OUT_OF_RANGE)
        self.shaft.modulus = value

    def _preset(self, value: int) -> None:
        if value >= self.shaft.modulus:
            raise SdoRefusal(OUT_OF_RANGE)
        self.shaft.preset(self._now(), value)

    @staticmethod
    def _limited(speed: float) -> float:
        return min(max(speed, -32768.0), 32767.0)
