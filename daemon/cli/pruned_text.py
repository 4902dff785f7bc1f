"""What ``cellward prune`` removed, in words: for the audit, and for who asks after a run that is gone."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from procedures.words import local_time

KEPT = "kept are its line in runs/pruned.jsonl and what the ledger holds of its results ('cellward results')"


def removed_folder(runs: Path, run_id: int) -> str | None:
    """A sentence about a run whose folder was removed; None for a run that was not."""
    told = [e for e in _of(runs, run_id) if not e["pictures"]]
    if not told:
        return None
    entry = told[-1]
    return (
        f"the folder of run {run_id} ({entry['job']}, {_size(entry)}) was removed by 'cellward prune' on "
        f"{local_time(entry['at'])} by {entry['who']}, for it was {_reason(entry)}; {KEPT}"
    )


def removed_pictures(runs: Path, run_id: int) -> list[str]:
    """A sentence for each time that pictures of this run were removed."""
    return [
        f"{entry['pictures']} pictures ({_size(entry)}) were removed by 'cellward prune' on "
        f"{local_time(entry['at'])} by {entry['who']}: {entry['why']}; the pictures that "
        "the solution uses are kept"
        for entry in _of(runs, run_id)
        if entry["pictures"]
    ]


def audit_lines(runs: Path) -> list[dict[str, Any]]:
    """The removals as lines of the audit, oldest first."""
    from cell.store.pruning import removals_recorded

    return [
        {
            "at": entry["at"],
            "channel": "prune",
            "who": entry["who"],
            "what": f"remove {_what(entry)} of run {entry['run_id']} ({entry['job']})",
            "accepted": True,
            "detail": f"{_size(entry)}; {entry['why']}",
        }
        for entry in removals_recorded(runs)
    ]


def _of(runs: Path, run_id: int) -> list[dict[str, Any]]:
    from cell.store.pruning import removals_recorded

    return [entry for entry in removals_recorded(runs) if entry["run_id"] == run_id]


def _what(entry: Mapping[str, Any]) -> str:
    return f"{entry['pictures']} pictures" if entry["pictures"] else "the folder"


def _size(entry: Mapping[str, Any]) -> str:
    return f"{entry['bytes'] / 1e6:.1f} MB"


def _reason(entry: Mapping[str, Any]) -> str:
    why = str(entry["why"])
    return why if why.startswith("older") else f"one of the oldest, and {why}"
