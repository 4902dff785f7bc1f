"""Power and safety states of the arm, as RTDE, dashboard and primary port report them."""

from enum import IntEnum

UNLOCK_DELAY_S = 5.0  # a protective stop cannot be unlocked earlier
POWER_STEP_S = 0.4  # the real arm takes seconds; the order of modes is the same


class RobotMode(IntEnum):
    """RTDE ``robot_mode``."""

    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7


class SafetyMode(IntEnum):
    """RTDE ``safety_mode``."""

    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9


_STOPPED = 10
_STATUS_BITS: dict[SafetyMode, tuple[int, ...]] = {
    SafetyMode.NORMAL: (0,),
    SafetyMode.REDUCED: (0, 1),
    SafetyMode.PROTECTIVE_STOP: (2, _STOPPED),
    SafetyMode.RECOVERY: (3,),
    SafetyMode.SAFEGUARD_STOP: (4, _STOPPED),
    SafetyMode.SYSTEM_EMERGENCY_STOP: (5, 7, _STOPPED),
    SafetyMode.ROBOT_EMERGENCY_STOP: (6, 7, _STOPPED),
    SafetyMode.VIOLATION: (8, _STOPPED),
    SafetyMode.FAULT: (9, _STOPPED),
}
_JOINT_RUNNING, _JOINT_IDLE, _JOINT_OFF = 253, 255, 239


class Safety:
    """The state alone; what a stop does to program and motion is the robot's business."""

    def __init__(self) -> None:
        self.mode = SafetyMode.NORMAL
        self.robot_mode = RobotMode.RUNNING
        self._since = 0.0
        self._pending: list[tuple[float, RobotMode]] = []

    @property
    def powered(self) -> bool:
        return self.robot_mode >= RobotMode.POWER_ON

    @property
    def may_move(self) -> bool:
        """Brakes released and no stop active."""
        normal = self.mode in (SafetyMode.NORMAL, SafetyMode.REDUCED)
        return normal and self.robot_mode == RobotMode.RUNNING

    @property
    def emergency(self) -> bool:
        return self.mode in (SafetyMode.SYSTEM_EMERGENCY_STOP, SafetyMode.ROBOT_EMERGENCY_STOP)

    @property
    def status_bits(self) -> int:
        return sum(1 << bit for bit in _STATUS_BITS[self.mode])

    @property
    def joint_modes(self) -> tuple[int, ...]:
        if self.robot_mode == RobotMode.RUNNING:
            return (_JOINT_RUNNING,) * 6
        return (_JOINT_IDLE if self.powered else _JOINT_OFF,) * 6

    def step(self, t: float) -> None:
        """Take the power transitions that are due at ``t``."""
        while self._pending and self._pending[0][0] <= t:
            self.robot_mode = self._pending.pop(0)[1]

    def stop(self, mode: SafetyMode, t: float) -> None:
        """Enter a stop; a graver one is not replaced by a lighter one."""
        if mode >= self.mode or self.mode in (SafetyMode.NORMAL, SafetyMode.REDUCED):
            self.mode, self._since = mode, t
        if self.emergency or self.mode >= SafetyMode.VIOLATION:
            self.power_off()

    def reduce(self) -> None:
        """The safety configuration reduces speeds and forces from now on; a stop stays one."""
        if self.mode == SafetyMode.NORMAL:
            self.mode = SafetyMode.REDUCED

    def unlock_protective_stop(self, t: float) -> bool:
        """Leave a protective stop; False while it is younger than five seconds."""
        if self.mode == SafetyMode.PROTECTIVE_STOP:
            if t - self._since < UNLOCK_DELAY_S:
                return False
            self.mode = SafetyMode.NORMAL
        return True

    def release(self, *modes: SafetyMode) -> None:
        """Leave the stop if it is one of ``modes``."""
        if self.mode in modes:
            self.mode = SafetyMode.NORMAL

    def restore(self) -> None:
        """No stop, drives on, brakes released: what an operator at the pendant ends with."""
        self._pending = []
        self.mode, self.robot_mode = SafetyMode.NORMAL, RobotMode.RUNNING

    def power_on(self, t: float) -> None:
        """Towards IDLE, brakes engaged."""
        if not self.powered and not self.emergency:
            self._pending = [(t, RobotMode.POWER_ON), (t + POWER_STEP_S, RobotMode.IDLE)]

    def brake_release(self, t: float) -> None:
        """Towards RUNNING, through power-on when needed."""
        if self.emergency or self.robot_mode == RobotMode.RUNNING:
            return
        self.power_on(t)
        ready = self._pending[-1][0] if self._pending else t
        self._pending.append((ready + POWER_STEP_S, RobotMode.RUNNING))

    def power_off(self) -> None:
        """Brakes on, drives off."""
        self._pending = []
        self.robot_mode = RobotMode.POWER_OFF
