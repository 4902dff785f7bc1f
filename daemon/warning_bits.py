"""The bits of the register ``warning_bits``: what each one means, and when it is shown.

The place in ``WARNING_BITS`` is the bit's number, which a PLC's program relies on: a new one goes to the end.
A warning stops nothing. What stops a job is an error, with its code in ``error_code``.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from cell.formats.result import Figures


@dataclass(frozen=True)
class WarningContext:
    """What a warning may look at; ``last`` is the last run, None while a job runs or once acknowledged, and
    ``figures`` those of the last result, also then."""

    status: Mapping[str, Any]
    last: Mapping[str, Any] | None
    figures: Figures


@dataclass(frozen=True)
class WarningBit:
    """One warning: a name for programs, a meaning for the manual, and whether it is to be shown."""

    name: str
    meaning: str
    shown: Callable[[WarningContext], bool]


def _verdict_warn(cell: WarningContext) -> bool:
    return cell.last is not None and cell.last.get("verdict") == "warn"


def _steps_taken_again(cell: WarningContext) -> bool:
    return bool(cell.status["steps_taken_again"] or (cell.last or {}).get("steps_taken_again"))


def _device_not_ready(cell: WarningContext) -> bool:
    return any(device["state"] != "READY" for device in cell.status["devices"].values())


def _interrupted(cell: WarningContext) -> bool:
    return bool(cell.status["interrupted"])


def _tool_moved(cell: WarningContext) -> bool:
    return cell.last is not None and cell.figures.tool_moved


def _ledger_damaged(cell: WarningContext) -> bool:
    return bool(cell.status["ledger_damage"])


def _check_due(cell: WarningContext) -> bool:
    return bool(cell.status["due"])


def _disk_low(cell: WarningContext) -> bool:
    return bool(cell.status["disk"].get("warning"))


WARNING_BITS = (
    WarningBit("verdict_warn", "the last result's verdict is warn, until acknowledged", _verdict_warn),
    WarningBit(
        "steps_taken_again",
        "a short silence of a device interrupted steps that were taken again, of the running job or of the "
        "last one until it is acknowledged",
        _steps_taken_again,
    ),
    WarningBit("device_not_ready", "a configured device is not ready", _device_not_ready),
    WarningBit("run_interrupted", "the last start of the daemon found a run that had no end", _interrupted),
    WarningBit(
        "tool_moved",
        "the last laser-check found that the tool has moved: run laser-update; until acknowledged",
        _tool_moved,
    ),
    WarningBit(
        "ledger_damaged",
        "the ledger was damaged or missing and a new one begun, until 'cellward acknowledge-ledger'",
        _ledger_damaged,
    ),
    WarningBit("disk_low", "the disk of the runs is nearly full: run prune", _disk_low),
    WarningBit(
        "check_due", "a calibration is older or has seen more runs than [check_due] permits", _check_due
    ),
)


def warning_bits(cell: WarningContext) -> int:
    """The register's value."""
    return sum(1 << number for number, bit in enumerate(WARNING_BITS) if bit.shown(cell))
