"""The palletizer of the object face: its joints at rest and moving, its program, and what it does wrong."""

from collections.abc import Awaitable, Callable
from typing import Any

import numpy as np
import pytest

from cell.devices import JointState, ObservedArm
from cell.errors import CellError
from fakes.object import ObjectObservedArm, VirtualClock, run_virtual

HOME = [0.0, 1.570796, -1.570796, 0.0]
THERE = [0.6, 1.3, -1.1, -0.4]
Scene = Callable[[ObjectObservedArm, VirtualClock], Awaitable[Any]]


def play(scene: Scene, **keys: Any) -> Any:
    async def whole() -> Any:
        clock = VirtualClock()
        config = ObjectObservedArm.Config(scenario="palletizer:ideal", **{"allow_requests": True, **keys})
        arm: ObjectObservedArm = ObjectObservedArm("palletizer", config, clock)
        checked: ObservedArm = arm
        await checked.open()
        try:
            return await scene(arm, clock)
        finally:
            await arm.close()

    return run_virtual(whole())


def now(arm: ObjectObservedArm) -> JointState:
    return arm.joints.latest(0.1).value


async def reaches(arm: ObjectObservedArm, clock: VirtualClock, number: int, within_s: float = 20.0) -> None:
    give_up = clock.now() + within_s
    while now(arm).at_pose != number or not now(arm).at_rest:
        assert clock.now() < give_up, f"never at pose {number}: {now(arm)}"
        await clock.sleep(0.1)


def test_a_requested_pose_is_gone_to_after_a_while_and_its_number_told_at_the_end() -> None:
    async def scene(arm: ObjectObservedArm, clock: VirtualClock) -> None:
        await clock.sleep(1.0)
        assert now(arm).at_rest
        assert now(arm).at_pose is None
        np.testing.assert_allclose(now(arm).q, HOME)
        assert await arm.request(7, np.array(THERE))
        await clock.sleep(0.9)
        assert now(arm).at_rest, "an operator looks around first"
        await clock.sleep(0.4)
        assert not now(arm).at_rest
        assert now(arm).at_pose is None
        await reaches(arm, clock, 7)
        np.testing.assert_allclose(now(arm).q, THERE)

    play(scene)


def test_nothing_is_asked_of_the_arm_without_permission_or_handshake() -> None:
    async def scene(arm: ObjectObservedArm, clock: VirtualClock) -> None:
        assert not await arm.request(1, np.array(THERE))
        await clock.sleep(10.0)
        np.testing.assert_allclose(now(arm).q, HOME)

    play(scene, allow_requests=False)
    play(scene, handshake=False)


def test_a_pose_outside_the_limits_is_refused_and_the_number_stays() -> None:
    async def scene(arm: ObjectObservedArm, clock: VirtualClock) -> None:
        await arm.request(1, np.array(THERE))
        await reaches(arm, clock, 1)
        await arm.request(2, np.array([0.0, 3.0, -1.0, 0.0]))
        await clock.sleep(8.0)
        assert now(arm).at_pose == 1
        np.testing.assert_allclose(now(arm).q, THERE)

    play(scene)


def test_a_request_is_taken_back_by_number_0_until_the_arm_sets_out() -> None:
    async def scene(arm: ObjectObservedArm, clock: VirtualClock) -> None:
        await arm.request(1, np.array(THERE))
        await clock.sleep(0.5)
        await arm.request(0, np.zeros(4))
        await clock.sleep(8.0)
        np.testing.assert_allclose(now(arm).q, HOME)
        assert now(arm).at_pose is None

    play(scene)


def test_a_program_that_skips_a_pose_says_it_is_there_with_the_joints_elsewhere() -> None:
    async def scene(arm: ObjectObservedArm, clock: VirtualClock) -> None:
        arm.inject("skip-pose")
        await arm.request(1, np.array(THERE))
        await reaches(arm, clock, 1)
        np.testing.assert_allclose(now(arm).q, HOME)
        await arm.request(2, np.array(THERE))
        await reaches(arm, clock, 2)
        np.testing.assert_allclose(now(arm).q, THERE)

    play(scene)


def test_a_program_in_the_wrong_order_says_where_it_really_is() -> None:
    async def scene(arm: ObjectObservedArm, clock: VirtualClock) -> None:
        await arm.request(1, np.array(THERE))
        await reaches(arm, clock, 1)
        arm.inject("wrong-order")
        await arm.request(2, np.array(HOME))
        await clock.sleep(5.0)
        assert now(arm).at_pose == 1
        np.testing.assert_allclose(now(arm).q, THERE)

    play(scene)


def test_a_jog_while_the_arm_should_stand_is_seen_in_its_joints() -> None:
    async def scene(arm: ObjectObservedArm, clock: VirtualClock) -> None:
        await clock.sleep(1.0)
        arm.inject("unasked-move", rad=0.002)
        await clock.sleep(0.1)
        assert not now(arm).at_rest
        await clock.sleep(1.0)
        assert now(arm).at_rest
        np.testing.assert_allclose(now(arm).q, np.array(HOME) + 0.002)

    play(scene)


def test_a_stuck_joint_shows_its_old_value_until_it_is_freed() -> None:
    async def scene(arm: ObjectObservedArm, clock: VirtualClock) -> None:
        arm.inject("stuck", joint=2)
        await arm.request(1, np.array(THERE))
        await reaches(arm, clock, 1)
        np.testing.assert_allclose(now(arm).q, [THERE[0], HOME[1], *THERE[2:]])
        arm.inject("clear")
        await clock.sleep(1.0)
        np.testing.assert_allclose(now(arm).q, THERE)

    play(scene)


def test_a_controller_that_falls_silent_is_lost_and_one_that_restarts_may_be_another() -> None:
    async def scene(arm: ObjectObservedArm, clock: VirtualClock) -> None:
        arm.inject("silence")
        found = await arm.wait_lost()
        assert isinstance(found, CellError)
        assert found.name == "DEVICE_LOST"
        arm.inject("clear")
        arm.inject("reboot", serial="99995500009", boot_s=0.5)
        with pytest.raises(CellError):
            await arm.open()
        await clock.sleep(1.0)
        await arm.open()
        assert (await arm.identify()).serial == "99995500009"

    play(scene)
