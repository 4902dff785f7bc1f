"""What every page shows of who asked for what lately."""

from types import SimpleNamespace
from typing import Any

import pytest

from cell.errors import CellError, error
from daemon.recent_writes import KEPT, RecentWrites


def told(subject: RecentWrites, count: int = 8) -> list[tuple[str, bool]]:
    return [(line["what"], line["accepted"]) for line in subject.newest(count)]


def writes(audit: Any = lambda *line: None) -> RecentWrites:
    ledger: Any = SimpleNamespace(audit=audit)
    return RecentWrites(ledger)


def test_the_newest_are_told_oldest_first() -> None:
    subject = writes()
    note = subject.audit("web")
    assert told(subject) == []
    for k in range(12):
        note("ida", f"write {k}", k % 3 > 0, "")
    assert told(subject, 4) == [(f"write {k}", k % 3 > 0) for k in (6, 9, 10, 11)]


@pytest.mark.parametrize("accepted", [True, False])
def test_those_of_one_kind_fill_what_the_other_leaves(accepted: bool) -> None:
    subject = writes()
    note = subject.audit("web")
    for k in range(3 * KEPT):
        note("ida", f"write {k}", accepted, "")
    assert told(subject) == [(f"write {k}", accepted) for k in range(3 * KEPT - 8, 3 * KEPT)]


def test_a_stranger_who_is_refused_all_the_time_hides_nobody() -> None:
    subject = writes()
    subject.audit("web")("ida", "start", True, "")
    for k in range(1000):
        subject.audit("modbus")("127.0.0.99", f"write {k}", False, "not allowed")
    assert told(subject) == [("start", True), *((f"write {k}", False) for k in range(993, 1000))]


def test_a_ledger_that_cannot_be_written_delays_nobody_and_its_error_comes_out() -> None:
    def locked(*line: Any) -> None:
        assert seen == [1], "the page knew before"
        raise error("DISK_FAILED", "database is locked")

    subject, seen = writes(locked), list[int]()
    subject.subscribe(lambda: seen.append(len(subject.newest())))
    with pytest.raises(CellError, match="database is locked"):
        subject.audit("web")("ida", "start", True, "")
    assert told(subject) == [("start", True)]
