"""The register of warnings: each bit has a meaning, and shows what the engine says."""

from typing import Any

import pytest

from cell.formats.result import Figures
from daemon.modbus import register_table
from daemon.warning_bits import WARNING_BITS, WarningContext, warning_bits
from tests.kit.warnings_shown import warnings_shown

QUIET: dict[str, Any] = {
    "steps_taken_again": 0,
    "devices": {"arm": {"state": "READY"}},
    "interrupted": [],
    "ledger_damage": None,
    "due": [],
    "disk": {"warning": None},
}


def shown(last: dict[str, Any] | None = None, moved: bool = False, **status: Any) -> list[str]:
    return warnings_shown(warning_bits(WarningContext(QUIET | status, last, Figures(tool_moved=moved))))


def test_nothing_to_warn_of_is_0() -> None:
    assert shown() == []
    assert shown({"verdict": "pass", "steps_taken_again": 0}) == []
    assert shown({"verdict": "fail"}) == []
    assert shown(None, moved=True) == []


@pytest.mark.parametrize(
    ("name", "last", "status"),
    [
        ("verdict_warn", {"verdict": "warn"}, {}),
        ("steps_taken_again", None, {"steps_taken_again": 2}),
        ("steps_taken_again", {"verdict": "pass", "steps_taken_again": 1}, {}),
        ("device_not_ready", None, {"devices": {"arm": {"state": "LOST"}}}),
        ("tool_moved", {"verdict": "fail"}, {"moved": True}),
        ("run_interrupted", None, {"interrupted": [7]}),
        ("disk_low", None, {"disk": {"warning": "1.2 GB are free"}}),
        ("ledger_damaged", None, {"ledger_damage": {"restored": {}}}),
        ("check_due", None, {"due": [{"name": "T_flange_tool.gripper"}]}),
    ],
)
def test_each_warning_has_a_bit_of_its_own(
    name: str, last: dict[str, Any] | None, status: dict[str, Any]
) -> None:
    assert shown(last, **status) == [name]


def test_the_bits_fit_the_register_and_each_is_in_the_manual() -> None:
    assert len(WARNING_BITS) <= 16
    assert len({bit.name for bit in WARNING_BITS}) == len(WARNING_BITS)
    register = next(r for r in register_table().status if r.name == "warning_bits")
    assert list(register.bits) == [bit.meaning for bit in WARNING_BITS]
