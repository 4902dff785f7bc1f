"""Clients that are not ours read the fake input module: mbpoll, pyModbusTCP, and pymodbus on three wires."""

import asyncio
import importlib.util
import logging
import shutil
import ssl
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient, AsyncModbusTlsClient
from pymodbus.client.base import ModbusBaseClient
from pyModbusTCP.client import ModbusClient

from tests.kit.modbus_io_rig import HOST, Steady, rig

pytestmark = pytest.mark.wire
COUNTS = [1, 70000 - 65536, 0, 3, 0, 5]

needs_mbpoll = pytest.mark.skipif(
    shutil.which("mbpoll") is None, reason="mbpoll is not installed (apt-get install mbpoll)"
)
needs_pyserial = pytest.mark.skipif(
    importlib.util.find_spec("serial") is None, reason="pyserial is not installed (pip install pyserial)"
)
needs_openssl = pytest.mark.skipif(
    shutil.which("openssl") is None, reason="openssl is not installed (apt-get install openssl)"
)


def serve(visit: Callable[[str, int], None], make: str, line: Path | None = None) -> None:
    """Run the blocking ``visit`` in a thread while the module serves."""

    async def scene() -> None:
        async with rig(make, Steady(), line=line) as subject:
            await asyncio.to_thread(visit, *subject.address)

    asyncio.run(scene())


def mbpoll(*words: str) -> str:
    command = ["mbpoll", "-0", "-1", "-q", "-a", "1", *words]
    done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
    return done.stdout + done.stderr


@needs_mbpoll
def test_mbpoll_reads_writes_and_is_refused_over_tcp() -> None:
    def visit(host: str, port: int) -> None:
        tcp = ("-m", "tcp", "-p", str(port))
        assert values(mbpoll(*tcp, "-t", "1", "-r", "0", "-c", "3", host)) == ["1", "0", "1"]
        assert values(mbpoll(*tcp, "-t", "0", "-r", "0", "-c", "12", host))[:3] == ["1", "0", "1"]
        # Without -B it takes the low word first, as this module has it.
        assert values(mbpoll(*tcp, "-t", "4:int", "-r", "0", "-c", "3", host)) == ["70000", "3", "5"]
        assert values(mbpoll(*tcp, "-t", "3", "-r", "300", "-c", "1", host)) == ["5"]
        mbpoll(*tcp, "-t", "0", "-r", "33", host, "1")  # clears counter 0
        assert values(mbpoll(*tcp, "-t", "4:int", "-r", "0", "-c", "2", host)) == ["0", "3"]
        mbpoll(*tcp, "-t", "0", "-r", "16", host, "1", "0", "1")
        assert values(mbpoll(*tcp, "-t", "4", "-r", "302", "-c", "1", host)) == ["5"]
        assert "Illegal data address" in mbpoll(*tcp, "-t", "3", "-r", "400", "-c", "1", host)

    serve(visit, "ADAM-6050")


@needs_mbpoll
@pytest.mark.parametrize("baud", ["9600", "115200"])
def test_mbpoll_reads_and_writes_over_rtu(tmp_path: Path, baud: str) -> None:
    line = tmp_path / "io.tty"

    def visit(host: str, port: int) -> None:
        rtu = ("-m", "rtu", "-b", baud, "-P", "none")
        assert values(mbpoll(*rtu, "-t", "1", "-r", "0", "-c", "3", str(line))) == ["1", "0", "1"]
        counts = mbpoll(*rtu, "-t", "3:int", "-B", "-r", "16", "-c", "2", str(line))
        assert values(counts) == ["70000", "3"]
        mbpoll(*rtu, "-t", "0", "-r", "272", str(line), "1")
        assert values(mbpoll(*rtu, "-t", "3:int", "-B", "-r", "16", "-c", "2", str(line))) == ["0", "3"]
        assert "Illegal data value" in mbpoll(*rtu, "-t", "0", "-r", "272", str(line), "0")

    serve(visit, "ioLogik-E1210", line)


def values(printed: str) -> list[str]:
    """The values that mbpoll prints as ``[address]: value``."""
    return [line.split(":")[1].strip().split(" ")[0] for line in printed.splitlines() if line.startswith("[")]


def test_pymodbustcp_reads_writes_and_identifies() -> None:
    def visit(host: str, port: int) -> None:
        client = ModbusClient(host, port, unit_id=17, timeout=5.0)
        try:
            assert client.read_discrete_inputs(0, 4) == [True, False, True, False]
            assert client.read_input_registers(0, 6) == COUNTS
            assert client.read_holding_registers(0, 6) == COUNTS
            assert client.read_coils(0, 2) == [False, False]
            assert client.write_single_coil(0, True)
            assert client.read_input_registers(0, 4) == [0, 0, 0, 3]
            assert client.write_multiple_coils(1, [True, True])
            assert client.read_input_registers(0, 6) == [0] * 6
            assert client.write_single_register(3, 9)
            assert client.write_multiple_registers(4, [1, 2])
            assert client.read_input_registers(0, 6) == [0, 0, 0, 9, 1, 2]
            assert client.read_input_registers(32, 1) is None
            assert client.last_except == 2
            assert client.read_input_registers(31, 2) is None
            assert client.last_except == 2
            assert client.write_read_multiple_registers(4, [3, 4], 4, 2) == [3, 4]
            assert client.custom_request(b"\x07") is None  # read exception status: a serial line's function
            assert client.last_except == 1
            told = client.read_device_identification(read_code=3, object_id=0)
            assert told is not None
            assert told.objects_by_id[0x80] == b"99993300001"
            assert told.objects_by_id[1] == b"generic"
        finally:
            client.close()

    serve(visit, "generic")


async def examine(client: ModbusBaseClient) -> None:
    """What pymodbus must be able to do on any wire."""
    try:
        assert await client.connect()
        bits = (await client.read_discrete_inputs(0, count=3, device_id=5)).bits
        assert bits[:3] == [True, False, True]
        image = (await client.read_input_registers(0x10, count=33, device_id=5)).registers
        assert image[:6] == COUNTS
        assert image[32] == 0b101
        assert not (await client.write_coil(0x110, True, device_id=5)).isError()
        assert (await client.read_input_registers(0x10, count=2, device_id=5)).registers == [0, 0]
        assert not (await client.write_coils(0x110, [True] * 3, device_id=5)).isError()
        assert (await client.read_input_registers(0x10, count=6, device_id=5)).registers == [0] * 6
        assert (await client.write_coil(0x110, False, device_id=5)).exception_code == 3
        assert (await client.read_holding_registers(0, count=1, device_id=5)).exception_code == 2
        told: Any = await client.read_device_information(read_code=3, device_id=5)
        assert told.information[0x80] == b"99993300001"
        assert told.information[1] == b"ioLogik-E1210"
    finally:
        client.close()


@pytest.fixture(autouse=True)
def _pymodbus_is_quiet() -> None:
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)


def test_pymodbus_over_tcp() -> None:
    async def scene() -> None:
        async with rig("ioLogik-E1210") as subject:
            host, port = subject.address
            await examine(AsyncModbusTcpClient(host, port=port, timeout=5, source_address=(HOST, 0)))
            client = AsyncModbusTcpClient(host, port=port, timeout=5)
            assert await client.connect()
            many = [client.read_input_registers(0x10, count=33, device_id=1) for _ in range(50)]
            assert all(reply.registers[32] == 0b101 for reply in await asyncio.gather(*many))
            client.close()

    asyncio.run(scene())


@needs_pyserial
def test_pymodbus_over_rtu(tmp_path: Path) -> None:
    async def scene() -> None:
        async with rig("ioLogik-E1210", line=tmp_path / "io.tty"):
            await examine(AsyncModbusSerialClient(str(tmp_path / "io.tty"), baudrate=115200, timeout=5))

    asyncio.run(scene())


@needs_openssl
def test_pymodbus_over_tls_and_a_client_without_tls_disturbs_nobody(tmp_path: Path) -> None:
    certificate, key = tmp_path / "module.crt", tmp_path / "module.key"
    request = "req -x509 -newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes -days 2 -subj /CN=module"
    names = ["-addext", f"subjectAltName=IP:{HOST}", "-keyout", str(key), "-out", str(certificate)]
    subprocess.run(["openssl", *request.split(), *names], check=True, capture_output=True, timeout=20)
    ours = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    ours.load_cert_chain(certificate, key)
    theirs = ssl.create_default_context(cafile=str(certificate))

    async def scene() -> None:
        async with rig("ioLogik-E1210", tls=ours) as subject:
            host, port = subject.address
            _, plain = await asyncio.open_connection(host, port)
            plain.write(bytes.fromhex("000100000006010200000003"))
            await examine(AsyncModbusTlsClient(host, port=port, sslctx=theirs, timeout=5))
            plain.close()
            await asyncio.sleep(0.05)

    asyncio.run(scene())
