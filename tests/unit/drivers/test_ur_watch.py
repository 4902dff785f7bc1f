"""An arm that rests away from its target: it missed it, or our own late beat stopped it."""

import asyncio
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from cell.devices import ArmState
from cell.errors import CellError
from cell.samples import Sample, Stream
from drivers.ur.script_end import ScriptEnd
from drivers.ur.watch import STUCK_S, Watch, joints_judge
from fakes.object import VirtualClock, run_virtual

TARGET = np.full(6, 0.1)


def resting(t: float, seq: int) -> Sample[ArmState]:
    """A sample of an arm at rest 0.1 rad from its target, our script running."""
    z = np.zeros(6)
    return Sample(ArmState(z, z, z, z, z, 7, 1, True, 0, 0, 0.0), t, 0.001, seq)


def outcome(times: list[float], withheld_after: int | None = None, end: ScriptEnd = ScriptEnd.NONE) -> str:
    """The error that samples with stamps ``times`` end a move with; the child's word comes with the last."""

    async def scene() -> str:
        clock = VirtualClock()
        arm: Any = SimpleNamespace(state=Stream("arm", clock), lost=None, fault=lambda: None)
        client: Any = SimpleNamespace(withheld=False, subscribe=lambda listener: lambda: None)
        script: Any = SimpleNamespace(end=end)
        with Watch(arm, client, joints_judge(TARGET, 1e-3, 0.0), script) as subject:
            for k, t in enumerate(times):  # at once, as a loop that stood still finds them
                arm.state.push(resting(t, k))
            if withheld_after is not None:
                asyncio.get_running_loop().call_later(0.01, lambda: setattr(client, "withheld", True))
            with pytest.raises(CellError) as caught:
                await subject.outcome(1.0, "the move")
        return caught.value.name

    return run_virtual(scene())


EVERY = [0.01 * k for k in range(1, int(100 * STUCK_S) + 5)]


def test_an_arm_that_rests_elsewhere_missed_its_target() -> None:
    assert outcome(EVERY) == "ARM_NOT_AT_TARGET"


def test_one_that_our_late_beat_stopped_did_not() -> None:
    assert outcome(EVERY, withheld_after=1) == "MOTION_WATCHDOG"
    assert outcome(EVERY, end=ScriptEnd.OURS) == "MOTION_WATCHDOG"


def test_a_move_that_our_late_beat_stopped_does_not_blame_the_arm_when_its_time_is_over() -> None:
    """The first thing that a loop finds which stood still for long is that the time is over."""
    assert outcome([0.01]) == "CALL_TIMEOUT"
    assert outcome([0.01], withheld_after=1) == "MOTION_WATCHDOG"


def test_rest_that_was_not_seen_does_not_count() -> None:
    assert outcome([0.01, 0.01 + 1.5 * STUCK_S]) == "CALL_TIMEOUT"
