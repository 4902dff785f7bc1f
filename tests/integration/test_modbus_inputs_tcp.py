"""The driver for input modules against pymodbus' own server and pyModbusTCP's, over TCP."""

import asyncio
import contextlib
import time
from collections import Counter
from itertools import pairwise
from typing import Any

import pytest
from pymodbus.constants import ExcCodes

from cell.errors import CellError
from cell.inputs import edges
from cell.samples import Quality
from drivers.modbus.link import ModbusLink
from drivers.modbus.registers import Span
from drivers.modbus_inputs import ModbusInputs
from drivers.modbus_inputs import uptime as uptime_watch
from tests.integration.modbus_inputs_rig import HOST, Board, make, newest, opened, pymodbus_server

pytestmark = pytest.mark.wire


GENERIC: dict[str, Any] = {"counters": {"address": 40, "word_order": "low-first"}}
WORDS: dict[str, Any] = {
    "levels": {"table": "holding", "address": 5},
    "counters": {"table": "holding", "address": 6, "width": 16},
}


@pytest.mark.parametrize(
    ("make_of", "keys", "functions", "counted"),
    [
        ("ioLogik-E1210", {}, {4}, True),
        ("ADAM-6050", {}, {3, 1}, True),
        ("WAGO-750", {}, {2}, False),
        ("generic", {}, {2}, False),
        ("generic", GENERIC, {4, 2}, True),
        ("generic", WORDS, {3}, True),
    ],
)
def test_each_make_is_read_where_its_manual_has_levels_and_counters(
    make_of: str, keys: dict[str, Any], functions: set[int], counted: bool
) -> None:
    async def scene() -> None:
        board = Board(make_of, levels=[True, False], counts=[65535, 7])
        async with pymodbus_server(board) as url, opened(url, module=make_of, **keys) as subject:
            first = (await newest(subject)).value
            assert first.levels == (True, False)
            assert first.changes == (0, 0)
            board.levels, board.counts = [True, True], [65537, 8]
            second = (await newest(subject)).value
            assert second.levels == (True, True)
            assert second.changes == ((4, 1) if counted else (0, 1))
            assert {function for _, function, _, _ in board.asked} == functions
            assert subject.health()["counters"] == ("ok" if counted else "none")

    asyncio.run(scene())


async def polled_more_than(polls: int, subject: ModbusInputs) -> None:
    """However long a machine that pauses takes."""
    async with asyncio.timeout(10.0):
        while subject.inputs.received <= polls:  # noqa: ASYNC110 -- nothing tells
            await asyncio.sleep(0.02)


def test_an_iologik_answers_a_poll_with_one_request_of_33_registers() -> None:
    async def scene() -> None:
        board = Board()
        async with pymodbus_server(board) as url, opened(url, module=board.make) as subject:
            await polled_more_than(10, subject)
            polls = subject.inputs.received
        assert {entry[1:] for entry in board.asked} == {(4, 0x10, 33)}
        assert polls <= len(board.asked) <= polls + 1

    asyncio.run(scene())


def test_a_pulse_of_4_ms_every_37_ms_is_never_missed_with_counters_and_often_without() -> None:
    width, period, periods_s = 0.004, 0.037, (0.002, 0.005, 0.01, 0.02, 0.05)
    start = time.monotonic()

    def look(board: Board) -> None:
        t = time.monotonic() - start
        turns = int(t / period)
        board.levels[0] = t - turns * period < width
        board.counts[0] = turns + 1

    async def scene() -> None:
        board = Board(look=look)
        async with pymodbus_server(board) as url:
            subjects = {
                (poll_s, counters): make(url, module=board.make, poll_period_s=poll_s, use_counters=counters)
                for poll_s in periods_s
                for counters in (True, False)
            }
            await asyncio.gather(*(subject.open() for subject in subjects.values()))
            await asyncio.sleep(1.4)
            await asyncio.gather(*(subject.close() for subject in subjects.values()))
        for (poll_s, counters), subject in subjects.items():
            polls = subject.inputs.between(0.0, time.monotonic())
            found = [edge.t for edge in edges(polls, 0) if edge.rising]
            first, last = polls[0], polls[-1]
            lowest, highest = (int((t - start) / period) for t in (first.t + first.dt, last.t - last.dt))
            true = highest - lowest
            if counters:
                assert true <= len(found) <= true + 2, (poll_s, true, len(found))
                for edge in edges(polls, 0):
                    if edge.rising:
                        inside = [
                            n
                            for n in range(lowest, highest + 3)
                            if abs(start + n * period - edge.t) <= edge.dt + 1e-9
                        ]
                        assert inside, f"no pulse within the bracket of an edge at {poll_s} s"
            elif poll_s >= 0.01:
                assert len(found) < 0.8 * true, (poll_s, true, len(found))

    asyncio.run(scene())


def test_a_stamp_and_its_half_width_enclose_the_instant_at_which_the_module_looked() -> None:
    async def scene() -> None:
        board = Board(delay_s=0.002)
        async with (
            pymodbus_server(board) as url,
            opened(url, module=board.make, time_offset_s=0.03, poll_period_s=0.01) as subject,
        ):
            await polled_more_than(10, subject)
            polls = subject.inputs.between(0.0, time.monotonic())
        looks = [t for t, *_ in board.asked]
        assert len(polls) > 10
        for poll in polls:
            middle = poll.t + 0.03
            enclosed = [look for look in looks if abs(look - middle) <= poll.dt]
            assert len(enclosed) == 1, "not those of its neighbours: no wider than from request to reply"
            assert poll.dt >= 0.001
        assert all(a.t < b.t and a.seq < b.seq for a, b in pairwise(polls))

    asyncio.run(scene())


@pytest.mark.parametrize("offset_s", [-0.1, 0.1])
def test_a_fresh_poll_is_one_made_after_the_call_whatever_the_offset_of_the_stamps(offset_s: float) -> None:
    async def scene() -> None:
        board = Board()
        async with (
            pymodbus_server(board) as url,
            opened(url, module=board.make, time_offset_s=offset_s, poll_period_s=0.02) as subject,
        ):
            for level in (True, False, True):
                board.levels[0] = level
                await subject.wait_fresh(1.0)
                assert subject.inputs.latest(1.0).value.levels[0] == level

    asyncio.run(scene())


def test_ticks_during_a_slow_reply_are_gaps_and_not_made_up_for() -> None:
    async def scene() -> None:
        board = Board(delay_s=0.012)
        async with pymodbus_server(board) as url, opened(url, module=board.make) as subject:
            await asyncio.sleep(0.3)
            gaps = subject.inputs.gaps
            polls = subject.inputs.between(0.0, time.monotonic())
            steps = Counter(
                b.seq - a.seq for a, b in pairwise(polls[1:])
            )  # the first is before the first tick
            assert set(steps) <= set(range(2, 30)), steps
            assert gaps == polls[-1].seq - polls[0].seq + 1 - len(polls)
            assert gaps >= 2 * (len(polls) - 3)

    asyncio.run(scene())


def test_a_stuck_input_degrades_the_samples_and_shows_in_health() -> None:
    async def scene() -> None:
        board = Board(levels=[True, False])
        inputs = {"xs": {"address": 0, "stuck_on_s": 0.05}, "ys": {"address": 1, "invert": True}}
        async with pymodbus_server(board) as url, opened(url, module=board.make, inputs=inputs) as subject:
            assert (await newest(subject)).quality is Quality.GOOD
            assert (await newest(subject)).value.levels == (True, True)
            await asyncio.sleep(0.08)
            assert (await newest(subject)).quality is Quality.DEGRADED
            assert subject.health()["stuck_s"]["xs"] > 0.05
            board.levels[0] = False
            assert (await newest(subject)).quality is Quality.GOOD
            assert subject.health()["stuck_s"] == {}

    asyncio.run(scene())


def test_a_counter_that_stands_still_while_its_input_changes_is_told() -> None:
    async def scene() -> None:
        board = Board()
        async with pymodbus_server(board) as url, opened(url, module=board.make) as subject:
            for level in (True, False, True, False, True):
                board.levels[0] = level
                await newest(subject)
            seen = await newest(subject)
            assert seen.value.changes[0] == 5
            assert seen.quality is Quality.DEGRADED
            assert subject.health()["counters"] == "not counting: xs"
            board.levels[0], board.counts[0] = True, 1
            assert (await newest(subject)).quality is Quality.GOOD

    asyncio.run(scene())


# -- what goes wrong


def failure_of(url: str, **keys: Any) -> CellError:
    """The error with which the driver does not open; nothing may be left behind."""

    async def scene() -> CellError:
        subject = make(url, **keys)
        with pytest.raises(CellError) as caught:
            await subject.open()
        assert not subject.health()["connected"]
        return caught.value

    return asyncio.run(scene())


def test_a_closed_port_is_unreachable_and_the_reason_is_told() -> None:
    found = failure_of(f"tcp://{HOST}:15099")
    assert found.name == "DEVICE_UNREACHABLE"
    assert f"beams at tcp://{HOST}:15099: " in str(found)
    assert "refused" in str(found) or "Connect call failed" in str(found)


def test_addresses_that_a_module_does_not_have_are_told_with_function_and_remedy() -> None:
    async def scene() -> CellError:
        async with pymodbus_server(Board("generic")) as url:
            subject = make(url, levels={"table": "input", "address": 500})
            with pytest.raises(CellError) as caught:
                await subject.open()
            return caught.value

    found = asyncio.run(scene())
    assert found.name == "MODBUS_REFUSED"
    assert "exception 2 to function 4, addresses 0x01F4 to 0x01F4" in str(found)
    assert "check module and the addresses of the inputs" in str(found)


def test_a_module_that_takes_connections_and_answers_nothing_is_unreachable() -> None:
    async def scene() -> None:
        async def listen(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await reader.read()
            writer.close()

        server = await asyncio.start_server(listen, HOST, 0)
        url = "tcp://{}:{}".format(*server.sockets[0].getsockname())
        subject, begun = make(url, unit=9, timeout_s=0.05), time.monotonic()
        with pytest.raises(CellError, match=r"connects, but unit 9 gives no answer in 0\.05 s") as caught:
            await subject.open()
        assert caught.value.name == "DEVICE_UNREACHABLE"
        assert time.monotonic() - begun < 1.0
        server.close()
        await asyncio.sleep(0.02)

    asyncio.run(scene())


def test_three_polls_without_an_answer_lose_the_device_and_say_what_was_heard_last() -> None:
    async def scene() -> None:
        board = Board(levels=[True, False])
        connections: list[bool] = []
        async with (
            pymodbus_server(board, connections=connections) as url,
            opened(url, module=board.make, timeout_s=0.05) as subject,
        ):
            await newest(subject)
            board.mute, begun = True, time.monotonic()
            async with asyncio.timeout(2.0):
                lost = await subject.wait_lost()
            assert 0.14 < time.monotonic() - begun < 0.6
            assert isinstance(lost, CellError)
            assert lost.name == "DEVICE_LOST"
            assert "no answer in 0.05 s; last received 0." in str(lost)
            assert str(lost).endswith("s ago: xs on, ys off")
            with pytest.raises(CellError, match="too old"):
                subject.inputs.latest(0.1)
            with pytest.raises(CellError, match="last received"):
                await subject.wait_fresh(0.1)
            with pytest.raises(CellError, match="last received"):
                await subject.identify()
            assert subject.health()["failures"] == 3
            await asyncio.sleep(0.2)
            assert connections.count(True) == 1, "reconnecting is the supervisor's business"

    asyncio.run(scene())


def test_one_reply_that_fails_is_a_gap_and_no_loss() -> None:
    async def scene() -> None:
        board = Board()
        async with pymodbus_server(board) as url, opened(url, module=board.make) as subject:
            await newest(subject)
            before = subject.inputs.gaps
            refused = len(board.asked) + 2

            def refuse_twice(board: Board) -> None:
                board.refusal = ExcCodes.DEVICE_BUSY if len(board.asked) <= refused else None

            board.look = refuse_twice
            await asyncio.sleep(0.1)
            await newest(subject)
            assert subject.health()["failures"] == 2
            assert subject.inputs.gaps >= before + 2

    asyncio.run(scene())


def test_a_module_that_goes_on_refusing_is_lost_with_its_exception() -> None:
    async def scene() -> None:
        board = Board()
        async with pymodbus_server(board) as url, opened(url, module=board.make) as subject:
            board.refusal = ExcCodes.DEVICE_BUSY
            async with asyncio.timeout(2.0):
                lost = await subject.wait_lost()
            assert isinstance(lost, CellError)
            assert lost.name == "MODBUS_REFUSED"
            assert "exception 6" in str(lost)

    asyncio.run(scene())


def test_a_connection_that_the_module_closes_is_lost_at_once_though_a_request_is_in_flight() -> None:
    async def scene() -> None:
        async def take(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            count = 0
            while request := await reader.read(1024):
                count += 1
                if count == 5:
                    told.set_result(time.monotonic())
                    writer.close()
                    return
                unit, function = request[6], request[7]
                body = bytes([unit, 0xAB, 1]) if function == 43 else bytes([unit, 2, 1, 0b01])
                writer.write(request[:4] + len(body).to_bytes(2, "big") + body)

        told: asyncio.Future[float] = asyncio.get_running_loop().create_future()
        server = await asyncio.start_server(take, HOST, 0)
        async with opened("tcp://{}:{}".format(*server.sockets[0].getsockname())) as subject:
            async with asyncio.timeout(2.0):
                lost = await subject.wait_lost()
            assert time.monotonic() - told.result() < 0.04, "it waited for the reply"
            assert "the other end closed the connection; last received" in str(lost)
        server.close()

    asyncio.run(scene())


def test_a_reply_that_comes_with_the_end_of_polling_does_not_hold_it_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def swallow(self: ModbusLink, span: Span) -> list[int]:
        """What asyncio.wait_for does before Python 3.12 when reply and cancellation meet."""
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.sleep(3600.0)
        return [0] * span.count

    async def scene() -> None:
        async with pymodbus_server(Board()) as url, opened(url, module="ioLogik-E1210") as subject:
            monkeypatch.setattr(ModbusLink, "read", swallow)
            await asyncio.sleep(0.02)
            before = subject.inputs.received
            async with asyncio.timeout(1.0):
                await subject.close()
            assert subject.inputs.received == before

    asyncio.run(scene())


def test_a_counter_that_begins_again_is_a_reboot_and_the_next_opening_a_new_epoch() -> None:
    async def scene() -> None:
        board = Board(counts=[70000, 5])
        async with pymodbus_server(board) as url, opened(url, module=board.make) as subject:
            board.counts = [70001, 5]
            assert (await newest(subject)).value.changes == (2, 0)
            epoch = subject.inputs.epoch
            board.counts = [2, 0]
            async with asyncio.timeout(2.0):
                lost = await subject.wait_lost()
            assert isinstance(lost, CellError)
            assert lost.name == "MODULE_REBOOTED"
            assert "the counter of xs went from 70001 to 2" in str(lost)
            last = subject.inputs.last()
            assert last is not None
            assert last.value.changes == (2, 0), "no sample of the poll that showed it"
            await subject.close()
            await subject.open()
            assert subject.inputs.epoch > epoch
            assert (await newest(subject)).value.changes == (0, 0)

    asyncio.run(scene())


def test_an_uptime_that_falls_is_a_reboot(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(uptime_watch, "LOOK_EVERY_S", 0.02)

    async def scene() -> None:
        board = Board("generic")
        uptime = {"table": "input", "address": 60}
        async with pymodbus_server(board) as url, opened(url, uptime=uptime) as subject:
            await asyncio.sleep(0.05)
            board.uptime = 1001
            await asyncio.sleep(0.05)
            assert subject.health()["connected"]
            board.uptime = 3
            async with asyncio.timeout(2.0):
                lost = await subject.wait_lost()
            assert "uptime went from 1001 to 3" in str(lost)
            asked = Counter(address for _, _, address, _ in board.asked)
            assert 2 <= asked[60] < asked[0]

    asyncio.run(scene())


def test_an_uptime_that_stands_still_is_a_module_that_repeats_old_values(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(uptime_watch, "LOOK_EVERY_S", 0.02)
    monkeypatch.setattr(uptime_watch, "FROZEN_AFTER_S", 0.2)

    async def scene() -> None:
        uptime = {"table": "input", "address": 60}
        async with pymodbus_server(Board("generic")) as url, opened(url, uptime=uptime) as subject:
            async with asyncio.timeout(2.0):
                lost = await subject.wait_lost()
            assert (lost.name, "uptime stands at 1000" in str(lost)) == ("MODULE_FROZEN", True)

    asyncio.run(scene())
