"""Job ``cone-capture``: camera poses on cones around a board, and the hand-eye result.

For each placement of the board: find it, plan a cone with constant roll, then move, settle and take several
frames at each pose. Raw data are on disk before anything is solved.
"""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar

from cell.formats.result import Envelope
from cell.procedure import FinishRequested, Procedure, Proposal, Run
from cell.run_values import RunValues
from procedures.hand_eye.capturing import CaptureRun, check_names, check_pose
from procedures.hand_eye.config import Acceptance, ConeCaptureConfig
from procedures.hand_eye.health import keep_health
from procedures.hand_eye.result import HandEyeResult
from procedures.hand_eye.solve.solver import solve_hand_eye
from procedures.hand_eye.states import TRANSITIONS, S, State
from procedures.hand_eye.verdict import judged


class ConeCapture(Procedure):
    """Hand-eye calibration, eye-in-hand or eye-to-hand."""

    name: ClassVar[str] = "cone-capture"
    number: ClassVar[int] = 1
    kind: ClassVar[str] = "hand-eye"
    Config = ConeCaptureConfig
    State = State
    TRANSITIONS: ClassVar[dict[Any, frozenset[Any]]] = TRANSITIONS
    CHECKPOINTS: ClassVar[frozenset[Any]] = frozenset({S.PLACE, S.SEEK, S.MOVE})

    config: ConeCaptureConfig

    def uses(self) -> tuple[str, ...]:
        return ("arm", self._camera_role)

    def check(self, values: RunValues) -> None:
        check_names(self.config.target, self.config.start_pose, values)
        check_pose("accept.task_pose", self.config.accept.task_pose, values)

    def pictures(self) -> tuple[str, int]:
        return self._camera_role, self.config.pictures()

    def proposal(self, run: Run) -> Proposal | None:
        pose = run.result.result.pose() if isinstance(run.result, HandEyeResult) else None
        return None if pose is None else Proposal(*pose, self.config.accept.auto)

    @property
    def _pose_name(self) -> str:
        return "T_flange_camera" if self.config.setup == "eye-in-hand" else "T_base_camera"

    @property
    def _camera_role(self) -> str:
        return "flange_camera" if self.config.setup == "eye-in-hand" else "fixed_camera"

    async def run(self, run: Run) -> None:
        capture = CaptureRun(self.config, run, run.camera(self._camera_role))
        with suppress(FinishRequested):
            await capture.take_all()
        await capture.solve()
        await keep_health(run, self.config.setup, self._pose_name)

    async def dry_run(self, run: Run) -> dict[str, Any]:
        """The plan from the board as it is seen now, with every check; nothing moves."""
        capture = CaptureRun(self.config, run, run.camera(self._camera_role))
        await capture.camera.set_target(capture.target)
        seen = await capture.seek()
        if capture.calibration is None:
            return {"note": "no nominal pose in [robot]: six small moves come first", "poses": []}
        plan = await capture.plan(seen, capture.calibration)
        return plan.as_dict()

    @classmethod
    def solve_again(cls, path: Path, info: Mapping[str, Any], recorded: Mapping[str, Any]) -> Envelope:
        again = solve_hand_eye(path, method=(recorded.get("inputs") or {}).get("method"), calls=1)
        limits = (info.get("job_config") or {}).get("accept")
        return judged(again, Acceptance.model_validate(limits)) if limits else again
