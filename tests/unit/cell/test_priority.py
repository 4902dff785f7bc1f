"""Real time for as long as it is needed, and none where it is refused; who has no right gives it back."""

import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from cell import priority
from cell.priority import COMPUTING, LOOP, process_in_real_time, real_time, yield_to_others

NOBODY = 65534


def permitted() -> bool:
    before = os.sched_getscheduler(0)
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(LOOP))
    except OSError:
        return False
    os.sched_setscheduler(0, before, os.sched_param(0))
    return True


needs_real_time = pytest.mark.skipif(not permitted(), reason="this user may not ask for real time")


@needs_real_time
def test_a_thread_goes_back_to_what_it_was_also_after_a_failure() -> None:
    with pytest.raises(KeyError), real_time(LOOP):
        assert os.sched_getscheduler(0) == os.SCHED_RR
        raise KeyError("work")
    assert os.sched_getscheduler(0) == os.SCHED_OTHER


@needs_real_time
def test_all_threads_of_a_process_run_in_real_time_and_those_that_began_meanwhile_stop_to() -> None:
    seen, go_on, begun = [], threading.Event(), threading.Event()

    def work() -> None:
        begun.set()
        go_on.wait(5.0)
        seen.append(os.sched_getscheduler(0))

    with process_in_real_time(LOOP):
        thread = threading.Thread(target=work)
        thread.start()
        begun.wait(5.0)
    go_on.set()
    thread.join()
    assert seen == [os.SCHED_OTHER]
    assert os.sched_getscheduler(0) == os.SCHED_OTHER


def test_a_thread_that_ended_since_it_was_listed_is_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    thread = threading.Thread(target=lambda: None)
    thread.start()
    thread.join()
    assert thread.native_id is not None
    gone = thread.native_id
    monkeypatch.setattr(priority, "_tasks", lambda: [gone])
    while Path(f"/proc/self/task/{gone}").exists():  # the kernel takes a moment longer than the interpreter
        time.sleep(0.001)
    with process_in_real_time(LOOP):
        pass


@pytest.mark.skipif(os.getuid() != 0 or not permitted(), reason="only root can drop its rights")
def test_real_time_ends_for_a_process_without_capabilities() -> None:
    program = f"""
import os
from cell.priority import LOOP, process_in_real_time
with process_in_real_time(LOOP):
    print(os.sched_getscheduler(0) == os.SCHED_RR)
    os.setgroups([]); os.setresgid({NOBODY}, {NOBODY}, {NOBODY}); os.setresuid({NOBODY}, {NOBODY}, {NOBODY})
print(os.sched_getscheduler(0))
"""
    path = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(p for p in sys.path if p),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    done = subprocess.run(
        [sys.executable, "-c", program], env=path, capture_output=True, text=True, check=False
    )
    if "Permission" in done.stderr:
        pytest.skip("an unprivileged user cannot read this checkout")
    assert done.stdout.split() == ["True", str(os.SCHED_OTHER)], done.stderr


@needs_real_time
def test_who_yields_is_behind_the_others_whatever_its_parent_ran_as() -> None:
    pid = os.fork()
    if pid == 0:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(LOOP))
        yield_to_others(COMPUTING)
        os._exit(0 if (os.sched_getscheduler(0), os.nice(0)) == (os.SCHED_BATCH, COMPUTING) else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0


def test_without_the_right_the_work_runs_and_its_failure_is_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with pytest.raises(KeyError) as failure, process_in_real_time(LOOP):
        raise KeyError("work")
    assert failure.value.__context__ is None


@pytest.mark.skipif(not Path("/proc/self/autogroup").exists(), reason="this kernel weighs no sessions")
def test_what_looks_at_pictures_has_the_share_of_the_daemon_in_its_own_session() -> None:
    ours, theirs = socket.socketpair()
    command = [sys.executable, "-P", "-m", "daemon.vision_child", str(theirs.fileno()), str(os.getpid())]
    child = subprocess.Popen(
        command,
        pass_fds=(theirs.fileno(),),
        start_new_session=True,
        preexec_fn=lambda: os.setpriority(os.PRIO_PROCESS, 0, 3),
    )
    try:
        share = Path(f"/proc/{child.pid}/autogroup")
        give_up = time.monotonic() + 20.0
        while share.read_text().split()[-1] != "3" and time.monotonic() < give_up:
            time.sleep(0.02)
        assert share.read_text().split()[-1] == "3"
    finally:
        child.kill()
        child.wait()
        ours.close()
        theirs.close()
