"""Job ``laser-reference``: where the beams are, and where a tool that is known to be good meets them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from cell.calibrations import laser_reference
from cell.formats.result import Envelope, Result
from cell.procedure import Procedure, Proposal, Run
from cell.run_values import RunValues
from cell.store.files import read_json
from procedures.laser.config import LaserReferenceConfig, Search
from procedures.laser.health import keep_health
from procedures.laser.judging import finished_early, judge_reference
from procedures.laser.measurement import Measurement, check_poses, check_speeds, nominal_header
from procedures.laser.packed import same_passes
from procedures.laser.record import PassRecord
from procedures.laser.result import ReferenceResult
from procedures.laser.solving import solve_new_reference
from procedures.laser.states import CHECKPOINTS, SCAN, ScanState

S = ScanState
PLACES = 2  # along each beam: two points make a line


def mount_text(tool: str) -> str:
    """What the operator is asked before a reference is made: nothing measured later is better than it."""
    return (
        f"Every later check measures against the tool that is in place now: mount tool '{tool}', known to be "
        "good, clean and undamaged, and leave the beams free; then confirm"
    )


class LaserReference(Procedure):
    """Measures both beams at two places and proposes the reference of this tool."""

    name: ClassVar[str] = "laser-reference"
    number: ClassVar[int] = 2
    kind: ClassVar[str] = "laser-reference"
    Config = LaserReferenceConfig
    State = ScanState
    TRANSITIONS: ClassVar[Mapping[Any, frozenset[Any]]] = SCAN
    CHECKPOINTS: ClassVar[frozenset[Any]] = CHECKPOINTS

    config: LaserReferenceConfig

    def uses(self) -> tuple[str, ...]:
        return ("arm", "beams")

    def check(self, values: RunValues) -> None:
        c = self.config
        check_poses({"xs.aux": c.xs.aux, "ys.aux": c.ys.aux, "retract_pose": c.retract_pose}, values)
        check_speeds(c.model_dump(), values)

    def proposal(self, run: Run) -> Proposal | None:
        if not isinstance(run.result, ReferenceResult):
            return None
        return Proposal(laser_reference(run.values.tool["name"]), run.result.result, self.config.accept.auto)

    async def run(self, run: Run) -> None:
        await run.enter(S.PREPARE)
        measurement = self._measurement(run)
        measurement.check_fixture()
        record = PassRecord(run.folder)
        scan = measurement.scan(record)
        if self.config.ask_for_tool:
            await run.ask(mount_text(run.values.tool["name"]))
        await scan.check_clear()
        await run.enter(S.PLAN)
        await measurement.plan_and_note()
        async with run.motion() as lease:
            await scan.take(lease)
        await run.enter(S.SOLVE, f"{len(record.passes)} ways")
        tool = run.values.tool
        header = nominal_header(measurement, tool, self.config.pin_radius_m)
        path = await record.write_data_set(run.worker, header, None, scan.complete)
        run.note("solve", event="started", passes=len(record.passes))
        known = known_of(self.config, run.values, measurement.search.device)
        run.result = await run.worker.call(solved_reference, path, known, self.config.model_dump())
        await keep_health(run)

    async def dry_run(self, run: Run) -> dict[str, Any]:
        """Every move with the guard's findings; nothing moves."""
        measurement = self._measurement(run)
        measurement.check_fixture()
        return await measurement.plan()

    @classmethod
    def solve_again(cls, path: Path, info: Mapping[str, Any], recorded: Mapping[str, Any]) -> Envelope:
        config = LaserReferenceConfig.model_validate(info["job_config"])
        known = known_of(config, RunValues.of(info["values"]), info["config"]["robot"]["beams"])
        return with_passes_of(recorded, solved_reference(path, known, info["job_config"]))

    def _measurement(self, run: Run) -> Measurement:
        search = Search.from_config(self.config, run.values.poses, run.inputs("beams").name)
        offset_s = float(run.values.time_offset_s["beams"]["effective"])
        return Measurement(run, search, PLACES, None, offset_s, self.config.retract_pose, self.config.max_U_m)


def with_passes_of(recorded: Mapping[str, Any], found: Envelope) -> Envelope:
    """``found`` with the passes as they were recorded, where they hold the same.

    An earlier version recorded them plain, and another computer may compress them to other texts.
    """
    answer = recorded.get("result") or {}
    passes = answer.get("passes")
    if not isinstance(found, ReferenceResult) or not passes:
        return found
    if not same_passes(passes, found.result.passes or []):
        return found
    return found.changed(result=found.result.changed(passes=passes, schema_=answer.get("schema")))


def known_of(config: LaserReferenceConfig, values: RunValues, device: str) -> dict[str, Any]:
    """What a reference keeps beside what was measured."""
    search = Search.from_config(config, values.poses, device)
    return {
        "search": search.model_dump(),
        "T_flange_tool": list(values.tool["T_flange_tool"]),
        "time_offset_s": float(values.time_offset_s["beams"]["effective"]),
    }


def solved_reference(
    path: Path, known: Mapping[str, Any], config: Mapping[str, Any]
) -> ReferenceResult | Result:
    """The result of a reference, judged; for the worker process."""
    early = finished_early("laser-reference", read_json(path))
    return early or judge_reference(solve_new_reference(path, known), config)
