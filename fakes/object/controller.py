"""The robot controller of the object face: modes, the one program that runs, and what can go wrong."""

import asyncio
from collections.abc import Callable
from enum import Enum

from scipy.spatial.transform import RigidTransform

from cell.clock import Clock
from cell.devices import SafetyMode
from cell.errors import CellError, error
from fakes.object._plant import Plant
from fakes.object.stream_time import StreamTime
from fakes.world.world import World

RUNNING, POWER_OFF = 7, 3
WATCHDOG_S = 0.2

# How hard the arm brakes, rad/s^2 of the fastest joint.
_NORMAL_STOP, _SAFEGUARD_STOP, _HARD_STOP = 8.0, 10.0, 20.0


class Program(Enum):
    """What the controller executes."""

    NONE = "none"
    OURS = "ours"
    FOREIGN = "foreign"


class Controller(Plant):
    """A UR controller without its wires. It keeps its state while drivers come and go."""

    def __init__(self, world: World, clock: Clock) -> None:
        super().__init__("arm", clock, world.config.arm.serial)
        self.world = world
        self.robot_mode = RUNNING
        self.safety_mode = SafetyMode.NORMAL
        self.remote = True
        self.program = Program.NONE
        self.loaded_program = ""
        self.registers_free = True
        self.T_flange_tcp = RigidTransform.identity()
        self.payload_kg = 0.0
        self.hanging_calls = 0
        self.stream_time = StreamTime(world.track, world.config.arm, world.config.seed)
        self.died_of: CellError | None = None
        self.rebooted = False
        self._booted_at = clock.now()
        self._run = 0
        self.faults |= {
            "protective-stop": self._protective_stop,
            "emergency-stop": self._emergency_stop,
            "safeguard-stop": self._safeguard_stop,
            "reduced-mode": self._reduced_mode,
            "local-mode": self._local_mode,
            "foreign-program": self._foreign_program,
            "register-in-use": self._register_in_use,
            "script-death": self._script_death,
            "child-crash": self._child_crash,
            "watchdog": self._watchdog,
            "stall": self._stall,
            "hang": self._hang,
            "speed-slider": self._speed_slider,
        }

    def stamp(self, t: float) -> float:
        """The controller's own clock at our time ``t``."""
        return t - self._booted_at

    @property
    def speed_fraction(self) -> float:
        """The speed slider's share of full speed."""
        return self.stream_time.fraction

    def speed_scaling(self, t: float) -> float:
        """The share of full speed at which the controller runs: the slider's, and less at a joint's limit."""
        return self.stream_time.fraction * self.stream_time.limiting(t)

    def safety_error(self, robot_mode: int, safety_mode: int) -> CellError | None:
        """The coded error that these modes mean, or None while the arm may move."""
        if safety_mode == SafetyMode.NORMAL and robot_mode == RUNNING:
            return None
        seen = f"{self.name}: safety mode {safety_mode}, robot mode {robot_mode}"
        if safety_mode in (SafetyMode.SYSTEM_EMERGENCY_STOP, SafetyMode.ROBOT_EMERGENCY_STOP):
            return error("ARM_EMERGENCY_STOP", seen)
        if safety_mode == SafetyMode.PROTECTIVE_STOP:
            return error("ARM_PROTECTIVE_STOP", seen)
        if safety_mode == SafetyMode.SAFEGUARD_STOP:
            return error("ARM_SAFEGUARD_STOP", seen)
        if robot_mode != RUNNING:
            return error("ARM_REBOOTED" if self.rebooted else "ARM_NOT_READY", seen)
        return error("ARM_NOT_READY", f"reduced mode: jobs need the arm's full speed, {seen}")

    # -- programs

    def start_ours(self) -> int:
        """Our control script starts; returns the number of this run of it."""
        self.settle_past()
        self.program, self.died_of = Program.OURS, None
        self._run += 1
        return self._run

    def start_foreign(self) -> None:
        """The loaded program starts."""
        self.settle_past()
        self.program = Program.FOREIGN
        self.announce()

    def runs(self, run: int) -> bool:
        """True while the run of our script with this number is the program."""
        return self.program is Program.OURS and run == self._run

    def end_ours(self, run: int) -> None:
        """Our script ends and the arm stops; harmless when it is another one that runs."""
        if self.runs(run):
            self._end_program()

    def stop_program(self) -> None:
        """Whatever runs is stopped, as by a script that only stops, or by the dashboard."""
        self.settle_past()
        self._end_program()
        self.announce()

    def abandon(self, run: int) -> None:
        """Nobody kicks the watchdog of this run any more: the arm stops 0.2 s later."""
        if self.runs(run):
            self._at_watchdog(lambda: self._expire(run))

    def brake(self, decel: float = _NORMAL_STOP) -> None:
        """The arm decelerates from now on."""
        self.world.track.halt(self.clock.now(), decel)

    # -- faults

    def clear(self) -> None:
        """An operator puts the arm right: released, powered, in remote mode, no program, registers free."""
        self.robot_mode, self.safety_mode, self.remote = RUNNING, SafetyMode.NORMAL, True
        self.registers_free, self.hanging_calls, self.rebooted = True, 0, False
        self._speed_slider(1.0)
        if self.program is Program.FOREIGN:
            self._end_program()
        super().clear()

    def _protective_stop(self) -> None:
        self.safety_mode = SafetyMode.PROTECTIVE_STOP
        self._die(error("ARM_PROTECTIVE_STOP", self.name), _HARD_STOP)

    def _emergency_stop(self) -> None:
        self.safety_mode, self.robot_mode = SafetyMode.ROBOT_EMERGENCY_STOP, POWER_OFF
        self._die(error("ARM_EMERGENCY_STOP", self.name), _HARD_STOP)

    def _safeguard_stop(self, duration_s: float | None = None) -> None:
        self.safety_mode = SafetyMode.SAFEGUARD_STOP
        self._die(error("ARM_SAFEGUARD_STOP", self.name), _SAFEGUARD_STOP)
        if duration_s is not None:
            self.later(duration_s, self._close_guard)

    def _close_guard(self) -> None:
        if self.safety_mode is SafetyMode.SAFEGUARD_STOP:
            self.settle_past()
            self.safety_mode = SafetyMode.NORMAL
            self.announce()

    def _reduced_mode(self) -> None:
        # The program runs on; whoever reads the mode has to end it.
        self.settle_past()
        self.safety_mode = SafetyMode.REDUCED
        self.announce()

    def _local_mode(self) -> None:
        self.remote = False
        self._die(error("ARM_LOCAL_MODE", self.name), _NORMAL_STOP)

    def _foreign_program(self) -> None:
        self._die(error("ARM_PROGRAM_RUNNING", f"another program was started on {self.name}"), _NORMAL_STOP)
        self.program = Program.FOREIGN

    def _register_in_use(self) -> None:
        self.registers_free = False
        self._die(error("ARM_REGISTER_CONFLICT", self.name), _NORMAL_STOP)

    def _script_death(self) -> None:
        self._die(error("ARM_SCRIPT_DIED", self.name), _NORMAL_STOP)

    def _child_crash(self) -> None:
        self._leave(error("CHILD_DIED", f"the motion process of {self.name}"))

    def _watchdog(self) -> None:
        self._leave(error("MOTION_WATCHDOG", self.name))

    def _stall(self) -> None:
        self.brake(_HARD_STOP)

    def _speed_slider(self, fraction: float) -> None:
        self.stream_time.set_fraction(self.clock.now(), min(max(fraction, 0.01), 1.0))

    def _hang(self, calls: int = 1) -> None:
        self.hanging_calls = calls

    def _reboot(self, serial: str | None = None, boot_s: float = 1.0) -> None:
        self.robot_mode, self.rebooted = POWER_OFF, True
        self._booted_at = self.clock.now() + boot_s
        self.T_flange_tcp, self.payload_kg = RigidTransform.identity(), 0.0
        self._die(error("ARM_REBOOTED", self.name), _HARD_STOP)
        super()._reboot(serial, boot_s)

    def cut(self, why: CellError) -> None:
        super().cut(error("ARM_REBOOTED", self.name) if self.rebooted else why)
        self.abandon(self._run)

    def _leave(self, why: CellError) -> None:
        """The kicks stop: our side knows at once, the arm after the watchdog's time."""
        self.died_of = why
        self.abandon(self._run)

    def _die(self, why: CellError, decel: float) -> None:
        """Our script is gone and the arm stops."""
        if self.program is Program.OURS:
            self.program, self.died_of = Program.NONE, why
        self.brake(decel)

    def _end_program(self) -> None:
        self.program = Program.NONE
        self.brake()

    def _expire(self, run: int) -> None:
        self.settle_past()
        if self.runs(run):
            self.died_of = self.died_of or error("MOTION_WATCHDOG", f"{self.name}: no kick in time")
        self.end_ours(run)
        self.announce()

    def _at_watchdog(self, action: Callable[[], None]) -> None:
        # The brake is planned here and now, so the arm stops even if the loop ends before.
        self.world.track.halt(self.clock.now() + WATCHDOG_S, _NORMAL_STOP)
        try:
            asyncio.get_running_loop().call_later(WATCHDOG_S, action)
        except RuntimeError:
            action()
