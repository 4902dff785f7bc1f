"""Another program locks the ledger while a job runs, to copy it for instance: nothing is lost or held up."""

import asyncio
import sqlite3
import threading
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from cell.procedure import Run
from cell.store import _database
from cell.store.ledger import Ledger
from daemon import app
from daemon.modbus.command import START, Command, CommandChannel, refused
from fakes.object import run_virtual
from procedures.belt.item_bookkeeping import ItemBookkeeping
from procedures.belt.item_tracking import BeltWatch
from procedures.belt.items import Item, Outcome
from tests.kit.control_serving import until
from tests.kit.object_cell import no_report, on_disk, open_cell, write_config

__all__ = ["no_report"]

BACKUP_S = 30.0  # a copy of a large ledger to a slow disk


class Lock:
    """A connection of another program that keeps everybody from writing."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._db: sqlite3.Connection | None = None
        self.held = threading.Event()

    def hold(self, seconds: float) -> None:
        """From now on, for so long in real time."""
        self._db = sqlite3.connect(self._path, isolation_level=None, check_same_thread=False)
        self._db.execute("BEGIN EXCLUSIVE")
        self.held.set()
        timer = threading.Timer(seconds, self.release)
        timer.start()

    def release(self) -> None:
        assert self._db is not None
        self._db.execute("ROLLBACK")
        self._db.close()


def test_an_open_ledger_waits_longer_than_a_copy_of_it_takes(tmp_path: Path) -> None:
    with closing(Ledger(tmp_path / "ledger.sqlite")) as subject:
        (busy_ms,) = subject._db.execute("PRAGMA busy_timeout").fetchone()
        assert busy_ms >= 1000 * (BACKUP_S + 10.0)
        Lock(tmp_path / "ledger.sqlite").hold(0.3)
        assert subject.next_run_id() == 1


def test_a_lock_that_does_not_end_is_refused_with_a_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_database, "BUSY_S", 0.05)
    with closing(Ledger(tmp_path / "ledger.sqlite")) as subject:
        Lock(tmp_path / "ledger.sqlite").hold(0.3)
        with pytest.raises(Exception, match="database is locked") as refused:
            subject.next_run_id()
        assert getattr(refused.value, "name", None) == "DISK_FAILED"


@pytest.mark.usefixtures("no_report")
@pytest.mark.parametrize("seconds", [0.5, pytest.param(BACKUP_S, marks=pytest.mark.soak)])
def test_a_run_whose_end_meets_the_lock_keeps_its_result(seconds: float, tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path, job={"placements": 2})) as cell:
            lock = Lock(cell.ledger.path)
            cell.at_state("solve", lambda: on_disk(lock.hold, seconds))
            end = await cell.run_job()
            assert lock.held.is_set()
            assert (end["outcome"], end["error"]) == ("complete", None)
            (row,) = on_disk(cell.ledger.results)
            assert (row["run_id"], row["state"]) == (1, "proposed")
            assert [r["outcome"] for r in on_disk(cell.ledger.runs)] == ["complete"]

    run_virtual(main())


def test_no_command_waits_for_a_locked_ledger_and_the_newest_number_is_kept() -> None:
    unlocked, kept, handled = threading.Event(), list[int](), list[int]()

    def remember(sequence: int) -> None:
        unlocked.wait(10.0)
        kept.append(sequence)

    async def handle(command: Command) -> int:
        handled.append(command.code)
        return 1

    async def main() -> None:
        subject = CommandChannel(handle, 0, remember)

        async def acknowledged(sequence: int, code: int) -> None:
            subject.offer(Command(code, sequence))
            await until(lambda: subject.acknowledged == sequence)

        for sequence, code in ((1, 5), (2, 6), (3, 4)):  # pause, resume, halt
            await acknowledged(sequence, code)
        assert (handled, kept) == ([5, 6, 4], [])
        await acknowledged(4, START)
        assert (handled, subject.result) == ([5, 6, 4], refused("DISK_FAILED")), "it would start again"
        unlocked.set()
        await until(lambda: kept == [1, 2, 3, 4])
        await acknowledged(5, START)
        assert handled == [5, 6, 4, START]
        await subject.stop()

    asyncio.run(main())


def test_what_waits_for_the_ledger_leaves_threads_for_the_records_of_a_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    unlocked = threading.Event()

    async def serve(*args: Any) -> None:
        waiting = [asyncio.create_task(asyncio.to_thread(unlocked.wait, 20.0)) for _ in range(40)]
        await asyncio.sleep(0.1)
        try:
            async with asyncio.timeout(5.0):
                assert await asyncio.to_thread(lambda: "written") == "written"
        finally:
            unlocked.set()
            await asyncio.wait(waiting)

    monkeypatch.setattr(app, "serve", serve)
    asyncio.run(app._until_signal(cast(Any, None), cast(Any, None)))


def test_items_of_a_belt_wait_for_the_ledger_one_behind_the_other() -> None:
    unlocked, asked = asyncio.Event(), list[int]()

    async def add_item(run: Any, item: int, *rest: Any) -> None:
        asked.append(item)
        await unlocked.wait()

    run = SimpleNamespace(
        cell=SimpleNamespace(add_item=add_item),
        clock=SimpleNamespace(now=lambda: 0.0),
        note=lambda *args, **fields: None,
        progress=lambda *args: None,
    )
    queue = SimpleNamespace(counts={Outcome.PICKED: 0})

    async def main() -> None:
        subject = ItemBookkeeping(
            cast(Run, run), cast(BeltWatch, SimpleNamespace(record=None, queue=queue)), 0, 3
        )
        for number in (1, 2, 3):
            item = SimpleNamespace(number=number, sightings=1, history=[], contact={})
            subject._ended(cast(Item, item), Outcome.LOST)
        await asyncio.sleep(0.05)
        assert asked == [1]
        unlocked.set()
        await asyncio.gather(*subject._writing)
        assert asked == [1, 2, 3]

    asyncio.run(main())
