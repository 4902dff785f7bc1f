"""What every observed arm with a handshake promises, on the object face and over Modbus registers."""

import asyncio
import tempfile
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from wire_faces import Face, Rig

from cell.devices import JointState, ObservedArm
from cell.errors import CellError
from fakes.object import ObjectObservedArm, VirtualClock, run_virtual
from tests.kit.observed_rig import CLOCK, palletizer, reader

HOME = [0.0, 1.570796, -1.570796, 0.0]
THERE = [0.2, 1.45, -1.45, 0.1]
LIMIT_S = 20.0


@dataclass
class ArmRig(Rig[ObservedArm]):
    """The palletizer of its scenario, at home."""

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


@asynccontextmanager
async def on_object(allow: bool) -> AsyncIterator[ArmRig]:
    clock = VirtualClock()
    config = ObjectObservedArm.Config(scenario="palletizer", allow_requests=allow)
    device = ObjectObservedArm("palletizer", config, clock)

    async def inject(kind: str, **arguments: Any) -> None:
        device.inject(kind, **arguments)

    await device.open()
    await device.wait_fresh(2.0)
    try:
        yield ArmRig(device, clock, inject)
    finally:
        await device.close()


@asynccontextmanager
async def on_the_wire(allow: bool) -> AsyncIterator[ArmRig]:
    with tempfile.TemporaryDirectory(prefix="observed-") as folder:
        async with palletizer(Path(folder)) as (twin, _, board):
            device = reader(twin.device(), allow_requests=allow)

            async def inject(kind: str, **arguments: Any) -> None:
                board.inject("palletizer", kind, arguments)

            await device.open()
            try:
                yield ArmRig(device, CLOCK, inject)
            finally:
                await device.close()


Scene = Callable[[ArmRig], Coroutine[Any, Any, Any]]
Play = Callable[..., Any]


@pytest.fixture(
    params=[
        pytest.param(Face("object", run_virtual, on_object), id="object"),
        pytest.param(Face("tcp", asyncio.run, on_the_wire, wire=True), id="tcp", marks=pytest.mark.wire),
    ]
)
def subject(request: pytest.FixtureRequest) -> Play:
    """Runs a scene with the arm open on this face."""
    face = request.param

    def play(scene: Scene, allow: bool = True) -> Any:
        async def whole() -> Any:
            async with face.rig(allow) as rig:
                return await scene(rig)

        return face.run(whole())

    return play


def test_joints_come_in_order_and_a_twin_says_that_it_is_one(subject: Play) -> None:
    async def scene(rig: ArmRig) -> None:
        assert rig.device.axes == 4
        found = await rig.device.identify()
        assert found.is_twin
        assert found.serial == "99995500001"
        begun = rig.clock.now()
        await rig.device.wait_fresh(2.0)
        await rig.until(lambda s: s.at_rest, "rest")
        samples = rig.device.joints.between(begun, rig.clock.now())
        assert len(samples) > 3
        assert all(a.t < b.t and a.seq < b.seq for a, b in pairwise(samples))
        np.testing.assert_allclose(samples[-1].value.q, HOME, atol=3e-7)
        assert samples[-1].value.at_pose is None

    subject(scene)


def test_an_asked_arm_sets_out_gets_there_and_says_the_number(subject: Play) -> None:
    async def scene(rig: ArmRig) -> None:
        await rig.until(lambda s: s.at_rest, "rest")
        assert await rig.device.request(9, np.array(THERE))
        moving = await rig.until(lambda s: not s.at_rest, "departure")
        assert moving.at_pose in (None, 9)
        state = await rig.until(lambda s: s.at_pose == 9 and s.at_rest, "arrival")
        np.testing.assert_allclose(state.q, THERE, atol=3e-7)
        again = await rig.goes_to(10, HOME)
        np.testing.assert_allclose(again.q, HOME, atol=3e-7)

    subject(scene)


def test_without_permission_a_person_must_move_the_arm(subject: Play) -> None:
    async def scene(rig: ArmRig) -> None:
        assert not await rig.device.request(1, np.array(THERE))
        await rig.clock.sleep(0.5)
        np.testing.assert_allclose(rig.state().q, HOME, atol=3e-7)
        assert rig.state().at_pose is None

    subject(scene, allow=False)


def test_a_pose_beyond_the_arms_limits_leaves_it_where_it_is(subject: Play) -> None:
    async def scene(rig: ArmRig) -> None:
        await rig.goes_to(1, THERE)
        assert await rig.device.request(2, np.array([0.0, 3.0, -1.0, 0.0]))
        await rig.clock.sleep(1.5)
        assert rig.state().at_pose == 1
        np.testing.assert_allclose(rig.state().q, THERE, atol=3e-7)

    subject(scene)


def test_a_skipped_pose_a_wrong_order_and_a_stuck_joint_show_in_the_joints(subject: Play) -> None:
    async def scene(rig: ArmRig) -> None:
        await rig.inject("skip-pose")
        np.testing.assert_allclose((await rig.goes_to(1, THERE)).q, HOME, atol=3e-7)
        await rig.goes_to(2, THERE)
        await rig.inject("wrong-order")
        assert await rig.device.request(3, np.array(HOME))
        await rig.clock.sleep(3.0)
        assert rig.state().at_pose == 2
        await rig.inject("stuck", joint=1)
        np.testing.assert_allclose((await rig.goes_to(4, HOME)).q, [THERE[0], *HOME[1:]], atol=3e-7)
        await rig.inject("clear")
        await rig.until(lambda s: bool(abs(s.q[0]) < 1e-6), "a joint that lives")

    subject(scene)


def test_an_arm_that_is_jogged_while_it_should_stand_is_seen_to_move(subject: Play) -> None:
    async def scene(rig: ArmRig) -> None:
        await rig.until(lambda s: s.at_rest, "rest")
        await rig.inject("unasked-move", rad=0.02)
        await rig.until(lambda s: not s.at_rest, "motion")
        state = await rig.until(lambda s: s.at_rest, "rest again")
        np.testing.assert_allclose(state.q, np.array(HOME) + 0.02, atol=3e-7)

    subject(scene)


def test_a_cut_connection_is_the_end_of_the_link_and_opening_again_begins_an_epoch(subject: Play) -> None:
    async def scene(rig: ArmRig) -> None:
        before = rig.device.joints.epoch
        await rig.inject("drop")
        async with asyncio.timeout(10.0):
            lost = await rig.device.wait_lost()
        assert isinstance(lost, CellError)
        assert lost.name == "DEVICE_LOST"
        with pytest.raises(CellError) as caught:
            await rig.device.request(1, np.array(THERE))
        assert caught.value.name == "DEVICE_LOST"
        await rig.device.close()
        await rig.device.open()
        assert rig.device.joints.epoch == before + 1
        await rig.device.wait_fresh(2.0)

    subject(scene)
