"""What tests with one browser leave behind is seen, here with a stand-in for the browser."""

import asyncio
import subprocess
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from tests.kit import browser, left_behind

pytestmark = pytest.mark.wire


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[subprocess.Popen[bytes]]:
    """Processes of the stand-in, which does not end them."""
    found: list[subprocess.Popen[bytes]] = []

    def start() -> None:
        found.append(subprocess.Popen(["sleep", "60"]))

    @asynccontextmanager
    async def stand_in() -> AsyncIterator[Any]:
        start()
        yield SimpleNamespace(contexts=[])

    monkeypatch.setattr(browser, "_browser", stand_in)
    monkeypatch.setattr(left_behind, "PATIENCE_S", 0.05)
    return found


def test_a_task_and_a_process_that_are_left_behind_are_named(started: list[subprocess.Popen[bytes]]) -> None:
    async def leaves(_: Any) -> None:
        asyncio.create_task(asyncio.sleep(60.0), name="forgotten")  # noqa: RUF006

    async def leaves_nothing(_: Any) -> None: ...

    def uses() -> None:
        with browser.one_browser() as subject:
            subject(leaves_nothing)
            with pytest.raises(AssertionError, match=r"tasks left behind: .*forgotten"):
                subject(leaves)

    try:
        with pytest.raises(AssertionError, match=r"children left behind: .*sleep 60"):
            uses()
    finally:
        for process in started:
            process.kill()
            process.wait()
