"""A full disk, a withdrawn start, late requests: the engine stays usable and each run keeps one end."""

import asyncio
import sqlite3
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from cell.errors import error
from cell.store.ledger import Ledger
from cell.store.runs import RunFolder
from fakes.object import VirtualClock, run_virtual
from procedures.hand_eye.record import CaptureRecord
from tests.kit.hand_eye_made import quick_solver
from tests.kit.object_cell import WHO, no_report, on_disk, open_cell, refused, write_config

__all__ = ["no_report", "quick_solver"]
pytestmark = pytest.mark.usefixtures("no_report", "quick_solver")


def full(*args: Any, **kwargs: Any) -> Any:
    raise error("DISK_FULL", "state")


def test_a_disk_that_is_full_at_the_end_frees_the_engine_and_the_next_start_writes_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        clock = VirtualClock()
        async with open_cell(write_config(tmp_path), clock) as cell:
            with monkeypatch.context() as patch:
                patch.setattr(RunFolder, "finish", full)
                await cell.start()
                await cell.until(lambda: not cell.engine.active, "the end")
            status = cell.engine.status()
            assert status["error"]["name"] == "DISK_FULL"
            assert cell.folder(1).read_end() is None
            assert (await cell.run_job())["outcome"] == "complete"
        async with open_cell(write_config(tmp_path), clock) as again:
            assert again.engine.interrupted == [1]
            assert again.end(1)["outcome"] == "complete"

    run_virtual(main())


@pytest.mark.parametrize("what", ["begin", "add_pose", "write_data_set"])
def test_a_disk_that_fills_up_on_the_way_ends_the_run_at_rest(
    what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            with monkeypatch.context() as patch:
                patch.setattr(CaptureRecord, what, full)
                end = await cell.run_job()
            assert (end["outcome"], end["error"]["name"]) == ("aborted", "DISK_FULL")
            assert cell.at_rest()
            assert cell.ledger.results() == []
            assert (await cell.run_job())["outcome"] == "complete"

    run_virtual(main())


def test_a_ledger_that_cannot_take_the_run_refuses_the_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            with monkeypatch.context() as patch:
                patch.setattr(Ledger, "start_run", full)
                assert (await refused(cell.start())).name == "DISK_FULL"
            assert not cell.engine.active
            assert cell.end(1)["outcome"] == "withdrawn"
            assert (await cell.run_job())["outcome"] == "complete"

    run_virtual(main())


@pytest.mark.parametrize(("owner", "call"), [(RunFolder, "create"), (Ledger, "start_run")])
def test_a_start_that_is_withdrawn_starts_nothing(
    owner: type, call: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            reached, go_on = asyncio.Event(), threading.Event()
            loop = asyncio.get_running_loop()
            genuine = getattr(owner, call)

            def slow(*args: Any) -> Any:
                loop.call_soon_threadsafe(reached.set)
                go_on.wait(10.0)
                return genuine(*args)

            with monkeypatch.context() as patch:
                patch.setattr(owner, call, slow)
                starting = asyncio.create_task(cell.start())
                await reached.wait()
                starting.cancel()
                for _ in range(10):  # time stands still while a thread works
                    await asyncio.sleep(0.0)
                assert not starting.done(), "what is being written is not left alone"
                go_on.set()
                await asyncio.wait([starting])
            assert starting.cancelled()
            assert not cell.engine.active
            assert cell.end(1)["outcome"] == "withdrawn"
            assert [row["outcome"] for row in on_disk(cell.ledger.runs)] == ["withdrawn"]
            assert (await cell.run_job())["outcome"] == "complete"

    run_virtual(main())


def test_a_journal_that_takes_no_first_line_withdraws_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            with monkeypatch.context() as patch:
                patch.setattr(RunFolder, "note", full)
                assert (await refused(cell.start())).name == "DISK_FULL"
            assert (cell.folder(1).read_end() or {})["outcome"] == "withdrawn"
            assert on_disk(cell.ledger.open_runs) == []
            assert (await cell.run_job())["outcome"] == "complete"

    run_virtual(main())


def test_a_ledger_that_fails_at_the_end_frees_the_engine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*args: Any) -> Any:
        raise sqlite3.DatabaseError("database disk image is malformed")

    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            with monkeypatch.context() as patch:
                patch.setattr(Ledger, "end_run", broken)
                await cell.start()
                await cell.until(lambda: not cell.engine.active, "the end")
            assert cell.engine.status()["error"]["name"] == "INTERNAL"
            assert (await cell.run_job())["outcome"] == "complete"

    run_virtual(main())


def test_who_starts_while_another_start_is_made_is_told_the_job_of_that_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            reached, go_on = asyncio.Event(), threading.Event()
            loop, genuine = asyncio.get_running_loop(), Ledger.start_run

            def slow(*args: Any) -> None:
                loop.call_soon_threadsafe(reached.set)
                go_on.wait(10.0)
                genuine(*args)

            with monkeypatch.context() as patch:
                patch.setattr(Ledger, "start_run", slow)
                starting = asyncio.create_task(cell.start())
                await reached.wait()
                busy = await refused(cell.start(job="latency-calibration"))
                go_on.set()
                run_id = await starting
            assert (busy.name, busy.detail) == ("BUSY", "cone-capture is being started")
            busy = await refused(cell.start())
            assert (busy.name, busy.detail) == ("BUSY", f"cone-capture, run {run_id}")
            await cell.finished(run_id)

    run_virtual(main())


def test_what_is_asked_while_the_end_is_written_is_refused_and_the_end_stays_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            reached, go_on = asyncio.Event(), threading.Event()
            loop, genuine = asyncio.get_running_loop(), RunFolder.finish

            def slow(folder: RunFolder, end: Mapping[str, Any]) -> None:
                genuine(folder, end)
                loop.call_soon_threadsafe(reached.set)
                go_on.wait(10.0)

            with monkeypatch.context() as patch:
                patch.setattr(RunFolder, "finish", slow)
                run_id = await cell.start()
                await reached.wait()
                assert cell.engine.active
                for verb in ("pause", "resume", "finish", "abort", "halt"):
                    assert (await refused(getattr(cell.engine, verb)(WHO))).name == "NOT_NOW"
                go_on.set()
                await cell.until(lambda: not cell.engine.active, "the end")
            assert cell.end(run_id)["outcome"] == "complete"
            assert cell.journal(run_id)[-1]["terminal"] is True

    run_virtual(main())
