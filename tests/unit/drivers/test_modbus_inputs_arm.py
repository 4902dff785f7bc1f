"""The arm's own inputs: from its state stream, alive as long as the arm, and bound by the config."""

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from cell.devices import DeviceState
from cell.errors import CellError
from cell.inputs import edges
from daemon.composition import supervised_devices
from daemon.config import CellConfig, ConfigInvalid, load_config
from daemon.health import Beats
from daemon.supervisor import Supervisor
from drivers.ur.inputs import ArmInputs
from fakes.object import ObjectArm, VirtualClock, run_virtual

SCENARIO = "laser:ideal"
INPUTS = {"xs": {"address": 0}, "free": {"address": 1, "invert": True}}


class Wired(ObjectArm):
    """An arm whose first input a test sets."""

    bits = 0

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.world.arm_digital_in = lambda t: self.bits  # type: ignore[method-assign]


async def play(script: Callable[[ArmInputs, Wired, VirtualClock], Awaitable[None]], **keys: Any) -> None:
    clock = VirtualClock()
    arm = Wired("arm", Wired.Config(scenario=SCENARIO), clock)
    subject = ArmInputs("beams", ArmInputs.Config(inputs=INPUTS, **keys), clock)  # type: ignore[arg-type]
    subject.bind(arm=arm)
    await arm.open()
    await subject.open()
    try:
        await script(subject, arm, clock)
    finally:
        await subject.close()
        await arm.close()


def test_an_input_shares_the_stamp_and_the_number_of_the_arms_state() -> None:
    async def script(subject: ArmInputs, arm: Wired, clock: VirtualClock) -> None:
        await clock.sleep(0.2)
        states = {s.seq: s for s in arm.state.between(0.0, clock.now())}
        polls = subject.inputs.between(0.0, clock.now())
        assert len(polls) >= 15
        for poll in polls:
            state = states[poll.seq]
            assert (poll.t, poll.dt, poll.quality) == (state.t, state.dt, state.quality)

    run_virtual(play(script))


def test_levels_are_the_bits_of_the_word_inverted_where_the_config_says() -> None:
    async def script(subject: ArmInputs, arm: Wired, clock: VirtualClock) -> None:
        assert subject.names == ("xs", "free")
        made = []
        for bits in (0b01, 0b00, 0b11):
            await clock.sleep(0.05)
            made.append(clock.now())
            arm.bits = bits
        await subject.wait_fresh(1.0)
        state = subject.inputs.latest(0.1).value
        assert state.levels == (True, False)
        assert state.changes == (3, 1)
        found = edges(subject.inputs.between(0.0, clock.now()), 0)
        assert [edge.rising for edge in found] == [True, False, True]
        for edge, t in zip(found, made, strict=True):
            assert abs(edge.t - t) <= edge.dt + 1e-6

    run_virtual(play(script))


def test_it_is_the_arm_that_it_identifies_as() -> None:
    async def script(subject: ArmInputs, arm: Wired, clock: VirtualClock) -> None:
        assert await subject.identify() == await arm.identify()

    run_virtual(play(script))


def test_the_inputs_are_lost_with_the_arm_and_come_back_in_a_new_epoch() -> None:
    async def script(subject: ArmInputs, arm: Wired, clock: VirtualClock) -> None:
        epoch = subject.inputs.epoch
        arm.inject("drop")
        async with asyncio.timeout(0.5):
            lost = await subject.wait_lost()
        assert isinstance(lost, CellError)
        assert lost.name == "DEVICE_LOST"
        assert "beams: arm is lost: " in str(lost)
        with pytest.raises(CellError, match="arm is lost"):
            await subject.wait_fresh(0.1)
        await arm.close()
        await subject.close()
        await arm.open()
        await subject.open()
        assert subject.inputs.epoch == epoch + 1
        await subject.wait_fresh(1.0)
        assert subject.inputs.latest(0.1).value.changes == (0, 0)

    run_virtual(play(script))


def test_inputs_of_an_arm_that_gives_no_state_do_not_open() -> None:
    async def scene() -> None:
        clock = VirtualClock()
        subject = ArmInputs("beams", ArmInputs.Config(inputs=INPUTS), clock)  # type: ignore[arg-type]
        subject.bind(arm=Wired("arm", Wired.Config(scenario=SCENARIO), clock))
        with pytest.raises(CellError, match="arm gave no state in 3 s") as caught:
            await subject.open()
        assert caught.value.name == "DEVICE_UNREACHABLE"

    run_virtual(scene())


CELL = """schema = 1
[cell]
name = "bay"
twin = true
clock = "fakes.object:VirtualClock"
[limits]
workspace = [{ min = [-1.0, -1.0, 0.0], max = [1.0, 1.0, 1.0] }]
[device.beams]
driver = "arm-inputs"
arm = "arm"
inputs = { xs = { address = 0 }, ys = { address = 1 } }
[device.arm]
driver = "fakes.object:ObjectArm"
scenario = "laser"
"""


def load(folder: Path, text: str) -> CellConfig:
    path = folder / "cell.toml"
    path.write_text(text)
    path.chmod(0o640)
    return load_config(path)


@pytest.mark.parametrize(
    ("old", "new", "finding"),
    [
        ('arm = "arm"', 'arm = "am"', "device.beams.arm: there is no [device.am], did you mean 'arm'?"),
        (
            'arm = "arm"',
            'arm = "beams"',
            "device.beams.arm: [device.beams] is no arm, its driver is 'arm-inputs'",
        ),
        (
            "ys = { address = 1 }",
            "ys = { address = 18 }",
            "device.beams.inputs: input ys has address 18, but a UR controller has inputs 0 to 17",
        ),
    ],
)
def test_a_binding_that_leads_nowhere_is_found_with_the_config(
    tmp_path: Path, old: str, new: str, finding: str
) -> None:
    assert old in CELL
    with pytest.raises(ConfigInvalid) as caught:
        load(tmp_path, CELL.replace(old, new, 1))
    (found,) = caught.value.findings
    assert found.endswith(finding)


def test_the_supervisor_brings_up_the_arm_and_its_inputs_together_and_again_after_a_loss(
    tmp_path: Path,
) -> None:
    config = load(tmp_path, CELL)

    async def scene() -> None:
        clock = VirtualClock()
        supervisor = Supervisor(supervised_devices(config, clock, Beats(clock)))
        tasks = [asyncio.create_task(entry.run()) for entry in supervisor.devices.values()]
        beams = supervisor.devices["beams"]
        try:
            await clock.sleep(2.0)
            assert {e.state for e in supervisor.devices.values()} == {DeviceState.READY}
            assert beams.identity is not None
            assert beams.identity.is_twin
            supervisor.devices["arm"].device.inject("drop", refuse_s=4.0)  # type: ignore[attr-defined]
            await clock.sleep(0.2)
            assert beams.state is DeviceState.RETRYING
            await clock.sleep(15.0)
            assert {e.state for e in supervisor.devices.values()} == {DeviceState.READY}
            assert beams.losses == 1
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)

    run_virtual(scene())
