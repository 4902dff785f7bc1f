"""Setting TCP and payload at rest: judged by the controller's own time, and ended by what ends the script."""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cell.devices import ArmState, ToolSettings
from cell.errors import CellError, error
from cell.poses import from_pose6, to_pose6
from cell.samples import Sample, Stream
from drivers.ur.config import UrConfig
from drivers.ur.feed import PLAYING, STOPPED
from drivers.ur.motion import UrMotion
from drivers.ur.script_end import Kicks, ScriptRecord
from drivers.ur.watch import until
from fakes.object import VirtualClock, run_virtual

TOOL = ToolSettings(from_pose6([0.0, 0.0, 0.18, 0.0, 0.0, 0.0]), 1.2)
TCP = to_pose6(TOOL.T_flange_tool)
Play = Callable[[SimpleNamespace], Awaitable[None]]


def setting(play: Play, answer_after_s: float, refused: bool = False) -> CellError | None:
    """Set the tool while ``play`` does what the controller and the child do; what it ended with."""

    async def scene() -> CellError | None:
        clock = VirtualClock()
        cell = SimpleNamespace(clock=clock, state=Stream("arm", clock), runtime=PLAYING, kicks=Kicks(), seq=0)

        async def call(do: str, deadline_s: float, **arguments: Any) -> list[float]:
            assert do == "tool"
            await asyncio.sleep(min(answer_after_s, deadline_s))
            if answer_after_s > deadline_s:
                raise error("CALL_TIMEOUT", "the child")
            if refused:
                raise error("CHILD_DIED", "the motion client refused")
            return TCP.tolist()

        subject = object.__new__(UrMotion)
        subject.client = SimpleNamespace(  # type: ignore[assignment]
            kicks=cell.kicks,
            withheld=False,
            ended=SimpleNamespace(is_set=lambda: False),
            call=call,
            subscribe=lambda listener: lambda: None,
        )
        cell.feed = SimpleNamespace(tcp_offset6=np.zeros(6), payload=(1.2,))
        subject._arm = SimpleNamespace(  # type: ignore[assignment]
            state=cell.state, feed=cell.feed, lost=None, fault=lambda: None, tcp_read_back=lambda tcp: None
        )
        subject._tool, subject._clock, subject._config = TOOL, clock, UrConfig(host="h")
        subject._until = partial(until, subject._arm, subject._config)
        subject.script = ScriptRecord(cell.kicks, 0.1)
        subject.script.expect()
        cell.state.subscribe(lambda s: subject.script.note(cell.runtime, s.t))
        playing = asyncio.create_task(play(cell))
        try:
            await subject._set_tool()
        except CellError as failure:
            return failure
        finally:
            playing.cancel()
            with suppress(asyncio.CancelledError):
                await playing
        return None

    return run_virtual(scene())


async def states(cell: SimpleNamespace, seconds: float, kicked: bool = True) -> None:
    """What the controller sends in so many seconds."""
    zero = np.zeros(6)
    for _ in range(round(seconds / 0.01)):
        await cell.clock.sleep(0.01)
        if kicked:
            cell.kicks.note(cell.clock.now())
        cell.seq += 1
        state = ArmState(zero, zero, zero, zero, zero, 7, 1, cell.runtime == PLAYING, 0, 0, 0.0)
        cell.state.push(Sample(state, cell.clock.now(), 0.001, cell.seq))


def test_a_tool_that_the_samples_show_is_set() -> None:
    async def play(cell: SimpleNamespace) -> None:
        await states(cell, 0.3)
        cell.feed.tcp_offset6 = TCP
        await states(cell, 1.0)

    assert setting(play, 0.1) is None


def test_a_controller_that_pauses_has_all_its_time_afterwards() -> None:
    async def play(cell: SimpleNamespace) -> None:
        await states(cell, 0.3)
        await cell.clock.sleep(0.7)
        cell.feed.tcp_offset6 = TCP
        await states(cell, 1.0)

    assert setting(play, 0.2) is None


def test_a_tool_that_half_a_second_of_samples_does_not_show_is_not_set() -> None:
    failure = setting(lambda cell: states(cell, 2.0), 0.1)
    assert failure is not None
    assert failure.name == "ARM_TOOL_NOT_SET"


def test_a_silence_does_not_say_that_the_tool_is_not_set() -> None:
    failure = setting(lambda cell: states(cell, 0.2), 0.1)
    assert failure is not None
    assert failure.name == "STALE_DATA"


def test_a_script_that_our_watchdog_ends_meanwhile_ends_it_at_once_by_name() -> None:
    ended: list[float] = []

    async def play(cell: SimpleNamespace) -> None:
        await states(cell, 0.1)
        await states(cell, 0.15, kicked=False)
        cell.runtime = STOPPED
        ended.append(cell.clock.now())
        await states(cell, 0.05, kicked=False)
        ended.append(cell.clock.now())

    failure = setting(play, 1.9)
    assert failure is not None
    assert failure.name == "MOTION_WATCHDOG"
    assert len(ended) == 1, "it did not wait for the child's answer, which never comes"


def test_a_child_that_does_not_answer_is_an_interruption() -> None:
    failure = setting(lambda cell: states(cell, 5.0), 60.0)
    assert failure is not None
    assert failure.name == "MOTION_WATCHDOG"


@pytest.mark.parametrize(("ends", "name"), [(True, "MOTION_WATCHDOG"), (False, "CHILD_DIED")])
def test_a_client_that_refuses_since_our_watchdog_ended_the_script_is_told_by_that(
    ends: bool, name: str
) -> None:
    async def play(cell: SimpleNamespace) -> None:
        await states(cell, 0.1)
        await states(cell, 0.15, kicked=not ends)
        cell.runtime = STOPPED if ends else PLAYING
        await states(cell, 1.0, kicked=not ends)

    failure = setting(play, 0.245, refused=True)  # the next state tells that the script has ended
    assert failure is not None
    assert failure.name == name
