"""A control server with a stand-in engine, and a blocking client beside it."""

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from daemon.control import ControlServer
from tests.kit.control_harness import RecordingEngine


@pytest.fixture
def engine() -> RecordingEngine:
    return RecordingEngine()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "control.sock"


def serving(
    path: Path, engine: RecordingEngine, use: Callable[[], Any], audit: Callable[..., None] | None = None
) -> Any:
    """Run the blocking ``use`` in a thread beside a server; its value."""

    async def scenario() -> Any:
        server = ControlServer(path, engine, audit)
        await server.start()
        try:
            return await asyncio.wait_for(asyncio.to_thread(use), 20)
        finally:
            await server.stop()

    return asyncio.run(scenario())


async def until(condition: Callable[[], bool]) -> None:
    for _ in range(500):
        if condition():
            return
        await asyncio.sleep(0.01)
    raise AssertionError("not within 5 s")
