"""One controller's state: arm, safety, program runner, I/O, registers and identity.

The servers look at it and command it; it knows nothing of sockets. Its time is that of the control cycle,
so the stamp in a package and the joints beside it belong together whatever the load of the machine.
"""

import logging
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from cell.poses import Array
from fakes.ur.arm import Arm, Tool
from fakes.ur.control_modes import ControlModes
from fakes.ur.force_sensor import ForceSensor
from fakes.ur.inputs import InputOutput, Inputs
from fakes.ur.registers import RegisterBank
from fakes.ur.runtime import Program, Runtime, RuntimeState, ScriptError, Steps
from fakes.ur.safety import RobotMode, Safety, SafetyMode
from fakes.ur.tcp import TcpKinematics
from fakes.world.arm.controller_limits import ControllerLimitsTruth
from fakes.world.arm.kinematics import Chain, LinkDeltas
from fakes.world.arm.reported import Reported
from fakes.world.arm.servo import Servo
from fakes.world.arm.track import Track
from fakes.world.arm.truth import ReportedTruth

log = logging.getLogger("cellward.twin.arm")

ContactForce = Callable[[float, RigidTransform], Array]
DigitalIn = Callable[[float], int]
PROTECTIVE_DECEL = 10.0
FORCE_LIMIT_N = 150.0
EMERGENCY_DECEL = 20.0


def no_contact(t: float, T_flange_tcp: RigidTransform) -> Array:
    """A world in which nothing touches the tool."""
    return np.zeros(6)


def nothing_wired(t: float) -> int:
    """No digital input is wired."""
    return 0


@dataclass(frozen=True)
class Identity:
    """Who the controller says it is. Twin serials begin with 9999."""

    model: str = "ur10e"
    serial: str = "99991100001"
    version: tuple[int, int, int, int] = (5, 12, 4, 1101534)
    deltas: LinkDeltas = field(default_factory=LinkDeltas)
    limits: ControllerLimitsTruth = field(default_factory=ControllerLimitsTruth)

    @property
    def rate(self) -> float:
        """Control cycles per second: 500 on the e-series and newer, 125 on CB3."""
        return 500.0 if self.version[0] > 3 else 125.0


@dataclass
class Instant:
    """What one control cycle reports; costly values are computed when a recipe asks for them."""

    robot: "Robot"
    t: float
    stamp: float
    _q: Array
    _qd: Array

    @cached_property
    def q(self) -> list[float]:
        return _floats(self._q)

    @cached_property
    def qd(self) -> list[float]:
        return _floats(self._qd)

    def _cycle_before(self) -> float:
        """When the state was true that the cycle before this one reports: late stamps make it older."""
        return self.t - self.robot.reported.late_s - 1.0 / self.robot.rate

    @cached_property
    def qdd(self) -> list[float]:
        before = self.robot.arm.track.at(self._cycle_before())[1]
        return _floats((self._qd - before) * self.robot.rate)

    @cached_property
    def _tcp(self) -> tuple[list[float], list[float]]:
        return self.robot.tcp.at(self.q, self.qd, self.robot.tool.offset6)

    @property
    def tcp_pose6(self) -> list[float]:
        return self._tcp[0]

    @property
    def tcp_speed(self) -> list[float]:
        return self._tcp[1]

    @cached_property
    def tcp_acceleration(self) -> list[float]:
        """By difference over one control cycle, like :attr:`qdd`."""
        arm, step = self.robot.arm, 1.0 / self.robot.rate
        before = arm.tcp_speed(*arm.track.at(self._cycle_before()))
        return _floats((np.array(self.tcp_speed) - before) / step)

    @cached_property
    def elbow_position(self) -> list[float]:
        """Where axis 3 crosses the plane of the upper arm that holds the base's z axis; in the base, m."""
        return _floats(self.robot.arm.elbow(self._q))

    @cached_property
    def elbow_velocity(self) -> list[float]:
        """By difference over one control cycle, like :attr:`qdd`."""
        arm, step = self.robot.arm, 1.0 / self.robot.rate
        before = arm.elbow(arm.track.at(self._cycle_before())[0])
        return _floats((np.array(self.elbow_position) - before) / step)

    @cached_property
    def contact_force(self) -> list[float]:
        """What the world does to the TCP, whatever the sensor was zeroed to."""
        return _floats(self.robot.contact_force(self.t))

    @cached_property
    def tcp_force(self) -> list[float]:
        """What the controller reports: of its own zeroed sensor, or of one that a client writes."""
        felt = _floats(np.array(self.contact_force) + self.robot.reported.force(self.t))
        return self.robot.force_sensor.report(self._q, felt)

    @property
    def control_step(self) -> int:
        return max(round(self.stamp * self.robot.rate), 0)

    @cached_property
    def raw_wrench(self) -> list[float]:
        """The sensor's own reading: in the flange, tool weight not compensated (the tool weighs nothing)."""
        turn = self.robot.arm.believed.matrix(self._q)[:3, :3].T
        force = np.array(self.contact_force) + self.robot.reported.force(self.t)
        return _floats(np.concatenate([turn @ force[:3], turn @ force[3:]]))

    @cached_property
    def force_scalar(self) -> float:
        return math.hypot(*self.tcp_force[:3])

    @property
    def collision_ratio(self) -> float:
        """The contact force over the one that stops the arm."""
        return math.hypot(*self.contact_force[:3]) / FORCE_LIMIT_N


def _floats(values: Array) -> list[float]:
    """Plain numbers: packing them is several times faster than packing NumPy's."""
    numbers: list[float] = values.tolist()
    return numbers


class Robot:
    """The controller without its servers."""

    def __init__(
        self,
        identity: Identity,
        track: Track,
        believed: Chain,
        now: Callable[[], float],
        contact: ContactForce = no_contact,
        digital_in: DigitalIn = nothing_wired,
        servo: Servo | None = None,
        reported: Reported | None = None,
    ) -> None:
        self.identity, self.now, self._contact, self._digital_in = identity, now, contact, digital_in
        self.tool = Tool()
        self.arm = Arm(track, believed, self.tool, servo, identity.limits.ranges())
        self.reported = reported or Reported(ReportedTruth(), 0)
        self.arm.period = 1.0 / identity.rate
        self.tcp = TcpKinematics(believed)
        self.modes = ControlModes(self.arm)
        self.script_line = 0  # of the running program, where the twin interprets it
        self.safety = Safety()
        self.io = InputOutput()
        self.registers = RegisterBank()
        self.inputs = Inputs(self.registers, self.io)
        self.force_sensor = ForceSensor(self.arm, self.inputs.vectors)
        self.runtime = Runtime(self.arm.moving, self.arm.halt, self._program_event)
        self.remote = True
        self.loaded_program = ""
        self.loaded: Callable[[], Program] | None = None
        self.boot_time = now()
        self.clock_offset = 0.0
        self.on_program: list[Callable[[str, str, ScriptError | None], None]] = []
        self.on_message: list[Callable[[str], None]] = []
        self._secondary: list[Steps] = []

    @property
    def rate(self) -> float:
        return self.identity.rate

    @property
    def speed_scaling(self) -> float:
        """The share of full speed at which the controller runs: the slider's, and less at a joint's limit."""
        return self.io.speed_fraction * self.arm.limiting

    def slide(self, fraction: float) -> None:
        """Somebody sets the speed slider."""
        self.io.speed_fraction = min(max(fraction, 0.0), 1.0)

    @property
    def robot_status_bits(self) -> int:
        playing = self.runtime.program is not None
        return int(self.safety.powered) | int(playing) << 1 | 1 << 3

    def stood_still(self, seconds: float, t: float) -> None:
        """The twin's process did, for so long until ``t``."""
        self.inputs.excuse(seconds, t)
        self.arm.stood_still(seconds, t)

    def step(self, t: float) -> Instant:
        """One control cycle at ``t``."""
        self.arm.t = t
        self.arm.speed_fraction = max(self.io.speed_fraction, 0.01)
        self.safety.step(t)
        if self.inputs.watchdog_expired(t) and self.runtime.active:
            self.say("RTDE watchdog: an input came too late, program stopped")
            self.runtime.stop(t)
        if self.safety.may_move:
            self.runtime.step(t)
            self._step_secondary()
            self._step_modes()
        else:
            self.runtime.settle(t)
        now = self.instant(t)
        self._supervise(now)
        return now

    def _step_modes(self) -> None:
        if self.runtime.state != RuntimeState.PLAYING:
            return
        try:
            self.modes.step(lambda: self.instant(self.arm.t).tcp_force)
        except ScriptError as exc:
            self.say(f"protective stop: {exc.text}")
            self.protective_stop()

    def _supervise(self, now: Instant) -> None:
        """What the controller's own safety stops: joints beyond their range, and too much force."""
        if self.safety.mode != SafetyMode.NORMAL or not self.safety.powered:
            return
        if not self.arm.within_limits(now.q) or now.collision_ratio > 1.0:
            self.say("protective stop: joint limit or force limit")
            self.protective_stop()

    def instant(self, t: float) -> Instant:
        """The state at ``t`` as it is told, with the controller's own stamp: seconds since its boot."""
        q, qd = self.reported.joints(t, *self.arm.track.at(t - self.reported.late_s))
        return Instant(self, t, t - self.boot_time + self.clock_offset, q, qd)

    def contact_force(self, t: float | None = None) -> Array:
        """Force and moment on the TCP in the base, (6,), N and Nm."""
        return self._contact(self.arm.t if t is None else t, self.tool.T_flange_tcp)

    def digital_in(self, t: float) -> int:
        """The digital inputs at ``t`` as a word."""
        return self._digital_in(t) | self.io.digital_in

    # -- what programs set

    def set_tcp(self, pose6: ArrayLike) -> None:
        """Make ``pose6`` the TCP in the flange."""
        self.tool.offset6 = tuple(float(x) for x in np.asarray(pose6, dtype=float))

    def zero_force_sensor(self) -> None:
        """zero_ftsensor()."""
        now = self.instant(self.arm.t)
        felt = np.array(now.contact_force) + self.reported.force(now.t)
        self.force_sensor.zero(self.arm.q, _floats(felt))

    def set_payload(self, mass: float, centre: Sequence[float]) -> None:
        """Payload in kg; a null centre of gravity keeps the one before, as the script does."""
        self.tool.payload = mass
        if any(centre):
            self.tool.centre_of_gravity = tuple(centre)

    def set_watchdog(self, name: str, frequency: float) -> None:
        """Stop the program when input ``name`` is not written at least ``frequency`` times a second."""
        self.inputs.arm_watchdog(name, frequency, self.arm.t)

    def say(self, text: str) -> None:
        """A text message for whoever listens on the primary port."""
        for listener in tuple(self.on_message):
            listener(text)

    # -- programs

    def start(self, program: Program) -> bool:
        """Replace the running program; False when the arm may not move."""
        if not self.safety.may_move:
            return False
        self.inputs.disarm_watchdog()
        self.runtime.start(program, self.now())
        return True

    def start_secondary(self, steps: Steps) -> None:
        """Run ``steps`` beside the main program."""
        self._secondary.append(steps)

    def _step_secondary(self) -> None:
        for steps in tuple(self._secondary):
            try:
                next(steps)
            except StopIteration:
                self._secondary.remove(steps)
            except ScriptError as exc:
                self._secondary.remove(steps)
                self._program_event("EXCEPTION", "secondary", exc)

    def report(self, name: str, failure: ScriptError) -> None:
        """An error of a program that does not run."""
        self._program_event("EXCEPTION", name, failure)

    def _program_event(self, event: str, name: str, failure: ScriptError | None) -> None:
        if event == "STOPPED":
            self.inputs.disarm_watchdog()
            self.script_line = 0
            self.modes.reset()
        if failure is not None:
            log.warning("program %s, line %d: %s", name, failure.line, failure.text)
        for listener in tuple(self.on_program):
            listener(event, name, failure)

    # -- stops

    def protective_stop(self) -> None:
        """Brake hard; the program is paused."""
        t = self.now()
        self.safety.stop(SafetyMode.PROTECTIVE_STOP, t)
        self.runtime.pause(t)
        self.arm.halt(t, PROTECTIVE_DECEL)

    def safeguard_stop(self) -> None:
        """Brake; the program is paused and can go on when the guard is closed."""
        t = self.now()
        self.safety.stop(SafetyMode.SAFEGUARD_STOP, t)
        self.runtime.pause(t)
        self.arm.halt(t)

    def emergency_stop(self) -> None:
        """Brake, end the program, switch the drives off."""
        t = self.now()
        self.runtime.stop(t)
        self.arm.halt(t, EMERGENCY_DECEL)
        self.safety.stop(SafetyMode.ROBOT_EMERGENCY_STOP, t)

    def power_off(self) -> None:
        """End the program and switch the drives off."""
        t = self.now()
        self.runtime.stop(t)
        self.arm.halt(t, EMERGENCY_DECEL)
        self.safety.power_off()

    def reboot(self, identity: Identity) -> None:
        """Start afresh: registers, tool and stamps are as after power-up, the arm is off."""
        self.power_off()
        self.identity = identity
        self.registers.clear()
        self.inputs.disarm_watchdog()
        self.tool.offset6, self.tool.payload = (0.0,) * 6, 0.0
        self._secondary.clear()
        self.force_sensor.reset()
        self.tool.gravity = Tool.gravity
        self.safety.release(*SafetyMode)
        self.safety.robot_mode = RobotMode.POWER_OFF
        self.boot_time, self.clock_offset = self.now(), 0.0
