"""Faults on real protocols, in one cell: what a probe tells, and how a run ends."""

import json
import subprocess
from collections.abc import Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from cell.calibrations import belt_scale
from cell.errors import CellError
from cell.store.journal import read_journal
from cell.store.ledger import Ledger
from cell.store.runs import JOURNAL_FILE
from fakes.twin.control import ask
from procedures.belt.items import CONTACT, Outcome
from tests.kit.contacts_stated import belt_result
from tests.kit.told_faults import Claim, Row, Told, Wanted
from tests.kit.wire_cell import BIN, WireCell, calibrate_camera, pause, shipped, wait_for, wire_cell

_FOLLOWING = {"descend", "grip"}
_SAME_S = 0.5  # between a contact's time by the job and by the world
_ATTEMPTS = 3  # a busy machine may be late for an arm that follows, which is no fault of the cell
_SHOWS_S = 0.3


@contextmanager
def wire_rows(bind: str) -> Iterator[list[Row]]:
    """The rows, to be played while twin and daemon run on ``bind``."""
    slider, reduced = {"fraction": 0.5}, dict[str, Any]()
    probed: dict[str, list[str]] = {}

    def first(cell: WireCell) -> None:
        calibrate_camera(cell)
        _calibrate_belt(cell)
        for kind, arguments in (("speed-slider", slider), ("reduced-mode", reduced)):
            cell.inject("arm", kind, **arguments)
            pause(_SHOWS_S)
            probed[kind] = _probe(cell)
            cell.inject("arm", "clear")

    # a feed that lets the arm come back between two items
    scenario = shipped("picking", real=True, spacing_m=0.45, profile="[{ speed_m_s = 0.2 }]")
    with TemporaryDirectory() as folder, wire_cell(Path(folder), bind, scenario, first) as cell:

        def row(fault: str, wanted: Wanted, device: str, kind: str, **arguments: Any) -> Row:
            play = partial(_follow, cell, device, kind, arguments, probed.get(kind, []))
            return Row(fault, "with an item, on the wire", wanted, lambda _: play())

        yield [
            row("two nodes on one identifier", Wanted(code="ENCODER_TWO_SENDERS"), "belt", "second-sender"),
            row(
                "speed slider at 50 %",
                Wanted(check="the speed slider stands at 50 %", code="ARM_SPEED_SCALED"),
                "arm",
                "speed-slider",
                **slider,
            ),
            row(
                "reduced mode",
                Wanted(check="reduced mode", code="ARM_NOT_READY"),
                "arm",
                "reduced-mode",
                **reduced,
            ),
        ]


def _calibrate_belt(cell: WireCell) -> None:
    """Commit the belt as a calibration would have left it; without, what is stated of contacts is large."""
    config = cell.config()
    belt = config["robot"]["belt_nominal"]
    value, stated, nominal = belt_result(belt["m_per_count"], belt["dir"])
    with closing(Ledger(Path(config["cell"]["state_dir"]) / "ledger.sqlite")) as ledger:
        ledger.accept(ledger.propose(belt_scale("belt"), value, {"result": stated}, 0, nominal), "test")


def _probe(cell: WireCell) -> list[str]:
    """The warnings of ``cellward check --probe``."""
    command = [BIN / "cellward", "check", "--probe", "--json", "--config", cell.folder / "cell.toml"]
    done = subprocess.run(
        [str(c) for c in command], capture_output=True, text=True, check=False, timeout=60.0
    )
    if not done.stdout:
        raise RuntimeError(f"no answer of the probe: {done.stderr}")
    found: list[str] = json.loads(done.stdout)["warnings"]
    return found


def _follow(cell: WireCell, device: str, kind: str, arguments: dict[str, Any], probed: list[str]) -> Told:
    """The fault is injected while the tool goes with its second item or a later one, and all is put right."""
    told = Told()
    for _ in range(_ATTEMPTS):
        wait_for(cell.ready, "all devices", 30.0)
        before = len(_contacts(cell))
        run_id = cell.start_job("belt-tracking")
        try:
            wait_for(partial(_follows, cell, run_id), "a pick, and the tool with an item", 90.0)
            cell.inject(device, kind, **arguments)
            injected = True
        except AssertionError:
            injected = False
        end = cell.wait_for_end(60.0)
        told = _told(cell, run_id, end, _contacts(cell)[before:], probed)
        _put_right(cell, device)
        if injected and told.code != "MOTION_WATCHDOG":
            break
    return told


def _follows(cell: WireCell, run_id: int) -> bool:
    status = cell.status()
    assert status["run_id"] == run_id, f"the run ended before: {status['last_run']}"
    return status["state"] in _FOLLOWING and bool(status["live"]["picks"])


def _contacts(cell: WireCell) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = ask(cell.folder, {"do": "truth"})["gripper"]["contacts"]
    return found


def _told(
    cell: WireCell, run_id: int, end: dict[str, Any], contacts: list[dict[str, Any]], probed: list[str]
) -> Told:
    at_rest = not cell.moving()
    ledger = Ledger(Path(cell.config()["cell"]["state_dir"]) / "ledger.sqlite", read_only=True)
    picked = sum(row["outcome"] == Outcome.PICKED for row in ledger.items(run_id))
    ledger.close()
    folder = next(run for run in cell.runs() if run.run_id == run_id)
    claims = []
    for line in read_journal(folder.path / JOURNAL_FILE):
        if line.get("event") != "item" or "contact_95_m" not in line:
            continue
        at = next(t for t, what in line["history"] if what == CONTACT)
        met = [c for c in contacts if c["off_m"] is not None and abs(c["t_contact"] - at) < _SAME_S]
        if met:
            off = float(np.linalg.norm(met[0]["off_m"]))
            claims.append(Claim(off / line["contact_95_m"], off))
    return Told(
        probed,
        end["outcome"],
        end["error"]["name"] if end["error"] else None,
        picked=picked,
        taken=sum(bool(c["taken"]) for c in contacts),
        claims=claims,
        at_rest=at_rest,
    )


def _put_right(cell: WireCell, device: str) -> None:
    """The cause is gone, the gripper is empty, and the cell is reset."""
    cell.inject(device, "clear")
    wait_for(cell.ready, "all devices back", 30.0)
    ask(cell.folder, {"do": "gripper", "empty": True})

    def reset() -> bool:
        try:
            cell.call("reset")
        except CellError as refusal:
            if refusal.name != "NOT_NOW":
                raise
            return False
        return True

    wait_for(reset, "reset", 30.0)
