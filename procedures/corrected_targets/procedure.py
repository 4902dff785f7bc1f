"""Job ``corrected-targets``: an arm that its own program moves is asked for target after target."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from cell.formats.result import Envelope
from cell.procedure import Procedure, Run
from cell.run_values import RunValues
from procedures.corrected_targets.config import CorrectedTargetsConfig
from procedures.corrected_targets.joint_ranges import JointRanges, outside_text
from procedures.corrected_targets.judging import solve_targets
from procedures.corrected_targets.plan import calibrated_of
from procedures.corrected_targets.session import TargetsRun
from procedures.corrected_targets.states import CHECKPOINTS, TRANSITIONS, State


class HandTargets(Procedure):
    """Hands targets to an observed arm, as given and corrected, and says what remains off at each."""

    name: ClassVar[str] = "corrected-targets"
    number: ClassVar[int] = 13
    kind: ClassVar[str] = "corrected-targets"
    Config = CorrectedTargetsConfig
    State = State
    TRANSITIONS: ClassVar[Mapping[Any, frozenset[Any]]] = TRANSITIONS
    CHECKPOINTS: ClassVar[frozenset[Any]] = CHECKPOINTS
    judges_arm: ClassVar[bool] = True  # the arm that is moved takes no part

    config: CorrectedTargetsConfig

    def uses(self) -> tuple[str, ...]:
        return ("observed_arm",) if self.config.reflector is None else ("observed_arm", "tracker")

    def check(self, values: RunValues) -> None:
        calibrated_of(values, self.config)

    async def run(self, run: Run) -> None:
        session = TargetsRun(self.config, run)
        await session.take_all()
        await run.enter(State.SOLVE, f"{len(session.record.arrivals)} arrivals")
        run.note("solve", event="started", arrivals=len(session.record.arrivals))
        run.result = await run.worker.call(solve_targets, session.record.path, self.config.max_error_m)

    async def dry_run(self, run: Run) -> dict[str, Any]:
        """Every target with what to command for it; nothing is asked of the arm."""
        planned = await TargetsRun(self.config, run).plan()
        ranges = JointRanges.of(calibrated_of(run.values, self.config))
        listed = [
            {"number": k, **t.model_dump(), "shift_m": _shift(t.T_base_flange, t.command)}
            for k, t in enumerate(planned, 1)
        ]
        Q, numbers = np.array([t.corrected for t in planned]), list(range(1, len(planned) + 1))
        return {"targets": listed, "outside_sampled": outside_text(Q, numbers, ranges.sampled)}

    @classmethod
    def solve_again(cls, path: Path, info: Mapping[str, Any], recorded: Mapping[str, Any]) -> Envelope:
        return solve_targets(path, info["job_config"].get("max_error_m"))


def _shift(wanted: list[float], command: list[float]) -> float:
    """m: how far the correction moves a target."""
    return float(np.linalg.norm(np.subtract(command[:3], wanted[:3])))
