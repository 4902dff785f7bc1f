"""Independent clients read and write the face: pyModbusTCP, pymodbus' own client, and mbpoll."""

import asyncio
import logging
import shutil
import subprocess
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from pymodbus.client import AsyncModbusTcpClient
from pyModbusTCP.client import ModbusClient
from pyModbusTCP.utils import decode_ieee, encode_ieee, long_list_to_word

from cell.clock import MonotonicClock
from cell.store.ledger import Ledger
from daemon.config import ModbusSection
from daemon.modbus import Command, ModbusFace

pytestmark = pytest.mark.wire
HOST = "127.0.0.45"


class Plant:
    """Accepts every command and shows fixed numbers."""

    def __init__(self) -> None:
        self.commands: list[Command] = []

    async def handle(self, command: Command) -> int:
        self.commands.append(command)
        return 1

    def snapshot(self) -> dict[str, Any]:
        return {
            "status": 1,
            "run_id": 70000,
            "belt_speed_m_s": 0.25,
            "picks": 3,
            "warning_bits": 0b101,
            "tool_z_m": 0.18,
        }


def serve(visit: Callable[[str, int], None], **keys: Any) -> list[Command]:
    """Run the blocking ``visit`` in a thread while the face serves; returns the commands that came."""
    plant = Plant()
    section = {"bind": f"{HOST}:0", "allow_write": True, "allow_clients": ["127.0.0.0/8"], **keys}

    async def scene() -> None:
        face = ModbusFace(
            ModbusSection.model_validate(section), MonotonicClock(), plant.handle, plant.snapshot
        )
        await face.start()
        try:
            await asyncio.to_thread(visit, *face.address)
        finally:
            await face.stop()

    asyncio.run(scene())
    return plant.commands


def test_pymodbustcp_reads_and_commands() -> None:
    def visit(host: str, port: int) -> None:
        client = ModbusClient(host, port, unit_id=17, timeout=5.0)
        try:
            assert client.read_input_registers(8, 4) == [0x0100, 0, 1, 70000 - 65536]
            assert client.read_holding_registers(1008, 4) == [0x0100, 0, 1, 70000 - 65536]
            assert client.read_discrete_inputs(0, 20) == [True] + [False] * 15 + [True, False, True, False]
            assert client.write_multiple_registers(0, [1, 7, 1, 0])
            assert client.write_single_register(2, 9)
            assert client.read_holding_registers(0, 4) == [1, 7, 9, 0]
            assert client.write_read_multiple_registers(3, [5], 0, 4) == [1, 7, 9, 5]
            for _ in range(200):
                if client.read_input_registers(1, 2) == [7, 1]:
                    break
            assert client.read_input_registers(1, 2) == [7, 1]
            assert client.write_single_register(40, 1) is False
            assert client.last_except == 2
            assert client.write_single_register(0, 99) is False
            assert client.last_except == 3
            assert client.read_coils(0, 8) is None
            assert client.last_except == 2
        finally:
            client.close()

    (command,) = serve(visit)
    assert (command.code, command.sequence, command.job) == (1, 7, 1)


@pytest.mark.parametrize("word_order", ["high-first", "low-first"])
def test_pymodbus_reads_32_bit_values_and_sends_arguments(word_order: str) -> None:
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
    plant = Plant()
    order: Any = "big" if word_order == "high-first" else "little"
    section = {"bind": f"{HOST}:0", "allow_write": True, "allow_clients": [HOST], "word_order": word_order}

    async def scene() -> None:
        face = ModbusFace(
            ModbusSection.model_validate(section), MonotonicClock(), plant.handle, plant.snapshot
        )
        await face.start()
        host, port = face.address
        client = AsyncModbusTcpClient(host, port=port, timeout=5, source_address=(HOST, 0))
        try:
            assert await client.connect()
            kinds = client.DATATYPE
            for address, kind, value in ((10, kinds.UINT32, 70000), (16, kinds.FLOAT32, 0.25)):
                words = (await client.read_input_registers(address, count=2, device_id=3)).registers
                assert client.convert_from_registers(words, kind, word_order=order) == value
            prompt = client.convert_to_registers(70001, kinds.UINT32, word_order=order)
            assert not (await client.write_registers(0, [10, 3, 0, 0, *prompt], device_id=0)).isError()
            refused = await client.write_register(63, 1, device_id=1)
            assert refused.exception_code == 2
            many = [client.read_input_registers(0, count=64, device_id=1) for _ in range(50)]
            assert all(len(reply.registers) == 64 for reply in await asyncio.gather(*many))
        finally:
            client.close()
            await face.stop()

    asyncio.run(scene())
    (command,) = plant.commands
    assert (command.code, command.argument_uint32) == (10, 70001)


@pytest.mark.parametrize("read_code", [1, 2, 3])
def test_pymodbustcp_reads_who_made_the_device(read_code: int) -> None:
    def visit(host: str, port: int) -> None:
        client = ModbusClient(host, port, unit_id=1, timeout=5.0)
        try:
            stream = client.read_device_identification(read_code=read_code, object_id=0)
            assert stream is not None
            assert stream.objects_by_id[1] == b"cellward"
            assert stream.objects_by_id[2] == version("cellward").encode()
            assert (stream.conformity_level, stream.more_follows) == (0x81, 0)
            for number, told in stream.objects_by_id.items():
                one = client.read_device_identification(read_code=4, object_id=number)
                assert one is not None
                assert one.objects_by_id == {number: told}
            assert client.read_device_identification(read_code=4, object_id=0x80) is None
            assert client.last_except == 2
        finally:
            client.close()

    serve(visit)


@pytest.mark.parametrize("word_order", ["high-first", "low-first"])
def test_pymodbustcp_writes_float32_arguments_that_arrive_and_read_back_as_written(word_order: str) -> None:
    def visit(host: str, port: int) -> None:
        client = ModbusClient(host, port, unit_id=1, timeout=5.0)
        big_endian = word_order == "high-first"
        numbers = [encode_ieee(0.25), encode_ieee(-1e-3)]
        words = long_list_to_word(numbers, big_endian=big_endian)
        try:
            assert client.write_multiple_registers(0, [2, 4, 0, 0, 0, 0, *words])
            assert client.read_holding_registers(6, 4) == words
        finally:
            client.close()

    (command,) = serve(visit, word_order=word_order)
    told = [decode_ieee(command.argument_as_uint32(index)) for index in (1, 2)]
    assert told == pytest.approx([0.25, -1e-3])


@pytest.mark.skipif(shutil.which("mbpoll") is None, reason="mbpoll is not installed (apt-get install mbpoll)")
def test_mbpoll_reads_and_commands() -> None:
    def mbpoll(host: str, port: int, *options: str) -> str:
        command = ["mbpoll", "-m", "tcp", "-p", str(port), "-0", "-1", "-q", *options]
        head = [o for o in options if o.startswith("=")]
        command = [o for o in command if not o.startswith("=")] + [host, *(o[1:] for o in head)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
        return done.stdout + done.stderr

    def visit(host: str, port: int) -> None:
        assert "0.25" in mbpoll(host, port, "-a", "1", "-t", "3:float", "-B", "-r", "16", "-c", "1")
        assert "0.18" in mbpoll(host, port, "-a", "1", "-t", "3:float", "-B", "-r", "86", "-c", "1")
        assert "70000" in mbpoll(host, port, "-a", "5", "-t", "3:int", "-B", "-r", "10", "-c", "1")
        assert "256" in mbpoll(host, port, "-a", "1", "-t", "4", "-r", "1008", "-c", "1")
        mbpoll(host, port, "-a", "1", "-t", "4", "-r", "0", "=2", "=9", "=1")
        assert "Illegal data address" in mbpoll(host, port, "-a", "1", "-t", "4", "-r", "50", "=1")
        assert "Illegal data value" in mbpoll(host, port, "-a", "1", "-t", "4", "-r", "0", "=200")

    (command,) = serve(visit)
    assert (command.code, command.sequence, command.job) == (2, 9, 1)


def test_the_acknowledged_sequence_survives_a_restart_in_the_ledger(tmp_path: Path) -> None:
    plants = [Plant(), Plant()]

    async def session(plant: Plant, script: Callable[[ModbusClient], None]) -> None:
        ledger = await asyncio.to_thread(Ledger, tmp_path / "ledger.sqlite")
        face = ModbusFace(
            ModbusSection(bind=f"{HOST}:0", allow_write=True, allow_clients=["127.0.0.0/8"]),
            MonotonicClock(),
            plant.handle,
            plant.snapshot,
            last_sequence=ledger.get_state("modbus.sequence", 0),
            remember=lambda sequence: ledger.set_state("modbus.sequence", sequence),
            audit=lambda *line: ledger.audit("modbus", *line),
        )
        await face.start()
        client = ModbusClient(*face.address, timeout=5.0)
        try:
            await asyncio.to_thread(script, client)
        finally:
            client.close()
            await face.stop()
            ledger.close()

    def first(client: ModbusClient) -> None:
        client.write_multiple_registers(0, [1, 300, 1])
        while client.read_input_registers(1, 1) != [300]:
            pass

    def second(client: ModbusClient) -> None:
        assert client.read_input_registers(1, 1) == [300]
        client.write_multiple_registers(0, [1, 300, 1])

    asyncio.run(session(plants[0], first))
    asyncio.run(session(plants[1], second))
    assert [len(p.commands) for p in plants] == [1, 0]
    ledger = Ledger(tmp_path / "ledger.sqlite")
    lines = [(line["what"], line["accepted"]) for line in reversed(ledger.audit_lines())]
    ledger.close()
    assert lines == [("write 0..2", True), ("command 1 sequence 300 job 1", True), ("write 0..2", True)]
