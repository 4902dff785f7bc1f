"""Job ``touch-test``: tool, camera and arm together, by the tool's point over corners of a board."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from calibration.targets import make_target
from cell.errors import error
from cell.formats.result import Envelope
from cell.procedure import Procedure, Run
from cell.run_values import RunValues
from procedures.hand_eye_in_use import require_hand_eye
from procedures.touch_test.config import TouchTestConfig
from procedures.touch_test.judging import solve_touch_test
from procedures.touch_test.session import TouchRun
from procedures.touch_test.states import CHECKPOINTS, TRANSITIONS, State


class TouchTest(Procedure):
    """Drives the tool's point over corners of a board, and says how far off it is there."""

    name: ClassVar[str] = "touch-test"
    number: ClassVar[int] = 14
    kind: ClassVar[str] = "touch-test"
    reads_reference: ClassVar[bool] = True
    Config = TouchTestConfig
    State = State
    TRANSITIONS: ClassVar[Mapping[Any, frozenset[Any]]] = TRANSITIONS
    CHECKPOINTS: ClassVar[frozenset[Any]] = CHECKPOINTS

    config: TouchTestConfig

    def uses(self) -> tuple[str, ...]:
        return ("arm", "flange_camera")

    def check(self, values: RunValues) -> None:
        _check_name("target", self.config.target, values.targets)
        _check_name("look_pose", self.config.look_pose, values.poses)
        points = len(make_target(values.targets[self.config.target]).points)
        if self.config.corners is not None and max(self.config.corners) >= points:
            text = f"corners has {max(self.config.corners)}, and the points of '{self.config.target}' are 0"
            raise error("ARGUMENT_INVALID", f"{text} to {points - 1}; name others")
        require_hand_eye(values)

    async def run(self, run: Run) -> None:
        session = TouchRun(self.config, run)
        await session.take_all()
        await run.enter(State.SOLVE, f"{len(session.data.stood)} corners")
        run.result = await run.worker.call(solve_touch_test, session.path)

    async def dry_run(self, run: Run) -> dict[str, Any]:
        """Every corner with every check, for the board as it is seen from here; nothing moves."""
        return (await TouchRun(self.config, run).plan_from_here()).listing

    @classmethod
    def solve_again(cls, path: Path, info: Mapping[str, Any], recorded: Mapping[str, Any]) -> Envelope:
        return solve_touch_test(path)


def _check_name(key: str, name: str, known: Mapping[str, Any]) -> None:
    if name not in known:
        there = ", ".join(known) or "none"
        raise error("ARGUMENT_INVALID", f"{key} '{name}' is unknown; there is {there}")
