"""What a PLC reads of the crossed-beam jobs, through the register table: tool offset, tilt, U, beams ok."""

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from cell.devices import DeviceState
from daemon.modbus.table import register_table
from daemon.plc import PlcFace
from daemon.stored_result import summary_of
from fakes.object import run_virtual
from procedures.documents import read_result
from tests.kit.object_cell import ObjectCell, open_cell, write_config
from tests.kit.whole_results import whole

RESULT: dict[str, Any] = {
    "kind": "laser",
    "verdict": "pass",
    "reasons": [],
    "result": {"dp_flange": [0.0012, -0.0007, 0.0005], "drot_flange": [0.006, 0.008, 0.0]},
    "uncertainty": {"U_point_m": 0.000031},
    "inputs": {"trend": {}},
}
VALID, BEAMS_OK = 1 << 6, 1 << 10


class Beams:
    """An input module as the supervisor keeps it."""

    def __init__(self, state: DeviceState, stuck: list[str]) -> None:
        self.state, self.device, self._stuck = state, self, stuck

    def health(self) -> dict[str, Any]:
        return {"stuck_s": dict.fromkeys(self._stuck, 7.5)}

    def status(self) -> dict[str, Any]:
        return {"state": self.state.value, **self.health()}


def registers(tmp_path: Path, result: dict[str, Any] | None, beams: Beams | None = None) -> dict[str, float]:
    """The status block as a master reads it after a run with ``result``, decoded by the table."""
    read: dict[str, float] = {}

    async def main() -> None:
        config = write_config(tmp_path)
        async with open_cell(config) as cell:
            subject = _face(cell, beams)
            if result is not None:
                verdict = result["verdict"]
                cell.engine.last = {
                    "run_id": 9,
                    "job": "laser-check",
                    "result": summary_of(result),
                    "verdict": verdict,
                }
                cell.engine.figures = read_result(whole(result)).figures()
            table = register_table()
            words = table.readable_words(subject.snapshot(), low_first=False)
            for r in table.status:
                read[r.name] = r.decode(words[r.address : r.address + r.words], low_first=False)

    run_virtual(main())
    return read


def _face(cell: ObjectCell, beams: Beams | None) -> PlcFace:
    config = cell.config
    if beams is not None:
        roles = {**config.robot.roles(), "beams": "beams"}
        robot = config.robot.model_copy(update={"devices": roles})
        config = config.model_copy(update={"robot": robot})
        cell.supervisor.devices["beams"] = beams  # type: ignore[assignment]
    return PlcFace(config, cell.engine)


def changed(**changes: Any) -> dict[str, Any]:
    """``RESULT`` with parts replaced."""
    return copy.deepcopy(RESULT) | changes


def test_offset_tilt_and_uncertainty_of_a_tool_check_stand_in_their_registers(tmp_path: Path) -> None:
    read = registers(tmp_path, RESULT)
    offset = [read[f"tool_offset_{axis}_m"] for axis in "xyz"]
    assert offset == pytest.approx([0.0012, -0.0007, 0.0005], rel=1e-6)
    assert read["tool_tilt_rad"] == pytest.approx(0.010, rel=1e-6)
    assert read["predicted_95_m"] == pytest.approx(31e-6, rel=1e-6)
    assert int(read["status"]) & VALID


def test_addresses_are_those_of_the_manual() -> None:
    at = {r.name: r.address for r in register_table().status}
    names = ("tool_offset_x_m", "tool_offset_y_m", "tool_offset_z_m", "tool_tilt_rad", "predicted_95_m")
    assert [at[name] for name in names] == [32, 34, 36, 38, 42]


def test_tilt_that_was_not_measured_reads_zero(tmp_path: Path) -> None:
    read = registers(tmp_path, changed(result={**RESULT["result"], "drot_flange": None}))
    assert read["tool_tilt_rad"] == 0.0
    assert read["tool_offset_x_m"] > 0.0


def test_refused_measurement_shows_no_figures_and_is_not_valid(tmp_path: Path) -> None:
    read = registers(tmp_path, changed(verdict="fail", result=None, uncertainty={}))
    assert not int(read["status"]) & VALID
    names = ("tool_offset_x_m", "tool_tilt_rad", "predicted_95_m")
    assert [read[name] for name in names] == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("result", "valid"),
    [
        (changed(inputs={"update": {"second_scan": {"meets": True}, "committed": True}}), True),
        (changed(inputs={"update": {"committed": False, "why": "turned down"}}), False),
        (
            changed(verdict="fail", inputs={"update": {"second_scan": {"meets": False}, "committed": False}}),
            False,
        ),
        (changed(verdict="fail", reasons=["bent tool: 4 mm"]), False),
        (changed(verdict="warn"), True),
    ],
)
def test_result_is_valid_only_when_an_update_took_effect(
    tmp_path: Path, result: dict[str, Any], valid: bool
) -> None:
    assert bool(int(registers(tmp_path, result)["status"]) & VALID) is valid


def test_figures_of_a_bent_tool_are_still_shown(tmp_path: Path) -> None:
    read = registers(tmp_path, changed(verdict="fail", reasons=["bent tool: 4 mm"]))
    assert read["tool_offset_x_m"] == pytest.approx(0.0012, rel=1e-6)


@pytest.mark.parametrize(
    ("beams", "ok"),
    [
        (lambda: None, False),
        (lambda: Beams(DeviceState.READY, []), True),
        (lambda: Beams(DeviceState.READY, ["xs"]), False),
        (lambda: Beams(DeviceState.RETRYING, []), False),
    ],
)
def test_beams_are_ok_when_their_module_is_ready_and_no_input_is_stuck(
    tmp_path: Path, beams: Callable[[], Beams | None], ok: bool
) -> None:
    assert bool(int(registers(tmp_path, None, beams())["status"]) & BEAMS_OK) is ok


@pytest.mark.parametrize("table", ["passes", "rows"])
def test_a_long_table_of_any_name_stays_out_of_the_status(table: str) -> None:
    reference = {"schema": "cellward.laser-reference/1", "hits": {}, table: [{"beam": "xs"}] * 1000}
    shown = summary_of({"kind": "laser-reference", "verdict": "pass", "result": reference})
    assert shown is not None
    assert shown["result"] == {"schema": "cellward.laser-reference/1", "hits": {}}
    assert shown["left_out"] == [f"result.{table}"]
    assert len(reference[table]) == 1000
