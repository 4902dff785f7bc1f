"""The handshake of a PLC by clients that are not ours: a lost reply, a restart, and a stranger beside it."""

import asyncio
import shutil
import socket
import struct
import subprocess
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from pyModbusTCP.client import ModbusClient

from cell.clock import MonotonicClock
from cell.store.ledger import Ledger
from daemon.config import ModbusSection
from daemon.modbus import Command, ModbusFace

pytestmark = pytest.mark.wire

HOST, STRANGER = "127.0.0.46", "127.0.0.99"
START, ABORT = 1, 3
ACKNOWLEDGED = 1  # input register
SOON_S = 5.0

Write = Callable[[str, int, list[int]], bool]
"""Write holding registers from 0 on; whether the server said yes."""
Read = Callable[[str, int], int]
"""The acknowledged sequence."""


def raw_request(host: str, port: int, pdu: bytes, source: str = "", listen: bool = True) -> bytes:
    """The answer's bytes after the header; without ``listen`` the link is cut before it can come."""
    with socket.create_connection((host, port), 5.0, source_address=(source, 0) if source else None) as link:
        link.sendall(struct.pack(">HHHB", 7, 0, len(pdu) + 1, 1) + pdu)
        if not listen:
            link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            return b""
        head = link.recv(7, socket.MSG_WAITALL)
        return link.recv(struct.unpack(">HHHB", head)[2] - 1, socket.MSG_WAITALL)


def write_pdu(words: list[int]) -> bytes:
    return struct.pack(f">BHHB{len(words)}H", 16, 0, len(words), 2 * len(words), *words)


def raw_write(host: str, port: int, words: list[int]) -> bool:
    return raw_request(host, port, write_pdu(words))[0] == 16


def raw_read(host: str, port: int) -> int:
    value: int = struct.unpack(">BBH", raw_request(host, port, struct.pack(">BHH", 4, ACKNOWLEDGED, 1)))[2]
    return value


def tcp_write(host: str, port: int, words: list[int]) -> bool:
    client = ModbusClient(host, port, auto_close=True, timeout=5.0)
    return bool(client.write_multiple_registers(0, words))


def tcp_read(host: str, port: int) -> int:
    words = ModbusClient(host, port, auto_close=True, timeout=5.0).read_input_registers(ACKNOWLEDGED, 1)
    assert words is not None
    return int(words[0])


def mbpoll(host: str, port: int, *more: str) -> str:
    command = ["mbpoll", "-m", "tcp", "-p", str(port), "-0", "-1", "-q", "-a", "1", *more]
    return subprocess.run(command, capture_output=True, text=True, timeout=20, check=False).stdout


def mbpoll_write(host: str, port: int, words: list[int]) -> bool:
    return f"Written {len(words)}" in mbpoll(host, port, "-t", "4", "-r", "0", host, *map(str, words))


def mbpoll_read(host: str, port: int) -> int:
    told = mbpoll(host, port, "-t", "3", "-r", str(ACKNOWLEDGED), "-c", "1", host)
    return int(told.partition(f"[{ACKNOWLEDGED}]:")[2].split()[0])


NEEDS_MBPOLL = pytest.mark.skipif(
    shutil.which("mbpoll") is None, reason="mbpoll is not installed (apt-get install mbpoll)"
)


@pytest.mark.parametrize(
    ("write", "read"),
    [
        pytest.param(raw_write, raw_read, id="raw socket"),
        pytest.param(tcp_write, tcp_read, id="pyModbusTCP"),
        pytest.param(mbpoll_write, mbpoll_read, id="mbpoll", marks=NEEDS_MBPOLL),
    ],
)
def test_each_command_acts_once_whatever_is_lost_and_whoever_else_writes(
    write: Write, read: Read, tmp_path: Path
) -> None:
    handled: list[Command] = []

    def acknowledged(host: str, port: int, sequence: int) -> None:
        give_up = time.monotonic() + SOON_S
        while read(host, port) != sequence:
            assert time.monotonic() < give_up

    def before(host: str, port: int) -> None:
        raw_request(host, port, write_pdu([START, 11, 1]), listen=False)  # the reply is lost
        acknowledged(host, port, 11)
        for _ in range(3):  # so it is asked again
            assert write(host, port, [START, 11, 1])
        refused = raw_request(host, port, write_pdu([START, 12, 1]), source=STRANGER)
        assert refused[0] == 16 | 0x80
        assert write(host, port, [ABORT, 13, 0])
        acknowledged(host, port, 13)

    def after(host: str, port: int) -> None:
        assert read(host, port) == 13
        assert write(host, port, [ABORT, 13, 0])  # what stood in the registers when the power went
        assert write(host, port, [START, 14, 2])
        acknowledged(host, port, 14)

    for visit in (before, after):
        asyncio.run(served(tmp_path, handled, visit))
    assert [(c.code, c.sequence, c.job) for c in handled] == [(START, 11, 1), (ABORT, 13, 0), (START, 14, 2)]
    with closing(Ledger(tmp_path / "ledger.sqlite")) as ledger:
        refused = [line for line in ledger.audit_lines() if not line["accepted"]]
    assert [STRANGER in line["who"] for line in refused] == [True]


async def served(folder: Path, handled: list[Command], visit: Callable[[str, int], None]) -> None:
    """``visit`` in a thread while a daemon's face serves, on the ledger of the one before it."""

    async def handle(command: Command) -> int:
        handled.append(command)
        return 1

    def snapshot() -> dict[str, Any]:
        return {"status": 1}

    ledger = await asyncio.to_thread(Ledger, folder / "ledger.sqlite")
    face = ModbusFace(
        ModbusSection(bind=f"{HOST}:0", allow_write=True, allow_clients=["127.0.0.1/32"]),
        MonotonicClock(),
        handle,
        snapshot,
        last_sequence=ledger.get_state("modbus.sequence", 0),
        remember=lambda sequence: ledger.set_state("modbus.sequence", sequence),
        audit=lambda *line: ledger.audit("modbus", *line),
    )
    await face.start()
    try:
        await asyncio.to_thread(visit, *face.address)
    finally:
        await face.stop()
        ledger.close()
