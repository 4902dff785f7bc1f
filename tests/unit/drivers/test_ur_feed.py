"""From data packages to stamped samples."""

import numpy as np
import pytest

from cell.clock import MonotonicClock
from cell.devices import ArmState
from cell.errors import CellError
from cell.samples import Stream
from drivers.ur import UrArm
from drivers.ur.feed import NAMES, StateFeed, available
from drivers.ur.rtde import Recipe, Value
from drivers.ur.safety import safety_finding

PERIOD = 0.002
TYPES = {
    "timestamp": "DOUBLE",
    "target_speed_fraction": "DOUBLE",
    "speed_scaling": "DOUBLE",
    "payload": "DOUBLE",
    "payload_cog": "VECTOR3D",
    "robot_mode": "INT32",
    "safety_mode": "INT32",
    "safety_status_bits": "UINT32",
    "runtime_state": "UINT32",
    "actual_digital_input_bits": "UINT64",
    "actual_digital_output_bits": "UINT64",
}
OLD = tuple(n for n in NAMES if n != "tcp_offset")


class HandClock:
    """A clock that the test turns."""

    def __init__(self) -> None:
        self.t = 100.0

    def now(self) -> float:
        return self.t

    async def sleep(self, seconds: float) -> None:
        self.t += seconds


def recipe(names: tuple[str, ...] = OLD) -> Recipe:
    return Recipe(1, names, tuple(TYPES.get(n, "VECTOR6D") for n in names))


def values(stamp: float, **changes: Value) -> dict[str, Value]:
    base: dict[str, Value] = {n: tuple(float(k) for k in range(6)) for n in NAMES if n not in TYPES}
    base |= {
        "timestamp": stamp,
        "target_speed_fraction": 1.0,
        "speed_scaling": 1.0,
        "payload": 1.25,
        "payload_cog": (0.0, 0.01, 0.05),
        "robot_mode": 7,
        "safety_mode": 1,
        "safety_status_bits": 1,
        "runtime_state": 1,
        "actual_digital_input_bits": 0b101,
        "actual_digital_output_bits": 1 << 17,
    }
    return base | changes


class Rig:
    """A feed, its stream and its clock, with packages made by the generic codec."""

    def __init__(self, names: tuple[str, ...] = OLD, offset: float = 0.0) -> None:
        self.clock = HandClock()
        self.stream: Stream[ArmState] = Stream("arm", self.clock)
        self.feed = StateFeed(self.stream, self.clock, offset)
        self.recipe = recipe(names)
        self.feed.begin(self.recipe, 500.0)

    def take(self, stamp: float, late: float = 0.0, **changes: Value) -> None:
        self.clock.t = 100.0 + stamp + late
        self.feed.take(self.recipe.pack(values(stamp, **changes)), self.clock.t)


@pytest.fixture
def subject() -> Rig:
    return Rig()


def test_each_value_lands_in_its_place(subject: Rig) -> None:
    q, pose = tuple(np.linspace(0, 1, 6)), tuple(np.linspace(2, 3, 6))
    subject.take(5.0, actual_q=q, actual_TCP_pose=pose, actual_TCP_force=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    state = subject.stream.latest(0.1).value
    assert tuple(state.q) == q
    assert tuple(state.tcp_pose6) == pose
    assert tuple(state.tcp_force) == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    assert (state.robot_mode, state.safety_mode, state.program_running) == (7, 1, False)
    assert (state.digital_in, state.digital_out, state.stamp) == (0b101, 1 << 17, 5.0)
    assert subject.feed.payload is not None
    assert subject.feed.payload[0] == 1.25
    assert tuple(subject.feed.payload[1]) == (0.0, 0.01, 0.05)


def test_the_stamp_follows_the_controller_not_the_late_arrival(subject: Rig) -> None:
    for k in range(100):
        subject.take(k * PERIOD)
    subject.take(100 * PERIOD, late=0.015)
    sample = subject.stream.last()
    assert sample is not None
    assert sample.t == pytest.approx(100.0 + 100 * PERIOD, abs=1e-6)
    assert sample.dt == pytest.approx(0.001)


def test_the_configured_offset_moves_the_stamp_but_not_the_silence() -> None:
    subject = Rig(offset=0.004)
    subject.take(1.0)
    sample = subject.stream.last()
    assert sample is not None
    assert sample.t == pytest.approx(101.0 - 0.004)
    assert subject.feed.silence() == pytest.approx(0.0)


def test_packages_that_the_controller_skipped_are_counted_as_gaps(subject: Rig) -> None:
    for k in (0, 1, 2, 7, 8):
        subject.take(k * PERIOD)
    assert subject.stream.gaps == 4


def test_a_repeated_package_is_no_news(subject: Rig) -> None:
    subject.take(1.0)
    subject.take(1.0, late=0.05)
    assert subject.stream.received == 1
    assert subject.feed.repeated == 1
    assert subject.feed.silence() == pytest.approx(0.05)


def test_a_clock_that_steps_back_means_a_restarted_controller(subject: Rig) -> None:
    subject.take(50.0)
    with pytest.raises(CellError) as caught:
        subject.take(2.0)
    assert caught.value.name == "ARM_REBOOTED"


def test_a_restart_between_two_connections_is_noticed_until_the_arm_runs_again(subject: Rig) -> None:
    subject.take(50.0)
    subject.feed.begin(subject.recipe, 500.0)
    subject.take(1.0, late=60.0, robot_mode=3)
    assert subject.feed.reboots == 1
    assert subject.feed.finding is not None
    assert subject.feed.finding.name == "ARM_REBOOTED"
    subject.take(2.0, late=60.0, robot_mode=7)
    assert subject.feed.finding is None


def test_a_plain_reconnect_is_not_taken_for_a_restart(subject: Rig) -> None:
    subject.take(50.0)
    subject.feed.begin(subject.recipe, 500.0)
    subject.take(80.0)
    assert subject.feed.reboots == 0
    assert subject.stream.last() is not None


def test_a_changed_tcp_starts_a_new_epoch_and_the_same_one_does_not(subject: Rig) -> None:
    subject.take(1.0)
    epoch = subject.stream.epoch
    subject.feed.set_tcp([0.0] * 6)
    assert subject.stream.epoch == epoch
    subject.feed.set_tcp([0.0, 0.0, 0.18, 0.0, 0.0, 0.0])
    assert subject.stream.epoch == epoch + 1
    subject.take(1.002)
    assert tuple(subject.stream.latest(0.1).value.tcp_offset6) == (0.0, 0.0, 0.18, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(("in_packages", "epochs"), [(True, 0), (False, 1)])
def test_a_tcp_read_back_does_not_overtake_the_packages_that_carry_it(in_packages: bool, epochs: int) -> None:
    arm = UrArm("arm", UrArm.Config(host="127.0.0.39"), MonotonicClock())
    arm._tcp_in_packages = in_packages
    before = arm.state.epoch
    arm.tcp_read_back(np.array([0.0, 0.0, 0.18, 0.0, 0.0, 0.0]))
    assert arm.state.epoch - before == epochs


def test_the_flange_is_the_tcp_pose_without_the_tcp(subject: Rig) -> None:
    subject.feed.set_tcp([0.0, 0.0, 0.2, 0.0, 0.0, 0.0])
    subject.take(1.0, actual_TCP_pose=(0.5, 0.1, 0.3, np.pi, 0.0, 0.0))
    flange = subject.stream.latest(0.1).value.T_base_flange
    # The tool points down, so the flange is 0.2 m above its tip.
    np.testing.assert_allclose(flange.translation, [0.5, 0.1, 0.5], atol=1e-12)


def test_newer_controllers_tell_the_tcp_in_every_package() -> None:
    subject = Rig(NAMES)
    subject.take(1.0, tcp_offset=(0.0, 0.0, 0.1, 0.0, 0.0, 0.0))
    assert subject.stream.latest(0.1).value.tcp_offset6[2] == 0.1


def test_optional_variables_are_left_out_when_the_controller_lacks_them() -> None:
    full = recipe(NAMES)
    missing = {"tcp_offset", "payload_cog"}
    answered = Recipe(
        0, NAMES, tuple("NOT_FOUND" if n in missing else t for n, t in zip(NAMES, full.types, strict=True))
    )
    assert set(NAMES) - set(available(answered)) == {"tcp_offset", "payload", "payload_cog"}


def test_a_missing_variable_that_is_needed_is_named() -> None:
    types = tuple("NOT_FOUND" if n == "runtime_state" else TYPES.get(n, "VECTOR6D") for n in OLD)
    with pytest.raises(CellError, match="runtime_state NOT_FOUND"):
        Rig().feed.begin(Recipe(0, OLD, types), 500.0)


@pytest.mark.parametrize("damage", [lambda p: p[:-1], lambda p: b"\x07" + p[1:], lambda p: p + b"\x00"])
def test_a_damaged_package_is_a_violation(subject: Rig, damage) -> None:
    payload = damage(subject.recipe.pack(values(1.0)))
    with pytest.raises(CellError) as caught:
        subject.feed.take(payload, 101.0)
    assert caught.value.name == "PROTOCOL_VIOLATION"


def test_numbers_that_are_not_finite_are_a_violation(subject: Rig) -> None:
    with pytest.raises(CellError) as caught:
        subject.take(1.0, actual_q=(0.0, float("nan"), 0.0, 0.0, 0.0, 0.0))
    assert caught.value.name == "PROTOCOL_VIOLATION"


def test_a_fault_is_known_with_the_package_that_shows_it(subject: Rig) -> None:
    subject.take(1.0)
    assert subject.feed.finding is None
    subject.take(1.002, safety_mode=3, safety_status_bits=1 << 2)
    assert subject.feed.finding is not None
    assert subject.feed.finding.name == "ARM_PROTECTIVE_STOP"


@pytest.mark.parametrize(
    ("robot_mode", "safety_mode", "bits", "name"),
    [
        (7, 1, 1, None),
        (7, 3, 1 << 2, "ARM_PROTECTIVE_STOP"),
        (7, 3, 1, "ARM_PROTECTIVE_STOP"),
        (7, 1, 1 << 2, "ARM_PROTECTIVE_STOP"),
        (7, 5, 1 << 4, "ARM_SAFEGUARD_STOP"),
        (3, 6, 1 << 5 | 1 << 7, "ARM_EMERGENCY_STOP"),
        (3, 7, 1 << 6 | 1 << 7, "ARM_EMERGENCY_STOP"),
        (7, 1, 1 << 7 | 1 << 2, "ARM_EMERGENCY_STOP"),
        (7, 8, 1 << 8, "ARM_PROTECTIVE_STOP"),
        (7, 9, 1 << 9, "ARM_PROTECTIVE_STOP"),
        (3, 1, 1, "ARM_NOT_READY"),
        (5, 1, 1, "ARM_NOT_READY"),
        (7, 2, 2, "ARM_NOT_READY"),
        (7, 4, 1 << 3, "ARM_NOT_READY"),
    ],
)
def test_modes_and_bits_give_the_worst_code(
    robot_mode: int, safety_mode: int, bits: int, name: str | None
) -> None:
    finding = safety_finding(robot_mode, safety_mode, bits)
    assert (finding.name if finding else None) == name


def test_reduced_mode_is_called_so() -> None:
    finding = safety_finding(7, 2, 2)
    assert finding is not None
    assert "reduced mode: jobs need the arm's full speed" in finding.detail
