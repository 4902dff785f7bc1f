"""``cellward prune``: remove run folders and pictures that nothing rests on."""

import getpass
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from cell.errors import error
from daemon.cli.options import CellPaths, ConfigOption, JsonOption, cell_paths
from daemon.cli.output import out, out_json, say
from procedures.words import table

NEEDED_STATES = ("proposed", "accepted", "committed", "superseded", "rolled-back")


def prune(
    runs: Annotated[
        int | None, typer.Option("--runs", min=1, help="Keep the newest of so many runs.", show_default=False)
    ] = None,
    days: Annotated[
        float | None,
        typer.Option(
            "--days", min=0.0, max=36500.0, help="Keep runs not older than this.", show_default=False
        ),
    ] = None,
    gigabytes: Annotated[
        float | None,
        typer.Option(
            "--gb", min=0.0, max=1e6, help="Keep so many of 10^9 bytes of runs.", show_default=False
        ),
    ] = None,
    pictures: Annotated[
        bool,
        typer.Option(
            "--pictures", help="Also pictures of complete captures that their solution does not use."
        ),
    ] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only list what would be removed.")] = False,
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Remove without asking.")] = False,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """Remove old run folders, by the bounds given here or by the section cell.keep. It needs no daemon.

    Never removed: a run without an end, the newest run, and a run that a calibration rests on which is
    proposed, accepted, in effect, or can be returned to.
    """
    from cell.store.pruning import Keep, Removal, carry_out, plan, plan_pictures

    paths = cell_paths(config)
    keep = Keep(runs, days, gigabytes)
    if keep == Keep() and (configured := _configured(paths.config)) is not None:
        keep = configured
    if keep == Keep() and not pictures:
        raise error("ARGUMENT_INVALID", "nothing bounds the runs; give --runs, --days, --gb or --pictures, "
                    "or set [cell.keep]")  # fmt: skip

    def planned() -> list[Removal]:
        removals = plan(paths.runs, keep, needed_runs(paths)) if keep != Keep() else []
        if pictures:
            removals += plan_pictures(paths.runs, without=[r.run_id for r in removals])
        return removals

    removals = planned()
    if not as_json:
        _show([r.as_dict() for r in removals])
    carried_out = bool(removals) and not dry_run and (yes or (not as_json and typer.confirm("Remove them?")))
    if carried_out:
        if not yes:  # the answer may have taken long, and the daemon goes on meanwhile
            _require_the_same(removals, planned())
        carry_out(paths.runs, removals, getpass.getuser())
    if as_json:
        total = sum(r.bytes for r in removals)
        out_json({"removed": carried_out, "bytes": total, "runs": [r.as_dict() for r in removals]})
    elif removals:
        say("Removed." if carried_out else "Nothing was removed.")


def _require_the_same(shown: Sequence[Any], planned: Sequence[Any]) -> None:
    """``NOT_NOW`` unless what was shown is what would be removed at this moment."""
    before, at_present = ({(r.run_id, r.files) for r in each} for each in (shown, planned))
    if changed := sorted({run_id for run_id, _ in before ^ at_present}):
        numbers = ", ".join(map(str, changed))
        raise error(
            "NOT_NOW",
            f"what may be removed of run {numbers} changed since the list was shown, and nothing was "
            "removed; give the command again",
        )


def needed_runs(paths: CellPaths) -> dict[int, str]:
    """The runs that calibrations rest on, by number with the calibration's name.

    ``NOT_NOW`` while a damaged ledger has not been acknowledged, for then this cannot be known;
    ``LEDGER_DAMAGED``, or ``FILE_UNREADABLE`` where runs have no ledger.
    """
    if not paths.ledger.exists() and not any(paths.runs.glob("*")):
        return {}
    from cell.store.ledger import Ledger

    ledger = Ledger(paths.ledger, read_only=True)
    try:
        if ledger.damage() is not None:
            raise error(
                "NOT_NOW",
                "the ledger was damaged, so it is unknown what rests on which run; look at 'cellward "
                "results', then 'cellward acknowledge-ledger'",
            )
        rows = ledger.results(limit=-1)
    finally:
        ledger.close()
    return {row["run_id"]: row["name"] for row in rows if row["state"] in NEEDED_STATES}


def _configured(path: Path) -> Any:
    from cell.store.pruning import Keep
    from daemon.config import load_config

    found = load_config(path).cell.keep
    return None if found is None else Keep(found.runs, found.age_days, found.size_gb)


def _show(removals: list[dict[str, Any]]) -> None:
    if not removals:
        say("There is nothing to remove.")
        return
    columns = ("run", "job", "what", "frees MB", "why")
    rows = (
        [r["run_id"], r["job"], f"{r['pictures']} pictures" if r["pictures"] else "folder", _mb(r), r["why"]]
        for r in removals
    )
    out(table(columns, rows))
    out(f"{len(removals)} runs, {sum(r['bytes'] for r in removals) / 1e6:.1f} MB together")


def _mb(removal: dict[str, Any]) -> str:
    return f"{removal['bytes'] / 1e6:.1f}"
