"""The solver's process: answers, errors, and what is left of a call that nobody wants any more."""

import asyncio
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from cell.errors import CellError
from daemon.worker import ProcessWorker
from procedures import registry
from procedures.documents import kind_named

pytestmark = pytest.mark.wire


def mark_and_sleep(mark: Path, seconds: float) -> None:
    mark.write_text(str(os.getpid()))
    time.sleep(seconds)


def with_worker(use: Callable[[ProcessWorker], Awaitable[None]]) -> None:
    async def main() -> None:
        subject = ProcessWorker()
        try:
            async with asyncio.timeout(60.0):
                await use(subject)
        finally:
            await subject.stop()

    asyncio.run(main())


def pid_in(mark: Path) -> int:
    """The number of the process that left the mark."""
    wait_until(lambda: mark.exists() and mark.read_text() != "")
    return int(mark.read_text())


def wait_until(true: Callable[[], bool], limit_s: float = 30.0) -> None:
    end = time.monotonic() + limit_s
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_cancelled_call_ends_its_process_and_the_next_call_does_not_wait_for_it(tmp_path: Path) -> None:
    mark = tmp_path / "pid"

    async def use(subject: ProcessWorker) -> None:
        solving = asyncio.create_task(subject.call(mark_and_sleep, mark, 3600.0))
        pid = await asyncio.to_thread(pid_in, mark)
        solving.cancel()
        await asyncio.wait([solving])
        assert solving.cancelled()
        assert await subject.call(os.getpid) != pid
        await asyncio.to_thread(wait_until, lambda: not Path(f"/proc/{pid}").exists())

    with_worker(use)


def test_a_worker_that_dies_is_told_and_replaced(tmp_path: Path) -> None:
    async def use(subject: ProcessWorker) -> None:
        first = await subject.start()
        assert await subject.call(os.getpid) == first
        with pytest.raises(CellError, match="_exit"):
            await subject.call(os._exit, 3)
        assert await subject.call(os.getpid) != first

    with_worker(use)


def test_it_knows_the_kind_of_a_job_that_only_a_configuration_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(Path(__file__).parents[3] / "docs/examples/acme/acme_belt", tmp_path / "acme_belt")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setitem(registry.CONFIGURED, "acme-still", "acme_belt.still:BeltStill")
    monkeypatch.setitem(registry.CONFIGURED, "acme-gone", "acme_not_installed.job:Gone")

    async def use(subject: ProcessWorker) -> None:
        kind = await subject.call(kind_named, "acme_belt.still:KIND")
        assert kind.words == "acme_belt.still:lines"

    with_worker(use)


def test_a_killed_daemon_leaves_no_warning_of_its_semaphores() -> None:
    """The process that removes them holds the other end of ``stderr`` until it is done."""
    killed = "import os; from daemon.worker import _new_pool; pool = _new_pool(); os.kill(os.getpid(), 9)"
    ended = subprocess.run([sys.executable, "-c", killed], stderr=subprocess.PIPE, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (-signal.SIGKILL, "")


FORKED = """
import asyncio, os, threading
import psutil
import {known}
from daemon.worker import ProcessWorker

async def use():
    pid = await subject.start()
    print(psutil.Process(pid).cmdline() == psutil.Process().cmdline())
    print(await subject.call(eval, "'{known}' in __import__('sys').modules"))
    try:
        await subject.call(os._exit, 3)
    except Exception as exc:
        print(type(exc).__name__, exc.name)
    print(await subject.call(os.getpid) != pid)
    await subject.stop()

{first}
subject = ProcessWorker()
subject.fork()
asyncio.run(use())
{last}
"""


def started_by(first: str = "", last: str = "") -> list[str]:
    """What a program says whose worker is made before its loop: is it a copy of the program; does it know a
    module that nobody imported for it; how its death is told; is there another one afterwards."""
    script = FORKED.format(known="colorsys", first=first, last=last)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", script],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.splitlines()


def test_the_first_process_of_a_program_is_its_copy_and_replaced_when_it_dies() -> None:
    assert started_by() == ["True", "True", "AbortError CHILD_DIED", "True"]


def test_a_program_with_threads_is_not_copied() -> None:
    """A copy may hold locks of threads that it has not."""
    begun = "end = threading.Event(); threading.Thread(target=end.wait).start()"
    assert started_by(begun, "end.set()") == ["False", "False", "AbortError CHILD_DIED", "True"]


KILLED = """
import os
from daemon import worker

subject = worker.ProcessWorker()
subject.fork()
print(subject._pool.submit(worker._ready).result(), flush=True)
os.kill(os.getpid(), 9)
"""


def test_a_copy_ends_with_a_killed_program() -> None:
    told = subprocess.run(
        [sys.executable, "-c", KILLED], stdout=subprocess.PIPE, text=True, check=False
    ).stdout
    wait_until(lambda: not Path(f"/proc/{int(told)}").exists())
