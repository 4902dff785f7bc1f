"""One run: every target is asked for as given, then corrected, and where the arm rests is measured."""

import asyncio
from contextlib import suppress
from typing import Any

import numpy as np

from calibration.identification.application import chain_of
from cell.calibrations import kinematics
from cell.errors import CellError
from cell.formats.corrected_targets import How, PlannedTarget
from cell.poses import Array
from cell.procedure import FinishRequested, Run
from procedures.asked_arm import AskedArm
from procedures.corrected_targets.config import CorrectedTargetsConfig
from procedures.corrected_targets.plan import (
    calibrated_of,
    needs_joints,
    place_of,
    plan_targets,
    require_same_devices,
)
from procedures.corrected_targets.record import TargetRecord
from procedures.corrected_targets.states import State as S
from procedures.corrected_targets.words import command_text
from procedures.laser_tracker.aiming import AGAIN, LOST, Eye
from procedures.laser_tracker.locating import registration_of

LOST_IN_A_ROW = 3
_GIVEN_UP = ("OBSERVED_ARM_NOT_THERE",)
_DECIMALS = 4  # of degrees: micrometres at the flange
_REGISTERS = ("target_x_m", "target_y_m", "target_z_m", "target_yaw_rad")


class TargetsRun:
    """The data and the devices of one run, and the steps that work on them."""

    def __init__(self, config: CorrectedTargetsConfig, run: Run) -> None:
        self.config, self.run = config, run
        self.arm = AskedArm(run, config)
        self.eye = None if config.reflector is None else Eye(run, config)
        self.record = TargetRecord(run.folder)
        self._found = calibrated_of(run.values, config)
        self._point = place_of(self._found["robot"], config.reflector)
        self._chain = chain_of(self._found["robot"])
        self._stand = registration_of(self._found["T_base_tracker"])
        self._targets: list[PlannedTarget] = []
        self._in_a_row = 0

    async def plan(self) -> list[PlannedTarget]:
        """The targets as they would be asked for now; nothing is asked."""
        config = self.config
        q_now = [float(v) for v in self.arm.now()] if needs_joints(self.run.values, config) else []
        return await self.run.worker.call(plan_targets, self.run.values, config.model_dump(), q_now)

    async def take_all(self) -> None:
        """All targets; after a finish those that there were by then."""
        run, config = self.run, self.config
        await run.enter(S.PREPARE)
        require_same_devices(self._found, await run.take_step("ask who the devices are", self._serials))
        self._targets = await self.plan()
        run.note("decision", event="plan", targets=[t.model_dump() for t in self._targets])
        await asyncio.to_thread(self.record.begin, self._header())
        hows: tuple[How, ...] = ("given", "corrected") if config.as_given else ("corrected",)
        route = [(k, how) for how in hows for k in range(len(self._targets))]
        with suppress(FinishRequested):
            async with self.arm.session():
                for number, (k, how) in enumerate(route):
                    run.progress(number, len(route))
                    await self._take(k, how)
                run.progress(len(route), len(route))
                await run.enter(S.NEXT, "all targets were asked for")

    async def _serials(self) -> dict[str, str]:
        found = {"arm": (await self.run.observed_arm().identify()).serial}
        if self.eye is not None:
            found["tracker"] = (await self.eye.tracker.identify()).serial
        return found

    async def _take(self, k: int, how: How) -> None:
        """One target in one way: ask, measure, keep; one that cannot be had is told and left out."""
        target, run = self._targets[k], self.run
        command = target.command if how == "corrected" else self._as_given(k)
        told = "corrected" if how == "corrected" else "as given"
        text = f"target {k + 1} of {len(self._targets)}, {told} ({command_text(command)})"
        await run.enter(S.NEXT, text)
        found = await run.take_step(text, lambda: self._visit(k, how, command, text))
        if isinstance(found, CellError):
            run.note("decision", event="target lost", target=k + 1, how=how, why=str(found))
            self._in_a_row += 1
            if self._in_a_row >= LOST_IN_A_ROW:
                raise found
            return
        self._in_a_row = 0
        await asyncio.to_thread(self.record.add, {"target": k, "how": how, **found})
        run.note("decision", event="target taken", target=k + 1, how=how, q=found["q"])

    async def _visit(self, k: int, how: How, command: list[float], text: str) -> dict[str, Any] | CellError:
        """Where the arm rested, or why it could not be had in the end."""
        run, target = self.run, self._targets[k]
        await run.enter(S.REQUEST, text)
        if len(command) == len(_REGISTERS):
            run.publish(**dict(zip(_REGISTERS, command, strict=True)))
        try:
            q = target.given if how == "given" else target.corrected
            await self.arm.ask_for(np.array(q), text, _DECIMALS)
        except CellError as refusal:
            if refusal.name not in _GIVEN_UP:
                raise
            return refusal
        finally:
            run.publish(**dict.fromkeys(_REGISTERS, 0.0))
        for attempt in range(1, self.config.retries_per_target + 2):
            await run.enter(S.SETTLE, f"attempt {attempt}")
            await self.arm.rest()
            await run.clock.sleep(self.config.settle_s)
            await run.enter(S.MEASURE)
            near = self._expected(self.arm.now())
            try:
                return await self._measured(near)
            except CellError as failure:
                if failure.name not in AGAIN:
                    raise
                last = failure
                if (
                    self.eye is not None
                    and failure.name in LOST
                    and attempt <= self.config.retries_per_target
                ):
                    await run.enter(S.REACQUIRE, failure.detail)
                    await self.eye.find_again(near)
        return last

    async def _measured(self, near: Array) -> dict[str, Any]:
        """The joints while nothing moved, and the point that the tracker saw meanwhile."""
        clock, config = self.run.clock, self.config
        if self.eye is None or config.reflector is None:
            begin = clock.now()
            await clock.sleep(config.window_s)
            return {"q": self._mean(begin, clock.now()), "t": begin}
        found = await self.eye.measure(config.reflector, near, config.max_surprise_m)
        return {
            "q": self._mean(found.t - found.dt, found.t + found.dt),
            "p_tracker": [float(v) for v in found.value.point],
            "t": found.t,
            "scatter_m": found.value.scatter_m,
            "warnings": list(found.value.warnings),
        }

    def _mean(self, begin: float, end: float) -> list[float]:
        return [float(v) for v in self.arm.joints(begin, end).mean(axis=0)]

    def _expected(self, q: Array) -> Array:
        """(3,): where the tracker should see the reflector of the calibrated arm at ``q``."""
        T = self._chain.flange(q[None])[0]
        out: Array = self._stand.to_tracker((T[:3, :3] @ self._point + T[:3, 3])[:, None])[:, 0]
        return out

    def _as_given(self, k: int) -> list[float]:
        """The target itself, as it was configured."""
        return [float(v) for v in self.config.targets[k]]

    def _header(self) -> dict[str, Any]:
        config, found = self.config, self._found
        tracker = None if self.eye is None else self.eye.tracker
        return {
            "arm": self.arm.name,
            "robot": found["robot"],
            "kinematics_version": self.run.values.versions.get(kinematics(self.arm.name)),
            "predicted_95": found.get("predicted_95"),
            "joints_sampled_rad": found.get("joints_sampled_rad"),
            "payload_kg": found.get("payload_kg"),
            "reflector": config.reflector,
            "T_base_tracker": None if tracker is None else found["T_base_tracker"],
            "noise": tracker and {"sigma0": tracker.noise.sigma0_m, "sigma_per_m": tracker.noise.sigma_per_m},
            "as_given": config.as_given,
            "pose_tolerance_rad": config.pose_tolerance_rad,
            "targets": [t.model_dump() for t in self._targets],
        }
