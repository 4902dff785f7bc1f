"""One test from the first look to the last arrival."""

import asyncio
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from calibration.identification.registration import Registration, robust_register
from cell.devices import Speed
from cell.errors import CellError, error
from cell.laser_tracker import StablePoint
from cell.motion import MotionLease
from cell.poses import Array, from_pose6
from cell.procedure import FinishRequested, Run
from cell.samples import Sample
from cell.standstill import measured_standstill
from procedures.arm_setup import lease_settings
from procedures.iso9283.config import Iso9283Config
from procedures.iso9283.plan import (
    ORDER,
    IsoPlan,
    TestPose,
    is_corrected,
    kinematics_of,
    plan_iso,
    point_of,
    require_same_devices,
)
from procedures.iso9283.record import IsoRecord
from procedures.iso9283.states import State as S
from procedures.laser_tracker.aiming import AGAIN, LOST, Eye
from procedures.laser_tracker.locating import registration_of

LOST_IN_A_ROW = 5
PLACE_TRUST_M = 0.4  # of a reflector seen from where T_base_tracker_nominal has the tracker
STANDSTILL_TIMEOUT_S = 5.0
_FLAT_M = 0.02


class IsoRun:
    """The data and the devices of one run, and the steps that work on them."""

    def __init__(self, config: Iso9283Config, run: Run) -> None:
        self.config, self.run, self.arm = config, run, run.arm()
        self.eye, self.record = Eye(run, config), IsoRecord(run.folder)
        self.speed = speed_of(lease_settings(run.values)[2], config.speed_share)
        self.point = point_of(run.values, config)
        self.place: Registration | None = None
        if config.T_base_tracker_nominal is not None:
            self.place = registration_of(config.T_base_tracker_nominal)
        self.stations: dict[str, TestPose] = {}
        self._located = False
        self._in_a_row = 0

    async def plan(self) -> IsoPlan:
        """The plan as it would be now; nothing moves."""
        run = self.run
        values = replace(run.values, laser_reference=None)
        q_start = [float(v) for v in (await run.arm_state()).q]
        return await run.worker.call(plan_iso, values, self.config.model_dump(), q_start)

    async def take_all(self) -> None:
        """All arrivals; after a finish those that there were by then."""
        run, config = self.run, self.config
        await run.enter(S.PREPARE)
        serials = await run.take_step("ask who the devices are", self._serials)
        require_same_devices(kinematics_of(run.values, config), config, serials)
        await run.enter(S.PLAN)
        plan = await self.plan()
        run.note("decision", event="plan", plan=plan.listing)
        self.stations = {station.name: station for station in plan.stations}
        await asyncio.to_thread(self.write)
        before = [name for name in self.stations if name not in ORDER]
        route = [(name, 0) for name in before]
        route += [(name, cycle) for cycle in range(1, config.cycles + 1) for name in ORDER]
        with suppress(FinishRequested):
            if self.place is None:
                await run.ask(
                    f"Point the tracker at reflector {config.reflector} and let it lock, then leave the cell "
                    "and confirm; the arm moves then."
                )
            async with run.motion() as lease:
                for number, (name, cycle) in enumerate(route):
                    run.progress(number, len(route))
                    await self._arrive(lease, self.stations[name], cycle)
                run.progress(len(route), len(route))

    async def _serials(self) -> dict[str, str]:
        return {
            "arm": (await self.arm.identify()).serial,
            "tracker": (await self.eye.tracker.identify()).serial,
        }

    async def _arrive(self, lease: MotionLease, station: TestPose, cycle: int) -> None:
        """Go there, measure, and keep it; an arrival that cannot be measured is told and left out."""
        run = self.run
        text = f"pose {station.name}" + (f", cycle {cycle} of {self.config.cycles}" if cycle else "")
        await run.enter(S.NEXT, text)

        async def visit() -> Sample[StablePoint] | CellError:
            await run.enter(S.MOVE, text)
            await lease.move_joints(np.array(station.q), self.speed)
            return await self._measured(station)

        found = await run.take_step(text, visit)
        if isinstance(found, CellError):
            run.note("decision", event="arrival lost", pose=station.name, cycle=cycle, why=str(found))
            self._in_a_row += 1
            if self._in_a_row >= LOST_IN_A_ROW:
                raise found
            return
        self._in_a_row = 0
        point = found.value
        sample = {
            "pose": station.name,
            "cycle": cycle,
            "p_tracker": [float(v) for v in point.point],
            "t": found.t,
            "scatter_m": point.scatter_m,
            "count": point.count,
            "warnings": list(point.warnings),
            **point.kept_rotation(),
        }
        await asyncio.to_thread(self.record.add, sample)
        self._place_anew()

    async def _measured(self, station: TestPose) -> Sample[StablePoint] | CellError:
        """The point with the arm at rest; the reason of the last try when none was to be had."""
        run, config = self.run, self.config
        near = None if self.place is None else self.place.to_tracker(self._wanted(station)[:, None])[:, 0]
        for attempt in range(1, config.retries_per_pose + 2):
            await run.enter(S.SETTLE, f"attempt {attempt}")
            if not await measured_standstill(self.arm, STANDSTILL_TIMEOUT_S):
                raise error("POSE_UNSTABLE", f"the arm did not come to rest in {STANDSTILL_TIMEOUT_S:g} s")
            await run.clock.sleep(config.settle_s)
            await run.enter(S.MEASURE)
            try:
                surprise = config.max_surprise_m if self._located else PLACE_TRUST_M
                found = await self.eye.measure(config.reflector, near, surprise)
                self._check_rest(found)
                return found
            except CellError as exc:
                if exc.name not in AGAIN:
                    raise
                last = exc
                if exc.name in LOST and attempt <= config.retries_per_pose:
                    await run.enter(S.REACQUIRE, exc.detail)
                    await self.eye.find_again(near)
        return last

    def _check_rest(self, found: Sample[StablePoint]) -> None:
        states = self.arm.state.between(found.t - found.dt, found.t + found.dt)
        if not states or not all(s.value.at_rest for s in states):
            raise error("POSE_UNSTABLE", "the arm moved while its reflector was measured")

    def _wanted(self, station: TestPose) -> Array:
        """(3,): where the reflector should be, in the base."""
        out: Array = from_pose6(station.T_base_flange).apply(self.point)
        return out

    def _place_anew(self) -> None:
        """Every arrival tells where the tracker stands, once they are not all on a line."""
        f = np.array([self._wanted(self.stations[s["pose"]]) for s in self.record.samples])
        if len(f) < 3 or np.linalg.svd(f - f.mean(axis=0), compute_uv=False)[1] < _FLAT_M:
            return
        p = np.array([s["p_tracker"] for s in self.record.samples])
        self.place = robust_register(p.T, f.T, np.ones(len(f)))
        self._located = True

    def write(self) -> Path:
        """The data set; blocks on the disk."""
        config, values = self.config, self.run.values
        noise = self.eye.tracker.noise
        calibrated = kinematics_of(values, config)
        version = values.versions.get(f"kinematics.{self.arm.name}")
        header: dict[str, Any] = {
            "reflector": config.reflector,
            "point": self.point,
            "noise": {"sigma0": noise.sigma0_m, "sigma_per_m": noise.sigma_per_m},
            "payload_kg": float(values.payload_kg),
            "speed_share": config.speed_share,
            "corrected": is_corrected(values, config),
            "registration": config.registration,
            "kinematics": calibrated
            and {"version": version, "T_base_tracker": calibrated.get("T_base_tracker")},
            "cycles": config.cycles,
            "poses": [
                {"name": s.name, "T_base_flange": s.T_base_flange, "q": s.q} for s in self.stations.values()
            ],
        }
        return self.record.write_data_set(header)


def speed_of(speed: Speed, share: float) -> Speed:
    return replace(
        speed,
        tcp_m_s=share * speed.tcp_m_s,
        joint_rad_s=share * speed.joint_rad_s,
        each_joint_rad_s=tuple(share * v for v in speed.each_joint_rad_s),
    )
