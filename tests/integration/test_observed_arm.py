"""An observed arm on real sockets: our driver with a foreign server, our fake with foreign clients, both."""

import asyncio
import shutil
import subprocess
import time
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyModbusTCP.client import ModbusClient
from pyModbusTCP.server import DataBank, ModbusServer
from pyModbusTCP.utils import decode_ieee, encode_ieee, long_list_to_word, word_list_to_long

from cell.errors import CellError
from drivers.observed_arm import ObservedArmReader
from tests.kit.observed_rig import CLOCK, HOST, PORT, palletizer, reader

pytestmark = pytest.mark.wire

OTHER = "127.0.43.12"
THERE = np.array([0.2, 1.45, -1.45, 0.1])


async def until(true: Callable[[], bool], what: str, limit_s: float = 20.0) -> None:
    give_up = CLOCK.now() + limit_s
    while not true():
        assert CLOCK.now() < give_up, f"no {what} within {limit_s:g} s"
        await CLOCK.sleep(0.01)


async def refused(work: Awaitable[Any]) -> CellError:
    with pytest.raises(CellError) as caught:
        await work
    return caught.value


# -- our driver on a server that is not ours


@contextmanager
def foreign_controller(writable: bool = True) -> Iterator[DataBank]:
    """Joints as int32 in 0.0001 degrees, low word first, in input registers 100...; no function 43."""

    class Bank(DataBank):
        def on_holding_registers_change(
            self, address: int, from_value: int, to_value: int, srv_info: Any
        ) -> None:
            if not writable and address in (41, 42):
                self.set_holding_registers(address, [from_value])

    bank = Bank()
    server = ModbusServer(OTHER, 5021, no_block=True, data_bank=bank)
    show(bank, [0.0, 90.0])
    bank.set_input_registers(110, [0b100])  # standing
    bank.set_input_registers(120, [0x2A, 0x95])
    server.start()
    try:
        yield bank
    finally:
        server.stop()


def show(bank: DataBank, degrees: list[float]) -> None:
    longs = [round(x * 10000) & 0xFFFFFFFF for x in degrees]
    bank.set_input_registers(100, long_list_to_word(longs, big_endian=False))


JOINT = {"table": "input", "type": "int32", "word_order": "low-first", "unit": "deg", "scale": 0.0001}
FOREIGN: dict[str, Any] = {
    "url": f"tcp://{OTHER}:5021",
    "joints": [{"address": 100, **JOINT}, {"address": 102, **JOINT}],
    "moving": {"table": "input", "address": 110, "bit": 2, "invert": True},
    "handshake": {"targets": [41, 43], "number": 50, "reached": 51},
    "model": "PAL-2",
    "serial": {"table": "input", "address": 120, "count": 2},
}


def test_joints_rest_and_pose_come_from_a_controller_that_is_not_ours() -> None:
    async def scene(bank: DataBank) -> None:
        subject = reader(FOREIGN)
        await subject.open()
        found = await subject.identify()
        assert (found.model, found.serial) == ("PAL-2", str(0x2A << 16 | 0x95))
        await subject.wait_fresh(1.0)
        await until(lambda: subject.joints.latest(1.0).value.at_rest, "rest")
        sample = subject.joints.latest(0.2)
        np.testing.assert_allclose(sample.value.q, [0.0, np.pi / 2])
        assert sample.value.at_pose is None
        assert 0.0 < sample.dt < 0.1
        bank.set_input_registers(110, [0])
        bank.set_holding_registers(51, [7])
        await until(lambda: not subject.joints.latest(1.0).value.at_rest, "motion")
        show(bank, [-12.3456, 45.0])
        bank.set_input_registers(110, [0b100])
        await until(lambda: subject.joints.latest(1.0).value.at_rest, "rest")
        state = subject.joints.latest(0.2).value
        np.testing.assert_allclose(np.degrees(state.q), [-12.3456, 45.0], atol=1e-9)
        assert state.at_pose == 7
        await subject.close()

    with foreign_controller() as bank:
        asyncio.run(scene(bank))


def test_nothing_is_written_without_permission_and_a_request_is_joints_before_number_with_it() -> None:
    async def scene(bank: DataBank) -> None:
        subject = reader(FOREIGN)
        await subject.open()
        assert not await subject.request(3, np.array([0.1, 0.2]))
        assert bank.get_holding_registers(41, 10) == [0] * 10
        await subject.close()

        subject = reader({**FOREIGN, "allow_requests": True})
        await subject.open()
        assert await subject.request(3, np.radians([1.0, -2.0]))
        words = bank.get_holding_registers(41, 10)
        longs = word_list_to_long(words[:4], big_endian=False)
        assert [x - (1 << 32 if x >> 31 else 0) for x in longs] == [10000, -20000]
        assert words[9] == 3
        assert await subject.request(0, np.zeros(2))
        assert bank.get_holding_registers(50, 1) == [0]
        for number, q, why in (
            (70000, [0, 0], "70000"),
            (1, [0.0], "2 joints"),
            (1, [np.nan, 0], "no number"),
        ):
            exc = await refused(subject.request(number, np.array(q, dtype=float)))
            assert exc.name == "ARGUMENT_INVALID"
            assert why in str(exc)
        await subject.close()
        assert (await refused(subject.request(1, np.zeros(2)))).name == "DEVICE_LOST"

    with foreign_controller() as bank:
        asyncio.run(scene(bank))


def test_a_controller_that_does_not_keep_the_joints_is_never_given_their_number() -> None:
    async def scene(bank: DataBank) -> None:
        subject = reader({**FOREIGN, "allow_requests": True})
        await subject.open()
        exc = await refused(subject.request(3, np.radians([1.0, -2.0])))
        assert exc.name == "OBSERVED_REQUEST_LOST"
        assert bank.get_holding_registers(50, 1) == [0]
        assert subject.health()["connected"]
        await subject.close()

    with foreign_controller(writable=False) as bank:
        asyncio.run(scene(bank))


def test_a_place_where_nobody_is_and_a_joint_that_is_no_number_are_refused_at_opening() -> None:
    async def scene(bank: DataBank) -> None:
        nobody = reader({**FOREIGN, "url": f"tcp://{OTHER}:5022"})
        assert (await refused(nobody.open())).name == "DEVICE_UNREACHABLE"
        floats = {**JOINT, "type": "float32", "scale": 1.0}
        bank.set_input_registers(102, [0, 0x7FC0])  # not a number
        subject = reader({**FOREIGN, "joints": [{"address": 100, **floats}, {"address": 102, **floats}]})
        exc = await refused(subject.open())
        assert exc.name == "PROTOCOL_VIOLATION"
        assert "joint 2 at address 102 is no number" in str(exc)

    with foreign_controller() as bank:
        asyncio.run(scene(bank))


# -- the twin's palletizer


@pytest.mark.parametrize(
    "changes",
    [{}, {"number": "int32", "scale": 1e-5, "word_order": "low-first"}, {"unit": "rad"}],
    ids=["float32 deg", "int32", "float32 rad"],
)
def test_the_twins_palletizer_goes_where_it_is_asked_and_the_driver_sees_it(
    tmp_path: Path, changes: dict[str, Any]
) -> None:
    async def scene() -> None:
        async with palletizer(tmp_path, **changes) as (twin, arm, _):
            subject = reader(twin.device())
            await subject.open()
            assert (await subject.identify()).serial == "99995500001"
            assert await subject.request(12, THERE)
            await until(lambda: not subject.joints.latest(1.0).value.at_rest, "departure")
            await until(lambda: subject.joints.latest(1.0).value.at_pose == 12, "arrival")
            await until(lambda: subject.joints.latest(1.0).value.at_rest, "rest")
            q = subject.joints.latest(1.0).value.q
            np.testing.assert_allclose(q, THERE, atol=3e-7)
            np.testing.assert_allclose(q, arm.joints(time.monotonic()), atol=3e-7)
            await subject.close()

    asyncio.run(scene())


def test_a_client_that_is_not_ours_reads_and_asks_the_twins_palletizer(tmp_path: Path) -> None:
    def visit() -> list[float]:
        client = ModbusClient(HOST, PORT, auto_open=True)
        words = client.read_input_registers(0, 8)
        assert words == client.read_holding_registers(0, 8)
        assert client.read_holding_registers(10, 1) == [0]
        longs = [int(np.float32(x).view(np.uint32)) for x in np.degrees(THERE)]
        assert client.write_multiple_registers(20, long_list_to_word(longs))
        assert client.write_single_register(28, 4)
        assert client.read_holding_registers(28, 1) == [4]
        assert not client.write_single_register(0, 4), "its joints are not for writing"
        assert client.last_except == 2
        deadline = time.monotonic() + 20.0
        while client.read_holding_registers(10, 1) != [4]:
            assert time.monotonic() < deadline
            time.sleep(0.02)
        after = client.read_holding_registers(0, 8)
        client.close()
        return [decode_ieee(x) for x in word_list_to_long(after)]

    async def scene() -> None:
        async with palletizer(tmp_path):
            degrees = await asyncio.to_thread(visit)
            np.testing.assert_allclose(np.radians(degrees), THERE, atol=1e-6)

    assert encode_ieee(90.0) == 0x42B40000
    asyncio.run(scene())


@pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll is not installed (apt-get install mbpoll)")
def test_mbpoll_reads_the_joints_of_the_twins_palletizer(tmp_path: Path) -> None:
    def visit() -> list[float]:
        words = ["mbpoll", "-0", "-1", "-q", "-a", "1", "-m", "tcp", "-p", str(PORT), "-B", "-t", "4:float"]
        done = subprocess.run(
            [*words, "-r", "0", "-c", "4", HOST], capture_output=True, text=True, timeout=20, check=True
        )
        return [float(line.split(":")[1]) for line in done.stdout.splitlines() if line.startswith("[")]

    async def scene() -> None:
        async with palletizer(tmp_path):
            np.testing.assert_allclose(await asyncio.to_thread(visit), [0, 90, -90, 0], atol=1e-3)

    asyncio.run(scene())


def test_an_address_that_the_controller_has_not_is_told_with_what_to_compare(tmp_path: Path) -> None:
    async def scene() -> None:
        async with palletizer(tmp_path) as (twin, _, _board):
            section = twin.device()
            subject = reader({**section, "joints": [*section["joints"][:3], {"address": 300}]})
            exc = await refused(subject.open())
            assert exc.name == "MODBUS_REFUSED"
            assert "addresses 0x012C to 0x012D" in str(exc)
            assert "check unit, and table and address of joints, moving and handshake" in str(exc)

    asyncio.run(scene())


def test_a_lost_or_silent_or_restarted_controller_is_told_and_comes_back(tmp_path: Path) -> None:
    async def scene() -> None:
        async with palletizer(tmp_path) as (twin, _, board):
            subject = reader(twin.device(), timeout_s=0.8, lost_after_failures=2)
            for kind in ("drop", "silence", "reboot"):
                await subject.open()
                arguments = {"boot_s": 0.1, "serial": "99995500008"} if kind == "reboot" else {}
                board.inject("palletizer", kind, arguments)
                async with asyncio.timeout(10.0):
                    lost = await subject.wait_lost()
                assert isinstance(lost, CellError)
                assert lost.name == "DEVICE_LOST"
                board.inject("palletizer", "clear", {})
                await subject.close()
            await asyncio.sleep(0.2)
            await subject.open()
            assert (await subject.identify()).serial == "99995500008"
            await subject.close()

    asyncio.run(scene())


def test_a_request_without_an_answer_or_without_a_link_is_told_as_that(tmp_path: Path) -> None:
    async def scene() -> None:
        async with palletizer(tmp_path) as (twin, arm, board):
            subject = reader(twin.device(), timeout_s=0.5, lost_after_failures=20)
            await subject.open()
            board.inject("palletizer", "silence", {})
            unanswered = await refused(subject.request(1, THERE))
            assert unanswered.name == "DEVICE_LOST"
            assert "request of pose 1: no answer in 0.5 s; last received" in unanswered.detail
            board.inject("palletizer", "half-open", {})
            asking = asyncio.ensure_future(subject.request(1, THERE))
            await asyncio.sleep(0.05)
            board.inject("palletizer", "drop", {})
            assert (await refused(asking)).name == "DEVICE_LOST"
            assert arm.track.end_time < time.monotonic(), "it was never told a number with its joints"
            await subject.close()

    asyncio.run(scene())


# -- a file


def test_each_rest_that_the_program_writes_down_is_told_once(tmp_path: Path) -> None:
    async def scene() -> None:
        async with palletizer(tmp_path, by="file") as (twin, arm, _):
            subject = reader(twin.device())
            await subject.open()
            assert (await subject.identify()).serial == "99995500001"
            await subject.wait_fresh(1.0)
            assert subject.joints.last() is None, "rows are events; there was none yet"
            assert not await subject.request(1, THERE)
            begun = time.monotonic()
            arm.go(begun, THERE)
            await until(lambda: subject.joints.received == 1, "a row")
            sample = subject.joints.latest(1.0)
            np.testing.assert_array_equal(sample.value.q, THERE)
            assert sample.value.at_rest
            assert begun < sample.t - sample.dt
            await asyncio.sleep(0.3)
            assert subject.joints.received == 1
            assert (await refused_now(subject)).name == "STALE_DATA"
            await subject.wait_fresh(1.0)
            await subject.close()

    async def refused_now(subject: ObservedArmReader) -> CellError:
        with pytest.raises(CellError) as caught:
            subject.joints.latest(0.2)
        return caught.value

    asyncio.run(scene())


def test_a_file_is_read_again_after_what_an_editor_does_to_it_and_lost_when_its_past_changes(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "joints.csv"
    section = {"url": f"file://{path}", "joints": [{"unit": "deg"}] * 2, "stated_serial": "PAL-7"}

    async def scene() -> None:
        subject = reader(section)
        assert (await refused(subject.open())).name == "DEVICE_UNREACHABLE"
        path.write_text("1,2\n")
        assert (await refused(subject.open())).name == "OBSERVED_FILE_FORMAT"
        path.write_text("q1,q2\n10,20\n")
        await subject.open()
        assert (await subject.identify()).serial == "PAL-7"
        assert subject.health()["rows_before"] == 1
        new = tmp_path / "joints.new"
        new.write_text("q1,q2\n10,20\n3o,40\n30,40\n")
        new.rename(path)
        await until(lambda: subject.joints.received == 1, "the good row")
        np.testing.assert_allclose(np.degrees(subject.joints.latest(1.0).value.q), [30, 40])
        assert subject.health()["rejected"] == 1
        assert "line 3" in subject.health()["last_rejected"]
        assert "'3o' is no number" in caplog.text
        path.write_text("q1,q2\n10,20\n30,40\n")
        async with asyncio.timeout(10.0):
            lost = await subject.wait_lost()
        assert isinstance(lost, CellError)
        assert lost.name == "OBSERVED_FILE_CHANGED"
        epoch = subject.joints.epoch
        await subject.open()
        assert subject.joints.epoch == epoch + 1
        path.unlink()
        async with asyncio.timeout(10.0):
            lost = await subject.wait_lost()
        assert isinstance(lost, CellError)
        assert lost.name == "DEVICE_LOST"
        await subject.close()

    asyncio.run(scene())
