"""The runs of a cell in its ledger: their numbers, how each began, and how it ended."""

from collections.abc import Collection
from typing import Any

from cell.errors import error
from cell.store.records import Records
from cell.store.tool_of import ANY_TOOL, ToolOf

MAX_RUN_ID = 2**32 - 1


class RunRows(Records):
    """One row a run, which is never removed."""

    def next_run_id(self) -> int:
        """A number from 1 that no run had before (uint32, as the registers carry it)."""
        with self._transaction():
            run_id = int(self.get_state("run_id", 0)) + 1
            if run_id > MAX_RUN_ID:
                raise error("INTERNAL", "the run numbers are used up")
            self.set_state("run_id", run_id)
        return run_id

    def start_run(
        self, run_id: int, job: str, folder: str, who: str, channel: str, tool: str | None = None
    ) -> None:
        """``tool`` is what was on the flange, None where that plays no part."""
        with self._transaction() as db:
            db.execute(
                "INSERT INTO runs (run_id, job, folder, who, channel, started, tool)"
                " VALUES (?, ?, ?, ?, ?, ?, ?)",
                (run_id, job, folder, who, channel, self._wall(), tool),
            )

    def end_run(self, run_id: int, outcome: str, verdict: str | None) -> None:
        """Write how a run ended; a run that a set-aside ledger knew and this one does not is no error."""
        with self._transaction() as db:
            db.execute(
                "UPDATE runs SET ended = ?, outcome = ?, verdict = ? WHERE run_id = ?",
                (self._wall(), outcome, verdict, run_id),
            )

    def open_runs(self) -> list[int]:
        """The numbers of the runs whose end was not written."""
        return [int(row["run_id"]) for row in self._rows("SELECT run_id FROM runs WHERE ended IS NULL")]

    def runs(self, limit: int = 100) -> list[dict[str, Any]]:
        """The newest runs first."""
        return self._rows("SELECT * FROM runs ORDER BY run_id DESC LIMIT ?", limit)

    def runs_since(self, t: float, without: Collection[str], of: ToolOf = ANY_TOOL) -> int:
        """How many runs ``of`` a tool began after ``t`` (time of day, s), without those of some jobs."""
        marks = ", ".join("?" for _ in without)
        query = f"SELECT COUNT(*) AS n FROM runs WHERE started > ? AND job NOT IN ({marks}) AND {of.sql}"
        return int(self._rows(query, t, *without, *of.values)[0]["n"])
