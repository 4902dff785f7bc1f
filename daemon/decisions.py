"""What a decision on a calibration means for this cell: may it be made, what uses it, what warned of it."""

from collections.abc import Mapping, Sequence
from typing import Any

from cell.calibrations import OF_A_TOOL, kinematics
from cell.errors import error
from cell.procedure import Procedure, Run
from cell.store.ledger import Ledger
from daemon.config import CellConfig
from daemon.tools import tool_names


def warnings_of(row: Mapping[str, Any]) -> list[str]:
    """Why a result is less than a pass; empty for one that passed, or has no verdict."""
    result = row.get("result")
    if not isinstance(result, Mapping) or result.get("verdict") != "warn":
        return []
    texts = [str(w.get("text")) for w in result.get("warnings") or []] + list(result.get("reasons") or [])
    return list(dict.fromkeys(texts)) or ["its verdict is warn"]


def check_decidable(ledger: Ledger, running: Run | None, result_id: int) -> None:
    """``NOT_NOW`` for a result of the running job: it decides about it itself, or has yet to end."""
    if running is not None and ledger.result(result_id)["run_id"] == running.id:
        raise error(
            "NOT_NOW", f"run {running.id} ({running.procedure.name}) still works on result {result_id}"
        )


def check_confirmed(ledger: Ledger, jobs: Mapping[str, type[Procedure]], result_id: int) -> None:
    """``NOT_NOW`` for a candidate that its own run should have confirmed and could not even reject."""
    job = ledger.job_of_open_result(result_id)
    if job is not None and job in jobs and jobs[job].decides:
        raise error(
            "NOT_NOW", f"result {result_id} was never confirmed by its {job}; reject it and start another"
        )


def require_read(row: Mapping[str, Any], read: bool) -> None:
    """``RESULT_WARNS`` for a result with warnings unless whoever accepts it says that they were read."""
    if not read and (found := warnings_of(row)):
        raise error("RESULT_WARNS", f"result {row['id']} ({row['name']}): {'; '.join(found)}")


def use_of(config: CellConfig, name: str, version: Any) -> str:
    """In a sentence: what uses this version of the calibration ``name`` in this cell, if anything does."""
    it = f"{name} version {version}"
    roles = config.robot.roles()
    kind, _, owner = name.partition(".")
    if kind == "kinematics":
        if name != kinematics(roles.get("arm", "")):
            return f"{it} is accepted and not used for moves: '{owner}' is not the arm of [robot]."
        if not config.robot.use_kinematics:
            return (
                f"{it} is accepted and not used: [robot] use_kinematics is false. With true, the daemon's "
                "own moves and poses go by it."
            )
        return (
            f"{it} is in effect from the next job on: moves and poses go by it. Values that were calibrated "
            "with another model no longer fit; 'cellward check' lists them."
        )
    tools = tool_names(config)
    if kind in OF_A_TOOL and owner not in tools:
        there = (
            f"the tool of [robot] is '{tools[0]}'" if len(tools) == 1 else _in_a_row("the tools are", tools)
        )
        return f"{it} is accepted and not used: {there}."
    if kind in ("belt", "time_offset_s") and owner not in roles.values():
        return f"{it} is accepted and not used: no role of [robot] names '{owner}'."
    more = ""
    if kind == "T_flange_tool":
        more = ": the arm moves by the new tool's point"
        if others := [tool for tool in tools if tool != owner]:
            more += f" while '{owner}' is on the flange; {_in_a_row('nothing changes for', others)}"
    return f"{it} is in effect from the next job on{more}."


def _in_a_row(words: str, names: Sequence[str]) -> str:
    return f"{words} {' and '.join(repr(name) for name in names)}"
