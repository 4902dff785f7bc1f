"""The page, the command line and a PLC see each other's actions within 0.5 s.

In virtual time, so a busy machine changes nothing: what is measured is what the daemon itself adds between an
action and the state that it hands to the page's stream, to ``cellward watch`` and into the registers. The
network's time comes on top, and a PLC's that asks seldom.
"""

import asyncio
import json
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from cell.packml import PackML
from daemon.auditor import Auditor
from daemon.control import ControlServer
from daemon.modbus import ModbusFace
from daemon.modbus.table import register_table
from daemon.plc import PlcFace
from daemon.recent_writes import RecentWrites
from daemon.requests import Caller, carry_out
from daemon.web.feed import Feed
from daemon.web.state import PageState
from fakes.object import run_virtual
from tests.kit.hand_eye_made import quick_solver
from tests.kit.object_cell import ObjectCell, no_report, open_cell, write_config

__all__ = ["no_report", "quick_solver"]
pytestmark = pytest.mark.usefixtures("no_report", "quick_solver")

LIMIT_S = 0.5
PLC_POLL_S = 0.1
CODES = {"start": 1, "abort": 3, "halt": 4, "pause": 5, "resume": 6, "reset": 7, "confirm": 10}
CAPTURE = 1

Seen = dict[str, float]


class Views:
    """What each of the three was told last, and its hand to ask for something."""

    def __init__(self, cell: ObjectCell) -> None:
        self.cell = cell
        self.writes = RecentWrites(cell.ledger)
        self.page: dict[str, Any] = {}
        self.cli: dict[str, Any] = {}
        self.plc: dict[str, int] = {}
        self._auditor = Auditor(self.writes.audit("web"))
        self._feed = Feed(PageState(cell.engine, self.writes, lambda: None))
        plc = PlcFace(cell.config, cell.engine)
        audit = self.writes.audit("modbus")
        keys = {"bind": "127.0.0.1:0", "allow_write": True, "allow_clients": ["127.0.0.0/8"]}
        modbus = cell.config.modbus.model_copy(update=keys)
        self._face = ModbusFace(modbus, cell.clock, plc.handle, plc.snapshot, audit=audit)
        self._socket = Path(cell.config.cell.control_socket)
        self._control = ControlServer(self._socket, cell.engine, self.writes.audit("control"))
        self._sequence = 0

    @asynccontextmanager
    async def open(self) -> AsyncIterator["Views"]:
        await self._face.start()
        await self._control.start()
        self._auditor.start()
        watching = [self._feed.run(), self._watch_page(), self._watch_cli(), self._poll()]
        tasks = [asyncio.create_task(each, name=f"watch {number}") for number, each in enumerate(watching)]
        try:
            await self.cell.until(lambda: self.page and self.cli and self.plc, "first states")
            yield self
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)
            await self._auditor.stop()
            await self._control.stop()
            await self._face.stop()

    async def ask(self, by: str, method: str, **params: Any) -> None:
        """One action of the ``page``, the ``cli`` or the ``plc``; a refusal is taken as the answer it is."""
        if by == "plc":
            number = params.get("prompt_id", 0)
            self._sequence += 1
            words = [CODES[method], self._sequence, CAPTURE, 0, number >> 16, number & 0xFFFF]
            self._face.write_holding(0, words, "127.0.0.1")
        elif by == "page":
            with suppress(Exception):
                await carry_out(self.cell.engine, self._auditor, method, params, Caller("anna", "web"))
        else:
            reader, writer = await asyncio.open_unix_connection(str(self._socket))
            writer.write(json.dumps({"id": 1, "method": method, "params": params}).encode() + b"\n")
            assert await reader.readline()
            writer.close()

    async def _watch_page(self) -> None:
        number = self._feed.begin_watch()
        while True:
            number, event = await self._feed.after(number)
            self.page = json.loads(event.partition(b"data: ")[2])

    async def _watch_cli(self) -> None:
        reader, writer = await asyncio.open_unix_connection(str(self._socket), limit=1 << 20)
        try:
            writer.write(b'{"id": 1, "method": "watch", "params": {}}\n')
            while line := await reader.readline():
                self.cli = json.loads(line)["data"]
        finally:
            writer.close()

    async def _poll(self) -> None:
        table = register_table()
        while True:
            words = self._face.read_input(0, table.readable_size)
            self.plc = _decoded(words)
            await self.cell.clock.sleep(PLC_POLL_S)


def _decoded(words: Sequence[int]) -> dict[str, int]:
    registers = [register_table().register(name) for name in ("packml_state", "active_job", "prompt_id")]
    return {r.name: int(r.decode(words[r.address : r.address + r.words], False)) for r in registers}


# What each of the three has to show: of the page's state and the command line's, and of the registers.
Shows = tuple[Callable[[dict[str, Any]], bool], Callable[[dict[str, int]], bool]]


def in_state(*states: PackML) -> Shows:
    names, numbers = {s.name for s in states}, {int(s) for s in states}
    return lambda status: status["packml"] in names, lambda plc: plc["packml_state"] in numbers


RUNS: Shows = (lambda status: status["job"] == "cone-capture", lambda plc: plc["active_job"] == CAPTURE)
ASKED: Shows = (lambda status: bool(status["prompt"]), lambda plc: plc["prompt_id"] > 0)
ANSWERED: Shows = (lambda status: not status["prompt"], lambda plc: plc["prompt_id"] == 0)
HELD = in_state(PackML.HOLDING, PackML.HELD)
GOES_ON = in_state(PackML.EXECUTE)
STOPPED = in_state(PackML.STOPPING, PackML.STOPPED)
IDLE = in_state(PackML.IDLE)


async def seen(views: Views, shows: Shows, limit_s: float) -> Seen:
    """After how many seconds each of the three shows it."""
    of_status, of_registers = shows
    looks: dict[str, Callable[[], bool]] = {
        "page": lambda: of_status(views.page["status"]),
        "cli": lambda: of_status(views.cli),
        "plc": lambda: of_registers(views.plc),
    }
    begun, found = views.cell.clock.now(), Seen()
    while len(found) < len(looks):
        now = views.cell.clock.now() - begun
        found |= {name: now for name, shown in looks.items() if name not in found and shown()}
        assert now <= limit_s, f"within {limit_s} s shown by {found} alone"
        await views.cell.clock.sleep(0.01)
    return found


async def act(views: Views, by: str, method: str, shows: Shows, **params: Any) -> None:
    await views.ask(by, method, **params)
    await seen(views, shows, LIMIT_S)


@pytest.mark.parametrize("after_s", [0.0, 0.13, 0.25, 0.9])
@pytest.mark.parametrize("by", ["page", "cli", "plc"])
def test_what_one_does_the_others_see_within_half_a_second(by: str, after_s: float, tmp_path: Path) -> None:
    """``after_s``: how long after the last state the next thing is done, as states come at a bounded rate."""

    async def main() -> None:
        config = write_config(tmp_path)
        async with open_cell(config) as cell, Views(cell).open() as views:
            for method, shows in (("abort", STOPPED), ("halt", in_state(PackML.ABORTING, PackML.ABORTED))):
                await cell.clock.sleep(after_s)
                await act(views, by, "start", RUNS, job="cone-capture")
                await seen(views, ASKED, 30.0)
                await cell.clock.sleep(after_s)
                await act(views, by, "confirm", ANSWERED, prompt_id=views.plc["prompt_id"])
                await cell.until_state("settle")
                await act(views, by, "pause", HELD)
                await cell.clock.sleep(after_s)
                await act(views, by, "resume", GOES_ON)
                await cell.clock.sleep(after_s)
                await act(views, by, method, shows)
                await cell.until(lambda: not cell.engine.active, "the end")
                await cell.clock.sleep(after_s)
                await act(views, by, "reset", IDLE)

    run_virtual(main())


@pytest.mark.parametrize("after_s", [0.05, 0.25, 0.5, 0.7])
@pytest.mark.parametrize("by", ["cli", "plc", "page"])
def test_what_one_is_refused_stands_on_the_page_within_half_a_second(
    by: str, after_s: float, tmp_path: Path
) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell, Views(cell).open() as views:
            told = views.page
            await cell.until(lambda: views.page is not told, "the next state of a quiet cell")
            await cell.clock.sleep(after_s)
            begun = cell.clock.now()
            await views.ask(by, "resume")
            while not any("resume" in w["what"] or "command 6" in w["what"] for w in views.page["writes"]):
                assert cell.clock.now() - begun <= LIMIT_S, views.page["writes"]
                await cell.clock.sleep(0.01)
            assert [w["accepted"] for w in views.page["writes"]][-1] is False

    run_virtual(main())
