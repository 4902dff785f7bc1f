"""The runs of a cell as a list shows them: what each came to, who decided about it, and who signed it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cell.errors import CellError
from cell.formats.main_figure import MainFigure, read_main_figure
from cell.store.ledger import Ledger
from cell.store.run_fields import tool_on_flange
from cell.store.runs import RunFolder, list_runs
from cell.store.signatures import Checked, check_signatures

REPORT_FILE = "report.html"


@dataclass(frozen=True)
class ListedRun:
    """One run; stamps are ISO text. ``outcome`` is None while it goes on or was interrupted.

    ``tool`` is what was on the flange, where ``run.json`` says it; ``cause`` says why it failed; ``decided``
    are the ledger's rows about its results, without their values.
    """

    run_id: int
    job: str
    tool: str | None
    folder: str
    twin: bool
    started: str | None
    ended: str | None
    outcome: str | None
    verdict: str | None
    figure: MainFigure | None
    cause: str | None
    who: str | None
    decided: Sequence[Mapping[str, Any]]
    signatures: Sequence[Checked]
    report: bool


def listed_runs(runs: Path, ledger: Ledger | None, newest: int) -> list[ListedRun]:
    """The newest runs below ``runs``, the newest first; one that cannot be read hides no other.

    It reads every file of the runs that are signed. A cell without a ledger has no decisions.
    """
    found = list_runs(runs, newest)[::-1]
    started, decided = dict[int, Any](), dict[int, list[dict[str, Any]]]()
    if ledger is not None and found:
        started = {row["run_id"]: row["who"] for row in ledger.runs(newest)}
        decided = ledger.decisions_since(min(run.run_id for run in found))
    return [_listed(run, started.get(run.run_id), decided.get(run.run_id, [])) for run in found]


def _listed(run: RunFolder, who: str | None, decided: Sequence[Mapping[str, Any]]) -> ListedRun:
    end = _end_of(run)
    failure = end.get("error") or {}
    config = run.info.get("config")
    cell = config.get("cell") if isinstance(config, Mapping) else None
    return ListedRun(
        run_id=run.run_id,
        job=run.job,
        tool=tool_on_flange(run.info),
        folder=run.path.name,
        twin=bool(isinstance(cell, Mapping) and cell.get("twin")),
        started=run.info.get("started"),
        ended=end.get("ended"),
        outcome=end.get("outcome"),
        verdict=end.get("verdict"),
        figure=read_main_figure(end.get("figure")),
        cause=failure.get("text"),
        who=who,
        decided=decided,
        signatures=check_signatures(run.path),
        report=(run.path / REPORT_FILE).exists(),
    )


def _end_of(run: RunFolder) -> Mapping[str, Any]:
    try:
        return {"outcome": "unreadable"} if "unreadable" in run.info else run.read_end() or {}
    except CellError:
        return {"outcome": "unreadable"}
