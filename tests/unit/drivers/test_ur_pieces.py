"""What the motion child is told with each piece of a trajectory."""

import asyncio
from collections.abc import AsyncIterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cell.clock import MonotonicClock
from cell.devices import TrajectoryPiece
from cell.samples import Sample, Stream
from drivers.ur.pieces import Following


class NotingClient:
    """Of the motion client what is posted."""

    def __init__(self) -> None:
        self.clock, self.idle = MonotonicClock(), asyncio.Event()
        self.posted: list[tuple[str, dict[str, Any]]] = []

    def subscribe(self, listener: Any) -> Any:
        return lambda: None

    def post(self, do: str, **arguments: Any) -> None:
        self.posted.append((do, arguments))


class OpenWatch:
    """A motion that goes on."""

    over = False

    async def first(self, *futures: Any) -> bool:
        await asyncio.wait(futures, return_when=asyncio.FIRST_COMPLETED)
        return True


def test_each_piece_carries_when_the_newest_state_was_made_for_the_pace_of_set_points() -> None:
    """Its stamp without the configured offset of 1.3 ms."""

    async def scene() -> None:
        client = NotingClient()
        state: Stream[Any] = Stream("arm", client.clock)
        now = client.clock.now()

        async def pieces() -> AsyncIterator[TrajectoryPiece]:
            for k in range(2):
                state.push(Sample(None, now + 0.002 * k, 0.001, k))
                yield TrajectoryPiece(now, now + 0.1, np.zeros((1, 6)))

        arm: Any = SimpleNamespace(state=state)
        with Following(client, arm, OpenWatch(), 0.0013) as subject:  # type: ignore[arg-type]
            await subject.send(pieces(), lambda: np.zeros(6))
        cycles = [arguments["cycle"] for do, arguments in client.posted if do == "piece"]
        assert cycles == pytest.approx(
            [now + 0.0013, now + 0.0033], rel=0.0, abs=1e-9
        )  # s since the machine's start

    asyncio.run(scene())
