"""A tracker that is asked is asked when it was, and its jobs go on when they did.

Polls of the driver come between what a job asks, and are left out while it asks. A job on virtual time does
not wait for its disk: it would ask earlier, up to 0.2 s in a run of ours, meet other polls, and wait for
answers that come when they came, longer than its timeout. So each question waits for the time at which it was
asked, and each state for the one at which it was entered.
"""

from collections import defaultdict, deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Any
from unittest.mock import patch

from cell.clock import Clock
from cell.procedure import Run
from cell.store.journal import read_journal
from cell.store.runs import JOURNAL_FILE, list_runs
from drivers.tracker import GeocomTracker
from drivers.tracker.geocom_session import GeocomSession
from drivers.tracker.geocom_station import Rpc
from drivers.tracker.geocom_text import request
from fakes.replay.player import WirePlayer

SAME_S = 1e-6  # instants that are no further apart are the same
LOOK_S = 0.001  # so often a job looks at an arm: it sees it come no later than it did


def entered(state: Path) -> dict[str, deque[float]]:
    """When each state of the runs below ``state`` was entered, s."""
    found: dict[str, deque[float]] = defaultdict(deque)
    for run in list_runs(state / "runs"):
        for line in read_journal(run.path / JOURNAL_FILE):
            if line["kind"] == "state" and "state" in line:  # not how it ended
                found[line["state"]].append(line["t"])
    return found


@contextmanager
def asked_as_recorded(player: WirePlayer, clock: Clock, state: Path) -> Iterator[None]:
    """Of trackers and their jobs; ``state``: the folder of the recorded runs."""
    until_poll, once, enter = GeocomTracker._until_poll, GeocomSession._once, Run.enter
    states = entered(state)

    async def until(t: float | None) -> None:
        if t is not None:
            await clock.sleep(max(t - clock.now(), 0.0))

    async def until_polled(self: GeocomTracker) -> None:
        lock = request(Rpc.MOT_ReadLockStatus, 0)  # with which a poll begins
        t = player.next_asked("tracker", lock, clock.now() + SAME_S)
        await (until_poll(self) if t is None else until(t))

    async def once_in_time(self: GeocomSession, rpc: int, parameters: Any, *more: Any) -> Any:
        await until(player.next_asked("tracker", request(rpc, 0, *parameters)))
        return await once(self, rpc, parameters, *more)

    async def enter_in_time(self: Run, to: StrEnum, *more: Any, **fields: Any) -> None:
        times = states[to.value]
        await until(times.popleft() if times else None)
        await enter(self, to, *more, **fields)

    with ExitStack() as stack:
        stack.enter_context(patch.object(GeocomTracker, "_until_poll", until_polled))
        stack.enter_context(patch.object(GeocomSession, "_once", once_in_time))
        stack.enter_context(patch.object(Run, "enter", enter_in_time))
        stack.enter_context(patch("procedures.asked_arm.LOOK_S", LOOK_S))
        yield
