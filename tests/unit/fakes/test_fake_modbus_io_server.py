"""The fake input module on raw sockets: nothing that a client sends may stop it or disturb another client."""

import asyncio
import time
from collections.abc import Awaitable, Callable
from itertools import pairwise

import pytest

from fakes.modbus_io import ModuleWires, Pace, TcpPlace, tcp
from tests.kit.modbus_io_rig import HOST, Pulses, RawClient, Rig, Steady, deaf_socket, mbap, rig

pytestmark = pytest.mark.wire
LEVELS, ANSWER = "0200000003", "020105"
Script = Callable[[Rig, RawClient], Awaitable[None]]


def talk(script: Script, inputs: Pulses | Steady | None = None, pace: Pace | None = None) -> None:
    """Run ``script`` with a module and one client of it."""

    async def scene() -> None:
        async with (
            rig(inputs=inputs, pace=pace or Pace(0.0, 0.0)) as subject,
            await RawClient.open(subject.address) as client,
        ):
            await script(subject, client)

    asyncio.run(scene())


@pytest.mark.parametrize("count", [1, 2, 20, 1000])
def test_pipelined_requests_in_one_segment_are_all_answered_in_order(count: int) -> None:
    async def script(subject: Rig, client: RawClient) -> None:
        client.writer.write(b"".join(mbap(i, LEVELS) for i in range(count)))
        assert [await client.reply() for _ in range(count)] == [(i, 1, ANSWER) for i in range(count)]

    talk(script)


def test_a_flood_of_requests_leaves_other_clients_their_turn() -> None:
    """What comes in one segment is answered one a turn: another client waits for a few, not for all."""

    async def script(subject: Rig, client: RawClient) -> None:
        answered, reply = 0, subject.wires.service.reply

        def counted(request: bytes) -> bytes:
            nonlocal answered
            answered += 1
            return reply(request)

        subject.wires.service.reply = counted  # type: ignore[method-assign]
        async with await RawClient.open(subject.address) as other:
            await other.ask(LEVELS)
            client.writer.write(b"".join(mbap(i, LEVELS) for i in range(5000)))
            await client.reply()
            assert await other.ask(LEVELS) == ANSWER
            assert answered < 200
            assert [(await client.reply())[0] for _ in range(1, 5000)] == list(range(1, 5000))

    talk(script)


def test_a_request_in_single_bytes_is_answered() -> None:
    async def script(subject: Rig, client: RawClient) -> None:
        for byte in mbap(7, LEVELS):
            client.writer.write(bytes([byte]))
            await asyncio.sleep(0.001)
        assert await client.reply() == (7, 1, ANSWER)

    talk(script)


def test_any_unit_is_answered_with_itself() -> None:
    async def script(subject: Rig, client: RawClient) -> None:
        for unit in (0, 1, 17, 247, 255):
            client.put(LEVELS, unit)
            assert (await client.reply())[1:] == (unit, ANSWER)

    talk(script)


@pytest.mark.parametrize("garbage", [b"\xff" * 50, b"GET / HTTP/1.1\r\n\r\n", b"\0" * 16, bytes(range(256))])
def test_garbage_closes_its_own_connection_and_nothing_else(garbage: bytes) -> None:
    async def script(subject: Rig, client: RawClient) -> None:
        assert await client.ask(LEVELS) == ANSWER
        async with await RawClient.open(subject.address) as vandal:
            vandal.writer.write(mbap(1, LEVELS) + garbage)
            assert await vandal.reply() == (1, 1, ANSWER), "what came before it is answered"
            assert await vandal.ended() == "FIN"
        assert await client.ask(LEVELS) == ANSWER
        assert len(subject.wires.connections) == 1

    talk(script)


def test_200_idle_connections_disturb_nobody() -> None:
    async def script(subject: Rig, client: RawClient) -> None:
        idle = [await RawClient.open(subject.address) for _ in range(200)]
        assert await client.ask(LEVELS) == ANSWER
        async with await RawClient.open(subject.address) as late:
            assert await late.ask(LEVELS) == ANSWER
        assert await idle[0].ask(LEVELS) == ANSWER
        for one in idle:
            await one.close()

    talk(script)


def test_when_there_are_too_many_connections_the_one_silent_longest_goes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(tcp, "MOST_CONNECTIONS", 3)

    async def script(subject: Rig, client: RawClient) -> None:
        first = await RawClient.open(subject.address)
        second = await RawClient.open(subject.address)
        assert await client.ask(LEVELS) == ANSWER
        async with await RawClient.open(subject.address) as third:
            assert await third.ask(LEVELS) == ANSWER
            assert await first.ended() == "FIN"
            assert await client.ask(LEVELS) == await second.ask(LEVELS) == ANSWER
        await first.close()
        await second.close()

    talk(script)


def test_a_client_that_reads_nothing_is_cut_off_and_the_others_are_served() -> None:
    async def script(subject: Rig, client: RawClient) -> None:
        deaf = deaf_socket(subject.address)
        flood = b"".join(mbap(i, "0400000020") for i in range(2000))
        try:
            async with asyncio.timeout(30.0):
                assert await client.ask(LEVELS) == ANSWER
                assert len(subject.wires.connections) == 2
                while len(subject.wires.connections) == 2:
                    try:
                        deaf.send(flood)
                    except (BlockingIOError, ConnectionError):
                        await asyncio.sleep(0.001)
                    assert await client.ask(LEVELS) == ANSWER
        finally:
            deaf.close()
        assert await client.ask(LEVELS) == ANSWER

    talk(script)


def test_a_defect_of_the_physics_is_exception_4_and_not_a_dead_connection(
    caplog: pytest.LogCaptureFixture,
) -> None:
    inputs = Steady()

    async def script(subject: Rig, client: RawClient) -> None:
        inputs.levels = lambda t: 1 / 0  # type: ignore[assignment, return-value]
        assert await client.ask(LEVELS) == "8204"
        del inputs.levels
        assert await client.ask(LEVELS) == ANSWER

    talk(script, inputs)
    assert "ZeroDivisionError" in caplog.text


def test_a_request_waits_for_the_delay_of_the_module() -> None:
    async def script(subject: Rig, client: RawClient) -> None:
        took = []
        for _ in range(20):
            begun = time.monotonic()
            await client.ask(LEVELS)
            took.append(time.monotonic() - begun)
        assert min(took) >= 0.004
        assert max(took) - min(took) > 0.001, "the delay jitters"

    talk(script, pace=Pace(0.004, 0.004))


@pytest.mark.parametrize("period", [0.002, 0.005, 0.02, 0.05])
def test_a_4_ms_pulse_every_37_ms_is_in_the_counter_at_any_poll_period(period: float) -> None:
    """Every poll has the count of its instant; levels alone miss pulses when the polls are slow."""
    pulses, polls = Pulses(), []

    async def scene() -> None:
        async with (
            asyncio.timeout(20.0),
            rig("ioLogik-E1210", pulses, Pace(0.001, 0.001)) as subject,
            await RawClient.open(subject.address) as client,
        ):
            while len(polls) < 2 or polls[-1][0] - polls[0][0] < 12:
                low = pulses.counts(time.monotonic())[0]
                image = bytes.fromhex((await client.ask("0400100021"))[4:])
                high = pulses.counts(time.monotonic())[0]
                count = int.from_bytes(image[:4])
                assert low <= count <= high
                polls.append((count, image[-1] & 1))
                await asyncio.sleep(period)

    asyncio.run(scene())
    pulses_there = polls[-1][0] - polls[0][0]
    if period > 0.5 * pulses.period:  # more often, and the polls may fall into step with the pulses
        seen = sum(now and not before for (_, before), (_, now) in pairwise(polls))
        assert seen < pulses_there, "levels polled this slowly show every pulse; the test shows nothing"


def test_level_and_counter_of_one_read_are_of_one_instant() -> None:
    """Input 0 and its opposite: at one instant exactly one is on, and their counts say which."""
    pulses = Pulses(period=0.002, width=0.001)

    async def scene() -> None:
        async with rig("ioLogik-E1210", pulses) as subject, await RawClient.open(subject.address) as client:
            for _ in range(300):
                image = bytes.fromhex((await client.ask("0400100021"))[4:])
                a, b = int.from_bytes(image[:4]), int.from_bytes(image[4:8])
                levels = int.from_bytes(image[-2:])
                assert (levels, a - b) in ((0b01, 1), (0b10, 0))

    asyncio.run(scene())


def test_an_address_that_is_taken_leaves_nothing_open() -> None:
    async def scene() -> None:
        async with rig() as subject:
            second = ModuleWires(
                subject.wires.service.module, (TcpPlace(HOST, 0), TcpPlace(*subject.address))
            )
            with pytest.raises(OSError, match="in use"):
                await second.start()
            free = second.addresses[0]
            with pytest.raises(ConnectionRefusedError):
                await RawClient.open(free)

    asyncio.run(scene())
