"""Job ``laser-check``: where the tool is now, against its reference; measured, and nothing proposed."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar

from cell.formats.result import Envelope, Result
from cell.procedure import Procedure, Run
from cell.run_values import RunValues
from cell.store.files import read_json
from procedures.laser.config import LaserCheckConfig, LaserUpdateConfig, Search
from procedures.laser.health import keep_health
from procedures.laser.judging import finished_early, judge_check, judge_moved
from procedures.laser.measurement import (
    Measurement,
    check_poses,
    check_speeds,
    data_header,
    known_reference,
    reference_of,
)
from procedures.laser.record import PassRecord
from procedures.laser.reference import LaserReference
from procedures.laser.result import LaserResult
from procedures.laser.solve.solver import solve_laser
from procedures.laser.states import CHECKPOINTS, SCAN, ScanState

S = ScanState
Judged = Callable[[Path, Mapping[str, Any], Mapping[str, Any]], LaserResult | Result]


class AgainstReference(Procedure):
    """What jobs have alike that measure a tool against its reference."""

    kind: ClassVar[str] = "laser"
    inherits: ClassVar[Mapping[type[Procedure], tuple[str, ...]]] = {LaserReference: ("floor_m",)}
    CHECKPOINTS: ClassVar[frozenset[Any]] = CHECKPOINTS

    def uses(self) -> tuple[str, ...]:
        return ("arm", "beams")

    def check(self, values: RunValues) -> None:
        check_poses({"retract_pose": self.config.retract_pose}, values)
        check_speeds(reference_of(values)["search"], values)


class LaserCheck(AgainstReference):
    """Measures the tool against its reference."""

    name: ClassVar[str] = "laser-check"
    number: ClassVar[int] = 3
    Config = LaserCheckConfig
    State = ScanState
    TRANSITIONS: ClassVar[Mapping[Any, frozenset[Any]]] = SCAN

    config: LaserCheckConfig

    async def run(self, run: Run) -> None:
        await measure(run, measurement_of(run, self.config), self.config, solved_check)

    async def dry_run(self, run: Run) -> dict[str, Any]:
        """Every move with the guard's findings; nothing moves."""
        measurement = measurement_of(run, self.config)
        measurement.check_fixture()
        return await measurement.plan()

    @classmethod
    def solve_again(cls, path: Path, info: Mapping[str, Any], recorded: Mapping[str, Any]) -> Envelope:
        return solved_check(path, known_of(RunValues.of(info["values"])), info["job_config"])


def measurement_of(run: Run, config: LaserCheckConfig | LaserUpdateConfig) -> Measurement:
    """The measurement that the reference of this tool defines."""
    reference = reference_of(run.values)
    p_ref = [float(v) for v in reference["tool"]["p_ref"]]
    search = Search.from_reference(reference, config.floor_m)
    offset_s = float(reference["time_offset_s"])
    return Measurement(run, search, 1, p_ref, offset_s, config.retract_pose, config.max_U_m)


async def measure(
    run: Run,
    measurement: Measurement,
    config: LaserCheckConfig | LaserUpdateConfig,
    judged: Judged,
    scans: int = 1,
) -> None:
    """One scan of both beams, the first of ``scans``, solved and judged by ``judged``, to ``run.result``."""
    await run.enter(S.PREPARE)
    measurement.check_fixture()
    record = PassRecord(run.folder)
    scan = measurement.scan(record, scans=scans)
    await scan.check_clear()
    await run.enter(S.PLAN)
    await measurement.plan_and_note()
    async with run.motion() as lease:
        await scan.take(lease)
    await run.enter(S.SOLVE, f"{len(record.passes)} ways")
    reference = known_reference(run.values)
    header = data_header(measurement, reference)
    path = await record.write_data_set(run.worker, header, reference["passes"], scan.complete)
    run.note("solve", event="started", passes=len(record.passes))
    run.result = found = await run.worker.call(judged, path, known_of(run.values), config.model_dump())
    if isinstance(found, LaserResult) and (test := found.result.moved) is not None:
        event = "tool moved" if test.moved else "tool has not moved"
        run.note("decision", event=event, **test.model_dump())
    await keep_health(run)


def known_of(values: RunValues) -> dict[str, Any]:
    """What judging a check needs of a run's values."""
    reference = known_reference(values)
    return {
        "T_flange_tool_ref": list(reference["T_flange_tool"]),
        "T_flange_tool_last": list(values.tool["T_flange_tool"]),
        "offset_s": float(reference["time_offset_s"]),
    }


def solved_check(path: Path, known: Mapping[str, Any], config: Mapping[str, Any]) -> LaserResult | Result:
    """As :func:`solved_measurement`, and whether the tool has moved."""
    return judge_moved(solved_measurement(path, known, config), known, config)


def solved_measurement(
    path: Path, known: Mapping[str, Any], config: Mapping[str, Any]
) -> LaserResult | Result:
    """The result of a measurement against a reference, judged; for the worker process."""
    early = finished_early("laser", read_json(path))
    return early or judge_check(solve_laser(path, calls=1), known, config)
