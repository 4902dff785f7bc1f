"""Every job by a PLC on the wire, whose program is what the manual tells: read, call the block, write."""

import time
from collections.abc import Callable, Iterator
from contextlib import closing
from importlib.resources import files
from pathlib import Path

import pytest
from pymodbus.client import ModbusTcpClient

from bench.hiccups import GRIPPING, SCENES, accept_proposed
from cell.store.ledger import Ledger
from fakes.twin.control import ask
from procedures.registry import JOBS
from tests.kit.structured_text import function_block
from tests.kit.wire_cell import WireCell, pause, wire_cell

pytestmark = [pytest.mark.wire, pytest.mark.soak]

SOURCE = files("daemon.modbus").joinpath("plc/cellward.st").read_text("utf-8")
CYCLE_S, LONGEST_S, WATCHED_S, STILL_S = 0.1, 400.0, 20.0, 3.0
PATIENT_S = 10.0  # a PLC is never busy with something else
STILL = ("belt-calibration", "corrected-targets")  # the arm of the twin takes no part
START, FINISH, ACCEPT, ACKNOWLEDGE, CONFIRM = 1, 2, 8, 9, 10


class Controller:
    """docs/plc.md: input registers 0 to 63 in one request, the block, holding registers 0 to 11 in one."""

    def __init__(self, host: str, port: int) -> None:
        self._client = ModbusTcpClient(host, port=port, timeout=5.0)
        assert self._client.connect()
        self.block = function_block(SOURCE, "FB_Cellward")
        self.block.set("Enable", True)

    def close(self) -> None:
        self._client.close()

    def is_so(self, name: str) -> bool:
        return bool(self.block.values[name])

    def number(self, name: str) -> int:
        return int(self.block.values[name])

    def cycle(self) -> None:
        begun = time.monotonic()
        read = self._client.read_input_registers(0, count=64)
        self.block.set("LinkOk", not read.isError())
        if not read.isError():
            self.block.set("Status", read.registers)
        self.block.cycle(begun)
        self._client.write_registers(0, list(self.block.values["Block"]))
        pause(max(begun + CYCLE_S - time.monotonic(), 0.0))

    def cycles(self, until: Callable[[], bool], limit_s: float = 30.0) -> None:
        give_up = time.monotonic() + limit_s
        while not until():
            assert time.monotonic() < give_up, self.block.values
            self.cycle()

    def give(self, command: int, job: int = 0, *arguments: int) -> None:
        for name, value in (("Command", command), ("Job", job)):
            self.block.set(name, value)
        for place in (1, 2, 3):
            self.block.set(f"Argument{place}", arguments[place - 1] if place <= len(arguments) else 0)
        for level in (False, True):
            self.block.set("Execute", level)
            self.cycle()
        self.cycles(lambda: not self.is_so("Busy"))
        assert self.is_so("Done"), (command, self.number("Reason"), self.is_so("NoAnswer"))


@pytest.fixture
def cell(tmp_path: Path, job: str) -> Iterator[WireCell]:
    scene = SCENES[job]

    def prepare(cell: WireCell) -> None:
        scene.first(cell)
        file = cell.folder / "cell.toml"
        text = file.read_text("utf-8")
        assert text.count("[modbus]\n") == 1
        file.write_text(text.replace("[modbus]\n", f"[modbus]\nheartbeat_timeout_s = {PATIENT_S}\n"), "utf-8")

    with wire_cell(tmp_path, "127.0.0.64", scene.text, prepare) as found:
        for before in scene.before:
            found.start_job(before)
            accept_proposed(found, found.wait_for_end(LONGEST_S)["run_id"])
        yield found


@pytest.mark.parametrize("job", sorted(SCENES))
def test_a_job_by_a_plc_alone(job: str, cell: WireCell) -> None:
    scene = SCENES[job]
    host, _, port = cell.config()["modbus"]["bind"].rpartition(":")
    given = scene.params(0)
    arguments = [int(given["slot"])] if "slot" in given else []

    with closing(Controller(host, int(port))) as plc:
        plc.cycles(lambda: plc.is_so("Ready"))
        plc.give(START, JOBS[job].number, *arguments)
        begun = time.monotonic()
        while not cell.moving() and time.monotonic() < begun + (STILL_S if job in STILL else WATCHED_S):
            plc.cycle()
            answer(plc, cell, job)
        plc.block.set("Stop", True)
        plc.cycles(lambda: not plc.is_so("JobRuns"))
        plc.block.set("Stop", False)
        assert cell.status()["last_run"]["outcome"] == "stopped"
        assert not plc.is_so("JobDone")
        assert not cell.moving()
        if job in GRIPPING:  # what is held is taken out by hand
            ask(cell.folder, {"do": "gripper", "empty": True})

        plc.cycles(lambda: plc.is_so("Ready") and cell.ready())
        plc.give(START, JOBS[job].number, *arguments)
        begun, finished = time.monotonic(), False
        plc.cycles(lambda: plc.is_so("JobRuns"))
        while plc.is_so("JobRuns"):
            spent = time.monotonic() - begun
            assert spent < LONGEST_S, cell.status()
            answer(plc, cell, job)
            if scene.finish_after_s is not None and spent > scene.finish_after_s and not finished:
                finished = True
                plc.give(FINISH)
            plc.cycle()
        assert plc.is_so("JobDone"), cell.status()["last_run"]["error"]
        assert plc.is_so("Valid"), cell.status()["last_run"]
        run_id = plc.number("RunId")
        if "proposed" in (states := results(cell, run_id)):  # others were accepted by [job.NAME] accept
            plc.give(ACCEPT, 0, run_id)
            states = results(cell, run_id)
        assert set(states) <= {"committed"}
        plc.give(ACKNOWLEDGE)
        plc.cycles(lambda: not plc.is_so("JobDone"))


def answer(plc: Controller, cell: WireCell, job: str) -> None:
    """A person does what is asked for, and the PLC says so."""
    if prompt := plc.number("PromptId"):
        SCENES[job].answer(cell, cell.status())
        plc.give(CONFIRM, 0, prompt)
        plc.cycles(lambda: plc.number("PromptId") != prompt)


def results(cell: WireCell, run_id: int) -> list[str]:
    """The states of what the run proposed."""
    with closing(Ledger(cell.folder / "state/ledger.sqlite", read_only=True)) as ledger:
        return [row["state"] for row in ledger.results() if row["run_id"] == run_id]
