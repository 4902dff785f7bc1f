"""Beams as a source: the tool of a reference crosses one, and the delay shows between out and back."""

from dataclasses import replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from cell.motion import MotionLease
from cell.poses import Array
from cell.procedure import Run
from cell.run_values import RunValues
from procedures.arm_setup import lease_settings
from procedures.laser.config import Search
from procedures.laser.faults import fault_of
from procedures.laser.measurement import Measurement, reference_of
from procedures.laser.pairs import Pairs, beam_of, even_shares
from procedures.laser.path import UP
from procedures.laser.plan import note_plan, plan_crossings
from procedures.laser.record import PassRecord
from procedures.laser.scan import leave_fixture
from procedures.laser.sweep import Sweeper
from procedures.latency.config import LatencyCalibrationConfig
from procedures.latency.solver import BEAM_EDGES
from procedures.latency.to_and_fro import to_and_fro


class DelayedBeams:
    """One beam, crossed by the tool where it is as thick as it gets: a :class:`.DelayedDevice`."""

    role: ClassVar[str] = "beams"
    signal: ClassVar[str] = BEAM_EDGES

    def __init__(self, config: LatencyCalibrationConfig, run: Run) -> None:
        self.config, self.run = config, run
        self.inputs = run.inputs(self.role)
        reference = reference_of(run.values)
        self.search = Search.from_reference(reference, config.floor_m)
        p_ref = [float(v) for v in reference["tool"]["p_ref"]]
        self.measurement = Measurement(run, self.search, 1, p_ref, 0.0, None, np.inf)
        self.measurement.check_fixture()
        self.record = PassRecord(run.folder)
        self.scan = self.measurement.scan(self.record)
        self.course = self.scan.course
        self.station = next(s for s in self.course.stations if s.beam == config.beam)
        hit: Array = np.array(reference["hits"][config.beam])
        hit = hit + self.course.R_base_flange.apply(np.array(p_ref))
        down = float((self.course.tip(self.station.start) - hit) @ UP)
        self.depth = down + self.search.measure_depth_m
        self.beam = beam_of(self.search, config.beam, self.inputs.names)

    @staticmethod
    def uses() -> tuple[str, ...]:
        return ("arm", "beams")

    @staticmethod
    def refuse(config: LatencyCalibrationConfig, values: RunValues) -> None:
        """Without a reference the place of the beam is unknown."""
        reference_of(values)

    @property
    def device(self) -> str:
        return self.inputs.name

    def data(self) -> dict[str, Any]:
        """The passes, and the way out across the beam (3,), in the base."""
        return {"across": self.station.across.tolist(), "passes": self.record.passes}

    def amount(self) -> str:
        return f"{len(self.record.passes)} ways" if self.record.passes else ""

    async def plan(self) -> dict[str, Any]:
        """Every move, held against the guard with a longer tool; nothing moves."""
        times = len(self.config.speeds) * self.config.passes
        request = await self.measurement.request()
        return await self.run.worker.call(plan_crossings, request, self.config.beam, self.depth, times)

    async def check(self) -> None:
        """Both beams are free."""
        await self.scan.check_clear()

    async def take(self) -> None:
        """Crossed out and back; refused before anything moves when the guard forbids a move."""
        note_plan(self.run, await self.plan())
        await to_and_fro(self, self.config, self.run)

    async def approach(self, lease: MotionLease) -> None:
        """Beside the beam, as deep as it will be crossed."""
        await leave_fixture(self.run, lease, self.course)
        await lease.move_joints(self.station.q)
        if not self.station.taught:
            await lease.move_linear(self.station.start)
        await self.scan.check_clear()
        await lease.move_linear(self.station.at(0.0, self.depth))

    async def excite(self, lease: MotionLease, speed_m_s: float, number: int) -> None:
        """Across the beam and back; the polls of the passes fall differently on the edges."""
        run = self.run
        await run.clock.sleep(self.search.settle_s)
        fastest, period = lease_settings(run.values)[2], self._poll_period()
        out, back = even_shares(self.config.passes)[number]
        # Unlike in a measurement, out and back are meant to disagree: that is the delay.
        lenient = self.search.model_copy(update={"max_out_back_m": np.inf})
        pairs = Pairs(run, self.search, self.record, Sweeper(run.arm(), self.inputs, lease, run.clock))
        await pairs.take(
            self.station,
            self.beam,
            self.depth,
            (0.0, self.station.distance_m),
            replace(fastest, tcp_m_s=speed_m_s),
            partial(fault_of, search=lenient),
            f"{1e3 * speed_m_s:g} mm/s",
            (out * period, back * period),
        )

    async def leave(self, lease: MotionLease) -> None:
        """Straight up beside the beam."""
        await lease.move_linear(self.station.at(0.0, 0.0))

    def _poll_period(self) -> float:
        """What the last polls show; 0 when there are none yet."""
        now = self.run.clock.now()
        recent = [p.t for p in self.inputs.inputs.between(now - 0.5, now)]
        return float(np.median(np.diff(recent))) if len(recent) > 2 else 0.0
