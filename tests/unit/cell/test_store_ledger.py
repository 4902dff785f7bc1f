"""The ledger: numbers that never repeat, versions that can be taken back, and records beside them."""

import threading
from pathlib import Path

import pytest

from cell.errors import CellError
from cell.store.ledger import Effective, Ledger
from tests.kit.ledgers import CONFIG, NAME, propose, subject

__all__ = ["subject"]


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


def test_a_number_that_is_entered_twice_is_refused_with_a_code(subject: Ledger) -> None:
    subject.start_run(1, "latency", "folder", "ann", "cli")
    with pytest.raises(CellError, match="UNIQUE") as refused:
        subject.start_run(1, "latency", "folder", "ann", "cli")
    assert refused.value.name == "INTERNAL"
    subject.start_run(2, "latency", "folder", "ann", "cli")
    assert [row["run_id"] for row in subject.runs()] == [2, 1]


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
