"""The control script's commands beside motion: force, freedrive, payload, dynamics; and what is refused.

A command is carried out in the twin's world or it ends the script with an error, which the client shows as
False; none is answered as done that was not done. Two kinds are refused: those for which the twin has no
model, and those whose lines the script lacks before a certain PolyScope version.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from cell.poses import Array
from fakes.ur.control_modes import ForceTask
from fakes.ur.registers import Registers
from fakes.ur.runtime import ScriptError
from fakes.ur.variables import Since

if TYPE_CHECKING:
    from fakes.ur.robot import Robot

SCRIPT_DAMPING, SCRIPT_GAIN_SCALING = 0.025, 0.5  # what the control script begins with
DIFFERENCE_S = 1e-4
_CONTACT, _NEWEST = Since((5, 4), None), Since((5, 23), None)
SINCE: dict[int, Since] = {
    20: Since((5, 0), (3, 5)),
    21: Since((5, 0), None),
    **dict.fromkeys((25, 26, 27, 51, 62, 63, 64), _CONTACT),
    28: Since((5, 3), None),
    **dict.fromkeys((52, 53, 54), Since((5, 10), None)),
    **dict.fromkeys((56, 57), Since((5, 9), None)),
    **dict.fromkeys((60, 61), Since((5, 10), (3, 15))),
    65: Since((5, 10), None),
    66: Since((5, 26), None),
    **dict.fromkeys((67, 68, 69, 70, 71), _NEWEST),
}
_NOT_MODELLED = {
    66: "direct_torque: the twin has no model of joint torques",
    67: "get_mass_matrix: the twin has no model of the arm's masses",
    68: "get_coriolis_and_centrifugal_torques: the twin has no model of the arm's masses",
}


def refusal(command: int, version: tuple[int, ...], known: bool) -> str:
    """Why ``command`` cannot be carried out; empty when it can."""
    if command in _NOT_MODELLED:
        return _NOT_MODELLED[command]
    if not known:
        return f"the control script has no command {command}"
    since = SINCE.get(command)
    if since is not None and not since.includes(version):
        number = ".".join(map(str, version[:3]))
        return f"command {command} of the control script does nothing on PolyScope {number}"
    return ""


class SpecialCommands:
    """The actions, by command number."""

    def __init__(self, robot: "Robot", registers: Registers) -> None:
        self._robot, self._arm, self._registers = robot, robot.arm, registers
        robot.modes.damping, robot.modes.gain_scaling = SCRIPT_DAMPING, SCRIPT_GAIN_SCALING

    def table(self) -> dict[int, Callable[[], None]]:
        """Number -> action; arguments and results are in the registers."""
        r, arm, robot = self._registers, self._arm, self._robot
        modes, out = robot.modes, r.vector_out
        return {
            6: self._force_mode,
            8: robot.zero_force_sensor,
            17: self._payload,
            18: modes.begin_freedrive,
            19: modes.end,
            20: lambda: modes.set_damping(r.double_in(0)),
            21: lambda: modes.set_gain_scaling(r.double_in(0)),
            28: lambda: out(arm.waypoint),
            29: lambda: robot.set_tcp(r.vector_in(0)),
            38: lambda: out(arm.jacobian(arm.q).T @ robot.contact_force()),
            40: lambda: out(robot.tool.offset6),
            52: self._freedrive,
            53: modes.end,
            54: lambda: r.int_out(1, modes.freedrive_status),
            56: self._external_sensor,
            57: self._external_sensor,
            59: self._gravity,
            65: self._target_payload,
            69: lambda: out(robot.instant(arm.t).qdd),
            70: lambda: self._matrix_out(arm.jacobian(arm.q)),
            71: lambda: self._matrix_out(self._jacobian_rate()),
        }

    def _force_mode(self) -> None:
        r = self._registers
        selection = [r.int_in(2 + k) for k in range(6)]
        task = ForceTask(r.vector_in(0), selection, r.vector_in(6), r.vector_in(12))
        self._robot.modes.begin_force(task, r.int_in(1))

    def _freedrive(self) -> None:
        axes = [self._registers.int_in(1 + k) for k in range(6)]
        if any(axis not in (0, 1) for axis in axes):
            raise ScriptError(f"freedrive_mode: free axes are 0 or 1, not {axes}")
        self._robot.modes.begin_freedrive()

    def _payload(self) -> None:
        r = self._registers
        self._robot.set_payload(r.double_in(0), [r.double_in(k) for k in (1, 2, 3)])

    def _target_payload(self) -> None:
        self._payload()
        self._robot.tool.inertia = tuple(self._registers.vector_in(4))

    def _gravity(self) -> None:
        gravity = [self._registers.double_in(k) for k in range(3)]
        if not np.all(np.isfinite(gravity)) or not any(gravity):
            raise ScriptError(f"set_gravity: needs a direction, not {gravity}")
        self._robot.tool.gravity = tuple(gravity)

    def _external_sensor(self) -> None:
        r = self._registers
        arguments = [r.double_in(k) for k in range(7)]
        if any(arguments):
            raise ScriptError("ft_rtde_input_enable: the twin models a sensor without mass and offset only")
        self._robot.force_sensor.use_external = r.int_in(1) == 1

    def _jacobian_rate(self) -> Array:
        q, qd = self._arm.track.at(self._arm.t)
        step = DIFFERENCE_S * qd
        rate: Array = (self._arm.jacobian(q + step) - self._arm.jacobian(q - step)) / (2 * DIFFERENCE_S)
        return rate

    def _matrix_out(self, matrix: ArrayLike) -> None:
        """Column by column: the first four in registers 0 to 23, the last two in 36 to 47."""
        columns = np.asarray(matrix).T
        self._registers.vector_out(columns[:4].ravel())
        self._registers.vector_out(columns[4:].ravel(), 36)
