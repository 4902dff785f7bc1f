"""One pose of a sampling: go there, rest, measure, and again where that fails; or give it up and say why."""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from cell.errors import CellError, error
from cell.laser_tracker import StablePoint
from cell.poses import Array
from cell.procedure import Run
from cell.samples import Sample
from procedures.laser_tracker.aiming import AGAIN, LOST, Eye
from procedures.tracker.arms import SampledArm
from procedures.tracker.config import TrackerSamplingConfig
from procedures.tracker.plan import Visit
from procedures.tracker.record import SampleRecord
from procedures.tracker.states import State as S
from procedures.tracker.tracker_pose import TrackerPose
from procedures.tracker.visit_order import blocked

SKIPPED = ("MOTION_LIMIT", "MOTION_COLLISION", "MOTION_UNREACHABLE", "OBSERVED_ARM_NOT_THERE")
Found = tuple[Array, Sample[StablePoint]]
"""Joints (j,) at which the arm rested, and the point that was seen meanwhile."""
Known = Callable[[], Sequence[Mapping[str, Any]]]


class Visitor:
    """Takes the arm from pose to pose; ``lost`` are those it had to give up, with the reasons.

    ``stored`` gives the poses of an earlier run that are solved with these.
    """

    def __init__(
        self,
        run: Run,
        config: TrackerSamplingConfig,
        arm: SampledArm,
        eye: Eye,
        place: TrackerPose,
        record: SampleRecord,
        stored: Known,
    ) -> None:
        self._run, self._config, self._arm, self._eye = run, config, arm, eye
        self._place, self._record, self._stored = place, record, stored
        self.hub: Array | None = None  # where ways meet that are not free directly
        self.lost: list[tuple[Visit, str]] = []

    async def measure_at(self, visit: Visit, surprise_m: float, text: str) -> Found | CellError:
        """Go there and measure, again where it fails; why the pose had to be given up.

        The reflector has to be seen within ``surprise_m`` of where it should be.
        """
        found = await self._run.take_step(text, lambda: self._visit(visit, surprise_m, text))
        if isinstance(found, CellError):  # told outside the step, which an interruption would repeat
            self.lost.append((visit, str(found)))
            self._run.note("decision", event="pose skipped", q=visit.q, why=str(found))
        return found

    async def _visit(self, visit: Visit, surprise_m: float, text: str) -> Found | CellError:
        """The arm there and what was measured, or why it could not be had in the end."""
        run = self._run
        await run.enter(S.NEXT, text)
        await run.enter(self._arm.travel, text)
        try:
            await self._arm.go(self._by_a_free_way(visit), text)
        except CellError as refusal:
            if refusal.name not in SKIPPED:
                raise
            return refusal
        for attempt in range(1, self._config.retries_per_pose + 2):
            await run.enter(S.SETTLE, f"attempt {attempt}")
            try:
                await self._arm.rest()
                await run.clock.sleep(self._config.settle_s)
                # An arm that is only observed may stand elsewhere than was asked.
                near = self._place.expected(self._arm.now(), visit.reflector)
                await run.enter(S.MEASURE)
                return await self._measure(visit, near, surprise_m)
            except CellError as failure:
                if failure.name in SKIPPED:
                    return failure
                if failure.name not in AGAIN or run.state is S.SETTLE:
                    raise
                run.note("decision", event="pose failed", q=visit.q, attempt=attempt, why=str(failure))
                last = failure
                if failure.name in LOST and attempt <= self._config.retries_per_pose:
                    await run.enter(S.REACQUIRE, failure.detail)
                    await self._eye.find_again(near)
        return last

    async def keep(self, visit: Visit, q: Array, found: Sample[StablePoint]) -> None:
        """Put a pose on disk; it tells of the tracker's place as well."""
        point, samples = found.value, self._record.samples
        sample = {
            "index": 1 + max((int(s["index"]) for s in samples), default=-1),
            "q": [float(v) for v in q],
            "p_tracker": [float(v) for v in point.point],
            "target": visit.reflector,
            "t": found.t,
            "scatter_m": point.scatter_m,
            **point.kept_rotation(),
            "held_out": visit.held_out,
            "asked_q": visit.q,
            "notes": {
                "readings": point.count,
                "window_s": point.window_s,
                "sigma_m": point.sigma_m,
                "temperature_c": point.temperature_c,
                "pressure_pa": point.pressure_pa,
                "warnings": list(point.warnings),
            },
        }
        await asyncio.to_thread(self._record.add_sample, sample)
        away = {"off_rad": _apart(q, visit.q)} if self.off_plan(q, visit.q) else {}
        self._run.note("decision", event="pose taken", index=sample["index"], **away)
        self._place.refine(samples)

    def off_plan(self, q: Array, asked: Sequence[float]) -> bool:
        """Whether joints (j,) are not those that were asked for."""
        return _apart(q, asked) > self._config.pose_tolerance_rad

    def _by_a_free_way(self, visit: Visit) -> Visit:
        """Ways are planned from pose to pose; one that was given up leaves the arm at another start.

        ``MOTION_COLLISION`` or ``MOTION_LIMIT`` when neither the direct way nor one by the hub is free.
        """
        here, check = self._arm.now(), self._place.space.check_way
        first = np.array((*visit.via, visit.q)[0])
        if blocked(here, first, check) is None:
            return visit
        hub = self.hub
        if hub is not None and not (blocked(here, hub, check) or blocked(hub, np.array(visit.q), check)):
            return replace(visit, via=[hub.tolist()])
        check(here, first)  # tells why it is not free
        return visit

    async def _measure(self, visit: Visit, near: Array | None, surprise_m: float) -> Found:
        """One try, the arm at rest all the while; one of ``AGAIN`` else."""
        found = await self._eye.measure(visit.reflector, near, surprise_m)
        Q = self._arm.joints(found.t - found.dt, found.t + found.dt)
        p = self._place.drawn_many(Q, visit.reflector)
        motion = float(np.max(np.linalg.norm(p - p.mean(axis=0), axis=1)))
        if motion > self._config.max_motion_m:
            raise error("POSE_UNSTABLE", f"the joints moved the reflector by {1e3 * motion:.3f} mm")
        q = Q.mean(axis=0)
        self._require_new(visit, q)
        return q, found

    def _require_new(self, visit: Visit, q: Array) -> None:
        """``OBSERVED_ARM_NOT_THERE`` where the arm was measured before and was not asked to be again.

        A reading set aside to judge the result must not be one of those that are solved.
        """
        if not self.off_plan(q, visit.q):
            return
        for sample in (*self._stored(), *self._record.samples):
            if sample["target"] == visit.reflector and not self.off_plan(q, sample["q"]):
                raise error(
                    "OBSERVED_ARM_NOT_THERE",
                    f"{self._arm.name} has not gone where it was asked to, "
                    "it stands where it was measured before",
                )


def _apart(q: Array, asked: Sequence[float]) -> float:
    return float(np.max(np.abs(q - np.array(asked))))
