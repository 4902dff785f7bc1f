"""``cellward recover``: bring back what is kept of a damaged or missing ledger, and say what is lost."""

from pathlib import Path
from typing import Any

import typer

from cell.errors import error
from daemon.cli.options import ConfigOption, JsonOption, cell_paths
from daemon.cli.output import out, out_json, say
from procedures.words import table

LOST = ("results that waited for a decision", "audit", "trends", "items")


def recover(config: ConfigOption = None, as_json: JsonOption = False) -> None:
    """Bring back the committed calibrations of a ledger that is damaged or missing. The daemon is stopped.

    The daemon does the same when it starts. An intact ledger is left as it is. The damaged file is kept.
    """
    from cell.store.ledger import Ledger
    from cell.store.recovery import waiting_in
    from daemon.state_folder import claimed

    paths = cell_paths(config)
    if not paths.state_dir.is_dir():
        raise error("FILE_MISSING", f"there is no folder {paths.state_dir}, which is [cell] state_dir")
    with claimed(paths.state_dir):
        kept = paths.ledger.exists() or _copy(paths.state_dir).exists()
        if not kept:
            raise error("FILE_MISSING", f"{paths.state_dir} holds neither a ledger nor {_copy(Path()).name}")
        ledger = Ledger(paths.ledger)
        try:
            damage = ledger.damage()
            in_effect = [row for row in ledger.results(limit=-1) if row["state"] == "committed"]
        finally:
            ledger.close()
    aside = None if damage is None or damage["aside"] is None else Path(damage["aside"])
    waiting = None if aside is None else waiting_in(aside)
    if as_json:
        versions = {row["name"]: row["version"] for row in in_effect}
        lost = {"kinds": list(LOST) if damage else [], "waiting_results": waiting}
        out_json({"damage": damage, "in_effect": versions, "lost": lost})
    else:
        _show(damage, in_effect, waiting)
    if damage is not None and not in_effect:
        raise typer.Exit(1)


def _copy(state_dir: Path) -> Path:
    from cell.store.calibration_copy import FILE

    return state_dir / FILE


def _show(
    damage: dict[str, Any] | None, in_effect: list[dict[str, Any]], waiting: list[dict[str, Any]] | None
) -> None:
    from daemon.state_folder import damage_text

    if damage is None:
        say("The ledger is intact; there is nothing to recover.")
        return
    text = damage_text(damage)
    out(f"{text[0].upper()}{text[1:]}.")
    if damage.get("copy_aside"):
        out(f"The copy that did not bring all back is kept as {damage['copy_aside']}.")
    if in_effect:
        out(
            table(
                ("calibration", "version", "run"), ([r["name"], r["version"], r["run_id"]] for r in in_effect)
            )
        )
    out(f"Lost: {', '.join(LOST)}; the run folders are as they were.")
    if waiting:
        runs = ", ".join(f"{each['name']} of run {each['run_id']}" for each in waiting)
        out(f"These results waited for a decision, and their jobs have to be run again: {runs}.")
    elif waiting is None:
        out("Which results waited for a decision cannot be read any more.")
    say("Next: start the daemon, look at 'cellward results', then 'cellward acknowledge-ledger'.")
