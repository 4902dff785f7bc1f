"""Accepting a result: warnings have to be read first, and what uses the accepted version is said."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cell.errors import CellError
from daemon.decisions import require_read, use_of, warnings_of
from daemon.modbus.command import Command
from daemon.plc import PlcFace
from fakes.object import run_virtual
from tests.kit.object_cell import WHO, no_report, open_cell, refused, write_config

__all__ = ["no_report"]

WARNED: dict[str, Any] = {
    "verdict": "warn",
    "warnings": [{"code": "kincal.few", "text": "16 samples for 30 unknowns"}],
    "reasons": [],
}


def cell(use_kinematics: bool = False, tool: str = "pin") -> Any:
    robot = SimpleNamespace(
        use_kinematics=use_kinematics,
        tool=SimpleNamespace(name=tool),
        plain_tool=True,
        roles=lambda: {"arm": "arm", "beams": "io", "belt": "encoder"},
    )
    return SimpleNamespace(robot=robot, tool={})


@pytest.mark.parametrize(
    ("name", "config", "words"),
    [
        ("kinematics.arm", cell(), "accepted and not used: [robot] use_kinematics is false"),
        ("kinematics.arm", cell(use_kinematics=True), "moves and poses go by it"),
        ("kinematics.other", cell(use_kinematics=True), "not used for moves: 'other' is not the arm"),
        ("T_flange_tool.pin", cell(), "is in effect from the next job on: the arm moves by"),
        (
            "T_flange_tool.pin",
            cell(tool="gripper"),
            "accepted and not used: the tool of [robot] is",
        ),
        ("laser_reference.pin", cell(tool="gripper"), "accepted and not used"),
        ("belt.encoder", cell(), "is in effect from the next job on"),
        ("belt.old", cell(), "accepted and not used: no role of [robot] names 'old'"),
        ("T_flange_camera", cell(), "is in effect from the next job on"),
    ],
)
def test_what_uses_an_accepted_version_is_said(name: str, config: Any, words: str) -> None:
    text = use_of(config, name, 3)
    assert text.startswith(f"{name} version 3 is ")
    assert words in text


def test_a_result_with_warnings_is_accepted_by_who_has_read_them() -> None:
    row = {"id": 4, "name": "kinematics.arm", "result": WARNED}
    assert warnings_of(row) == ["16 samples for 30 unknowns"]
    with pytest.raises(CellError, match=r"result 4 \(kinematics.arm\): 16 samples for 30 unknowns") as caught:
        require_read(row, read=False)
    assert caught.value.name == "RESULT_WARNS"
    assert "--warned" in caught.value.hint
    require_read(row, read=True)
    require_read({**row, "result": {**WARNED, "verdict": "pass"}}, read=False)


@pytest.mark.usefixtures("no_report")
def test_the_engine_refuses_a_silent_accept_and_tells_what_waits(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            row = cell.ledger.propose("kinematics.arm", {"robot": {}}, WARNED, 7, None)
            await cell.engine.decisions.look()
            waits = [{"id": row, "name": "kinematics.arm", "run_id": 7}]
            assert cell.engine.status()["waiting"] == waits
            refusal = await refused(cell.engine.decisions.accept(row, WHO))
            assert refusal.name == "RESULT_WARNS"
            assert cell.ledger.result(row)["state"] == "proposed", "nothing happened"
            entry = await cell.engine.decisions.accept(row, WHO, warned=True)
            assert "accepted and not used" in entry["use"]
            assert cell.engine.status()["waiting"] == []

    run_virtual(main())


@pytest.mark.usefixtures("no_report")
def test_a_plc_that_may_accept_goes_by_its_bit_that_warns(tmp_path: Path) -> None:
    async def main() -> None:
        config = write_config(tmp_path)
        modbus = config.modbus.model_copy(update={"allow_accept": True})
        async with open_cell(config) as cell:
            row = cell.ledger.propose("T_flange_camera", [0.0] * 6, WARNED, 7, None)
            face = PlcFace(config.model_copy(update={"modbus": modbus}), cell.engine)
            await face._accept(Command(8, 1, args=(0, 7, 0, 0, 0, 0)), "PLC 10.0.0.5")
            assert cell.ledger.result(row)["state"] == "committed"

    run_virtual(main())
