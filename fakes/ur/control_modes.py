"""How the arm is controlled when it does not follow a path: freedrive, teach mode and force mode.

Nobody pushes the arm of the twin by hand, so in freedrive it stays where it is. In force mode the TCP moves
along the compliant axes with a speed in proportion to the force that is missing. The twin overlays no
motion on either, so a motion command is refused meanwhile.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike

from cell.poses import Array, from_pose6
from fakes.ur.arm import Arm
from fakes.ur.runtime import ScriptError

COMPLIANCE = np.array([0.004] * 3 + [0.2] * 3)  # (m/s)/N and (rad/s)/Nm at a gain of 1 without damping
FORCE_ACCEL = 5.0  # m/s^2
FRAME_AS_GIVEN = 2  # the type of force mode whose frame is not turned
NEAR_SINGULAR, TOO_NEAR_SINGULAR = 0.10, 0.03  # smallest singular value of the Jacobian (m and rad mixed)


class ControlMode(IntEnum):
    """As the primary port tells it."""

    POSITION = 0
    TEACH = 1
    FORCE = 2


@dataclass(frozen=True)
class ForceTask:
    """Arguments of force_mode(); ``wrench`` and ``limits`` (6,) are along and about ``frame6``'s axes."""

    frame6: Sequence[float]
    selection: Sequence[float]
    wrench: Sequence[float]
    limits: Sequence[float]

    def velocity(self, force: ArrayLike, gain: float) -> Array:
        """TCP velocity (6,) in the base for the wrench ``force`` on the TCP, in the base."""
        turn = from_pose6(self.frame6).rotation
        seen = turn.inv().apply(np.reshape(force, (2, 3))).ravel()
        wanted = gain * COMPLIANCE * (np.asarray(self.wrench) + seen)
        speed = np.clip(wanted, -np.abs(self.limits), np.abs(self.limits)) * (np.asarray(self.selection) != 0)
        velocity: Array = turn.apply(speed.reshape(2, 3)).ravel()
        return velocity


class ControlModes:
    """The mode that is active, and what force mode was told."""

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self.mode = ControlMode.POSITION
        self._task: ForceTask | None = None
        self.damping, self.gain_scaling = 0.005, 1.0  # the defaults of the URScript manual

    def begin_freedrive(self) -> None:
        """freedrive_mode() and teach_mode()."""
        self._enter(ControlMode.TEACH, "the arm is in freedrive mode")

    def begin_force(self, task: ForceTask, kind: int) -> None:
        """force_mode(); again with other arguments while it is active."""
        if kind != FRAME_AS_GIVEN:
            raise ScriptError(f"force_mode: the twin models type {FRAME_AS_GIVEN} only, not {kind}")
        if not np.all(np.isfinite([*task.frame6, *task.wrench, *task.limits])):
            raise ScriptError("force_mode: needs finite numbers")
        self._enter(ControlMode.FORCE, "the arm is in force mode, on which the twin overlays no motion")
        self._task = task

    def set_damping(self, damping: float) -> None:
        """force_mode_set_damping(): 0 to 1."""
        self.damping = _within("force_mode_set_damping", damping, 1.0)

    def set_gain_scaling(self, scaling: float) -> None:
        """force_mode_set_gain_scaling(): 0 to 2."""
        self.gain_scaling = _within("force_mode_set_gain_scaling", scaling, 2.0)

    def end(self) -> None:
        """Back to position control."""
        self.mode, self._task, self._arm.refusal = ControlMode.POSITION, None, ""

    def reset(self) -> None:
        """What a program leaves behind: position control, the defaults of force mode."""
        self.end()
        self.damping, self.gain_scaling = 0.005, 1.0

    def step(self, force: Callable[[], ArrayLike]) -> None:
        """One control cycle; ``force`` tells the wrench on the TCP in the base."""
        if self._task is not None:
            gain = self.gain_scaling * (1.0 - self.damping)
            self._arm.drive_linear(self._task.velocity(force(), gain), FORCE_ACCEL)

    @property
    def freedrive_status(self) -> int:
        """get_freedrive_status(): 0 normal, 1 near a singularity, 2 too near."""
        smallest = float(np.linalg.svd(self._arm.jacobian(self._arm.q), compute_uv=False)[-1])
        return int(smallest < NEAR_SINGULAR) + int(smallest < TOO_NEAR_SINGULAR)

    def _enter(self, mode: ControlMode, refusal: str) -> None:
        if mode != self.mode and self._arm.moving(self._arm.t):
            self._arm.halt(self._arm.t)
        self.mode, self._task, self._arm.refusal = mode, None, refusal


def _within(function: str, value: float, most: float) -> float:
    if not 0.0 <= value <= most:
        raise ScriptError(f"{function}: {value:g} is not between 0 and {most:g}")
    return value
