"""Commands that read the run folders; none of them needs the daemon."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from cell.errors import CellError, error
from cell.store.fingerprint import SIGNATURES_FILE
from cell.store.run_fields import tool_on_flange
from daemon.cli.damaged import reading
from daemon.cli.failures import FAILED
from daemon.cli.options import CellPaths, ConfigOption, JsonOption, cell_paths, know_configured_jobs
from daemon.cli.output import out, out_json, out_table, say
from procedures.words import local_time, table

RunArgument = Annotated[int, typer.Argument(help="The number of a run.", show_default=False)]


def load(config: Path | None, run_id: int) -> Any:
    """The folder of a run; ``NOT_FOUND``, which says when and why it was removed if it was."""
    from cell.store.runs import ALTERED, load_run

    runs = cell_paths(config).runs
    know_configured_jobs(config)
    try:
        run = load_run(runs, run_id)
    except CellError as exc:
        from daemon.cli.pruned_text import removed_folder

        if exc.name == "NOT_FOUND" and (removed := removed_folder(runs, run_id)):
            raise error("NOT_FOUND", removed) from exc
        raise
    if _end_or_reason(run).get("verdict") == ALTERED:
        told = f"the result of run {run_id} was altered after the run's end"
        say(f"Warning: {told}; see 'cellward verify {run_id}'")
    return run


def result_of(run: Any) -> dict[str, Any]:
    """The result of a run, or ``NOT_FOUND`` that says why there is none."""
    result: dict[str, Any] | None = run.read_result()
    if result is None:
        end = run.read_end()
        how = "was interrupted" if end is None else f"ended {end['outcome']}"
        raise error("NOT_FOUND", f"run {run.run_id} ({run.job}) {how} and has no result")
    return result


def runs(
    limit: Annotated[int, typer.Option("--limit", "-n", min=1, help="How many of the newest.")] = 20,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """The runs of this cell, newest last."""
    from cell.store.runs import list_runs

    found = [_row(run) for run in list_runs(cell_paths(config).runs, limit)]
    if as_json:
        out_json(found)
    elif not found:
        say("There are no runs yet; 'cellward start cone-capture' makes one.")
    else:
        columns = ("run", "job", "tool", "started", "outcome", "verdict")
        rows = (
            [r["run_id"], r["job"], r["tool"], local_time(r["started"]), r["outcome"], r["verdict"]]
            for r in found
        )
        out_table(columns, rows, give_way=("outcome",))


def _row(run: Any) -> dict[str, Any]:
    end = _end_or_reason(run)
    return {
        "run_id": run.run_id,
        "job": run.job,
        "tool": tool_on_flange(run.info),
        "started": run.info.get("started"),
        "outcome": end.get("outcome"),
        "verdict": end.get("verdict"),
        "folder": str(run.path),
    }


def _end_or_reason(run: Any) -> Mapping[str, Any]:
    """The end of a run; one that cannot be read is listed with its reason and hides no other run."""

    if "unreadable" in run.info:
        return {"outcome": f"unreadable: {run.info['unreadable']}"}
    try:
        end: dict[str, Any] | None = run.read_end()
    except CellError as exc:
        return {"outcome": f"unreadable: {exc.detail}"}
    return end or {"outcome": "running or interrupted"}


def show(run: RunArgument, config: ConfigOption = None, as_json: JsonOption = False) -> None:
    """One run: its journal as a timeline, how it ended, its result."""
    folder = load(config, run)
    with reading(folder.path):
        _show(folder, as_json)


def _show(folder: Any, as_json: bool) -> None:
    journal, end, result = folder.read_journal(), folder.read_end(), folder.read_result()
    if as_json:
        out_json({"run": folder.info, "journal": journal, "end": end, "result": result})
        return
    from daemon.cli.pruned_text import removed_pictures
    from daemon.words.journal_text import timeline
    from daemon.words.result_text import result_text

    tool = tool_on_flange(folder.info)
    told = f" of tool '{tool}'" if tool else ""
    out(f"run {folder.run_id}: {folder.job}{told}, started {local_time(folder.info.get('started'))}")
    out(f"folder  {folder.path}")
    for line in removed_pictures(folder.path.parent, folder.run_id):
        out(line)
    out(timeline(journal))
    if result is not None:
        out(result_text(result, str(folder.path / "result.json")))
    if end is None:
        out("no end: the run goes on, or it was interrupted (the next start of the daemon says which)")
    else:
        verdict = f", verdict {end['verdict']}" if end.get("verdict") else ""
        out(f"ended {local_time(end.get('ended'))}: {end['outcome']}{verdict}")
        if failure := end.get("error"):
            out(f"  {failure.get('text')} ({failure.get('code')})\n  {failure.get('hint')}")


def report(
    run: RunArgument,
    open_it: Annotated[bool, typer.Option("--open/--no-open", help="Show it in a browser.")] = False,
    rebuild: Annotated[bool, typer.Option("--rebuild", help="Draw it again from result.json.")] = False,
    pdf: Annotated[
        bool, typer.Option("--pdf", help="Print it to A4 pages; this needs Chromium or Chrome.")
    ] = False,
    figures: Annotated[
        bool, typer.Option("--csv", help="Write every figure of the result as a line of CSV.")
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Where the pages or figures go; beside the report unless given.",
            show_default=False,
        ),
    ] = None,
    config: ConfigOption = None,
) -> None:
    """Print where the report of a run is; it is drawn when it is missing.

    A run without a result has one that tells why it ended. What was decided and signed since is told.
    """
    if figures and (pdf or open_it or rebuild):
        raise error("ARGUMENT_INVALID", "--csv writes figures alone: leave out --pdf, --open and --rebuild")
    folder = load(config, run)
    if figures:
        with reading(folder.path):
            path = _write_figures(folder, output)
        out(str(path))
        return
    with reading(folder.path):
        path = renew_report(folder, cell_paths(config), rebuild)
    if pdf:
        from daemon.cli.printing import print_pdf

        path = print_pdf(path, output)
    elif output is not None:
        raise error("ARGUMENT_INVALID", "--output is for --pdf or --csv; give one of them, or leave it out")
    out(str(path))
    if open_it:
        typer.launch(path.as_uri())


def _write_figures(folder: Any, output: Path | None) -> Path:
    from cell.store.files import write_atomic
    from procedures.documents import read_result
    from procedures.report.figures_csv import FILE_NAME, figures_csv

    path: Path = output or folder.path / FILE_NAME
    document = result_of(folder)
    write_atomic(path, figures_csv(read_result(document, str(folder.path / "result.json"))))
    return path


def renew_report(folder: Any, paths: CellPaths, rebuild: bool = False) -> Path:
    """Draw the report of a run where it is missing, or older than what it tells; returns where it is.

    It is drawn at the end of the run first, and tells since then who decided about it and who signed it. Who
    may read the folder and not write it gets the report that is there, and is told so.
    """
    try:
        return _drawn(folder, paths, rebuild)
    except CellError as exc:
        path: Path = folder.path / "report.html"
        if exc.name not in ("DISK_FAILED", "DISK_FULL") or not path.exists():
            raise
        say(f"The report could not be drawn anew, this is an earlier one: {exc}")
        return path


def _drawn(folder: Any, paths: CellPaths, rebuild: bool) -> Path:
    path: Path = folder.path / "report.html"
    if not (folder.path / "result.json").exists():  # always anew: the run may have gone on
        from procedures.report.failed import write_failed_report

        return write_failed_report(folder.path, path)
    from cell.store.signatures import check_signatures
    from procedures.report.source import hides_altered

    decided = decisions(paths, folder.run_id)
    told = [folder.path / name for name in ("result.json", "end.json", SIGNATURES_FILE)]
    newest = max([p.stat().st_mtime for p in told if p.exists()] + [d["decided"] or 0.0 for d in decided])
    changed = any(signature.changed for signature in check_signatures(folder.path))
    stale = not path.exists() or path.stat().st_mtime < newest
    stale = stale or hides_altered(folder.path, path.read_text("utf-8", errors="replace"))
    if rebuild or changed or stale:
        result_of(folder)
        from procedures.report.write import write_report

        write_report(folder.path, path, decided=decided)
    return path


def decisions(paths: CellPaths, run_id: int) -> list[dict[str, Any]]:
    """What became of the results of a run, by the ledger; empty without one."""
    if not paths.ledger.exists():
        return []
    from cell.store.ledger import Ledger

    ledger = Ledger(paths.ledger, read_only=True)
    try:
        return ledger.decisions_on(run_id)
    finally:
        ledger.close()


def replay(run: RunArgument, config: ConfigOption = None, as_json: JsonOption = False) -> None:
    """Solve the data of a run again; exit code 1 when the answer differs by more than 1e-9 (relative).

    Figures that the version which ran it did not record yet are named, and are no difference.
    """
    from daemon.cli.replay import TOLERANCE, differences
    from procedures.replay import solve_again

    folder = load(config, run)
    recorded = result_of(folder)
    with reading(folder.path):
        everywhere = differences(
            recorded, solve_again(folder.job, folder.path, folder.info, recorded).as_json()
        )
    found = [d for d in everywhere if not d["added"]]
    added = [d["where"] for d in everywhere if d["added"]]
    if as_json:
        answer = {"run_id": run, "same": not found, "tolerance": TOLERANCE, "differences": found}
        out_json({**answer, "not_recorded": added})
    elif found:
        out(f"run {run} does not replay:")
        out(table(("where", "recorded", "now"), ([d["where"], d["recorded"], d["now"]] for d in found)))
    else:
        out(f"run {run} replays: every figure is within {TOLERANCE:g} of what was recorded")
    if added and not as_json:
        say(f"An earlier version did not record these figures: {', '.join(added)}.")
    if found:
        raise typer.Exit(FAILED)


def compare(
    first: RunArgument,
    second: RunArgument,
    false_alarm: Annotated[
        float | None,
        typer.Option(
            help="How often results that differ by chance alone are called different: between 0 and 1. "
            "By default 1 of 300.",
            show_default=False,
        ),
    ] = None,
    config: ConfigOption = None,
    as_json: JsonOption = False,
) -> None:
    """The difference of two results of the same kind, against their uncertainties."""
    from procedures.comparison import compare_results

    folders = [load(config, number) for number in (first, second)]
    results = [result_of(folder) for folder in folders]
    with reading(folders[1].path.parent):
        found = compare_results(*results, false_alarm=false_alarm)
        text = found.text(f"run {first}", f"run {second}")
    if as_json:
        out_json({"runs": [first, second], **found.as_dict()})
    else:
        out(text)
