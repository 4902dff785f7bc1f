"""The report of a run without a result is drawn at its end, by a process that yields to all others."""

import asyncio
import logging
import os
import time
from pathlib import Path

import pytest

from cell.errors import error
from daemon import report_drawing
from daemon.report_drawing import ReportDrawing
from fakes.object import run_virtual
from procedures.hand_eye.record import CaptureRecord
from tests.kit.cli_harness import CellOnDisk
from tests.kit.object_cell import no_report, open_cell, write_config

__all__ = ["no_report"]


def drawn(folders: list[Path], until: Path) -> float:
    """Have ``folders`` drawn until the file ``until`` is there; the seconds that asking for it took."""

    async def scenario() -> float:
        subject = ReportDrawing()
        task = asyncio.create_task(subject.run())
        began = time.perf_counter()
        for folder in folders:
            subject.want(folder)
        asked = time.perf_counter() - began
        async with asyncio.timeout(180):
            while not await asyncio.to_thread(until.exists):
                assert not task.done()
                await asyncio.sleep(0.02)
        task.cancel()
        await asyncio.wait([task])
        return asked

    return asyncio.run(scenario())


def test_a_run_that_was_aborted_has_its_report_without_anybody_asking(tmp_path: Path) -> None:
    cell = CellOnDisk(tmp_path)
    run = cell.add_run(1)
    run.finish({"outcome": "aborted", "packml": "ABORTED", "verdict": None,
                "error": error("DEVICE_LOST", "arm").as_dict()})  # fmt: skip
    asked = drawn([tmp_path / "no such folder", run.path], run.path / "report.html")
    assert "DEVICE_LOST" in (run.path / "report.html").read_text()
    assert asked < 0.05


def test_a_report_that_cannot_be_drawn_is_told_in_one_line_and_the_next_one_is_drawn(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    good = CellOnDisk(tmp_path).add_run(1)
    good.finish({"outcome": "stopped"})
    bad = tmp_path / "a_file"
    bad.write_text("no folder")
    with caplog.at_level(logging.WARNING, "cellward.results"):
        drawn([bad, good.path], good.path / "report.html")
    told = [r.getMessage() for r in caplog.records if r.name == "cellward.results"]
    assert len(told) == 1
    assert "the report of a_file was not drawn" in told[0]


def test_the_drawing_runs_behind_all_other_processes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []
    monkeypatch.setattr(report_drawing, "yield_to_others", asked.append)
    run = CellOnDisk(tmp_path).add_run(1)
    assert report_drawing.main(run.path) == 0
    assert asked == [19]


def test_a_drawing_that_hangs_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    slow = tmp_path / "python"
    pid_file = tmp_path / "pid"
    slow.write_text(f"#!/bin/sh\necho $$ > {pid_file}\nexec sleep 600\n")
    slow.chmod(0o755)
    monkeypatch.setattr("sys.executable", str(slow))
    drawn([tmp_path], pid_file)
    while not pid_file.read_text().strip():
        time.sleep(0.01)
    with pytest.raises(ProcessLookupError):
        os.kill(int(pid_file.read_text()), 0)


def test_the_engine_asks_for_it_when_a_run_has_no_result_and_the_next_can_start_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise error("DISK_FULL", "here")

    async def main() -> None:
        async with open_cell(write_config(tmp_path)) as cell:
            wanted: list[tuple[Path, bool]] = []
            cell.engine.report_wanted = lambda folder: wanted.append((folder, cell.engine.active))
            with monkeypatch.context() as patch:
                patch.setattr(CaptureRecord, "begin", full)
                await cell.run_job()
            assert (await cell.run_job())["outcome"] == "complete"
            assert wanted == [(cell.folder(1).path, False)]

    run_virtual(main())
