"""Job ``tracker-sampling``: reflectors on a flange, seen by a laser tracker at poses that tell most."""

import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from cell.calibrations import kinematics
from cell.errors import CellError, error
from cell.formats.result import Envelope
from cell.procedure import Procedure, Proposal, Run
from cell.run_values import RunValues
from cell.to_its_end import run_to_its_end
from procedures.tracker.config import TrackerSamplingConfig
from procedures.tracker.feasible_poses import payload_of, robot_of
from procedures.tracker.health import keep_health
from procedures.tracker.judging import proposal_value, solve_within_limits
from procedures.tracker.result import KincalResult
from procedures.tracker.sampling import SamplingRun
from procedures.tracker.states import CHECKPOINTS, TRANSITIONS, State

MIN_SAMPLES = 3
PAYLOAD_SAME_KG = 1e-3


class TrackerSampling(Procedure):
    """Measures an arm with a laser tracker and proposes its kinematics."""

    name: ClassVar[str] = "tracker-sampling"
    number: ClassVar[int] = 5
    kind: ClassVar[str] = "kincal"
    Config = TrackerSamplingConfig
    State = State
    TRANSITIONS: ClassVar[Mapping[Any, frozenset[Any]]] = TRANSITIONS
    CHECKPOINTS: ClassVar[frozenset[Any]] = CHECKPOINTS
    judges_arm: ClassVar[bool] = True

    config: TrackerSamplingConfig

    def uses(self) -> tuple[str, ...]:
        return (self.config.arm, "tracker")

    def check(self, values: RunValues) -> None:
        robot_of(values, self.config)
        check_payload(self.config, values)

    def proposal(self, run: Run) -> Proposal | None:
        if not isinstance(run.result, KincalResult):
            return None
        value = proposal_value(
            run.result, payload_of(self.config, run.values), robot_of(run.values, self.config)
        )
        device = run.cell.device(self.config.arm).name
        return Proposal(kinematics(device), value, self.config.accept.auto)

    async def run(self, run: Run) -> None:
        sampling = SamplingRun(self.config, run)
        try:
            await sampling.take_all()
        except CellError as failure:
            raise await _with_what_is_left(run, sampling, failure) from failure
        except (Exception, asyncio.CancelledError):  # a bug, an abort or a halt: the poses are no less good
            await run_to_its_end(_keep_what_is_left(run, sampling))
            raise
        await run.enter(State.SOLVE, f"{len(sampling.record.samples)} poses")
        if len(sampling.record.samples) < MIN_SAMPLES:
            raise error("TRACKER_INCOMPLETE", f"{len(sampling.record.samples)} poses were finished")
        path = await asyncio.to_thread(sampling.write)
        run.note("solve", event="started", samples=len(sampling.record.samples))
        run.result = await run.worker.call(solve_within_limits, path, self.config.accept.max_error_m)
        await keep_health(run)

    async def dry_run(self, run: Run) -> dict[str, Any]:
        """Every pose with the guard's findings and what the plan promises; nothing moves."""
        sampling = SamplingRun(self.config, run)
        plan = await sampling.plan()
        if self.config.T_base_tracker_nominal is None:
            note = "without T_base_tracker_nominal the job finds the tracker first, then plans in its view"
            return {"note": note, **plan.listing}
        return plan.listing

    @classmethod
    def solve_again(cls, path: Path, info: Mapping[str, Any], recorded: Mapping[str, Any]) -> Envelope:
        method = (recorded.get("inputs") or {}).get("method")
        return solve_within_limits(path, info["job_config"]["accept"]["max_error_m"], method)


async def _with_what_is_left(run: Run, sampling: SamplingRun, failure: CellError) -> CellError:
    """``failure`` with what can be done with the poses that were measured; their data sets are written."""
    count = len(sampling.record.samples)
    if not count or failure.name == "TRACKER_MOVED":
        return failure
    await _keep_what_is_left(run, sampling)
    text = f"{failure.detail}; {count} poses are kept, `cellward adopt {run.id}` goes on from them"
    return error(failure.name, text)


async def _keep_what_is_left(run: Run, sampling: SamplingRun) -> None:
    """Write the data sets of what was measured, if anything was."""
    if not sampling.record.samples:
        return
    try:
        await asyncio.to_thread(sampling.write)
    except CellError as second:  # as a full disk; what ended the run is the reason
        run.note("error", **second.as_dict())


def check_payload(config: TrackerSamplingConfig, values: RunValues) -> None:
    """``PAYLOAD_DIFFERS`` when what hangs on a moved arm is not what its controller is told."""
    told = float(values.payload_kg)
    if config.arm == "arm" and abs(payload_of(config, values) - told) > PAYLOAD_SAME_KG:
        raise error(
            "PAYLOAD_DIFFERS",
            f"[job.tracker-sampling] payload_kg is {config.payload_kg:g} kg, and [robot] payload_kg, which "
            f"the controller is told, {told:g} kg",
        )
