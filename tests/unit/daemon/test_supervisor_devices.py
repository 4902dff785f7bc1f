"""How devices come up, go down and come back: identity, back-off, what is logged, and beats meanwhile."""

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import pytest

from cell.devices import DeviceState, Identity
from cell.errors import CellError, error
from daemon.health import Beats
from daemon.supervisor import ExpectedIdentity, SupervisedDevice, Supervisor
from fakes.object import VirtualClock, run_virtual


@dataclass
class Gadget:
    """A device that a test breaks and repairs."""

    clock: VirtualClock
    name: str = "gadget"
    serial: str = "9999001"
    broken: CellError | None = None
    opened_at: list[float] = field(default_factory=list)
    open_now: bool = False
    hang: bool = False
    stale: bool = False

    def __post_init__(self) -> None:
        self._lost = asyncio.Event()
        self.why: Exception = error("DEVICE_LOST", self.name)

    async def open(self) -> None:
        self.opened_at.append(self.clock.now())
        if self.hang:
            await asyncio.Event().wait()
        if self.broken is not None:
            raise error(self.broken.name, self.broken.detail)
        self.open_now = True
        self._lost.clear()

    async def close(self) -> None:
        self.open_now = False

    async def identify(self) -> Identity:
        return Identity("gadget-1", self.serial)

    async def wait_fresh(self, timeout: float) -> None:
        if self.stale:
            await asyncio.sleep(timeout)
            raise error("DEVICE_LOST", f"{self.name} gave no fresh sample")

    async def wait_lost(self) -> Exception:
        await self._lost.wait()
        return self.why

    def health(self) -> dict[str, Any]:
        return {"open": self.open_now}

    def lose(self) -> None:
        self._lost.set()


@dataclass
class Bench:
    gadget: Gadget
    entry: SupervisedDevice
    beats: Beats
    supervisor: Supervisor

    async def until(self, state: DeviceState, limit_s: float = 60.0) -> None:
        async with asyncio.timeout(limit_s):
            while self.entry.state is not state:
                await self.entry.changed.wait()


@asynccontextmanager
async def supervised(expect: ExpectedIdentity | None = None, **gadget_keys: Any) -> AsyncIterator[Bench]:
    clock = VirtualClock()
    gadget, beats = Gadget(clock, **gadget_keys), Beats(clock)
    entry = SupervisedDevice(gadget, expect or ExpectedIdentity(twin=True), clock, beats)
    task = asyncio.create_task(entry.run())
    try:
        yield Bench(gadget, entry, beats, Supervisor([entry]))
    finally:
        task.cancel()
        await asyncio.wait([task])
        assert entry.state is DeviceState.CLOSED
        assert not gadget.open_now
        assert beats.silent() == []


@pytest.fixture
def lines(caplog: pytest.LogCaptureFixture) -> pytest.LogCaptureFixture:
    caplog.set_level(logging.INFO, "cellward.devices")
    return caplog


def test_one_line_tells_of_the_loss_and_one_of_the_recovery_with_the_outage(
    lines: pytest.LogCaptureFixture,
) -> None:
    async def main() -> None:
        async with supervised() as bench:
            await bench.until(DeviceState.READY)
            lines.clear()
            bench.gadget.broken = error("DEVICE_UNREACHABLE", "gadget")
            bench.gadget.lose()
            await asyncio.sleep(12.0)
            assert bench.entry.state is DeviceState.RETRYING
            bench.gadget.broken = None
            await bench.until(DeviceState.READY)
            loss, recovery = lines.records
            assert "A device stopped answering" in loss.getMessage()
            assert "ready after 1" in recovery.getMessage()
            assert "serial 9999001" in recovery.getMessage()
            assert bench.entry.status()["losses"] == 1

    run_virtual(main())


def test_attempts_come_at_growing_intervals_up_to_a_cap_and_never_in_step() -> None:
    async def main() -> None:
        async with supervised(broken=error("DEVICE_UNREACHABLE", "gadget")) as bench:
            await asyncio.sleep(60.0)
            times = bench.gadget.opened_at
            waits = [b - a for a, b in pairwise(times)]
            assert 0.2 <= waits[0] <= 0.31
            late = [
                b - a for a, b in pairwise(times) if a - times[0] > 15.0
            ]  # quick ones for SOON_S come first
            assert len(late) >= 5
            assert all(4.0 <= w <= 6.1 for w in late)
            assert len(set(waits)) == len(waits)

    run_virtual(main())


def test_the_back_off_starts_anew_after_a_recovery() -> None:
    async def main() -> None:
        async with supervised(broken=error("DEVICE_UNREACHABLE", "gadget")) as bench:
            await asyncio.sleep(30.0)
            bench.gadget.broken = None
            await bench.until(DeviceState.READY)
            lost_at = bench.gadget.clock.now()
            bench.gadget.lose()
            await bench.until(DeviceState.RETRYING)
            await bench.until(DeviceState.READY)
            assert bench.gadget.clock.now() - lost_at < 0.4

    run_virtual(main())


@pytest.mark.parametrize(
    ("serial", "twin", "expected", "told"),
    [
        ("9999001", True, "9999002", "has serial 9999001, the config expects 9999002"),
        ("9999001", False, None, "is a twin but the config says twin = false"),
        ("20235500123", True, None, "is real hardware but the config says twin = true"),
    ],
)
def test_a_device_that_is_not_the_one_meant_is_refused_and_said_once(
    serial: str, twin: bool, expected: str | None, told: str, lines: pytest.LogCaptureFixture
) -> None:
    async def main() -> None:
        async with supervised(ExpectedIdentity(twin, expected), serial=serial) as bench:
            await asyncio.sleep(20.0)
            assert bench.entry.state is DeviceState.FAULTED
            assert not bench.gadget.open_now
            with pytest.raises(CellError) as refusal:
                bench.supervisor.ready("gadget")
            assert refusal.value.name == "DEVICE_NOT_READY"
            assert told in refusal.value.detail
            (line,) = lines.records
            assert told in line.getMessage()
            assert len(bench.gadget.opened_at) > 3, "the right device may come back"

    run_virtual(main())


@pytest.mark.parametrize("expected", ["9999001", None])
def test_a_device_that_was_silent_when_it_was_asked_for_its_serial_is_asked_again(
    expected: str | None,
) -> None:
    async def main() -> None:
        async with supervised(ExpectedIdentity(True, expected), serial="") as bench:
            await bench.until(DeviceState.RETRYING)
            assert "told no serial" in str(bench.entry.last_error)
            assert bench.entry.lasting is None, "a run may wait for it"
            bench.gadget.serial = "9999001"
            await bench.until(DeviceState.READY)

    run_virtual(main())


@pytest.mark.parametrize(
    ("expected", "remedy"), [("9999001", "take expect_serial out of [device.gadget]"), (None, "twin = false")]
)
def test_a_device_that_answers_and_goes_on_telling_no_serial_is_refused_with_what_to_change(
    expected: str | None, remedy: str, lines: pytest.LogCaptureFixture
) -> None:
    async def main() -> None:
        async with supervised(ExpectedIdentity(True, expected), serial="") as bench:
            await asyncio.sleep(5.0)
            assert bench.entry.state is DeviceState.RETRYING, "it may have been silent"
            await bench.until(DeviceState.FAULTED)
            lasting = bench.entry.lasting
            assert isinstance(lasting, CellError)
            assert (lasting.name, remedy in lasting.detail) == ("DEVICE_IDENTITY", True)
            assert len(lines.records) == 2, "once as silent, once as refused"
            bench.gadget.serial = "9999001"
            await bench.until(DeviceState.READY)

    run_virtual(main())


def test_a_silence_between_two_answers_without_a_serial_starts_the_wait_for_it_anew() -> None:
    async def main() -> None:
        async with supervised(ExpectedIdentity(True), serial="") as bench:
            for _ in range(3):
                await asyncio.sleep(7.0)
                bench.gadget.broken = error("DEVICE_UNREACHABLE", "gadget")
                await asyncio.sleep(7.0)
                bench.gadget.broken = None
            assert bench.entry.state is DeviceState.RETRYING
            assert bench.entry.lasting is None, "a run may wait for it"

    run_virtual(main())


def test_another_device_in_the_place_of_the_lost_one_is_said_and_the_right_one_recovers(
    lines: pytest.LogCaptureFixture,
) -> None:
    async def main() -> None:
        async with supervised(ExpectedIdentity(True, "9999001")) as bench:
            await bench.until(DeviceState.READY)
            lines.clear()
            bench.gadget.serial = "9999777"
            bench.gadget.lose()
            await asyncio.sleep(10.0)
            assert bench.entry.state is DeviceState.FAULTED
            bench.gadget.serial = "9999001"
            await bench.until(DeviceState.READY)
            loss, stranger, recovery = (r.getMessage() for r in lines.records)
            assert "stopped answering" in loss
            assert "has serial 9999777" in stranger
            assert "ready after" in recovery

    run_virtual(main())


def test_a_device_without_fresh_samples_is_not_ready() -> None:
    async def main() -> None:
        async with supervised(stale=True) as bench:
            await asyncio.sleep(10.0)
            assert bench.entry.state is DeviceState.RETRYING
            bench.gadget.stale = False
            await bench.until(DeviceState.READY)

    run_virtual(main())


@pytest.mark.parametrize("trouble", [{"hang": True}, {"broken": error("DEVICE_UNREACHABLE", "gadget")}, {}])
def test_it_beats_while_it_waits_for_a_device(trouble: dict[str, Any]) -> None:
    async def main() -> None:
        async with supervised(**trouble) as bench:
            for _ in range(200):
                await asyncio.sleep(0.5)
                assert bench.beats.silent() == []
            assert (bench.entry.state is DeviceState.READY) == (not trouble)

    run_virtual(main())


def test_a_job_hears_of_a_loss_even_when_the_device_is_back_at_once() -> None:
    async def main() -> None:
        async with supervised() as bench:
            await bench.until(DeviceState.READY)
            waiting = asyncio.create_task(bench.supervisor.first_loss(["gadget"]))
            await asyncio.sleep(1.0)
            assert not waiting.done()
            bench.gadget.lose()
            async with asyncio.timeout(5.0):
                loss = await waiting
            assert isinstance(loss, CellError)
            assert loss.name == "DEVICE_LOST"

    run_virtual(main())


@pytest.mark.parametrize(
    ("first_try", "passes"),
    [
        (error("CALL_TIMEOUT", "gadget"), True),
        (error("DEVICE_UNREACHABLE", "gadget"), True),
        (error("DEVICE_IDENTITY", "another serial"), False),
    ],
)
def test_who_waits_for_a_lost_device_waits_through_connections_that_fail(
    first_try: CellError, passes: bool
) -> None:
    async def main() -> None:
        async with supervised() as bench:
            await bench.until(DeviceState.READY)
            bench.gadget.broken = first_try
            bench.gadget.lose()
            await bench.until(DeviceState.RETRYING)
            await asyncio.sleep(0.6)  # the first try has failed
            assert len(bench.gadget.opened_at) >= 2
            waiting = asyncio.create_task(bench.supervisor.back(["gadget"]))
            await asyncio.sleep(0.1)
            assert waiting.done() is not passes
            bench.gadget.broken = None
            async with asyncio.timeout(2.0):
                if passes:
                    await waiting
                else:
                    with pytest.raises(CellError, match="another serial"):
                        await waiting

    run_virtual(main())


def test_who_waits_for_a_device_that_was_lost_by_more_than_a_silence_is_told_at_once() -> None:
    async def main() -> None:
        async with supervised() as bench:
            await bench.until(DeviceState.READY)
            bench.gadget.why = error("ARM_REBOOTED", "gadget")
            bench.gadget.lose()
            await bench.until(DeviceState.RETRYING)
            with pytest.raises(CellError) as told:
                await bench.supervisor.back(["gadget"])
            assert told.value.name == "ARM_REBOOTED"

    run_virtual(main())
