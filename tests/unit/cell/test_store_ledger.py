"""The ledger: numbers that never repeat, versions that can be taken back, and a corrupt file set aside."""

import os
import signal
import sqlite3
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from cell.clock import MonotonicClock
from cell.errors import CellError
from cell.store import _database
from cell.store.ledger import Effective, Ledger
from cell.store.runs import RunFolder
from daemon.state_folder import damage_text

NAME = "T_flange_camera"
CONFIG = [0, -0.08, 0.05, 0, 0, 0]


@pytest.fixture
def subject(tmp_path: Path) -> Iterator[Ledger]:
    ledger = Ledger(tmp_path / "ledger.sqlite", lambda: 1_700_000_000.0)
    yield ledger
    ledger.close()


def propose(ledger: Ledger, x: float, config: object = CONFIG) -> int:
    return ledger.propose(NAME, [x, 0, 0, 0, 0, 0], {"verdict": "pass"}, 1, config)


def test_looking_at_a_ledger_changes_nothing_even_at_a_corrupt_one(tmp_path: Path) -> None:
    path = tmp_path / "ledger #1?.sqlite"
    writing = Ledger(path)
    writing.propose("T_flange_camera", [0.0] * 6, {}, 1, None)
    subject = Ledger(path, read_only=True)
    assert [row["name"] for row in subject.results()] == ["T_flange_camera"]
    with pytest.raises(CellError, match="readonly"):
        subject.set_state("key", 1)
    subject.close()
    writing.close()
    path.write_bytes(b"no database" * 1000)
    with pytest.raises(CellError) as refusal:
        Ledger(path, read_only=True)
    assert refusal.value.name == "LEDGER_DAMAGED"
    assert path.read_bytes().startswith(b"no database")


def test_a_version_notes_with_which_model_of_the_arm_it_was_made(subject: Ledger) -> None:
    model = {"name": "kinematics.arm", "version": 3}
    subject.accept(propose(subject, 1.0), "test")
    assert subject.effective(NAME, CONFIG).arm_model is None
    made = subject.propose(NAME, [2, 0, 0, 0, 0, 0], {}, 1, CONFIG, model)
    assert subject.effective(NAME, CONFIG).arm_model is None, "it is only proposed"
    subject.accept(made, "test")
    assert subject.effective(NAME, CONFIG).arm_model == model
    assert subject.results()[0]["arm_model"] == model
    subject.rollback(NAME, "test")
    assert subject.effective(NAME, CONFIG).arm_model is None


@pytest.mark.parametrize(
    ("version", "missing"),
    [(1, ("arm_model", "folder")), (2, ("folder",)), (3, ())],
    ids=["schema 1", "schema 2", "schema 3"],
)
def test_a_ledger_of_an_earlier_schema_is_read_as_it_is_and_taken_over(
    tmp_path: Path, version: int, missing: tuple[str, ...]
) -> None:
    path = tmp_path / "ledger.sqlite"
    old = Ledger(path)
    old.start_run(1, "cone-capture", "20260101T000000Z_cone-capture_1", "anna", "control")
    old.accept(propose(old, 1.0), "test")
    old.close()
    database = sqlite3.connect(path)
    for column in missing:
        database.execute(f"ALTER TABLE calibrations DROP COLUMN {column}")
    database.execute("ALTER TABLE runs DROP COLUMN tool")
    database.executescript(f"PRAGMA user_version = {version};")
    database.close()
    looking = Ledger(path, read_only=True)
    assert [(row["name"], row["arm_model"], row["folder"]) for row in looking.results()] == [
        (NAME, None, None)
    ]
    assert [row["run_id"] for row in looking.runs()] == [1]
    assert looking.effective(NAME, CONFIG).version == 1
    looking.close()
    database = sqlite3.connect(path)
    assert database.execute("PRAGMA user_version").fetchone()[0] == version
    database.close()
    subject = Ledger(path)
    assert subject.aside is None
    assert subject.effective(NAME, CONFIG) == Effective(
        [1.0, 0, 0, 0, 0, 0], 1, False, 1, None, {"verdict": "pass"}
    )
    assert subject.result(1)["result"] == {"verdict": "pass"}
    taken_over = "20260101T000000Z_cone-capture_1" if "folder" in missing else None
    assert subject.result(1)["folder"] == taken_over
    assert subject.runs()[0]["tool"] is None
    subject.accept(subject.propose(NAME, CONFIG, {}, 1, CONFIG, {"name": "controller"}), "test")
    assert subject.effective(NAME, CONFIG).arm_model == {"name": "controller"}
    subject.close()


def test_run_numbers_go_on_after_a_restart(tmp_path: Path, subject: Ledger) -> None:
    assert [subject.next_run_id() for _ in range(3)] == [1, 2, 3]
    subject.close()
    again = Ledger(tmp_path / "ledger.sqlite")
    assert again.next_run_id() == 4
    again.close()


def test_threads_never_get_the_same_run_number(subject: Ledger) -> None:
    got: list[int] = []
    threads = [
        threading.Thread(target=lambda: got.extend(subject.next_run_id() for _ in range(10)))
        for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(got) == list(range(1, 41))


def test_runs_are_kept_with_their_end(subject: Ledger) -> None:
    subject.start_run(1, "cone-capture", "folder-1", "ann", "cli")
    subject.start_run(2, "laser-check", "folder-2", "modbus 10.0.0.5", "modbus")
    subject.end_run(1, "complete", "pass")
    newest, oldest = subject.runs()
    assert (newest["run_id"], newest["outcome"], newest["channel"]) == (2, None, "modbus")
    assert (oldest["outcome"], oldest["verdict"], oldest["who"]) == ("complete", "pass", "ann")


def test_the_configured_value_holds_until_a_result_is_accepted(subject: Ledger) -> None:
    assert subject.effective(NAME, CONFIG) == Effective(CONFIG, None, False)
    result_id = propose(subject, 0.1)
    assert subject.open_results_of(1) == [result_id]
    assert subject.effective(NAME, CONFIG).version is None
    accepted = subject.accept(result_id, "ann")
    assert (accepted["state"], accepted["version"], accepted["who"]) == ("committed", 1, "ann")
    assert subject.effective(NAME, CONFIG) == Effective(
        [0.1, 0, 0, 0, 0, 0], 1, False, result_id, result={"verdict": "pass"}
    )
    assert subject.open_results_of(1) == []


def test_acceptance_alone_changes_nothing_until_the_commit(subject: Ledger) -> None:
    result_id = propose(subject, 0.1)
    assert subject.accept(result_id, "policy", commit=False)["state"] == "accepted"
    assert subject.effective(NAME, CONFIG).version is None
    assert subject.commit(result_id)["version"] == 1
    assert subject.effective(NAME, CONFIG).version == 1


def test_an_accepted_candidate_that_fails_its_check_is_rejected_and_nothing_is_committed(
    subject: Ledger,
) -> None:
    result_id = propose(subject, 0.1)
    subject.accept(result_id, "policy", commit=False)
    rejected = subject.reject(result_id, "laser-update", "the point missed the reference")
    assert (rejected["state"], rejected["why"]) == ("rejected", "the point missed the reference")
    for attempt in (subject.commit, lambda i: subject.accept(i, "ann")):
        with pytest.raises(CellError) as caught:
            attempt(result_id)
        assert caught.value.name == "NOT_NOW"
    assert subject.effective(NAME, CONFIG).version is None


def test_a_commit_without_acceptance_is_refused(subject: Ledger) -> None:
    result_id = propose(subject, 0.1)
    with pytest.raises(CellError, match="proposed, not accepted"):
        subject.commit(result_id)


def test_rollback_goes_one_version_back_and_at_last_to_the_config(subject: Ledger) -> None:
    first = propose(subject, 0.1)
    subject.accept(first, "ann")
    subject.accept(propose(subject, 0.2), "ann")
    assert subject.effective(NAME, CONFIG).version == 2
    assert subject.rollback(NAME, "bob") == {
        "name": NAME, "version": 1, "value": [0.1, 0, 0, 0, 0, 0], "rolled_back": 2,
    }  # fmt: skip
    assert subject.rollback(NAME, "bob")["value"] == CONFIG
    with pytest.raises(CellError, match="no committed version"):
        subject.rollback(NAME, "bob")
    assert subject.accept(first, "ann")["version"] == 3, "version numbers are never used again"


def test_editing_the_config_under_a_committed_version_is_a_conflict_until_accepted(subject: Ledger) -> None:
    result_id = propose(subject, 0.1)
    subject.accept(result_id, "ann")
    edited = [0.0, -0.09, 0.05, 0.0, 0.0, 0.0]
    assert subject.effective(NAME, edited).conflict
    accepted = subject.accept(result_id, "ann")
    assert accepted["config_value"] == edited
    assert not subject.effective(NAME, edited).conflict
    assert subject.effective(NAME, edited).version == 1


def test_one_rollback_ends_a_conflict_whatever_the_history(subject: Ledger) -> None:
    subject.accept(propose(subject, 0.1), "ann")
    subject.accept(propose(subject, 0.2), "ann")
    edited = [0.0, -0.09, 0.05, 0.0, 0.0, 0.0]
    assert subject.effective(NAME, edited).conflict
    assert subject.rollback(NAME, "bob")["value"] == edited
    assert subject.effective(NAME, edited) == Effective(edited, None, False)


def test_whole_numbers_and_floats_of_the_same_value_do_not_conflict(subject: Ledger) -> None:
    subject.accept(propose(subject, 0.1, [0, 1, 0]), "ann")
    assert not subject.effective(NAME, [0.0, 1.0, 0.0]).conflict
    assert subject.effective(NAME, None).conflict


def test_an_unknown_result_is_not_found(subject: Ledger) -> None:
    with pytest.raises(CellError) as caught:
        subject.accept(99, "ann")
    assert caught.value.name == "NOT_FOUND"


def test_results_are_listed_by_name_newest_first(subject: Ledger) -> None:
    propose(subject, 0.1)
    other = subject.propose("tool", {"x": 1}, {}, 2, None)
    assert [row["id"] for row in subject.results()] == [other, 1]
    assert [row["value"] for row in subject.results("tool")] == [{"x": 1}]
    assert subject.result(1)["result"] == {"verdict": "pass"}


def test_audit_state_trends_and_items_survive_a_restart(tmp_path: Path, subject: Ledger) -> None:
    subject.audit("modbus", "10.0.0.5", "write 0..3", False, "not in allow_clients")
    subject.set_state("modbus.sequence", 41)
    subject.set_state("modbus.sequence", 42)
    for value in (0.1, 0.2, 0.3):
        subject.add_trend("reprojection_px", value)
    subject.add_item(5, 17, 12.5, "lost", {"miss_m": 0.004})
    subject.close()
    again = Ledger(tmp_path / "ledger.sqlite")
    line = again.audit_lines()[0]
    assert (line["channel"], line["accepted"], line["detail"]) == ("modbus", False, "not in allow_clients")
    assert again.get_state("modbus.sequence") == 42
    assert again.get_state("absent", 7) == 7
    assert [value for _, value in again.trend("reprojection_px", limit=2)] == [0.2, 0.3]
    assert again.items(5) == [{"item": 17, "t": 12.5, "outcome": "lost", "detail": {"miss_m": 0.004}}]
    again.close()


@pytest.mark.parametrize("junk", [b"not a database at all" * 99, b"SQLite format 3\0" + b"\xff" * 8192])
def test_a_corrupt_ledger_is_set_aside_and_numbering_goes_on_behind_the_run_folders(
    tmp_path: Path, junk: bytes
) -> None:
    RunFolder.create(tmp_path / "runs", "cone-capture", 12, {}, MonotonicClock()).close()
    (tmp_path / "ledger.sqlite").write_bytes(junk)
    subject = Ledger(tmp_path / "ledger.sqlite")
    assert subject.aside is not None
    assert subject.aside.read_bytes() == junk
    assert subject.next_run_id() == 13
    subject.close()
    again = Ledger(tmp_path / "ledger.sqlite")
    assert again.aside is None
    again.close()


def test_the_form_before_is_kept_and_can_be_put_back(tmp_path: Path) -> None:
    path = tmp_path / "ledger.sqlite"
    old = Ledger(path)
    old.accept(propose(old, 1.0), "test")
    old.close()
    database = sqlite3.connect(path)
    database.execute("ALTER TABLE calibrations DROP COLUMN folder")
    database.execute("ALTER TABLE runs DROP COLUMN tool")
    database.executescript("PRAGMA user_version = 2;")
    database.close()
    subject = Ledger(path)
    subject.accept(propose(subject, 2.0), "test")
    subject.close()
    copy = tmp_path / "ledger.sqlite.schema-2"
    database = sqlite3.connect(copy)
    columns = [row[1] for row in database.execute("PRAGMA table_info(calibrations)")]
    assert database.execute("PRAGMA user_version").fetchone()[0] == 2
    database.close()
    assert "folder" not in columns
    copy.replace(path)
    again = Ledger(path)
    assert again.effective(NAME, CONFIG).value == [1.0, 0, 0, 0, 0, 0]
    again.close()


def test_a_change_that_fails_leaves_the_ledger_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "ledger.sqlite"
    old = Ledger(path)
    old.accept(propose(old, 1.0), "test")
    old.close()
    database = sqlite3.connect(path)
    database.execute("ALTER TABLE calibrations DROP COLUMN folder")
    database.execute("ALTER TABLE runs DROP COLUMN tool")
    database.executescript("PRAGMA user_version = 2;")
    database.close()
    monkeypatch.setitem(_database.STEPS, 2, _database.STEPS[2] + "SELECT 1 FROM nowhere;")
    with pytest.raises(CellError, match="nowhere"):
        Ledger(path)
    monkeypatch.undo()
    subject = Ledger(path)
    assert subject.effective(NAME, CONFIG).version == 1
    subject.close()


def test_a_ledger_of_a_newer_program_is_left_alone(tmp_path: Path, subject: Ledger) -> None:
    subject.close()
    path = tmp_path / "ledger.sqlite"
    with sqlite3.connect(path) as db:
        db.execute("PRAGMA user_version = 9")
    db.close()
    with pytest.raises(CellError, match=r"newer cellward .*\(schema 9\).*ledger.sqlite.schema-4") as caught:
        Ledger(path)
    assert caught.value.name == "STORE_NEWER"
    assert list(tmp_path.glob("*.corrupt*")) == []


def test_a_ledger_that_cannot_be_opened_says_where(tmp_path: Path) -> None:
    with pytest.raises(CellError, match=str(tmp_path / "absent")) as caught:
        Ledger(tmp_path / "absent" / "ledger.sqlite")
    assert caught.value.name == "DISK_FAILED"


def test_a_full_disk_is_named_and_leaves_the_ledger_usable(subject: Ledger) -> None:
    subject._db.execute("PRAGMA max_page_count = 1")
    with pytest.raises(CellError) as caught:
        for _ in range(200):
            subject.propose(NAME, "x" * 4000, {}, 1, None)
    assert caught.value.name == "DISK_FULL"
    subject._db.execute("PRAGMA max_page_count = 100000")
    assert propose(subject, 0.1) > 0


def damage_schema(path: Path) -> None:
    other = sqlite3.connect(path)
    other.executescript(
        "PRAGMA writable_schema = ON; UPDATE sqlite_schema SET sql = 'no words of SQL' WHERE name = 'runs';"
        "PRAGMA schema_version = 1000;"
    )
    other.close()


def test_a_ledger_that_is_damaged_while_it_is_open_refuses_with_a_code(subject: Ledger) -> None:
    damage_schema(subject.path)
    for call in (
        subject.waiting_results,
        lambda: subject.end_run(1, "complete", None),
        lambda: subject.effective(NAME, CONFIG),
    ):
        with pytest.raises(CellError, match=r"ledger\.sqlite: ") as refused:
            call()
        assert refused.value.name == "LEDGER_DAMAGED"
        assert "cellward recover" in refused.value.hint


def test_damage_that_is_found_while_the_ledger_is_open_is_told_until_it_was_opened_anew(
    subject: Ledger, caplog: pytest.LogCaptureFixture
) -> None:
    damage_schema(subject.path)
    assert subject.damage() is None
    for _ in range(2):
        with pytest.raises(CellError):
            subject.end_run(1, "complete", None)
    told = subject.damage()
    assert told is not None
    assert "start the daemon anew" in damage_text(told)
    assert len(caplog.records) == 1
    with pytest.raises(CellError, match="still damaged") as refused:
        subject.acknowledge_damage()
    assert refused.value.name == "NOT_NOW"


def test_a_number_that_is_entered_twice_is_refused_with_a_code(subject: Ledger) -> None:
    subject.start_run(1, "latency", "folder", "ann", "cli")
    with pytest.raises(CellError, match="UNIQUE") as refused:
        subject.start_run(1, "latency", "folder", "ann", "cli")
    assert refused.value.name == "INTERNAL"
    subject.start_run(2, "latency", "folder", "ann", "cli")
    assert [row["run_id"] for row in subject.runs()] == [2, 1]


class NoWayBack:
    """A connection on which a commit and the rollback after it fail, as on a disk that went away."""

    def __init__(self, db: sqlite3.Connection) -> None:
        self.db = db

    def __getattr__(self, name: str) -> object:
        return getattr(self.db, name)

    def execute(self, query: str, *values: object) -> object:
        if query in ("COMMIT", "ROLLBACK"):
            raise sqlite3.OperationalError("disk I/O error")
        return self.db.execute(query, *values)


def test_a_transaction_that_cannot_be_taken_back_hides_no_later_write(
    subject: Ledger, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(subject, "_db", NoWayBack(subject._db))
        with pytest.raises(CellError, match="disk I/O error"):
            subject.set_state("a", 1)
    with pytest.raises(CellError, match="transaction"):
        subject.set_state("b", 2)  # refused, or it would wait for a commit that never comes
    subject.set_state("c", 3)
    again = sqlite3.connect(subject.path)
    assert again.execute("SELECT key FROM state").fetchall() == [("c",)]
    again.close()


def test_items_and_trends_keep_the_newest_and_no_more(
    subject: Ledger, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in {"ROTATE_EVERY": 10, "MAX_ITEMS": 25, "MAX_TREND_POINTS": 15}.items():
        monkeypatch.setattr(f"cell.store.records.{name}", value)
    for number in range(100):
        subject.add_item(1, number, 0.0, "picked", {})
        subject.add_trend("lag", float(number))
    assert [row["item"] for row in subject.items(1)] == list(range(75, 100))
    assert len(subject.trend("lag")) == 15


class Versions(RuleBasedStateMachine):
    """Whatever people decide in whatever order: at most one version is in effect, and it was accepted."""

    def __init__(self) -> None:
        super().__init__()
        import tempfile

        self.folder = tempfile.TemporaryDirectory()
        self.ledger = Ledger(Path(self.folder.name) / "ledger.sqlite")
        self.ids: list[int] = []
        self.config = 0

    def teardown(self) -> None:
        self.ledger.close()
        self.folder.cleanup()

    @rule()
    def propose(self) -> None:
        self.ids.append(self.ledger.propose("n", len(self.ids) + 100, {}, 1, self.config))

    @rule(data=st.data(), verb=st.sampled_from(["accept", "reject"]))
    def decide(self, data: st.DataObject, verb: str) -> None:
        if not self.ids:
            return
        result_id = data.draw(st.sampled_from(self.ids))
        before = self.ledger.result(result_id)["state"]
        refused = None
        try:
            if verb == "accept":
                self.ledger.accept(result_id, "ann")
            else:
                self.ledger.reject(result_id, "ann", "no")
        except CellError as exc:
            refused = exc.name
        assert refused in (None, "NOT_NOW")
        if refused:
            assert self.ledger.result(result_id)["state"] == before
        elif verb == "accept":
            assert self.ledger.effective("n", self.config).result_id == result_id
            assert not self.ledger.effective("n", self.config).conflict

    @rule()
    def roll_back(self) -> None:
        had = self.ledger.effective("n", self.config)
        if had.version is not None:
            self.ledger.rollback("n", "bob")
            now = self.ledger.effective("n", self.config)
            assert not now.conflict
            assert now.version is None or now.version < had.version

    @rule()
    def edit_config(self) -> None:
        self.config += 1
        now = self.ledger.effective("n", self.config)
        assert now.conflict == (now.version is not None)

    @invariant()
    def one_version_at_most_is_in_effect(self) -> None:
        committed = [r for r in self.ledger.results("n") if r["state"] == "committed"]
        assert len(committed) <= 1
        now = self.ledger.effective("n", self.config)
        assert now.value == (committed[0]["value"] if committed else self.config)


Versions.TestCase.settings = settings(max_examples=20, stateful_step_count=15, deadline=None)
TestVersions = Versions.TestCase


WRITER = """
import sys
from pathlib import Path
from cell.store import _database
from cell.store.ledger import Ledger
ledger = Ledger(Path(sys.argv[1]))
while True:
    run_id = ledger.next_run_id()
    ledger.accept(ledger.propose("n", run_id, {}, run_id, 0), "ann")
    print(run_id, flush=True)
"""


@pytest.mark.wire
def test_a_killed_process_loses_no_number_and_no_version_that_it_was_told_of(tmp_path: Path) -> None:
    path = tmp_path / "ledger.sqlite"
    child = subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True)
    assert child.stdout is not None
    told = [int(child.stdout.readline()) for _ in range(20)][-1]
    os.kill(child.pid, signal.SIGKILL)
    child.stdout.close()
    child.wait(10)
    again = Ledger(path)
    now = again.effective("n", 0)
    assert again.aside is None
    assert now.version is not None
    assert now.version >= told
    assert now.value == now.version
    assert again.next_run_id() in (now.value + 1, now.value + 2)
    again.close()
