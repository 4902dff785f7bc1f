"""Real time for as long as it is needed, and none where it is not permitted."""

import json
import os
import subprocess
import sys
from typing import Any

import pytest

from cell.priority import LOOP, SETPOINTS, real_time

ASKED = os.SCHED_RR | os.SCHED_RESET_ON_FORK

# Leaves real time without the capability by which root entered: what the unit does by a limit instead.
DROPPING_PRIVILEGES = """
import json, os
from cell.priority import LOOP, SETPOINTS, real_time

def seen():
    return [os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK, os.sched_getparam(0).sched_priority]

states = [seen()]
with real_time(LOOP):
    states.append(seen())
    with real_time(SETPOINTS):
        states.append(seen())
        os.setgroups([])
        os.setgid(65534)
        os.setuid(65534)
    states.append(seen())
states.append(seen())
print(json.dumps(states))
"""


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int]]:
    """Policies and priorities that were asked for; each is granted."""
    seen: list[tuple[int, int]] = []

    def take(pid: int, policy: int, param: Any) -> None:
        assert pid == 0
        seen.append((policy, param.sched_priority))

    monkeypatch.setattr(os, "sched_getscheduler", lambda pid: os.SCHED_OTHER)
    monkeypatch.setattr(os, "sched_getparam", lambda pid: os.sched_param(0))
    monkeypatch.setattr(os, "sched_setscheduler", take)
    return seen


def test_a_thread_goes_back_to_what_it_was_also_after_a_failure(asked: list[tuple[int, int]]) -> None:
    with pytest.raises(KeyError), real_time(LOOP):
        assert asked == [(ASKED, LOOP)]
        raise KeyError("work")
    assert asked == [(ASKED, LOOP), (os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, 0)]


def test_real_time_ends_also_for_a_process_without_capabilities() -> None:
    if os.geteuid() != 0:
        pytest.skip("needs root, to take a child's capabilities away")
    done = subprocess.run(
        [sys.executable, "-c", DROPPING_PRIVILEGES], capture_output=True, text=True, timeout=30, check=True
    )
    states = json.loads(done.stdout)
    ordinary, loop, setpoints = [os.SCHED_OTHER, 0], [os.SCHED_RR, LOOP], [os.SCHED_RR, SETPOINTS]
    if loop not in states:
        pytest.skip("this machine grants no real-time priority at all")
    assert states == [ordinary, loop, setpoints, loop, ordinary]


def test_without_the_right_the_work_runs_and_its_failure_is_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with pytest.raises(KeyError) as failure, real_time(LOOP):
        raise KeyError("work")
    assert failure.value.__context__ is None
