"""The start of the control script: seen late, ended by our own pause, or ended by others."""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import partial
from types import SimpleNamespace

import pytest

from cell.errors import CellError
from cell.samples import Stream
from drivers.ur.config import UrConfig
from drivers.ur.feed import PLAYING, STOPPED
from drivers.ur.motion import UrMotion
from drivers.ur.script_end import Kicks, ScriptRecord
from drivers.ur.watch import until
from fakes.object import VirtualClock, run_virtual
from tests.unit.drivers.test_ur_setting_the_tool import states


def scene_of(runtime: int) -> tuple[SimpleNamespace, UrMotion]:
    """An arm whose script is about to be uploaded, and the port that waits for its start."""
    clock = VirtualClock()
    cell = SimpleNamespace(clock=clock, state=Stream("arm", clock), runtime=runtime, kicks=Kicks(), seq=0)
    subject = object.__new__(UrMotion)
    subject._arm = SimpleNamespace(state=cell.state, lost=None)  # type: ignore[assignment]
    subject._clock, subject._config = clock, UrConfig(host="h")
    subject._until = partial(until, subject._arm, subject._config)
    subject.script = ScriptRecord(cell.kicks, 0.1)
    subject.script.expect()
    cell.state.subscribe(lambda s: subject.script.note(cell.runtime, s.t))
    return cell, subject


def started(play: Callable[[SimpleNamespace], Awaitable[None]]) -> str | None:
    """The name of the error with which waiting for the start ended."""

    async def scene() -> str | None:
        cell, subject = scene_of(STOPPED)
        playing = asyncio.create_task(play(cell))
        try:
            await subject._until_script_runs()
        except CellError as failure:
            return failure.name
        finally:
            playing.cancel()
            with suppress(asyncio.CancelledError):
                await playing
        return None

    return run_virtual(scene())


@pytest.mark.parametrize(("before_s", "name"), [(0.1, None), (2.0, None), (4.0, "CALL_TIMEOUT")])
def test_a_start_is_waited_for(before_s: float, name: str | None) -> None:
    async def play(cell: SimpleNamespace) -> None:
        await states(cell, before_s)
        cell.runtime = PLAYING
        await states(cell, 0.5)

    assert started(play) == name


@pytest.mark.parametrize(("lapse_s", "name"), [(0.3, "MOTION_WATCHDOG"), (0.0, "ARM_SCRIPT_DIED")])
def test_a_script_that_ended_before_its_start_was_looked_for_says_whose_end_it_was(
    lapse_s: float, name: str
) -> None:
    """The states of the whole story come at once, as to a loop that had paused."""

    async def scene() -> str:
        cell, subject = scene_of(PLAYING)
        await states(cell, 0.2)
        await states(cell, lapse_s, kicked=False)
        cell.runtime = STOPPED
        more = asyncio.create_task(states(cell, 1.0, kicked=False))
        await states(cell, 0.02, kicked=False)
        with pytest.raises(CellError) as caught:
            await subject._until_script_runs()
        await more
        return caught.value.name

    assert run_virtual(scene()) == name
