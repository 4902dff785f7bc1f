"""The operator as an automaton: moves the target on whenever the arm's control program has ended."""

import asyncio

from fakes.ur.robot import Robot
from fakes.ur.runtime import ScriptError
from fakes.world.world import Operator

REACTION_S = 0.3  # a program that is only uploaded again follows at once; then nobody moves anything


class AutomaticOperator:
    """A job gives the arm back before it asks for the target to be moved, and that is what is seen here."""

    def __init__(self, robot: Robot, operator: Operator) -> None:
        self._robot, self._operator = robot, operator
        robot.on_program.append(self._program_event)

    def _program_event(self, event: str, name: str, failure: ScriptError | None) -> None:
        if event == "STOPPED" and name == "rtde_control" and failure is None:
            asyncio.get_running_loop().call_later(REACTION_S, self._move_on)

    def _move_on(self) -> None:
        if not self._robot.runtime.active and self._robot.safety.may_move:
            self._operator.move_on(self._robot.now())
