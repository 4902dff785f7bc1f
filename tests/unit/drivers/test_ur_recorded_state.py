"""What a real controller sent, through our parsers and, played as a recording, through the link itself."""

import asyncio
import struct
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from cell.errors import CellError
from cell.wire_recording.reader import Connection, Record, WireRecording
from drivers.ur.arm import UrArm
from drivers.ur.kinematics import describe
from drivers.ur.primary import (
    JointLimits,
    PrimaryLink,
    PrimarySplitter,
    Six,
    parse_joint_limits,
    sub_packages,
)
from fakes.object import VirtualClock
from fakes.object.loop import run_virtual
from fakes.replay.player import WirePlayer
from fakes.ur.primary import robot_state
from fakes.ur.robot import Identity, Robot
from fakes.world.arm.controller_limits import ControllerLimitsTruth
from fakes.world.arm.kinematics import chain
from fakes.world.arm.track import Track

FILE = Path(__file__).parents[2] / "data" / "recordings" / "ur5e_first_state.hex"
HOST, BEGIN = "127.0.24.1", 500.0


def recorded() -> bytes:
    lines = FILE.read_text("ascii").splitlines()
    return bytes.fromhex("".join(line for line in lines if not line.startswith("#")))


def test_it_is_the_message_that_its_source_describes() -> None:
    """Thirteen sub-packages in 1386 bytes, as the test of Universal Robots that it is from counts them."""
    ((kind, body),) = list(PrimarySplitter().feed(recorded()))
    assert (kind, len(body)) == (16, 1381)
    assert [kind for kind, _ in sub_packages(body)] == [0, 1, 4, 5, 9, 3, 2, 6, 7, 8, 10, 11, 12]


def configuration(message: bytes) -> bytes:
    ((_, body),) = list(PrimarySplitter().feed(message))
    (data,) = [part for kind, part in sub_packages(body) if kind == 6]
    return data


def test_its_configuration_data_tell_how_far_and_how_fast_its_joints_may_turn() -> None:
    """363 deg each way and 191.5 deg/s each; between the speeds stand 40 rad/s^2, which fit a UR5e."""
    data = configuration(recorded())
    found = parse_joint_limits(data)
    assert found.speeds == pytest.approx((3.3416,) * 6, abs=1e-4)
    assert np.degrees(found.ranges) == pytest.approx(np.tile([-363.0, 363.0], (6, 1)), abs=1e-6)
    with pytest.raises(CellError, match="configuration data of 100 bytes"):
        parse_joint_limits(data[:100])


NAN = float("nan")


def test_of_configuration_data_that_nothing_was_filled_in_nothing_is_taken() -> None:
    subject = parse_joint_limits(bytes(192))
    assert (subject.told(), len(subject.doubts)) == ({}, 2)


@pytest.mark.parametrize(
    ("at", "wrong", "what"),
    [
        (0, NAN, "ranges"),
        (23, 1.0, ""),  # an acceleration, which is not read
        (1, float("inf"), "ranges"),
        (1, -6.4, "ranges"),  # the lowest is -363 deg
        (12, 0.0, "speeds"),
        (22, NAN, "speeds"),
        (14, -1.0, "speeds"),
    ],
)
def test_numbers_that_cannot_be_limits_are_not_taken_and_named(at: int, wrong: float, what: str) -> None:
    data = bytearray(configuration(recorded()))
    struct.pack_into(">d", data, 8 * at, wrong)
    found = parse_joint_limits(bytes(data))
    known = {"ranges": "joint_ranges_rad", "speeds": "joint_speeds_rad_s"}
    assert set(found.told()) == {key for kind, key in known.items() if kind != what}
    assert len(found.doubts) == bool(what)
    assert all(f"joint {what} of " in words and f"{wrong:g}" in words for words in found.doubts)


def test_a_probe_says_which_limits_cannot_be_any(monkeypatch: pytest.MonkeyPatch) -> None:
    async def free(*_: object) -> list[str]:
        return []

    monkeypatch.setattr("drivers.ur.arm.registers_in_use", free)
    arm = UrArm("arm", UrArm.Config(host=HOST), VirtualClock(BEGIN))
    limits = JointLimits(((-1.0, 1.0),) * 6, None, ("the controller tells joint speeds of 0 rad/s",))
    monkeypatch.setattr(arm, "_primary", SimpleNamespace(joint_limits=limits))
    assert asyncio.run(arm.doubts()) == list(limits.doubts)


def test_a_twin_of_that_arm_tells_the_same_configuration_data() -> None:
    """But for the numbers that name board, box and subtype."""
    identity = Identity("ur5e")
    robot = Robot(identity, Track(0.0, np.zeros(6)), chain("ur5e"), lambda: 0.0)
    messages = robot_state(robot, robot.instant(0.0)), recorded()
    ours, theirs = (struct.unpack(">12d12d5d24d4i", configuration(message)) for message in messages)
    assert ours[:-4] == pytest.approx(theirs[:-4], abs=1e-8)
    assert ours[-2] == theirs[-2]


def test_a_twin_tells_what_was_set_in_its_safety_configuration_and_keeps_to_it() -> None:
    limits = ControllerLimitsTruth(
        joint_ranges_rad=[[-1.0, 2.0], *[[-6.0, 6.0]] * 5], joint_speeds_rad_s=[0.5, 1.0, 1.5, 2.0, 2.5, 3.0]
    )
    robot = Robot(Identity(limits=limits), Track(0.0, np.zeros(6)), chain("ur10e"), lambda: 0.0)
    found = parse_joint_limits(configuration(robot_state(robot, robot.instant(0.0))))
    assert found.speeds == (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)
    assert found.ranges == ((-1.0, 2.0), *((-6.0, 6.0),) * 5)
    assert robot.arm.within_limits([1.9, 0, 0, 0, 0, 0])
    assert not robot.arm.within_limits([-1.1, 0, 0, 0, 0, 0])
    assert not robot.arm.within_limits([0, 6.1, 0, 0, 0, 0])


@pytest.mark.wire
def test_the_link_reads_tool_and_kinematics_from_it_in_pieces_of_seven_bytes() -> None:
    data = recorded()
    pieces = [Record(BEGIN + 0.001 * at, False, data[at : at + 7]) for at in range(0, len(data), 7)]
    connection = Connection("primary", f"{HOST}:30001", BEGIN, None, pieces)
    told: list[Six] = []

    async def work() -> None:
        async with WirePlayer(WireRecording([connection], []), VirtualClock(BEGIN)):
            link = await PrimaryLink.connect(HOST, told.append, lambda failure: None, 3.0)
            found = await link.wait_kinematics(3.0)
            await link.close()
            await asyncio.sleep(0)
        # The values are those that the test of Universal Robots expects.
        assert found.checksum == (2**32 - 1,) * 6
        assert found.a == pytest.approx((0.0, -0.425, -0.3922, 0.0, 0.0, 0.0))
        assert found.d == pytest.approx((0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996))
        assert found.theta == (0.0,) * 6
        assert found.alpha == pytest.approx((1.570796327, 0.0, 0.0, 1.570796327, -1.570796327, 0.0))
        deltas = describe("ur5e", found)["calibration"]
        assert all(value == pytest.approx(0.0, abs=1e-9) for row in deltas.values() for value in row)

    run_virtual(work(), 60.0)
    assert told == [(0.0,) * 6]
