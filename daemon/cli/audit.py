"""``cellward audit``: who wrote what from outside, what was refused, and which runs were removed."""

import heapq
from typing import Annotated, Any

import typer

from daemon.cli.options import ConfigOption, JsonOption, cell_paths
from daemon.cli.output import out_json, out_table, say
from procedures.words import local_time


def audit(
    limit: Annotated[int, typer.Option("--limit", "-n", min=1, help="How many of the newest.")] = 20,
    channel: Annotated[
        str | None,
        typer.Option("--channel", help="Only this channel: control, modbus or prune.", show_default=False),
    ] = None,
    who: Annotated[
        str | None, typer.Option("--who", help="Only names that contain this text.", show_default=False)
    ] = None,
    refused: Annotated[bool, typer.Option("--refused", help="Only what was refused.")] = False,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Writes from outside, accepted and refused, and removals of runs, newest last. It needs no daemon."""
    from daemon.cli.pruned_text import audit_lines as removals

    paths = cell_paths(config)
    found: list[dict[str, Any]] = []
    if paths.ledger.exists():
        from cell.store.ledger import Ledger

        ledger = Ledger(paths.ledger, read_only=True)
        try:
            found = ledger.audit_lines(limit, channel=channel, who=who, refused=refused)[::-1]
        finally:
            ledger.close()
    if channel in (None, "prune") and not refused:
        removed = [line for line in removals(paths.runs) if who is None or who.lower() in line["who"].lower()]
        found = _together(found, removed)[-limit:]
    if as_json:
        out_json(found)
    elif not found:
        say("The audit holds no such line.")
    else:
        columns = ("time", "channel", "who", "what", "outcome", "detail")
        out_table(columns, (_row(line) for line in found), give_way=("detail",))


def _together(*lists: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The lines by their time, each list in its own order: a clock that was set back changes none.

    They are put together from the newest on, so that how many older ones were read makes no difference.
    """
    newest_first = (reversed(lines) for lines in lists)
    return list(heapq.merge(*newest_first, key=lambda line: line["at"], reverse=True))[::-1]


def _row(line: dict[str, Any]) -> list[Any]:
    outcome = "accepted" if line["accepted"] else "refused"
    return [local_time(line["at"]), line["channel"], line["who"], line["what"], outcome, line["detail"]]
