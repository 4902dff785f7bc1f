"""A module of digital inputs, polled over Modbus, as ``cell.devices.DigitalInputs``."""

import asyncio
import logging
from typing import Any

from cell.clock import Clock
from cell.devices import DigitalInputs, InputsState
from cell.errors import CellError, error
from cell.samples import Quality, Sample, Stream
from drivers.digital import StuckWatch
from drivers.life import SampledDevice
from drivers.modbus.identify import identify, read_number
from drivers.modbus.link import ModbusLink, NoAnswer
from drivers.modbus.ticker import Ticker
from drivers.modbus_inputs.changes import ChangeCount, CounterJump
from drivers.modbus_inputs.config import InputsConfig
from drivers.modbus_inputs.plan import Reading
from drivers.modbus_inputs.uptime import UptimeWatch

log = logging.getLogger("cellward.devices")

# A counter is believed to stand still after so many rising edges that it did not count.
MOST_UNSEEN = 2


class ModbusInputs(SampledDevice):
    """Reconnecting is the supervisor's business: after an error ``close`` and ``open`` again.

    A sample's number is that of its tick, so ``inputs.gaps`` counts the ticks without a poll, be it because
    the one before took too long or because there was no answer.
    """

    Config = InputsConfig
    PLAYS = (DigitalInputs,)

    def __init__(self, name: str, config: InputsConfig, clock: Clock) -> None:
        self.names = tuple(config.inputs)
        self.inputs: Stream[InputsState] = Stream(name, clock)
        super().__init__(name, clock, self.inputs, config.time_offset_s)
        self._config = config
        self._plan, self._highest_hz = config.plan, config.model.highest_hz
        self._inverted = tuple(c.invert for c in config.inputs.values())
        self._stuck = StuckWatch(name, config.inputs)
        self._link: ModbusLink | None = None
        self._ticker: Ticker | None = None
        self._counts: list[ChangeCount] = []
        self._begun = 0.0  # start of the newest good poll
        self._round_trip_s = 0.0
        self._failures = 0
        self._failures_in_a_row = 0
        self._uptime = UptimeWatch(name)
        self._standing: set[str] = set()

    # -- Device

    async def open(self) -> None:
        """Connect, ask who it is and poll once; ``DEVICE_UNREACHABLE`` or ``MODBUS_REFUSED``."""
        await self.close()
        self._life.begin()
        self.inputs.new_epoch()
        self._uptime.begin()
        self._failures_in_a_row = 0
        self._link = link = ModbusLink(self.name, self._config.link, self._clock, self._disconnected)
        try:
            await link.connect()
            found = await identify(link, self._config.module, self._config.serial)
            if self._identity is not None and self._identity.serial and not found.serial:
                raise NoAnswer(
                    "it told its serial number before, and now does not"
                )  # a question went unheard
            self._identity = found
            await self._first_poll(link)
        except NoAnswer as exc:
            unreachable = self._unreachable(exc)
            await self.close()
            raise unreachable from exc
        except BaseException:
            await self.close()
            raise
        self._ticker = Ticker(self._config.poll_period_s)
        self._ticker.start()
        self._life.keep_going(self._poll_on(self._ticker, link), "polling")

    async def close(self) -> None:
        """End polling and the connection."""
        await self._life.end()
        if self._ticker is not None:
            self._ticker.stop()
        link, self._link, self._ticker = self._link, None, None
        if link is not None:
            await link.close()
            await asyncio.sleep(0)  # an aborted transport closes its socket on the loop's next turn

    def health(self) -> dict[str, Any]:
        """Counts, age and round trip (s), levels, and for how long (s) inputs are stuck."""
        last, now = self.inputs.last(), self._clock.now()
        return {
            "connected": self._life.good,
            "age_s": None if last is None else now - last.t,
            "polls": self.inputs.received,
            "gaps": self.inputs.gaps,
            "failures": self._failures,
            "round_trip_s": self._round_trip_s,
            "epoch": self.inputs.epoch,
            "levels": {} if last is None else dict(zip(self.names, last.value.levels, strict=True)),
            "changes": {} if last is None else dict(zip(self.names, last.value.changes, strict=True)),
            "stuck_s": self._stuck.report(now),
            "counters": self._counters_report(),
        }

    # -- polling

    async def _first_poll(self, link: ModbusLink) -> None:
        for attempt in range(self._config.lost_after_failures):
            try:
                reading, begin = await self._read(link)
            except NoAnswer:
                if attempt + 1 == self._config.lost_after_failures:
                    raise
                continue
            if not self._life.good:
                raise NoAnswer("no second answer")
            end, width = link.received_at, self._plan.width
            counts: tuple[int | None, ...] = reading.counts or (None,) * len(reading.levels)
            pairs = zip(reading.levels, counts, strict=True)
            self._counts = [ChangeCount(level, count, width) for level, count in pairs]
            self._stuck.begin(end, (0,) * len(self.names))
            self._standing.clear()
            self._push(reading, begin, end, 0)
            return

    async def _poll_on(self, ticker: Ticker, link: ModbusLink) -> None:
        while self._life.good:
            tick = await ticker.wait()
            try:
                reading, begin = await self._read(link)
                if not self._life.good:
                    return
                self._take(reading, begin, link.received_at, tick)
                await self._look_at_uptime(link, begin)
            except NoAnswer as exc:
                self._failed(error("DEVICE_LOST", self._silence(str(exc))))
            except CellError as exc:
                if exc.name != "MODBUS_REFUSED":
                    self._life.lose(exc)
                    return
                self._failed(exc)

    async def _read(self, link: ModbusLink) -> tuple[Reading, float]:
        """The levels and counts, and when the first request left: what is read was so after that."""
        first, *more = self._plan.spans
        values = [await link.read(first)]
        begin = link.sent_at
        values += [await link.read(span) for span in more]
        return self._plan.decode(values), begin

    def _take(self, reading: Reading, begin: float, end: float, tick: int) -> None:
        most = self._highest_hz * (end - self._begun) + 2.0
        counts: tuple[int | None, ...] = reading.counts or (None,) * len(reading.levels)
        for name, of, level, count in zip(self.names, self._counts, reading.levels, counts, strict=True):
            try:
                of.take(level, count, most)
            except CounterJump as jump:
                raise error(
                    "MODULE_REBOOTED",
                    f"{self.name}: the counter of {name} went {jump}; its module was restarted, or somebody"
                    " cleared the counter",
                ) from jump
            if of.unseen >= MOST_UNSEEN and name not in self._standing:
                self._standing.add(name)
                log.warning("%s: %s changes, but its counter stands still", self.name, name)
            elif of.unseen == 0:
                self._standing.discard(name)
        self._failures_in_a_row = 0
        self._push(reading, begin, end, tick)

    def _push(self, reading: Reading, begin: float, end: float, tick: int) -> None:
        self._begun, self._round_trip_s = begin, end - begin
        levels = tuple(raw != inv for raw, inv in zip(reading.levels, self._inverted, strict=True))
        changes = tuple(of.changes for of in self._counts)
        stuck = self._stuck.take(end, levels, changes)
        quality = Quality.DEGRADED if stuck or self._standing else Quality.GOOD
        t = 0.5 * (begin + end) - self._config.time_offset_s
        self.inputs.push(Sample(InputsState(levels, changes), t, 0.5 * (end - begin), tick, quality))

    async def _look_at_uptime(self, link: ModbusLink, now: float) -> None:
        place = self._config.uptime
        if place is not None and self._uptime.due(now):
            self._uptime.take(now, await read_number(link, place))

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

    def _unreachable(self, exc: NoAnswer) -> CellError:
        what = f"unit {self._config.unit} gives {exc}"
        if not self._life.good:
            what = "the other end closes the connection"
            if self._config.link.address.scheme == "tls" and self._config.tls_certificate is None:
                what += "; it may want a certificate of ours (tls_certificate, tls_key)"
        return error("DEVICE_UNREACHABLE", f"{self.name} at {self._config.url} connects, but {what}")

    def _silence(self, what: str) -> str:
        last = self.inputs.last()
        head = f"{self.name} at {self._config.url}: {what}"
        if last is None:
            return f"{head}; nothing was received on this connection"
        levels = ", ".join(
            f"{name} {'on' if level else 'off'}"
            for name, level in zip(self.names, last.value.levels, strict=True)
        )
        return f"{head}; last received {self._clock.now() - last.t:.3f} s ago: {levels}"

    def _counters_report(self) -> str:
        if not self._plan.width:
            return "none"
        return f"not counting: {', '.join(sorted(self._standing))}" if self._standing else "ok"
