"""Requests to the daemon that are damaged in their bytes or values: how is each answered?

The engine, the ledger and both servers are the product's own, on loopback and in this process; no device of
the configuration is opened. Beside each damaged request an intact one has to be answered.
"""

import asyncio
import copy
import json
import logging
import random
import struct
import tempfile
import time
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pyModbusTCP.client import ModbusClient

from bench._mutate import change_value, flipped, inserted, without_piece
from cell.clock import MonotonicClock
from cell.motion import MotionBroker
from cell.store.ledger import Ledger
from daemon.cell_context import CellContext
from daemon.composition import supervised_devices
from daemon.config import ModbusSection, load_config
from daemon.control import MAX_REQUEST_BYTES, ControlServer
from daemon.engine import Engine
from daemon.health import Beats
from daemon.modbus import Command, ModbusFace
from daemon.supervisor import Supervisor
from daemon.worker import InlineWorker
from procedures.registry import JOBS

HOST = "127.0.0.1"
ANSWER_S = 10.0
ANSWERED, REFUSED, CLOSED = 0, 2, 3
SERVER_FAILURE = 4  # the exception code of a defect
METHODS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("confirm", {"prompt_id": 65537}),
    ("accept", {"result_id": 4, "warned": True}),
    ("reject", {"result_id": 5, "why": "the board was loose"}),
    ("rollback", {"name": "T_flange_camera"}),
    ("live", {"since": {"speed": 3}}),
    ("halt", {}),
    ("reset", {}),
    ("status", {}),
)
PDUS = (
    "0400000040",
    "030000000a",
    "0200000010",
    "06000a0001",
    "100064000204000100ff",
    "0f00000001010f",
    "2b0e0100",
)


@dataclass
class Answers:
    """What became of the requests of one kind: 0 answered, 2 refused, 3 closed without an answer."""

    codes: Counter[int] = field(default_factory=Counter)
    faults: list[str] = field(default_factory=list)
    longest: float = 0.0


class _Defects(logging.Handler):
    """Keeps the log's lines that come with a traceback."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.found: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        if record.exc_info:
            self.found.append(f"logged a traceback: {record.getMessage()[:200]}")


def control_requests(folder: Path, count: int, seed: int) -> Answers:
    """``count`` damaged lines to the control socket; each is answered by one line."""
    return asyncio.run(_dealt(_control(folder), _damaged_line, count, seed))


def modbus_requests(folder: Path, count: int, seed: int) -> Answers:
    """``count`` damaged frames to the Modbus server; a client of another make polls beside them."""
    return asyncio.run(_dealt(_modbus(), _damaged_frame, count, seed))


Ask = Callable[[bytes], Awaitable[tuple[int, str]]]
"""How a request was answered, and what is wrong with that (empty: nothing)."""


async def _dealt(served: Any, damaged: Callable[[random.Random], bytes], count: int, seed: int) -> Answers:
    answers, defects = Answers(), _Defects()
    logging.getLogger("cellward").addHandler(defects)
    try:
        async with served as ask:
            for k in range(count):
                request = damaged(random.Random(f"{seed} {damaged.__name__} {k}"))
                began = time.perf_counter()
                try:
                    code, wrong = await ask(request)
                except TimeoutError:
                    code, wrong = CLOSED, f"no answer in {ANSWER_S:g} s"
                answers.codes[code] += 1
                answers.longest = max(answers.longest, time.perf_counter() - began)
                told = [text for text in (wrong, *defects.found) if text]
                answers.faults += [f"{k}: {request[:120]!r}: {text}" for text in told]
                defects.found.clear()
    finally:
        logging.getLogger("cellward").removeHandler(defects)
    return answers


# -- the control socket


@asynccontextmanager
async def _control(folder: Path) -> AsyncIterator[Ask]:
    config = load_config(_config(folder))
    clock = MonotonicClock()
    runs = folder / "state" / "runs"
    runs.mkdir(parents=True)
    ledger = Ledger(folder / "state" / "ledger.sqlite")
    supervisor = Supervisor(supervised_devices(config, clock, Beats(clock)))
    context = CellContext(config, clock, InlineWorker(), supervisor, MotionBroker(clock), ledger)
    async with AsyncExitStack() as stack:
        stack.callback(ledger.close)
        # A unix socket's path holds 107 bytes, and the caller's folder may be deeper than that.
        at = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="requests-")))
        server = ControlServer(
            at / "control.sock",
            Engine(context, JOBS, runs),
            lambda who, what, accepted, detail: ledger.audit("control", who, what, accepted, detail),
        )
        await server.start()
        stack.push_async_callback(server.stop)

        async def ask(line: bytes) -> tuple[int, str]:
            reader, writer = await asyncio.open_unix_connection(server.path, limit=64 * MAX_REQUEST_BYTES)
            try:
                async with asyncio.timeout(ANSWER_S):
                    writer.write(line)
                    code, wrong = _judged(await reader.readline())
                    if len(line) <= MAX_REQUEST_BYTES:  # after a longer one the server closes
                        writer.write(b'{"id": 2, "method": "status"}\n')
                        if "result" not in json.loads(await reader.readline() or b"{}"):
                            wrong = wrong or "the request after it was not answered"
            finally:
                writer.close()
            return code, wrong

        yield ask


def _config(folder: Path) -> Path:
    """The shipped configuration, readable by its owner alone as the daemon wants it."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "cell.toml"
    path.write_bytes((Path(__file__).parents[1] / "deploy" / "cell.toml").read_bytes())
    path.chmod(0o600)
    return path


def _judged(line: bytes) -> tuple[int, str]:
    if not line:
        return CLOSED, "closed without an answer"
    answer = json.loads(line)
    refusal = answer.get("error")
    if refusal is None:
        return ANSWERED, "" if "result" in answer else f"neither result nor error: {line[:200]!r}"
    whole = all(refusal.get(key) for key in ("code", "name", "text", "hint"))
    return REFUSED, "" if whole and refusal["name"] != "INTERNAL" else f"{refusal}"


def _damaged_line(rng: random.Random) -> bytes:
    job = rng.choice([*JOBS, "no-such-job"])
    start = {"job": job, "params": {"settle_s": "0.5"}, "adopt": 3, "dry_run": True}
    method, params = ("start", start) if rng.random() < 0.5 else rng.choice(METHODS)
    request: Any = {"id": 1, "method": method, "params": copy.deepcopy(params)}
    way = rng.random()
    for _ in range(1 + (way > 0.5) if way < 0.6 else 0):  # one value, two, none
        change_value(request, rng)
    line = json.dumps(request).encode()
    if 0.6 <= way < 0.9:
        line = _damaged_bytes(line, rng)
    return line.replace(b"\n", b" ") + b"\n"


def _damaged_bytes(data: bytes, rng: random.Random) -> bytes:
    ways: tuple[Callable[[], bytes], ...] = (
        lambda: data[: rng.randrange(len(data) + 1)],
        lambda: flipped(data, rng),
        lambda: inserted(data, rng.choice((b"\xe4", b"\0", b"[" * 5000, b"9" * 5000)), rng),
        lambda: without_piece(data, rng),
        lambda: data.decode("utf-8", "replace").encode("utf-16"),
        lambda: b'{"a":' * 3000 + b"[" * 3000,
        lambda: data + data,
        lambda: b"x" * (MAX_REQUEST_BYTES + 10),
        lambda: b"",
    )
    return rng.choice(ways)()


# -- the Modbus server


@asynccontextmanager
async def _modbus() -> AsyncIterator[Ask]:
    async def carried_out(command: Command) -> int:
        return 1

    section = {"bind": f"{HOST}:0", "allow_write": True, "allow_clients": [HOST]}
    face = ModbusFace(
        ModbusSection.model_validate(section), MonotonicClock(), carried_out, lambda: {"status": 1},
        audit=lambda *line: None, on_plc=lambda alive: None, last_sequence=0, remember=lambda sequence: None,
    )  # fmt: skip
    await face.start()
    poller = ModbusClient(*face.address, timeout=ANSWER_S, auto_open=True)

    async def ask(frame: bytes) -> tuple[int, str]:
        reader, writer = await asyncio.open_connection(*face.address)
        try:
            async with asyncio.timeout(ANSWER_S):
                writer.write(frame)
                writer.write_eof()
                try:
                    reply = await reader.read()
                except ConnectionError:
                    reply = b""
        finally:
            writer.close()
        polled = await asyncio.to_thread(poller.read_input_registers, 0, 8)
        wrong = "" if polled and len(polled) == 8 else "the poll after it was not answered"
        if len(reply) < 9:
            return CLOSED, wrong or ("" if not reply else f"half a reply: {reply.hex()}")
        if reply[:2] != frame[:2]:
            return ANSWERED, f"the reply is for another request: {reply.hex()}"
        refused = bool(reply[7] & 0x80)
        if refused and reply[8] == SERVER_FAILURE:
            wrong = wrong or "exception 4"
        return REFUSED if refused else ANSWERED, wrong

    try:
        yield ask
    finally:
        poller.close()
        await face.stop()


def _damaged_frame(rng: random.Random) -> bytes:
    pdu = bytearray(bytes.fromhex(rng.choice(PDUS)))
    if rng.random() < 0.5:
        at = rng.randrange(1, len(pdu))
        pdu[at] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))
    if rng.random() < 0.2:
        pdu[0] = rng.randrange(256)
    if rng.random() < 0.3:
        pdu = bytearray(_cut_or_longer(bytes(pdu), rng))
    protocol = rng.choice((0, 0, 0, 0, 0, 0, 1, 0xFFFF))
    length = len(pdu) + 1 if rng.random() < 0.8 else rng.choice((0, 1, 2, 254, 255, 0xFFFF))
    frame = struct.pack(">HHHB", rng.randrange(65536), protocol, length, rng.choice((1, 0, 255))) + bytes(pdu)
    return flipped(frame, rng) if rng.random() < 0.1 else frame


def _cut_or_longer(pdu: bytes, rng: random.Random) -> bytes:
    return (
        pdu[: rng.randrange(1, len(pdu) + 1)]
        if rng.random() < 0.5
        else pdu + rng.randbytes(rng.randrange(250))
    )
