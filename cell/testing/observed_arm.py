"""What every observed arm with a handshake promises, on the object face and over Modbus registers."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import pytest

from cell.devices import JointState, ObservedArm
from cell.errors import CellError
from cell.testing.bench import Bench, Rig
from cell.testing.device import DeviceContract

LIMIT_S = 20.0


@dataclass
class ObservedArmRig(Rig[ObservedArm]):
    """An arm at ``home``; ``there`` is another pose, ``beyond`` one outside its limits, joints (n,), rad.

    It moves when a case asks for a pose, so those cases need ``motion``. The bench's rig takes ``allow``:
    whether requests are permitted.
    """

    home: list[float] = field(default_factory=list, kw_only=True)
    there: list[float] = field(default_factory=list, kw_only=True)
    beyond: list[float] = field(default_factory=list, kw_only=True)

    def state(self) -> JointState:
        return self.device.joints.latest(2.0).value

    async def until(self, true: Callable[[JointState], bool], what: str) -> JointState:
        give_up = self.clock.now() + LIMIT_S
        while not true(self.state()):
            assert self.clock.now() < give_up, f"no {what}: {self.state()}"
            await self.clock.sleep(0.02)
        return self.state()

    async def goes_to(self, number: int, q: list[float]) -> JointState:
        """Ask for a pose; the state in which the arm's program is said to stand at ``number``."""
        assert await self.device.request(number, np.array(q))
        return await self.until(lambda s: s.at_pose == number and s.at_rest, f"pose {number}")


class ObservedArmContract(DeviceContract[ObservedArmRig]):
    """Joints come in order, and an asked arm says the number of the pose at which it stands."""

    def test_joints_come_in_order(self, subject: Bench[ObservedArmRig]) -> None:
        subject.needs("truth")

        async def scene(rig: ObservedArmRig) -> None:
            assert rig.device.axes == len(rig.home)
            begun = rig.clock.now()
            await rig.device.wait_fresh(2.0)
            await rig.until(lambda s: s.at_rest, "rest")
            samples = rig.device.joints.between(begun, rig.clock.now())
            assert len(samples) > 3
            assert all(a.t < b.t and a.seq < b.seq for a, b in pairwise(samples))
            np.testing.assert_allclose(samples[-1].value.q, rig.home, atol=3e-7)
            assert samples[-1].value.at_pose is None

        subject(scene)

    def test_an_asked_arm_sets_out_gets_there_and_says_the_number(
        self, subject: Bench[ObservedArmRig]
    ) -> None:
        subject.needs("motion")

        async def scene(rig: ObservedArmRig) -> None:
            await rig.until(lambda s: s.at_rest, "rest")
            assert await rig.device.request(9, np.array(rig.there))
            moving = await rig.until(lambda s: not s.at_rest, "departure")
            assert moving.at_pose in (None, 9)
            state = await rig.until(lambda s: s.at_pose == 9 and s.at_rest, "arrival")
            np.testing.assert_allclose(state.q, rig.there, atol=3e-7)
            again = await rig.goes_to(10, rig.home)
            np.testing.assert_allclose(again.q, rig.home, atol=3e-7)

        subject(scene)

    def test_without_permission_a_person_must_move_the_arm(self, subject: Bench[ObservedArmRig]) -> None:
        subject.needs("motion")

        async def scene(rig: ObservedArmRig) -> None:
            assert not await rig.device.request(1, np.array(rig.there))
            await rig.clock.sleep(0.5)
            np.testing.assert_allclose(rig.state().q, rig.home, atol=3e-7)
            assert rig.state().at_pose is None

        subject(scene, allow=False)

    def test_a_pose_beyond_the_arms_limits_leaves_it_where_it_is(
        self, subject: Bench[ObservedArmRig]
    ) -> None:
        subject.needs("motion")

        async def scene(rig: ObservedArmRig) -> None:
            await rig.goes_to(1, rig.there)
            assert await rig.device.request(2, np.array(rig.beyond))
            await rig.clock.sleep(1.5)
            assert rig.state().at_pose == 1
            np.testing.assert_allclose(rig.state().q, rig.there, atol=3e-7)

        subject(scene)

    def test_a_skipped_pose_a_wrong_order_and_a_stuck_joint_show_in_the_joints(
        self, subject: Bench[ObservedArmRig]
    ) -> None:
        subject.needs("motion", "skip-pose", "wrong-order", "stuck")

        async def scene(rig: ObservedArmRig) -> None:
            await rig.inject("skip-pose")
            np.testing.assert_allclose((await rig.goes_to(1, rig.there)).q, rig.home, atol=3e-7)
            await rig.goes_to(2, rig.there)
            await rig.inject("wrong-order")
            assert await rig.device.request(3, np.array(rig.home))
            await rig.clock.sleep(3.0)
            assert rig.state().at_pose == 2
            await rig.inject("stuck", joint=1)
            np.testing.assert_allclose(
                (await rig.goes_to(4, rig.home)).q, [rig.there[0], *rig.home[1:]], atol=3e-7
            )
            await rig.inject("clear")
            await rig.until(lambda s: bool(abs(s.q[0]) < 1e-6), "a joint that lives")

        subject(scene)

    def test_an_arm_that_is_jogged_while_it_should_stand_is_seen_to_move(
        self, subject: Bench[ObservedArmRig]
    ) -> None:
        subject.needs("truth", "unasked-move")

        async def scene(rig: ObservedArmRig) -> None:
            await rig.until(lambda s: s.at_rest, "rest")
            await rig.inject("unasked-move", rad=0.02)
            await rig.until(lambda s: not s.at_rest, "motion")
            state = await rig.until(lambda s: s.at_rest, "rest again")
            np.testing.assert_allclose(state.q, np.array(rig.home) + 0.02, atol=3e-7)

        subject(scene)

    def test_a_cut_connection_is_the_end_of_the_link_and_opening_again_begins_an_epoch(
        self, subject: Bench[ObservedArmRig]
    ) -> None:
        subject.needs("motion", "drop")

        async def scene(rig: ObservedArmRig) -> None:
            before = rig.device.joints.epoch
            await rig.inject("drop")
            async with asyncio.timeout(10.0):
                lost = await rig.device.wait_lost()
            assert isinstance(lost, CellError)
            assert lost.name == "DEVICE_LOST"
            with pytest.raises(CellError) as caught:
                await rig.device.request(1, np.array(rig.there))
            assert caught.value.name == "DEVICE_LOST"
            await rig.device.close()
            await rig.device.open()
            assert rig.device.joints.epoch == before + 1
            await rig.device.wait_fresh(2.0)

        subject(scene)
