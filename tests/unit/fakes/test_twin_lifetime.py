"""What the twin's processes take of the cores, when they end, and when the collector runs in them."""

import ctypes
import multiprocessing
import os
import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest

from cell.priority import LOOP, SETPOINTS, SIMULATED_CONTROLLER
from fakes.wire.lifetime import die_with_parent


def said_by(*lines: str) -> list[str]:
    """The words that a process of its own prints."""
    done = subprocess.run(
        [sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_everything_of_the_daemon_that_follows_the_arm_comes_before_the_simulated_controller() -> None:
    assert 0 < SIMULATED_CONTROLLER < LOOP < SETPOINTS


def test_the_controller_has_the_least_real_time_priority_and_its_children_have_none() -> None:
    said = said_by(
        "import os",
        "from fakes.wire.lifetime import run_as_controller",
        "run_as_controller()",
        "policy, priority = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority",
        "pid = os.fork()",
        "if pid == 0: os._exit(os.sched_getscheduler(0))",
        "child = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])",
        "print(policy & ~os.SCHED_RESET_ON_FORK, priority, child)",
    )
    if said[0] == str(os.SCHED_OTHER):
        pytest.skip("this user may not ask for real time")
    assert said == [str(os.SCHED_RR), str(SIMULATED_CONTROLLER), str(os.SCHED_OTHER)]


def test_who_draws_is_behind_real_time_and_beside_what_looks_at_pictures() -> None:
    said = said_by(
        "import os",
        "from fakes.wire.lifetime import run_as_camera",
        "run_as_camera()",
        "print(os.sched_getscheduler(0), os.nice(0))",
    )
    assert int(said[0]) == os.SCHED_BATCH
    assert int(said[1]) == 0


def test_the_collector_passes_over_what_was_there_when_it_was_settled() -> None:
    before, after, found = map(
        int,
        said_by(
            "import gc",
            "from fakes.wire.lifetime import settle_collector",
            "kept = [[k] for k in range(50_000)]",
            "before = len(gc.get_objects())",
            "settle_collector()",
            "cycle = []; cycle.append(cycle); del cycle",
            "print(before, len(gc.get_objects()), gc.collect())",
        ),
    )
    assert before > 50_000
    assert after < 1000
    assert found >= 1, "what became rubbish later is still collected"


@pytest.mark.parametrize(
    ("started_by", "ends"), [(1, []), (4711, [signal.SIGTERM]), (None, [signal.SIGTERM])]
)
def test_a_child_of_process_1_is_no_orphan(
    monkeypatch: pytest.MonkeyPatch, started_by: int | None, ends: list[signal.Signals]
) -> None:
    """In a container the twin is process 1, which on another machine is who takes over orphans."""
    ended: list[signal.Signals] = []
    parent = None if started_by is None else SimpleNamespace(pid=started_by)
    monkeypatch.setattr(ctypes, "CDLL", lambda *_a, **_k: SimpleNamespace(prctl=lambda *_: 0))
    monkeypatch.setattr(multiprocessing, "parent_process", lambda: parent)
    monkeypatch.setattr(os, "getppid", lambda: 1)
    monkeypatch.setattr(os, "kill", lambda _pid, how: ended.append(how))
    die_with_parent(signal.SIGTERM)
    assert ended == ends
