"""Job ``latency-calibration``: how late a source's stamps are against the arm's, as a versioned offset.

Beams are crossed and a camera sees a target while the arm goes out and back at several speeds; items show how
a belt starts and stops. What differs is in a class for each source, see
:class:`procedures.latency.delayed_device.DelayedDevice`.
"""

import asyncio
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from cell.calibrations import time_offset
from cell.errors import error
from cell.formats.result import Envelope, Result
from cell.procedure import Procedure, Proposal, Run
from cell.run_values import RunValues
from cell.store.files import to_json, write_atomic
from procedures.belt.calibrating.procedure import BeltCalibration
from procedures.laser.reference import LaserReference
from procedures.latency.beams import DelayedBeams
from procedures.latency.camera import FixedCamera, FlangeCamera
from procedures.latency.config import Acceptance, LatencyCalibrationConfig
from procedures.latency.delayed_device import DelayedDevice
from procedures.latency.encoder import DelayedEncoder
from procedures.latency.result import LatencyResult
from procedures.latency.solver import DATA_FILE, SCHEMA, solve_latency
from procedures.latency.states import TRANSITIONS, S, State
from procedures.trends import keep_trends


class LatencyCalibration(Procedure):
    """Measures ``time_offset_s`` of a device."""

    name: ClassVar[str] = "latency-calibration"
    number: ClassVar[int] = 10
    kind: ClassVar[str] = "latency"
    Config = LatencyCalibrationConfig
    inherits: ClassVar[Mapping[type[Procedure], tuple[str, ...]]] = {
        LaserReference: ("floor_m",),
        BeltCalibration: ("belt_z_m", "items"),
    }
    State = State
    TRANSITIONS: ClassVar[dict[Any, frozenset[Any]]] = TRANSITIONS
    CHECKPOINTS: ClassVar[frozenset[Any]] = frozenset({S.APPROACH, S.SWEEP, S.WATCH})
    SOURCES: ClassVar[dict[str, type[DelayedDevice]]] = {
        source.role: source for source in (DelayedBeams, FlangeCamera, FixedCamera, DelayedEncoder)
    }

    config: LatencyCalibrationConfig

    def uses(self) -> tuple[str, ...]:
        return self.SOURCES[self.config.source].uses()

    def check(self, values: RunValues) -> None:
        self.SOURCES[self.config.source].refuse(self.config, values)
        fastest, allowed = max(self.config.speeds, default=0.0), values.limits["speed_m_s"]
        if fastest > allowed:  # slowed down in silence, two speeds could become one
            raise error(
                "MOTION_LIMIT", f"speeds_m_s has {fastest:g} m/s, [limits] speed_m_s is {allowed:g} m/s"
            )

    def proposal(self, run: Run) -> Proposal | None:
        if not isinstance(run.result, LatencyResult):
            return None
        answer = run.result.result
        return Proposal(time_offset(answer.source), answer.time_offset_s, self.config.accept.auto)

    async def run(self, run: Run) -> None:
        source = self._source(run)
        await run.enter(S.PREPARE)
        await source.check()
        await source.take()
        await run.enter(S.SOLVE, source.amount())
        if not source.amount():
            raise error("LATENCY_INCOMPLETE", "nothing was taken")
        path = await asyncio.to_thread(self._write_data_set, run, source)
        found = await run.worker.call(solve_within_limits, path, self.config.accept)
        run.result = found
        if isinstance(found, LatencyResult):
            name = f"{source.role}.latency_s.{source.device}"
            await keep_trends(run, {name: found.result.time_offset_s})

    async def dry_run(self, run: Run) -> dict[str, Any]:
        """Every move with the guard's findings; nothing moves."""
        return await self._source(run).plan()

    @classmethod
    def solve_again(cls, path: Path, info: Mapping[str, Any], recorded: Mapping[str, Any]) -> Envelope:
        return solve_within_limits(path, Acceptance.model_validate(info["job_config"]["accept"]))

    def _source(self, run: Run) -> DelayedDevice:
        return self.SOURCES[self.config.source](self.config, run)

    def _write_data_set(self, run: Run, source: DelayedDevice) -> Path:
        """``latency.json`` of what can be used."""
        data = {
            "schema": SCHEMA,
            "source": source.device,
            "signal": source.signal,
            "applied_s": run.values.time_offset_s[self.config.source]["applied"],
            **source.data(),
        }
        path = run.folder / DATA_FILE
        write_atomic(path, to_json(data))
        return path


def solve_within_limits(path: Path, limits: Acceptance) -> LatencyResult | Result:
    """The result held against the limits of the job; for the worker process."""
    result = solve_latency(path)
    if not isinstance(result, LatencyResult):
        return result
    low, high = result.result.interval95_s
    reasons = []
    if high - low > limits.max_interval_s:
        answering = 2.0 * (result.uncertainty.look_s or 0.0)
        remedy = "take more passes or poll faster"
        if answering > 0.5 * limits.max_interval_s:
            remedy = (
                f"{1e3 * answering:.2f} ms of it are the time of an answer, which more passes do not narrow"
            )
        reasons.append(
            f"max_interval_s: the 95 % interval is {1e3 * (high - low):.2f} ms wide, the limit is "
            f"{1e3 * limits.max_interval_s:g} ms; {remedy}"
        )
    if abs(result.result.time_offset_s) > limits.max_offset_s:
        reasons.append(
            f"max_offset_s: the delay is {1e3 * result.result.time_offset_s:.1f} ms, the limit is "
            f"{1e3 * limits.max_offset_s:g} ms"
        )
    return result.judged(reasons)
