"""Commands about calibration results: what is proposed, what is in effect, and the decisions on them."""

from typing import Annotated, Any

import typer

from cell.errors import error
from daemon.cli.jobs import connect
from daemon.cli.options import CellPaths, ConfigOption, JsonOption, cell_paths
from daemon.cli.output import out_json, out_table, say
from daemon.words.value_text import in_a_list, value_text
from procedures.kinematics_in_use import in_words
from procedures.words import local_time

ResultArgument = Annotated[
    int, typer.Argument(help="The number that 'cellward results' shows.", show_default=False)
]


def results(
    which: Annotated[
        str | None,
        typer.Argument(
            metavar="[NAME|NUMBER]",
            help="Only this calibration, for instance T_flange_tool.gripper, or this result.",
        ),
    ] = None,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Proposed, committed and earlier calibrations, newest first.

    ``--json`` tells a document, such as a crossed-beam reference, in a line; with its name or number in full.
    """
    paths = cell_paths(config)
    found: list[dict[str, Any]] = []
    damage: dict[str, Any] | None = None
    if paths.ledger.exists():
        from cell.store.ledger import Ledger
        from cell.store.summary import whole_result

        ledger = Ledger(paths.ledger, read_only=True)
        try:
            if which is not None and which.isdecimal():
                row = ledger.result(int(which))
                found = [{**row, "result": whole_result(row, paths.runs) or row["result"]}]
            else:
                found = ledger.results(which)
            damage = ledger.damage()
        finally:
            ledger.close()
    else:
        _refuse_a_lost_ledger(paths)
    if damage is not None:
        from daemon.state_folder import damage_text

        say(f"Warning: {damage_text(damage)}. 'cellward acknowledge-ledger' ends this warning.")
    if as_json:
        out_json(found if which is not None else [in_a_list(entry) for entry in found])
    elif not found:
        say("There are no results yet; a finished job proposes one.")
    else:
        columns = (
            "result",
            "calibration",
            "state",
            "version",
            "run",
            "proposed",
            "decided by",
            "why",
            "made with",
            "value",
        )
        out_table(columns, (_row(entry) for entry in found), give_way=("value", "made with", "why"))
        if waiting := [entry for entry in found if entry["state"] == "proposed"]:
            say(f"To decide: cellward accept {waiting[0]['id']}, or cellward reject {waiting[0]['id']}.")


def _refuse_a_lost_ledger(paths: CellPaths) -> None:
    """``LEDGER_DAMAGED`` where none is in place and its copy says that there was one."""
    from cell.store.calibration_copy import FILE, holds_rows

    if holds_rows(paths.state_dir):
        raise error(
            "LEDGER_DAMAGED", f"there is no {paths.ledger}, and {FILE} beside it has committed calibrations"
        )


def _row(entry: dict[str, Any]) -> list[Any]:
    keys = ("id", "name", "state", "version", "run_id")
    made = "" if entry["arm_model"] is None else in_words(entry["arm_model"])
    told = local_time(entry["proposed"]), entry["who"], entry["why"], made
    return [*(entry[k] for k in keys), *told, value_text(entry["name"], entry["value"])]


def accept(
    result: ResultArgument,
    warned: Annotated[
        bool, typer.Option("--warned", help="Accept it with its warnings, which you have read.")
    ] = False,
    config: ConfigOption = None,
) -> None:
    """Accept a result: it becomes the version in effect, from the next job on.

    A result with warnings is refused, and the warnings are listed, unless --warned says that they were read.
    """
    with connect(config) as daemon:
        entry = daemon.call("accept", result_id=result, warned=warned)
    say(entry["use"])


def reject(
    result: ResultArgument,
    why: Annotated[str, typer.Option("--why", help="The reason, kept with the result.")] = "",
    config: ConfigOption = None,
) -> None:
    """Reject a result; the version in effect stays."""
    with connect(config) as daemon:
        entry = daemon.call("reject", result_id=result, why=why)
    say(f"Result {result} ({entry['name']}) is rejected; nothing else changed.")


def rollback(
    name: Annotated[
        str, typer.Argument(help="The calibration, for instance T_flange_camera.", show_default=False)
    ],
    config: ConfigOption = None,
) -> None:
    """Go back to the version before, or to the configured value when there is none."""
    with connect(config) as daemon:
        entry = daemon.call("rollback", name=name)
    now = f"version {entry['version']}" if entry["version"] is not None else "the configured value"
    value = f": {value_text(name, entry['value'])}" if "value" in entry else ""
    say(f"{name}: {now} is in effect from the next job on{value}.")


def acknowledge_ledger(config: ConfigOption = None) -> None:
    """Acknowledge that the ledger was damaged, after a look at the calibrations in effect."""
    with connect(config) as daemon:
        daemon.call("acknowledge_ledger")
    say("Acknowledged. 'cellward results' lists the calibrations in effect; the damaged file is kept.")
