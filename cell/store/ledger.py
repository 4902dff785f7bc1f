"""The ledger: calibration versions, beside the runs and the records, in one SQLite file.

A calibration is *proposed*, *accepted* by someone, *committed* as a new version, and can be rolled back. The
effective value is the committed version, else the configured value. A version remembers the configured value
it replaced; if that was edited since, the two contradict each other until someone accepts or rolls back.
"""

import json
import time
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cell.errors import CellError, error, present
from cell.store._database import open_database, open_for_reading
from cell.store.calibration_copy import COLUMNS, FILE, STATES, holds_rows, is_current, write_copy
from cell.store.files import to_json
from cell.store.recovery import bring_back
from cell.store.run_rows import RunRows
from cell.store.runs import highest_run_id
from cell.store.summary import summary
from cell.store.tool_of import ANY_TOOL, ToolOf
from cell.store.versions_now import LastChange, VersionsNow

CHANGE_KEY = "last_change"
DAMAGE_KEY = "ledger_damaged"
OPEN_STATES = ("proposed", "accepted")
_JSON = ("value", "result", "config_value", "arm_model")


@dataclass(frozen=True)
class Effective:
    """The value in effect; ``version`` is None when it is the configured one.

    ``arm_model`` is the model of the arm that it was made with, None where that played no part or was not
    noted yet: such versions were made as the arm's controller believes. ``result`` is the summary of the
    result that the version comes from.
    """

    value: Any
    version: int | None
    conflict: bool
    result_id: int | None = None
    arm_model: dict[str, Any] | None = None
    result: dict[str, Any] | None = None


class Ledger(RunRows):
    """Every method is one durable transaction and may be called from any thread."""

    def __init__(self, path: Path, wall: Callable[[], float] = time.time, *, read_only: bool = False) -> None:
        """Open or make ``path``. A corrupt file is set aside: ``aside`` names it, and it is to be reported.

        What the copy beside it holds comes back then, and also where the file is missing. A new ledger goes
        on numbering behind the folders in ``runs`` beside it. With ``read_only`` nothing is made or set
        aside: ``LEDGER_DAMAGED`` or ``FILE_UNREADABLE`` instead.
        """
        self._configured: dict[str, Any] = {}
        if read_only:
            db, new, self.aside = open_for_reading(path), False, None
        else:
            db, new, self.aside = open_database(path)
        super().__init__(path, wall, db)
        if new and (highest := highest_run_id(path.parent / "runs")):
            self.set_state("run_id", highest)
        if not read_only:
            if self.aside is not None or self._lacks_what_is_copied(new):
                self._restore()
            elif not new:
                self._renew_copy()
        self._damage: dict[str, Any] | None = self.get_state(DAMAGE_KEY)
        self._now = self._next = VersionsNow() if read_only else self._read_versions()

    # -- after damage

    def damage(self) -> dict[str, Any] | None:
        """What a damaged or missing predecessor cost, until somebody acknowledges it; from memory.

        ``aside`` (None: the file was missing), ``at``, what :func:`bring_back` tells; ``still_open``: why the
        open file itself is damaged.
        """
        return self._broken or self._damage

    def acknowledge_damage(self) -> dict[str, Any]:
        """Somebody has seen it; ``NOT_NOW`` when there is nothing to acknowledge, or while it is so still."""
        if self._broken is not None:
            raise error("NOT_NOW", "the ledger is still damaged: start the daemon anew first")
        found = self._damage
        if found is None:
            raise error("NOT_NOW", "the ledger was not damaged, or that is acknowledged")
        self.set_state(DAMAGE_KEY, None)
        self._damage = None
        return found

    def _lacks_what_is_copied(self, new: bool) -> bool:
        """Rows never leave a ledger. One without any beside a copy that has some was lost, or begun by a
        start that could not bring them back, on a full disk for instance."""
        if new:
            return (self.path.parent / FILE).exists()
        return not self._rows("SELECT 1 FROM calibrations LIMIT 1") and holds_rows(self.path.parent)

    def _restore(self) -> None:
        """Bring back from the copy what was committed, and remember that the predecessor was lost."""
        with self._transaction() as db:
            aside = None if self.aside is None else str(self.aside)
            told = {"aside": aside, "at": self._wall(), **bring_back(db, self.path.parent)}
            self.set_state(DAMAGE_KEY, told)

    def _renew_copy(self) -> None:
        """The ledger is the truth: a copy that is missing, damaged or behind is written again."""
        rows = self._for_copy()
        if not is_current(self.path.parent, rows):
            with suppress(CellError):  # a full disk keeps nobody from starting; the next commit needs it
                write_copy(self.path.parent, rows)

    def _for_copy(self) -> list[dict[str, Any]]:
        columns = ", ".join(COLUMNS)
        return self._rows(
            f"SELECT {columns} FROM calibrations WHERE state IN (?, ?) ORDER BY id",
            *STATES,
        )

    # -- calibrations

    def checked_at(self, name: str, judging: Collection[str], of: ToolOf = ANY_TOOL) -> float | None:
        """When the version in effect was measured, or later a run of the jobs ``judging`` passed ``of`` a
        tool: time of day, s. None when no version is in effect and no such run passed."""
        marks = ", ".join("?" for _ in judging)
        rows = self._rows(
            "SELECT MAX(t) AS t FROM ("
            "SELECT proposed AS t FROM calibrations WHERE name = ? AND state = 'committed' UNION ALL "
            "SELECT ended FROM runs WHERE outcome = 'complete' AND verdict = 'pass'"
            f" AND job IN ({marks}) AND {of.sql})",
            name,
            *judging,
            *of.values,
        )
        found: float | None = rows[0]["t"]
        return found

    def propose(
        self,
        name: str,
        value: Any,
        result: Mapping[str, Any],
        run_id: int,
        config_value: Any,
        arm_model: Mapping[str, Any] | None = None,
        folder: str | None = None,
    ) -> int:
        """Offer ``value`` for ``name``; returns the result's number. Nothing changes until it is accepted.

        ``arm_model`` names the model of the arm that the value was made with. ``folder`` is the name of the
        run folder whose ``result.json`` keeps ``result`` whole; the ledger then keeps a summary of it.
        """
        self._configured[name] = json.loads(to_json(config_value))
        with self._transaction() as db:
            cursor = db.execute(
                "INSERT INTO calibrations"
                " (name, state, value, result, run_id, config_value, proposed, arm_model, folder)"
                " VALUES (?, 'proposed', ?, ?, ?, ?, ?, ?, ?)",
                (
                    name,
                    to_json(value),
                    to_json(result if folder is None else summary(result)),
                    run_id,
                    to_json(config_value),
                    self._wall(),
                    to_json(arm_model),
                    folder,
                ),
            )
        return present(cursor.lastrowid, "number of the new row")

    def accept(self, result_id: int, who: str, commit: bool = True, why: str = "") -> dict[str, Any]:
        """Accept a result, and commit it as the version in effect unless ``commit`` is False.

        Accepting the version that is in effect confirms it against a configured value that was edited.
        ``NOT_FOUND``, or ``NOT_NOW`` when the result was rejected or superseded.
        """
        with self._transaction() as db:
            row = self._result(result_id)
            if row["state"] not in (*OPEN_STATES, "committed", "rolled-back"):
                raise error("NOT_NOW", f"result {result_id} ({row['name']}) is {row['state']}")
            state = row["state"] if row["state"] == "committed" else "accepted"
            db.execute(
                "UPDATE calibrations SET state = ?, who = ?, why = ?, decided = ?, config_value = ?"
                " WHERE id = ?",
                (state, who, why or row["why"], self._wall(), self._known_config(row), result_id),
            )
            return self.commit(result_id) if commit else self._result(result_id)

    def commit(self, result_id: int) -> dict[str, Any]:
        """Make an accepted result the version in effect; ``NOT_NOW`` when nobody accepted it."""
        with self._transaction() as db:
            self._versions_changed = True
            row = self._result(result_id)
            if row["state"] == "accepted":
                name = row["name"]
                last = db.execute("SELECT MAX(version) FROM calibrations WHERE name = ?", (name,)).fetchone()
                db.execute(
                    "UPDATE calibrations SET state = 'superseded' WHERE name = ? AND state = 'committed'",
                    (name,),
                )
                db.execute(
                    "UPDATE calibrations SET state = 'committed', version = ? WHERE id = ?",
                    ((last[0] or 0) + 1, result_id),
                )
                self._note_change(name)
            elif row["state"] != "committed":
                raise error("NOT_NOW", f"result {result_id} ({row['name']}) is {row['state']}, not accepted")
            return self._result(result_id)

    def reject(self, result_id: int, who: str, why: str) -> dict[str, Any]:
        """Turn a proposed or accepted result down; ``NOT_NOW`` once it is committed."""
        with self._transaction() as db:
            row = self._result(result_id)
            if row["state"] not in OPEN_STATES:
                raise error("NOT_NOW", f"result {result_id} ({row['name']}) is {row['state']}")
            db.execute(
                "UPDATE calibrations SET state = 'rejected', who = ?, why = ?, decided = ? WHERE id = ?",
                (who, why, self._wall(), result_id),
            )
            return self._result(result_id)

    def rollback(self, name: str, who: str) -> dict[str, Any]:
        """Go back to the version before, or to the configured value when there is none.

        A version before that replaced another configured value than today's is passed over: it would only
        contradict the configuration again. Returns what is in effect now.
        """
        with self._transaction() as db:
            self._versions_changed = True
            row = self._committed(name)
            if row is None:
                raise error("NOT_NOW", f"{name} has no committed version")
            configured = self._configured.get(name, row["config_value"])
            self._set_rolled_back(row["id"], who)
            for before in self._rows(
                "SELECT * FROM calibrations WHERE name = ? AND state = 'superseded' ORDER BY version DESC",
                name,
            ):
                if json.loads(before["config_value"]) == configured:
                    db.execute("UPDATE calibrations SET state = 'committed' WHERE id = ?", (before["id"],))
                    break
                self._set_rolled_back(before["id"], who)
            self._note_change(name)
            now = self.effective(name, configured)
        return {"name": name, "version": now.version, "value": now.value, "rolled_back": row["version"]}

    def effective(self, name: str, config_value: Any) -> Effective:
        """The committed version of ``name``, else ``config_value`` (None when the config has none)."""
        with self._lock:
            self._configured[name] = json.loads(to_json(config_value))
            row = self._committed(name)
            if row is None:
                return Effective(config_value, None, False)
            conflict = row["config_value"] != self._configured[name]
            return Effective(
                row["value"], row["version"], conflict, row["id"], row["arm_model"], row["result"]
            )

    def versions_now(self) -> VersionsNow:
        """What is in effect, and what changed last; from memory, so the event loop may ask."""
        return self._now

    def in_effect(self, name: str) -> dict[str, Any] | None:
        """The committed version with the summary of its result, None when there is none.

        ``edited`` says whether today's configured value, if this process told it, is not the one replaced.
        """
        with self._lock:
            row = self._committed(name)
            if row is None:
                return None
            configured = self._configured.get(name, row["config_value"])
            return {**row, "edited": configured != row["config_value"]}

    def open_results_of(self, run_id: int) -> list[int]:
        """The results of a run that wait for a decision."""
        rows = self._rows(
            "SELECT id FROM calibrations WHERE run_id = ? AND state IN (?, ?) ORDER BY id",
            run_id,
            *OPEN_STATES,
        )
        return [int(row["id"]) for row in rows]

    def waiting_results(self) -> list[dict[str, Any]]:
        """``id``, ``name`` and ``run_id`` of every result that waits for a decision, oldest first."""
        return self._rows(
            "SELECT id, name, run_id FROM calibrations WHERE state IN (?, ?) ORDER BY id", *OPEN_STATES
        )

    def open_results_of_job(self, job: str) -> list[int]:
        """The results of all runs of a job that wait for a decision."""
        rows = self._rows(
            "SELECT c.id FROM calibrations c JOIN runs r ON r.run_id = c.run_id"
            " WHERE r.job = ? AND c.state IN (?, ?) ORDER BY c.id",
            job,
            *OPEN_STATES,
        )
        return [int(row["id"]) for row in rows]

    def job_of_open_result(self, result_id: int) -> str | None:
        """The job whose run proposed a result that waits for a decision; None for any other result."""
        rows = self._rows(
            "SELECT r.job FROM calibrations c JOIN runs r ON r.run_id = c.run_id"
            " WHERE c.id = ? AND c.state IN (?, ?)",
            result_id,
            *OPEN_STATES,
        )
        return str(rows[0]["job"]) if rows else None

    def results(self, name: str | None = None, limit: int = 100) -> list[dict[str, Any]]:
        """Calibrations of every state, newest first, without their results."""
        rows = self._rows(
            "SELECT id, name, state, version, value, run_id, config_value, proposed, decided, who, why,"
            " arm_model, folder"
            " FROM calibrations WHERE ? IS NULL OR name = ? ORDER BY id DESC LIMIT ?",
            name,
            name,
            limit,
        )
        return [_decoded(row) for row in rows]

    def decisions_on(self, run_id: int) -> list[dict[str, Any]]:
        """What became of the results of a run, oldest first: without values and results."""
        return self._rows(
            "SELECT id, name, state, version, proposed, decided, who, why FROM calibrations"
            " WHERE run_id = ? ORDER BY id",
            run_id,
        )

    def decisions_since(self, run_id: int) -> dict[int, list[dict[str, Any]]]:
        """What :meth:`decisions_on` tells of this run and all later ones, by run."""
        found: dict[int, list[dict[str, Any]]] = {}
        rows = self._rows(
            "SELECT run_id, id, name, state, version, proposed, decided, who, why FROM calibrations"
            " WHERE run_id >= ? ORDER BY id",
            run_id,
        )
        for row in rows:
            found.setdefault(row.pop("run_id"), []).append(row)
        return found

    def result(self, result_id: int) -> dict[str, Any]:
        """One calibration with the summary of its result; ``NOT_FOUND``. ``whole_result`` reads all of it."""
        return self._result(result_id)

    # -- inside

    def _copy_versions(self) -> None:
        write_copy(self.path.parent, self._for_copy())
        self._next = self._read_versions()

    def _versions_written(self) -> None:
        self._now = self._next

    def _note_change(self, name: str) -> None:
        """``name`` has another value in effect from now on."""
        last = self._now.change
        self.set_state(CHANGE_KEY, {"count": last.count + 1 if last else 1, "name": name, "at": self._wall()})

    def _last_change(self) -> LastChange | None:
        """As it was noted, or of a ledger that comes from a copy or from an earlier program, the newest."""
        if (noted := self.get_state(CHANGE_KEY)) is not None:
            return LastChange(**noted)
        newest = self._rows(
            "SELECT name, decided FROM calibrations WHERE state = 'committed' ORDER BY decided DESC LIMIT 1"
        )
        return LastChange(1, newest[0]["name"], newest[0]["decided"] or 0.0) if newest else None

    def _read_versions(self) -> VersionsNow:
        rows = self._rows("SELECT name, version FROM calibrations WHERE state = 'committed'")
        poses = self._rows(
            "SELECT name, value FROM calibrations WHERE state = 'committed' AND name GLOB 'T_*'"
        )
        return VersionsNow(
            self._last_change(),
            {row["name"]: row["version"] for row in rows},
            {row["name"]: json.loads(row["value"]) for row in poses},
        )

    def _result(self, result_id: int) -> dict[str, Any]:
        rows = self._rows("SELECT * FROM calibrations WHERE id = ?", result_id)
        if not rows:
            raise error("NOT_FOUND", f"result {result_id}")
        return _decoded(rows[0])

    def _committed(self, name: str) -> dict[str, Any] | None:
        rows = self._rows("SELECT * FROM calibrations WHERE name = ? AND state = 'committed'", name)
        return _decoded(rows[0]) if rows else None

    def _known_config(self, row: Mapping[str, Any]) -> str:
        """The configured value of today if this process told it, else the one the result remembers."""
        return to_json(self._configured.get(row["name"], row["config_value"]))

    def _set_rolled_back(self, result_id: int, who: str) -> None:
        self._db.execute(
            "UPDATE calibrations SET state = 'rolled-back', who = ?, decided = ? WHERE id = ?",
            (who, self._wall(), result_id),
        )


def _decoded(row: Mapping[str, Any]) -> dict[str, Any]:
    return {k: json.loads(v) if k in _JSON and v is not None else v for k, v in row.items()}
