"""One run: the board is looked at, and over each corner a person brings the tool's point where it belongs."""

import asyncio
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter
from scipy.spatial.transform import RigidTransform

from cell.devices import Arm, Frame, Speed, flange_poses
from cell.errors import CellError, error
from cell.formats.capture import Camera, TargetTable
from cell.motion import MotionLease
from cell.poses import Array, from_pose6, to_pose6
from cell.procedure import FinishRequested, Run
from cell.standstill import measured_standstill
from cell.store.files import to_json, write_atomic
from procedures.arm_setup import arm_robot, lease_settings
from procedures.hand_eye_in_use import HAND_EYE, arm_rms_m, found_size, require_hand_eye, solved_lens
from procedures.touch_test.config import TouchTestConfig
from procedures.touch_test.data import DATA_FILE, LookTaken, PointStood, PrintedSize, TouchData
from procedures.touch_test.judging import require_clearance
from procedures.touch_test.plan import CornerPlan, TouchPlan, plan_touch
from procedures.touch_test.states import State as S
from procedures.touch_test.words import corner_text
from procedures.words import mm

FEWEST_SEEN = 4  # points in all pictures of the look
STANDSTILL_TIMEOUT_S = 2.0
UNMOVED_M = 1e-4
STILL_S = 0.3  # over which the arm's place is averaged


class TouchRun:
    """The data and the devices of one run, and the steps that work on them."""

    def __init__(self, config: TouchTestConfig, run: Run) -> None:
        self.config, self.run = config, run
        self.arm: Arm = run.arm()
        self.camera = run.camera("flange_camera")
        values = run.values
        tool = from_pose6(values.tool["T_flange_tool"])
        reference = values.laser_reference
        self.data = TouchData(
            job=config,
            robot=arm_robot(values),
            arm_rms_m=arm_rms_m(values),
            target=TypeAdapter(TargetTable).validate_python(dict(values.targets[config.target])),
            T_flange_camera=_six(require_hand_eye(values)),
            hand_eye_cov=values.uncertainty[HAND_EYE]["cov"],
            tool=tool.translation.tolist(),
            tool_reference=None if reference is None else [float(v) for v in reference["tool"]["p_ref"]],
        )
        self._tool = tool
        self._slow = _slower(lease_settings(values)[2], config.speed_m_s)

    @property
    def path(self) -> Path:
        return self.run.folder / DATA_FILE

    async def plan_from_here(self) -> TouchPlan:
        """For the board as it is seen from where the arm stands."""
        await self.camera.set_target(self.data.spec)
        return await self._plan(await self._taken())

    async def take_all(self) -> None:
        """The look, and every corner; after a finish those that there were by then."""
        run = self.run
        await run.enter(S.PREPARE)
        await run.take_step("prepare the camera", partial(self.camera.set_target, self.data.spec))
        await run.enter(S.LOOK, f"from pose '{self.config.look_pose}'")
        async with run.motion() as lease:
            look = await run.take_step("look at the board", lambda: self._look(lease))
        await self._keep(look=look)
        await run.enter(S.PLAN)
        plan = await self._plan(look)
        run.note("decision", event="plan", plan=plan.listing)
        with suppress(FinishRequested):
            for k, corner in enumerate(plan.corners):
                run.progress(k, len(plan.corners))
                await self._take(k, corner, plan)
            run.progress(len(plan.corners), len(plan.corners))

    async def _plan(self, look: LookTaken) -> TouchPlan:
        q_now = [float(v) for v in (await self.run.arm_state()).q]
        worker = self.run.worker
        plan = await worker.call(plan_touch, self.run.values, self.config, look, q_now)
        there = [PointStood(corner=c.corner, q=c.q_above, T_base_flange=c.T_over) for c in plan.corners]
        await worker.call(require_clearance, self.data.model_copy(update={"look": look, "stood": there}))
        return plan

    # -- the look

    async def _look(self, lease: MotionLease) -> LookTaken:
        await lease.move_joints(np.array(self.run.values.poses[self.config.look_pose]))
        return await self._taken()

    async def _taken(self) -> LookTaken:
        """The board from where the arm stands, at rest; ``BOARD_NOT_SEEN`` or ``POSE_UNSTABLE``."""
        run, config = self.run, self.config
        if not await measured_standstill(self.arm, STANDSTILL_TIMEOUT_S):
            raise error("POSE_UNSTABLE", f"the arm did not come to rest in {STANDSTILL_TIMEOUT_S:g} s")
        await run.clock.sleep(config.settle_s)
        started = run.clock.now()
        frames = await self.camera.capture(config.frames, run.folder, "look", started)
        states = [s.value for s in self.arm.state.between(started, frames[-1].exposed_until)]
        if not states or not all(state.at_rest for state in states):
            raise error("POSE_UNSTABLE", "the arm moved while the board was looked at")
        ids, corners = _mean_corners(frames)
        if len(ids) < FEWEST_SEEN:
            text = f"{len(ids)} points of '{config.target}' show in all {len(frames)} pictures of the look"
            raise error("BOARD_NOT_SEEN", f"{text}; {FEWEST_SEEN} are needed")
        told = frames[0].intrinsics
        lens = solved_lens(run.values, HAND_EYE, told)
        size = found_size(run.values, HAND_EYE, config.target)
        return LookTaken(
            q=[float(v) for v in np.mean([state.q for state in states], axis=0)],
            T_base_flange=_six(flange_poses(states).mean()),
            ids=ids,
            corners=corners,
            frames=len(frames),
            camera=Camera.of(told),
            lens=None if lens is None else Camera.of(lens),
            printed=None if size is None else PrintedSize.model_validate(size),
        )

    # -- the corners

    async def _take(self, k: int, corner: CornerPlan, plan: TouchPlan) -> None:
        """One corner: there, as a person has it, and up again; also when the job is to end there."""
        run = self.run
        where = f"corner {k + 1} of {len(plan.corners)}"
        await run.enter(S.APPROACH, where)
        forced = await run.take_step(f"approach {where}", lambda: self._approach(k, corner), measures=False)
        await run.enter(S.TOUCH, where)
        ends = False
        try:
            stood = await self._stand(where, corner, forced)
        except FinishRequested:
            stood, ends = None, True
        if stood is not None:
            await self._keep(stood=[*self.data.stood, stood])
            run.note("decision", event="corner taken", corner=corner.corner, q=stood.q)
        elif not ends:
            await self._keep(skipped=[*self.data.skipped, corner.corner])
        await run.enter(S.LIFT, where)
        await run.released()  # no checkpoint: a finish shall lift the arm
        if run.wants_finish and self._not_ready():
            run.note("decision", event="not lifted", corner=corner.corner, why="the arm is in local mode")
            raise FinishRequested
        above = from_pose6([*plan.away, 0.0, 0.0, 0.0]) * (await run.arm_state()).T_base_flange
        await run.take_step(f"lift from {where}", lambda: self._lift(above), measures=False)
        if ends:
            raise FinishRequested

    async def _approach(self, k: int, corner: CornerPlan) -> bool:
        """Above the corner, and down to the stand-off, or until a force ends that: then True. The arm is
        nobody's when that is over."""
        config = self.config
        async with self.run.motion() as lease:
            if k:
                await lease.move_linear(from_pose6(corner.T_above))
            else:
                await lease.move_joints(np.array(corner.q_above))
            return await lease.guarded_move(
                from_pose6(corner.T_over), config.max_force_n, config.clear_m, self._slow
            )

    async def _lift(self, above: RigidTransform) -> None:
        async with self.run.motion() as lease:
            await lease.move_linear(above, self._slow)

    async def _stand(self, where: str, corner: CornerPlan, forced: bool) -> PointStood | None:
        """Where the arm rests once a person has confirmed that the point is where it belongs; None where that
        corner is to be left out. ``forced``: a force ended the way there."""
        run, why, met = self.run, "", None
        run.publish(corner=corner.corner)
        wanted = (from_pose6(corner.T_over) * self._tool).translation
        if forced:
            met = ((await run.arm_state()).T_base_flange * self._tool).translation
            why = (
                f"The tool met something, {self.config.max_force_n:g} N or more, "
                f"{mm(float(np.linalg.norm(met - wanted)), 1)} before it was there, and was stopped. "
            )
            run.note("decision", event="met something", corner=corner.corner, why=why.strip())
        while True:
            text = corner_text(where, self.config.target, corner.corner, self.config.stand_off_m)
            wants = await run.ask(f"{why}{text}", skippable=True)
            why = self._not_ready()
            if not why:
                if not wants:
                    return None
                stood = await run.take_step(f"read the arm at {where}", partial(self._rest, corner.corner))
                why = self._misses(stood, wanted, met)
                if stood is not None and not why:
                    return stood
            run.note("decision", event="asked again", corner=corner.corner, why=why.strip())
            await run.enter(S.TOUCH, why)

    def _not_ready(self) -> str:
        """Why the arm cannot go on yet, in words; empty when it can."""
        fault = self.arm.fault()
        if isinstance(fault, CellError) and fault.name == "ARM_LOCAL_MODE":
            return "The arm is still in local mode: give it back to remote control. "
        return ""

    def _misses(self, stood: PointStood | None, wanted: Array, met: Array | None) -> str:
        """Why that is not taken, in words; empty when it is. ``wanted``, and ``met`` where a force ended the
        way there, (3,) m in the base."""
        if stood is None:
            return "The arm still moved, so that was not taken. "
        point = (from_pose6(stood.T_base_flange) * self._tool).translation
        if met is not None and np.linalg.norm(point - met) < UNMOVED_M:
            return "The tool still stands where it met something. "
        away = float(np.linalg.norm(point - wanted))
        if away <= self.config.max_jog_m:
            return ""
        return f"The tool's point is {mm(away, 1)} from where the camera has this corner. "

    async def _rest(self, corner: int) -> PointStood | None:
        """The arm's place, averaged; None while it moves."""
        if not await measured_standstill(self.arm, STANDSTILL_TIMEOUT_S):
            return None
        await self.run.clock.sleep(STILL_S)
        now = self.run.clock.now()
        states = [s.value for s in self.arm.state.between(now - STILL_S, now)]
        if not states or not all(state.at_rest for state in states):
            return None
        q = np.mean([state.q for state in states], axis=0)
        return PointStood(
            corner=corner, q=[float(v) for v in q], T_base_flange=_six(flange_poses(states).mean())
        )

    async def _keep(self, **fields: Any) -> None:
        """On disk before the next step."""
        self.data = self.data.model_copy(update=fields)
        text = to_json(self.data.model_dump(mode="json", by_alias=True), indent=1) + "\n"
        await asyncio.to_thread(write_atomic, self.path, text)


def _mean_corners(frames: Sequence[Frame]) -> tuple[list[int], list[list[float]]]:
    """Points that all pictures show, and their mean pixels."""
    seen = [
        {} if f.board is None else dict(zip(f.board.ids.tolist(), f.board.corners, strict=True))
        for f in frames
    ]
    ids = sorted(set.intersection(*(set(board) for board in seen)))
    return ids, [np.mean([board[i] for board in seen], axis=0).tolist() for i in ids]


def _slower(speed: Speed, tcp_m_s: float) -> Speed:
    return replace(speed, tcp_m_s=min(tcp_m_s, speed.tcp_m_s))


def _six(T: RigidTransform) -> list[float]:
    return [float(v) for v in to_pose6(T)]
