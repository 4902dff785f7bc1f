"""Whether a sample is fresh is judged by when it was taken, whatever ``time_offset_s`` its stamp has."""

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from cell.devices import Identity
from cell.errors import CellError
from cell.samples import Sample
from drivers.life import LinkedDevice
from drivers.oak import OakCamera
from drivers.ur import UrArm
from drivers.ur.gripper import ArmGripper
from drivers.ur.inputs import ArmInputs
from fakes.object import VirtualClock, run_virtual

PERIOD_S, OFFSET_S = 0.01, 0.08


class State:
    digital_in = 0


def arm_itself(clock: VirtualClock, offset_s: float) -> tuple[LinkedDevice, LinkedDevice]:
    arm = UrArm("arm", UrArm.Config(host="127.0.0.1", time_offset_s=offset_s), clock)
    return arm, arm


def camera(clock: VirtualClock, offset_s: float) -> tuple[LinkedDevice, LinkedDevice]:
    device = OakCamera("camera", OakCamera.Config(time_offset_s=offset_s), clock)
    return device, device


def inputs_of_the_arm(clock: VirtualClock, offset_s: float) -> tuple[Any, LinkedDevice]:
    arm, _ = arm_itself(clock, offset_s)
    inputs = ArmInputs("beams", ArmInputs.Config(inputs={"x": {"address": 0}}), clock)
    inputs.bind(arm=arm)
    arm.state.subscribe(inputs._take)
    return inputs, arm


def gripper_on_the_arm(clock: VirtualClock, offset_s: float) -> tuple[Any, LinkedDevice]:
    arm, _ = arm_itself(clock, offset_s)
    gripper = ArmGripper("gripper", ArmGripper.Config(output=0, confirm=1), clock)
    gripper.bind(arm=arm)
    return gripper, arm


DEVICES = [arm_itself, camera, inputs_of_the_arm, gripper_on_the_arm]


def play(make: Callable[..., Any], offset_s: float, scene: Callable[..., Any]) -> None:
    """A device whose source sends a sample each 10 ms, stamped when it was taken less the offset."""

    async def whole() -> None:
        clock = VirtualClock()
        await clock.sleep(1.0)
        subject, source = make(clock, offset_s)
        for device in {subject, source}:
            device._life.begin()
            device._identity = Identity("", "")

        async def send() -> None:
            for seq in range(1, 1000):
                await clock.sleep(PERIOD_S)
                source._samples.push(Sample(State(), clock.now() - offset_s, 0.0, seq))

        sending = asyncio.create_task(send())
        try:
            await clock.sleep(0.005)
            await scene(subject, clock, sending)
        finally:
            sending.cancel()
            await asyncio.wait([sending])

    run_virtual(whole())


@pytest.mark.parametrize("offset_s", [OFFSET_S, -OFFSET_S])
@pytest.mark.parametrize("make", DEVICES)
def test_the_next_sample_is_fresh_with_an_offset_of_either_sign(
    make: Callable[..., Any], offset_s: float
) -> None:
    async def scene(subject: Any, clock: VirtualClock, sending: Any) -> None:
        asked = clock.now()
        await subject.wait_fresh(0.05)
        assert clock.now() - asked <= PERIOD_S + 1e-6

    play(make, offset_s, scene)


@pytest.mark.parametrize("make", DEVICES)
def test_without_samples_the_wait_ends_with_a_loss(make: Callable[..., Any]) -> None:
    async def scene(subject: Any, clock: VirtualClock, sending: Any) -> None:
        sending.cancel()
        with pytest.raises(CellError) as caught:
            await subject.wait_fresh(0.05)
        assert caught.value.name == "DEVICE_LOST"

    play(make, OFFSET_S, scene)
