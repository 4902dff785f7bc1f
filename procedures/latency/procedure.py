"""Job ``latency-calibration``: how late a source's stamps are against the arm's, as a versioned offset.

For beams the tool crosses one of them out and back at several speeds. What a source needs is in ``_Beams``;
a belt or a camera would get a class of the same shape.
"""

import asyncio
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.calibrations import time_offset
from cell.devices import Speed
from cell.errors import error
from cell.motion import MotionLease
from cell.poses import Array
from cell.procedure import FinishRequested, Procedure, Proposal, Run
from cell.store.files import to_json, write_atomic
from procedures.arm_setup import lease_settings
from procedures.laser.config import Search
from procedures.laser.faults import fault_of
from procedures.laser.measurement import Measurement, reference_of
from procedures.laser.record import PassRecord
from procedures.laser.scan import leave_fixture
from procedures.laser.sweep import Beam, Sweeper
from procedures.latency.config import LatencyCalibrationConfig
from procedures.solve.latency import DATA_FILE, SCHEMA, solve_latency

UP = np.array([0.0, 0.0, 1.0])


class State(StrEnum):
    """Where the job is."""

    PREPARE = "prepare"
    APPROACH = "approach"
    SWEEP = "sweep"
    RETURN = "return"
    LIFT = "lift"
    SOLVE = "solve"


S = State


class LatencyCalibration(Procedure):
    """Measures ``time_offset_s`` of a device."""

    name: ClassVar[str] = "latency-calibration"
    number: ClassVar[int] = 10
    Config = LatencyCalibrationConfig
    State = State
    TRANSITIONS: ClassVar[dict[Any, frozenset[Any]]] = {
        None: frozenset({S.PREPARE}),
        S.PREPARE: frozenset({S.APPROACH}),
        S.APPROACH: frozenset({S.SWEEP, S.SOLVE}),
        S.SWEEP: frozenset({S.RETURN, S.LIFT}),
        S.RETURN: frozenset({S.SWEEP, S.LIFT}),
        S.LIFT: frozenset({S.SOLVE}),
        S.SOLVE: frozenset(),
    }
    CHECKPOINTS: ClassVar[frozenset[Any]] = frozenset({S.APPROACH, S.SWEEP})

    config: LatencyCalibrationConfig

    def uses(self) -> tuple[str, ...]:
        return ("arm", self.config.source)

    def check(self, values: Mapping[str, Any]) -> None:
        reference_of(values)
        fastest, allowed = max(self.config.speeds_m_s), values["limits"]["speed_m_s"]
        if fastest > allowed:  # slowed down in silence, two speeds could become one
            raise error(
                "MOTION_LIMIT", f"speeds_m_s has {fastest:g} m/s, [limits] speed_m_s is {allowed:g} m/s"
            )

    def proposal(self, run: Run) -> Proposal | None:
        answer = (run.result or {}).get("result")
        if answer is None:
            return None
        device = run.inputs(self.config.source).name
        return Proposal(time_offset(device), answer["time_offset_s"], self.config.accept.auto)

    async def run(self, run: Run) -> None:
        beams = _Beams(self.config, run)
        await run.enter(S.PREPARE)
        await beams.check()
        async with run.motion() as lease:
            with suppress(FinishRequested):
                await beams.cross_all(lease)
            if run.state != S.APPROACH:  # a finish there finds the arm wherever it was
                await run.enter(S.LIFT)
                await lease.move_linear(beams.station.at(0.0, 0.0))
        await run.enter(S.SOLVE, f"{len(beams.record.passes)} ways")
        if not beams.record.passes:
            raise error("LASER_INCOMPLETE", "no pass was taken")
        path = await asyncio.to_thread(beams.write_data_set)
        run.result = await run.worker.call(solve_within_limits, path, self.config.accept.model_dump())
        if (answer := run.result["result"]) is not None:
            name = f"{self.config.source}.latency_s.{run.inputs(self.config.source).name}"
            trend = await run.cell.add_trend(name, answer["time_offset_s"])
            run.result["inputs"]["trend"] = {name: [list(point) for point in trend]}

    async def dry_run(self, run: Run) -> dict[str, Any]:
        """Every sweep that a measurement would take, with the guard's findings; nothing moves."""
        return await _Beams(self.config, run).measurement.plan()


class _Beams:
    """One beam, crossed out and back at every speed."""

    def __init__(self, config: LatencyCalibrationConfig, run: Run) -> None:
        self.config, self.run = config, run
        self.inputs = run.inputs(config.source)
        reference = reference_of(run.values)
        self.search = Search.from_reference(reference, run.values["laser_floor_m"])
        p_ref = [float(v) for v in reference["tool"]["p_ref"]]
        self.measurement = Measurement(run, self.search, 1, p_ref, 0.0, None)
        self.measurement.check_fixture()
        self.record = PassRecord(run.folder)
        self.scan = self.measurement.scan(self.record)
        self.course = self.scan.course
        self.station = next(s for s in self.course.stations if s.beam == config.beam)
        hit: Array = np.array(reference["hits"][config.beam])
        hit = hit + self.course.R_base_flange.apply(np.array(p_ref))
        down = float((self.course.tip(self.station.start) - hit) @ UP)
        self.depth = down + self.search.measure_depth_m  # where the tool is as thick as it gets
        index = self.inputs.names.index(self.search.beam(config.beam).input)
        self.beam = Beam(config.beam, index, self.station.across)

    async def check(self) -> None:
        """As before a measurement: free beams, and every sweep that it would take with a longer tool."""
        await self.scan.check_clear()
        await self.measurement.plan_and_note()

    async def cross_all(self, lease: MotionLease) -> None:
        run, config, station = self.run, self.config, self.station
        await run.enter(S.APPROACH, station.name)
        await leave_fixture(run, lease, self.course)
        await lease.move_joints(station.q)
        await self.scan.check_clear()
        near, far = station.at(0.0, self.depth), station.at(station.distance_m, self.depth)
        await lease.move_linear(near)
        sweeper = Sweeper(run.arm(), self.inputs, lease, run.clock)
        fastest = lease_settings(run.values)[2]
        total = len(config.speeds_m_s) * config.passes
        period = self._poll_period()
        for number in range(total):
            speed = _slower(fastest, config.speeds_m_s[number // config.passes])
            # The polls of the passes should fall differently on the edges.
            stagger = period * (number % config.passes) / config.passes
            await self._pair(sweeper, near, far, speed, stagger)
            run.progress(number + 1, total)

    async def _pair(
        self, sweeper: Sweeper, near: RigidTransform, far: RigidTransform, speed: Speed, stagger: float
    ) -> None:
        run = self.run
        for attempt in range(1, self.search.retries + 2):
            await run.clock.sleep(self.search.settle_s)
            await run.enter(S.SWEEP, f"{1e3 * speed.tcp_m_s:g} mm/s, attempt {attempt}")
            out = await sweeper.cross(self.beam, 1, far, speed, stagger)
            await run.clock.sleep(self.search.settle_s)
            await run.enter(S.RETURN)
            back = await sweeper.cross(self.beam, -1, near, speed, stagger)
            # Unlike in a measurement, out and back are meant to disagree: that is the delay.
            fault = fault_of(out, back, self.search.model_copy(update={"max_out_back_m": np.inf}))
            phase = f"{1e3 * speed.tcp_m_s:g} mm/s"
            await asyncio.to_thread(
                self.record.add, (out, back), phase, 0, None if fault is None else fault.text
            )
            if fault is None:
                return
            run.note("decision", event="pass refused", why=fault.text, attempt=attempt)
            last = fault.error(attempt)
        raise last

    def write_data_set(self) -> Path:
        """``latency.json`` of the usable passes."""
        data = {
            "schema": SCHEMA,
            "source": self.inputs.name,
            "applied_s": self.run.values["time_offset_s"][self.config.source]["applied"],
            "across": self.station.across.tolist(),
            "passes": self.record.passes,
        }
        path = self.run.folder / DATA_FILE
        write_atomic(path, to_json(data))
        return path

    def _poll_period(self) -> float:
        """What the last polls show; 0 when there are none yet."""
        now = self.run.clock.now()
        recent = [p.t for p in self.inputs.inputs.between(now - 0.5, now)]
        return float(np.median(np.diff(recent))) if len(recent) > 2 else 0.0


def solve_within_limits(path: Path, limits: Mapping[str, Any]) -> dict[str, Any]:
    """The result held against the limits of the job; for the worker process."""
    result = solve_latency(path)
    answer = result["result"]
    if answer is None:
        return result
    low, high = answer["interval95_s"]
    reasons = []
    if high - low > limits["max_interval_s"]:
        reasons.append(
            f"max_interval_s: the 95 % interval is {1e3 * (high - low):.2f} ms wide, the limit is "
            f"{1e3 * limits['max_interval_s']:g} ms; take more passes or poll faster"
        )
    if abs(answer["time_offset_s"]) > limits["max_offset_s"]:
        reasons.append(
            f"max_offset_s: the delay is {1e3 * answer['time_offset_s']:.1f} ms, the limit is "
            f"{1e3 * limits['max_offset_s']:g} ms"
        )
    return {**result, "verdict": "fail", "reasons": reasons} if reasons else result


def _slower(fastest: Speed, tcp_m_s: float) -> Speed:
    return replace(fastest, tcp_m_s=min(fastest.tcp_m_s, tcp_m_s))
