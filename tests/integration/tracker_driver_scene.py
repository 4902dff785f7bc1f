"""The GeoCOM driver opened on a scripted instrument."""

import asyncio
import math
from collections.abc import Callable, Coroutine
from typing import Any

import numpy as np
import pytest
from geocom_rig import Instrument, on_tcp, opened

from cell.errors import CellError
from drivers.tracker import GeocomTracker

TRUTH = np.array([3 * math.sin(1.4) * math.sin(0.3), 3 * math.sin(1.4) * math.cos(0.3), 3 * math.cos(1.4)])
Scene = Callable[[GeocomTracker], Coroutine[Any, Any, Any]]


@pytest.fixture
def subject() -> Instrument:
    return Instrument()


def play(instrument: Instrument, scene: Scene, **keys: Any) -> Any:
    """Runs a scene with the open driver on TCP."""

    async def whole() -> Any:
        async with asyncio.timeout(10), on_tcp(instrument) as (url, _), opened(url, **keys) as tracker:
            return await scene(tracker)

    return asyncio.run(whole())


async def found(tracker: GeocomTracker) -> None:
    await tracker.select("smr1")
    await tracker.find(None, 2.0)


async def failure_of(what: Coroutine[Any, Any, Any]) -> CellError:
    with pytest.raises(CellError) as caught:
        await what
    return caught.value


async def until(true: Callable[[], bool]) -> None:
    async with asyncio.timeout(5.0):
        while not true():  # noqa: ASYNC110 -- nothing tells
            await asyncio.sleep(0.01)
