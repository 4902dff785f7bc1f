"""Grippers with a link of their own on real sockets and lines, beside clients and a server that are not ours.

pyRobotiqUR (the URCap's socket), pyrobotiqgripper (Modbus RTU) and pymodbus' own server are by other people.
"""

import asyncio
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from cell.clock import MonotonicClock
from cell.devices import Gripper
from cell.errors import CellError
from cell.wire_recording.reader import read_recording
from cell.wire_recording.tap import recorded_by
from cell.wire_recording.writer import WireRecorder
from drivers.grippers import ModbusGripper, RobotiqGripper
from drivers.grippers.polled import PolledGripper
from fakes.faults.vocabulary import Fault
from fakes.twin.gripper import TwinGripper
from fakes.world.belt.gripper import Gripper as WorldGripper
from fakes.world.belt.item_truth import GripperTruth
from fakes.world.scenario import FakeAddresses
from tests.kit.one_item import POINT, Thing

pytestmark = pytest.mark.wire
HOST = "127.0.22.1"
KINDS = ("modbus", "robotiq-rtu", "robotiq-urcap")
DRIVERS: dict[str, Any] = {"modbus-gripper": ModbusGripper, "robotiq": RobotiqGripper}


@asynccontextmanager
async def twin(by: str, folder: Path, there: bool = True) -> AsyncIterator[TwinGripper]:
    world = WorldGripper(GripperTruth(close_s=0.15, open_s=0.1), Thing(there), lambda t: POINT)
    made = TwinGripper(world, FakeAddresses(gripper_by=by, gripper_port=5504), HOST, folder)  # type: ignore[arg-type]
    await made.start()
    try:
        yield made
    finally:
        await made.stop()


@asynccontextmanager
async def opened(table: dict[str, Any], **keys: Any) -> AsyncIterator[Any]:
    driver = DRIVERS[table["driver"]]
    patient = {"timeout_s": 1.0}  # a machine that pauses is not what these tests are about
    config = {key: value for key, value in (patient | table | keys).items() if key != "driver"}
    subject = driver("gripper", driver.Config(**config), MonotonicClock())
    await subject.open()
    try:
        yield subject
    finally:
        await subject.close()


def play(work: Callable[[], Awaitable[None]]) -> None:
    asyncio.run(asyncio.wait_for(work(), 30.0))  # type: ignore[arg-type]


@pytest.mark.parametrize("by", KINDS)
def test_it_takes_and_lets_go_and_says_what_it_holds(by: str, tmp_path: Path) -> None:
    async def work() -> None:
        async with twin(by, tmp_path) as made, opened(made.device()) as subject:
            assert isinstance(subject, PolledGripper)
            device: Gripper = subject
            assert not device.holding(1.0)
            assert await device.grip(3.0)
            assert device.holding(0.5)
            assert subject.health()["closed"]
            assert await device.release(3.0)
            assert not device.holding(0.5)
            assert (await device.identify()).is_twin

    play(work)


@pytest.mark.parametrize("by", KINDS)
def test_fingers_that_close_on_nothing_hold_nothing(by: str, tmp_path: Path) -> None:
    async def work() -> None:
        async with twin(by, tmp_path, there=False) as made, opened(made.device()) as subject:
            assert not await subject.grip(2.0)
            assert not subject.holding(0.5)

    play(work)


@pytest.mark.parametrize("by", KINDS)
def test_a_gripper_that_falls_silent_is_lost(by: str, tmp_path: Path) -> None:
    async def work() -> None:
        async with twin(by, tmp_path) as made, opened(made.device(), timeout_s=0.1) as subject:
            made.faults.inject(Fault.SILENCE, {})
            loss = await asyncio.wait_for(subject.wait_lost(), 10.0)
            assert isinstance(loss, CellError)
            assert loss.name == "DEVICE_LOST"

    play(work)


@pytest.mark.parametrize("by", ["robotiq-rtu", "robotiq-urcap"])
def test_one_that_is_not_activated_does_not_move_unless_the_config_lets_it(by: str, tmp_path: Path) -> None:
    async def work() -> None:
        async with twin(by, tmp_path) as made:
            async with opened(made.device(), activate=False) as subject:
                with pytest.raises(CellError, match="not activated") as caught:
                    await subject.grip(2.0)
                assert caught.value.name == "GRIPPER_NOT_ACTIVE"
            async with opened(made.device()) as subject:
                assert not subject.health()["active"], "opening it moved it"
                assert await subject.grip(3.0)

    play(work)


@pytest.mark.parametrize("by", ["robotiq-rtu", "robotiq-urcap"])
def test_a_fault_of_the_gripper_is_named(by: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fakes.robotiq.hand.Hand._not_activated", lambda self: 0x0A)

    async def work() -> None:
        async with twin(by, tmp_path) as made, opened(made.device()) as subject:
            with pytest.raises(CellError, match="0Ah, its supply voltage is too low"):
                await subject.grip(2.0)

    play(work)


def test_the_vendors_socket_is_recorded(tmp_path: Path) -> None:
    async def work() -> None:
        async with twin("robotiq-urcap", tmp_path) as made, opened(made.device()) as subject:
            await subject.grip(3.0)

    recorder = WireRecorder(tmp_path / "recording", 10**7)
    with recorded_by(recorder):
        play(work)
    recorder.close()
    (connection,) = read_recording(tmp_path / "recording").of("robotiq-urcap")
    said = [record.data for record in connection.records if record.sent]
    assert b"SET ACT 1\n" in said
    assert b"SET POS 255 SPE 255 FOR 128 GTO 1\n" in said
    assert connection.closed is not None


def test_a_client_of_other_people_drives_the_sockets_twin(tmp_path: Path) -> None:
    pyrobotiqur = pytest.importorskip("pyrobotiqur", reason="pyRobotiqUR is not installed")

    def their_client(port: int) -> None:
        with pyrobotiqur.RobotiqGripper(HOST, port) as client:
            client.activate(poll_interval=0.02)
            position, found = client.close()
            assert (position, int(found.value)) == (200, 2)
            position, found = client.open()
            assert (position, int(found.value)) == (0, 3)

    async def work() -> None:
        async with twin("robotiq-urcap", tmp_path) as made:
            port = int(made.addresses()["gripper"].rsplit(":", 1)[1])
            await asyncio.to_thread(their_client, port)

    play(work)


def test_a_client_of_other_people_drives_the_serial_twin(tmp_path: Path) -> None:
    theirs = pytest.importorskip("pyrobotiqgripper", reason="pyrobotiqgripper is not installed")

    def their_client(path: str) -> None:
        client = theirs.RobotiqGripper(com_port=path)
        client.connect()
        client.activate()
        client.close()
        assert client.position() == 200
        client.open()
        assert client.position() == 0

    async def work() -> None:
        async with twin("robotiq-rtu", tmp_path):
            await asyncio.to_thread(their_client, str(tmp_path / "gripper.tty"))

    play(work)


def test_the_outputs_of_a_server_of_other_people_are_switched_one_after_the_other() -> None:
    """A valve with two coils and no input that confirms, on pymodbus' own server."""
    wrote: list[tuple[int, list[Any]]] = []

    async def action(
        function: int, start: int, address: int, count: int, registers: list[int], values: Any
    ) -> None:
        if values is not None:
            wrote.append((address, list(values)))

    async def work() -> None:
        bits = [SimData(0, values=[False] * 16, datatype=DataType.BITS)]
        words = [SimData(0, count=16, datatype=DataType.REGISTERS)]
        device = SimDevice(1, (bits, bits, words, words), action=action)
        server = ModbusTcpServer(device, address=(HOST, 5505))
        await server.serve_forever(background=True)
        table = {
            **{"driver": "modbus-gripper", "url": f"tcp://{HOST}:5505", "serial": "7"},
            **{"output": 2, "open_output": 3, "moves_s": 0.05},
        }
        try:
            async with opened(table) as subject:
                begun = time.monotonic()
                assert await subject.grip(1.0)
                assert time.monotonic() - begun >= 0.05
                assert subject.holding(0.5)
                assert await subject.release(1.0)
                assert not subject.holding(0.5)
        finally:
            await server.shutdown()

    play(work)
    assert [(address, bool(values[0])) for address, values in wrote] == [
        *((3, False), (2, True)),  # closed: the coil that opens goes off before
        *((2, False), (3, True)),
    ]
