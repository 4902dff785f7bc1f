"""Who ended our script, told apart through the genuine client: a person at the pendant, or our watchdog."""

import asyncio
import os
import signal
import time
from collections.abc import AsyncIterator, Iterator

import numpy as np
import pytest
from ur_driver_rig import Rig, rests, start

from cell.devices import Speed, TrajectoryPiece
from cell.testing.taken_again import ends_by
from drivers.ur import UrArm
from drivers.ur.dashboard import dashboard
from drivers.ur.motion import UrMotion

SLOW = Speed(tcp_m_s=0.02, tcp_m_s2=0.5, joint_rad_s=0.05, joint_rad_s2=0.5)
PAUSED_S = 0.4
pytestmark = pytest.mark.wire


@pytest.fixture(scope="module")
def shared() -> Iterator[Rig]:
    with Rig.running() as rig:
        yield rig


@pytest.fixture
def rig(shared: Rig) -> Iterator[Rig]:
    yield shared
    shared.tidy()


async def under_way(arm: UrArm, port: UrMotion, how: str) -> asyncio.Task[None]:
    """A slow motion that lasts longer than the test looks at it; the arm moves."""
    q0 = arm.state.latest(2.0).value.q.copy()
    if how == "move":
        return await start(arm, port.move_joints(q0 + np.array([0.5, 0, 0, 0, 0, 0]), SLOW))

    async def pieces() -> AsyncIterator[TrajectoryPiece]:
        t0 = time.monotonic() + 0.3
        for k in range(200):
            q = q0 + np.array([0.05 * 0.1 * k, 0, 0, 0, 0, 0])
            yield TrajectoryPiece(t0 + 0.1 * k, t0 + 0.1 * (k + 1), np.array([q, [0.05, 0, 0, 0, 0, 0]]))

    return await start(arm, port.stream(pieces()))


async def stopped_at_the_pendant(rig: Rig) -> None:
    async with dashboard(rig.host, 1.0) as link:
        await link.stop(1.0)


@pytest.mark.parametrize("round_", range(3))
@pytest.mark.parametrize("how", ["move", "stream"])
def test_a_script_stopped_at_the_pendant_is_never_opened_again_however_late_we_are_afterwards(
    how: str, round_: int, rig: Rig
) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            motion = await under_way(arm, port, how)
            await asyncio.sleep(0.007 * round_)
            await stopped_at_the_pendant(rig)
            with ends_by("ARM_SCRIPT_DIED"):
                async with asyncio.timeout(10.0):
                    await motion
            port.client._beating.cancel()
            await asyncio.sleep(0.3)
            with ends_by("ARM_SCRIPT_DIED"):
                _ = port.usable
            port.client.kill()
            with ends_by("ARM_SCRIPT_DIED"):
                _ = port.usable

    rig.play(scenario)


@pytest.mark.parametrize("how", ["move", "stream"])
def test_a_script_that_ended_while_the_motion_client_stood_still_may_be_opened_again(
    how: str, rig: Rig
) -> None:
    async def scenario() -> None:
        async with rig.movable() as (arm, port):
            motion = await under_way(arm, port, how)
            os.kill(port.client.pid, signal.SIGSTOP)
            await asyncio.sleep(PAUSED_S)
            os.kill(port.client.pid, signal.SIGCONT)
            with ends_by("MOTION_WATCHDOG"):
                async with asyncio.timeout(10.0):
                    await motion
            await rests(arm, 1.0)
            assert not port.usable

    rig.play(scenario)
