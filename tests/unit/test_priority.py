"""Real time for as long as it is needed, and none where it is not permitted."""

import os
from typing import Any

import pytest

from cell.priority import LOOP, real_time

ASKED = os.SCHED_RR | os.SCHED_RESET_ON_FORK


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int]]:
    """Policies and priorities that were asked for; each is granted."""
    seen: list[tuple[int, int]] = []

    def take(pid: int, policy: int, param: Any) -> None:
        assert pid == 0
        seen.append((policy, param.sched_priority))

    monkeypatch.setattr(os, "sched_getscheduler", lambda pid: os.SCHED_OTHER)
    monkeypatch.setattr(os, "sched_setscheduler", take)
    return seen


def test_a_thread_goes_back_to_what_it_was_also_after_a_failure(asked: list[tuple[int, int]]) -> None:
    with pytest.raises(KeyError), real_time(LOOP):
        assert asked == [(ASKED, LOOP)]
        raise KeyError("work")
    assert asked == [(ASKED, LOOP), (os.SCHED_OTHER, 0)]


def test_without_the_right_the_work_runs_and_its_failure_is_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with pytest.raises(KeyError) as failure, real_time(LOOP):
        raise KeyError("work")
    assert failure.value.__context__ is None
