"""The dashboard server: one text line each way, on a connection of our own so that a stop never queues."""

import asyncio
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass

from cell.answer_time import answer_within
from cell.errors import error
from cell.wire_recording.tap import NO_TAP, Tap, tap
from drivers.ur.refused import why

PORT = 29999


@dataclass(frozen=True)
class RobotFacts:
    """What the dashboard says about the robot."""

    serial: str
    model: str
    version: str


class Dashboard:
    """A connected dashboard. Every question has a deadline; a late answer ends the connection."""

    def __init__(
        self, host: str, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, told: Tap
    ) -> None:
        self._host, self._reader, self._writer, self._tap = host, reader, writer, told
        self._turn = asyncio.Lock()

    @classmethod
    async def connect(cls, host: str, timeout: float) -> "Dashboard":
        """Connect and read the greeting; ``DEVICE_UNREACHABLE`` when either fails in ``timeout`` seconds."""
        writer: asyncio.StreamWriter | None = None
        told = NO_TAP
        try:
            async with answer_within(timeout):
                reader, writer = await asyncio.open_connection(host, PORT, limit=4096)
                told = tap("dashboard", f"{host}:{PORT}")
                greeting = await reader.readline()
                told.received(greeting)
                if not greeting.startswith(b"Connected"):
                    raise error("PROTOCOL_VIOLATION", f"{host}:{PORT} greets with {greeting[:60]!r}")
                return cls(host, reader, writer, told)
        except (OSError, TimeoutError, ValueError) as exc:
            _abort(writer)
            told.closed()
            raise error("DEVICE_UNREACHABLE", f"dashboard at {host}:{PORT}: {_reason(exc, timeout)}") from exc
        except BaseException:
            _abort(writer)
            told.closed()
            raise

    async def ask(self, command: str, timeout: float) -> str:
        """Send one line, return the answering line. ``CALL_TIMEOUT`` or ``DEVICE_LOST`` close the link."""
        try:
            async with answer_within(timeout), self._turn:
                question = command.encode("ascii") + b"\n"
                self._tap.sent(question)
                self._writer.write(question)
                await self._writer.drain()
                answer = await self._reader.readline()
                self._tap.received(answer)
        except TimeoutError:
            # The late answer would be taken for the next question's.
            self.close()
            raise error(
                "CALL_TIMEOUT", f"dashboard '{command}' on {self._host} after {timeout:g} s"
            ) from None
        except (OSError, ValueError) as exc:
            self.close()
            raise error("DEVICE_LOST", f"dashboard on {self._host}: {exc}") from exc
        except asyncio.CancelledError:
            self.close()
            raise
        if not answer.endswith(b"\n"):
            self.close()
            raise error("DEVICE_LOST", f"dashboard on {self._host} closed the connection")
        return answer.decode("utf-8", "replace").strip()

    async def in_remote_control(self, timeout: float) -> bool:
        """True in remote control, and on controllers that do not know the question (before 5.6)."""
        answer = (await self.ask("is in remote control", timeout)).lower()
        return "true" in answer or "could not understand" in answer

    async def facts(self, timeout: float) -> RobotFacts:
        """Serial number, model (``ur10e``) and PolyScope version (``5.12.4``)."""
        serial = await self.ask("get serial number", timeout)
        model = await self.ask("get robot model", timeout)
        answer = await self.ask("PolyscopeVersion", timeout)
        found = re.search(r"(\d+)\.(\d+)\.(\d+)", answer)
        if found is None:
            raise error("PROTOCOL_VIOLATION", f"PolyscopeVersion answered {answer!r}")
        return RobotFacts(serial, model_name(model, int(found[1])), found[0])

    async def stop(self, timeout: float) -> None:
        """Stop the program on the robot; ``CALL_TIMEOUT`` when it says anything but ``Stopped``."""
        answer = await self.ask("stop", timeout)
        if not answer.lower().startswith("stopped"):
            raise error("CALL_TIMEOUT", f"dashboard stop on {self._host} answered {answer!r}")

    async def load(self, program: str, timeout: float) -> None:
        """Load a program; ``ARM_PROGRAM_NOT_STARTED`` with the controller's words."""
        answer = await self.ask(f"load {program}", timeout)
        if not answer.lower().startswith("loading program"):
            raise error("ARM_PROGRAM_NOT_STARTED", f"'load {program}' on {self._host} answered {answer!r}")

    async def require_loaded(self, program: str, timeout: float) -> None:
        """``ARM_PROGRAM_NOT_STARTED`` unless ``program`` is what is loaded.

        A controller may answer with the whole path; its programs are in a folder ``programs``.
        """
        answer = await self.ask("get loaded program", timeout)
        loaded = answer.removeprefix("Loaded program:").strip()
        if loaded != program and not loaded.endswith(f"/programs/{program}"):
            raise error("ARM_PROGRAM_NOT_STARTED", f"{program} is not what is loaded: {answer!r}")

    async def play(self, timeout: float) -> None:
        """Start the loaded program; ``ARM_PROGRAM_NOT_STARTED`` with the controller's words."""
        answer = await self.ask("play", timeout)
        if not answer.lower().startswith("starting program"):
            raise error("ARM_PROGRAM_NOT_STARTED", f"'play' on {self._host} answered {answer!r}")

    def close(self) -> None:
        """Drop the connection at once."""
        _abort(self._writer)
        self._tap.closed()


@asynccontextmanager
async def dashboard(host: str, timeout: float) -> AsyncIterator[Dashboard]:
    """A short-lived connection for one question, so that it never waits behind another."""
    link = await Dashboard.connect(host, timeout)
    try:
        yield link
    finally:
        link.close()


def model_name(answer: str, major: int) -> str:
    """Our name of a model: an e-series controller calls a UR10e ``UR10``."""
    name = answer.strip().lower().replace(" ", "")
    old_sizes = {"ur3", "ur5", "ur7", "ur10", "ur12", "ur16"}
    return name + "e" if major >= 5 and name in old_sizes else name


def _abort(writer: asyncio.StreamWriter | None) -> None:
    if writer is not None:
        writer.transport.abort()


def _reason(exc: Exception, timeout: float) -> str:
    return f"no greeting in {timeout:g} s" if isinstance(exc, TimeoutError) else why(exc, PORT)
