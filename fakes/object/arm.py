"""The arm of the object face: the driver's Protocol attached straight to the world."""

from collections.abc import Callable
from dataclasses import replace
from weakref import ref

import numpy as np
from pydantic import Field
from scipy.spatial.transform import RigidTransform

from cell.clock import Clock
from cell.devices import Arm, ArmState, Identity, StartsPrograms, ToolSettings
from cell.errors import error, present
from cell.formats.reading import Strict
from cell.poses import Array, to_pose6
from fakes.object._ahead import Ahead, ticks_ahead
from fakes.object._lazy import LazyStream
from fakes.object._plant import ObjectDevice
from fakes.object.controller import Controller, Program
from fakes.object.motion import ObjectMotionPort
from fakes.object.registry import cell_of
from fakes.world.arm.segments import Segment

OPEN_TIMEOUT_S = 1.0
LOAD_S = 0.3  # what a controller takes to load a program


class ObjectArmConfig(Strict):
    """Keys of a device with ``driver = "fakes.object:ObjectArm"``."""

    scenario: str = Field(description="scenario file, or the name of a shipped one")
    expect_serial: str | None = None
    state_period_s: float = Field(default=0.01, ge=0.002, le=0.02)
    stale_after_s: float = Field(default=0.05, gt=0, le=1)
    lost_after_s: float = Field(default=0.1, gt=0, le=5)
    joint_tolerance_rad: float = Field(default=0.001, gt=0, le=0.05)
    position_tolerance_m: float = Field(default=0.0005, gt=0, le=0.01)
    rotation_tolerance_rad: float = Field(default=0.001, gt=0, le=0.05)
    servo_lookahead_s: float = Field(default=0.05, ge=0.03, le=0.2)
    servo_gain: float = Field(default=500.0, ge=100.0, le=2000.0)


class ObjectArm(ObjectDevice):
    """``cell.devices.Arm`` on virtual time. State samples are made when somebody looks at them."""

    Config = ObjectArmConfig
    PLAYS = (Arm, StartsPrograms)

    def __init__(self, name: str, config: ObjectArmConfig, clock: Clock) -> None:
        self._cell = cell_of(config.scenario, clock)
        self.controller: Controller = self._cell.controller
        super().__init__(name, clock, self.controller, config.lost_after_s)
        self.config = config
        self.world = self.controller.world
        self.state: LazyStream[ArmState] = LazyStream(
            f"{name}.state", clock, config.state_period_s, self._state_at, dt=0.001
        )
        self.stream = self.state
        self._port: ref[ObjectMotionPort] | None = None
        self.motion_begun = False
        self.connections = 0  # so many were made
        self._tcp = RigidTransform.identity(), np.eye(4), np.zeros(6)  # of the newest sample
        self._resting: tuple[Segment, tuple[object, ...], ArmState] | None = None
        self._ahead: Ahead | None = None

    async def open(self) -> None:
        """Connect; ``DEVICE_UNREACHABLE`` while the controller refuses."""
        await super().open()
        self.connections += 1
        self._cell.start()

    @property
    def expected_lag_s(self) -> float:
        """How late the arm is on its set-points as far as the configuration tells."""
        return 0.0 if self.world.config.arm.servo.lag == "none" else self.config.servo_lookahead_s

    async def identify(self) -> Identity:
        """Who the controller is; ``DEVICE_IDENTITY`` when the config expects another serial."""
        self._check_open()
        arm, serial, expected = self.world.config.arm, self.controller.serial, self.config.expect_serial
        if expected is not None and serial != expected:
            raise error("DEVICE_IDENTITY", f"{self.name} has serial {serial}, expected {expected}")
        calibration = {k: list(v) for k, v in arm.factory.model_dump().items()}
        extra = {"kinematics": {"calibration": calibration}, **arm.controller_limits.told()}
        return Identity(arm.name, serial, arm.version, extra)

    def fault(self) -> Exception | None:
        """The coded error that the newest package shows, or None."""
        if self.lost is not None:
            return self.lost
        sample = self.state.last()
        if sample is None:
            return None
        c = self.controller
        shown = c.safety_error(sample.value.robot_mode, sample.value.safety_mode)
        return shown or (None if c.remote else error("ARM_LOCAL_MODE", self.name))

    def check_movable(self) -> None:
        """Raise the coded error that forbids motion now."""
        self._check_open()
        self.state.latest(self.config.stale_after_s)
        fault = self.fault()
        if fault is not None:
            raise fault
        if self.controller.program is Program.FOREIGN:
            raise error("ARM_PROGRAM_RUNNING", f"a program that is not ours runs on {self.name}")

    async def open_motion(self, tool: ToolSettings) -> ObjectMotionPort:
        """Start our script, set TCP and payload; refused while the arm may not move."""
        if self._port is not None and (port := self._port()) is not None and not port.closed:
            raise error("MOTION_BUSY", f"{self.name} has a motion client already")
        self.motion_begun = False
        self.check_movable()
        if not self.controller.registers_free:
            raise error("ARM_REGISTER_CONFLICT", f"another client holds the registers of {self.name}")
        await self.clock.sleep(0.05)
        self.check_movable()
        run = self.controller.start_ours()
        self.motion_begun = True
        port = ObjectMotionPort(self, run)
        await self.take_tool(tool)
        self._port = ref(port)
        return port

    async def take_tool(self, tool: ToolSettings) -> None:
        """TCP and payload, set and seen; a change of the TCP starts a new epoch."""
        before = self.controller.T_flange_tcp
        self.controller.T_flange_tcp = tool.T_flange_tool
        self.controller.payload_kg = tool.payload_kg
        if not np.allclose(to_pose6(before), to_pose6(tool.T_flange_tool), rtol=0.0, atol=1e-9):
            self.state.new_epoch()
        await self.wait_fresh(OPEN_TIMEOUT_S)

    async def stop_script(self) -> None:
        """End the motion client and make the controller run a stop."""
        await self._stop_over_another_link()

    async def stop_program(self) -> None:
        """The dashboard's stop."""
        await self._stop_over_another_link()

    async def load_program(self, program: str) -> None:
        """The dashboard's load; this controller has every program whose name ends in .urp."""
        await self.clock.sleep(LOAD_S)
        if not program.endswith(".urp"):
            raise error("ARM_PROGRAM_NOT_STARTED", f"{self.name} has no program {program}")
        self.controller.loaded_program = program

    async def play_program(self, program: str, last_look: Callable[[], None]) -> None:
        """The dashboard's play; the program runs and does nothing."""
        if self.controller.loaded_program != program:
            raise error("ARM_PROGRAM_NOT_STARTED", f"{self.name} has loaded {self.controller.loaded_program}")
        self.check_movable()
        last_look()
        self.controller.start_foreign()

    def inject(self, kind: str, **arguments: object) -> None:
        """Begin a fault of the controller or of the link, by its name in the vocabulary."""
        self.controller.inject(kind, arguments)

    async def _stop_over_another_link(self) -> None:
        # These go over ports of their own, so they work while the state link is down.
        self.controller.check_reachable()
        await self.clock.sleep(0.01)
        self.controller.stop_program()

    def _check_open(self) -> None:
        if self.lost is not None:
            raise error(self.lost.name, self.lost.detail)

    def _state_at(self, t: float, tick: int) -> ArmState:
        c, track = self.controller, self.world.track
        was = t - self.world.reported.late_s
        segment = track.segment_at(was)
        modes = (c.robot_mode, c.safety_mode, c.program, id(c.T_flange_tcp))
        if self._resting is not None and self._resting[:2] == (segment, modes):
            return replace(
                self._resting[2],
                stamp=c.stamp(t),
                digital_in=self.world.arm_digital_in(t),
                speed_scaling=c.speed_scaling(t),
            )
        state = self._measure(t, tick, segment)
        if was >= segment.t_end and self.world.reported.exact:
            self._resting = (segment, modes, state)
        return state

    def _measure(self, t: float, tick: int, segment: Segment) -> ArmState:
        c = self.controller
        if self._tcp[0] is not c.T_flange_tcp:
            offset = to_pose6(c.T_flange_tcp)
            offset.flags.writeable = False
            self._tcp = c.T_flange_tcp, c.T_flange_tcp.as_matrix(), offset
        _, T_flange_tcp, tcp_offset6 = self._tcp
        q, qd, tcp_pose6, free_force = self._told(t, tick, segment, T_flange_tcp)
        force = self.world.contact_force(t, c.T_flange_tcp) + free_force
        force.flags.writeable = False
        return ArmState(
            q=q,
            qd=qd,
            tcp_pose6=tcp_pose6,
            tcp_force=force,
            tcp_offset6=tcp_offset6,
            robot_mode=c.robot_mode,
            safety_mode=int(c.safety_mode),
            program_running=c.program is not Program.NONE,
            digital_in=self.world.arm_digital_in(t),
            digital_out=0,
            stamp=c.stamp(t),
            speed_scaling=c.speed_scaling(t),
        )

    def _told(self, t: float, tick: int, segment: Segment, T_flange_tcp: Array) -> list[Array]:
        """Joints, joint speeds, the TCP's pose and the force without a contact at ``t``, which this tick
        tells, and those of the ticks after it together."""
        ahead = self._ahead
        if ahead is not None and ahead.segment is segment and ahead.T_flange_tcp is T_flange_tcp:
            told = ahead.at(t)
            if told is not None:
                return told
        ticks = ticks_ahead(segment, t - self.world.reported.late_s, self.config.state_period_s)
        later = (self.state.time_of(tick + k) for k in range(1, ticks))
        self._ahead = ahead = Ahead(self.world, segment, T_flange_tcp, [t, *later])
        return present(ahead.at(t), "time that was foreseen")
