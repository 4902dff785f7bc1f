"""A disk that runs low is told before it is full: in the status, in the log, and to the PLC."""

import asyncio
import logging
from collections import namedtuple
from pathlib import Path

import pytest

from daemon.cli.status_text import status_text
from daemon.disk_space import LOOK_S, LOW_FREE_BYTES, DiskSpace, free_bytes
from fakes.object import VirtualClock, run_virtual

Usage = namedtuple("Usage", "total used free")


def test_a_disk_that_runs_low_is_told_once_and_so_is_its_recovery(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    free = [LOW_FREE_BYTES + 1, LOW_FREE_BYTES - 1, 10**8, OSError(5, "I/O error"), LOW_FREE_BYTES]
    looked = iter(free)

    def usage(_: Path) -> Usage:
        found = next(looked)
        if isinstance(found, OSError):
            raise found
        return Usage(0, 0, found)

    monkeypatch.setattr("shutil.disk_usage", usage)

    async def main() -> list[str | None]:
        clock = VirtualClock()
        subject = DiskSpace(tmp_path, clock)
        assert subject.status()["warning"] is None
        task = asyncio.create_task(subject.watch())
        told = []
        for _ in free:
            await clock.sleep(LOOK_S / 2)
            told.append(subject.status()["warning"])
            await clock.sleep(LOOK_S / 2)
        task.cancel()
        return told

    with caplog.at_level(logging.INFO, "cellward.health"):
        told = run_virtual(main())
    assert [warning is not None for warning in told] == [False, True, True, False, False]
    assert "0.1 GB are free, less than 2 GB" in (told[2] or "")
    assert [r.levelname for r in caplog.records] == ["WARNING", "ERROR", "INFO"]
    assert "free again" in caplog.records[2].getMessage()


def test_the_status_says_it_in_words() -> None:
    status = {"cell": "c", "packml": "IDLE", "devices": {}, "disk": {"warning": "1.2 GB are free"}}
    assert "disk      1.2 GB are free" in status_text(status)
    assert "disk" not in status_text({**status, "disk": {}})


def test_a_folder_that_is_not_made_yet_is_judged_by_what_exists_of_its_path(tmp_path: Path) -> None:
    assert free_bytes(tmp_path / "not" / "yet") > 0
