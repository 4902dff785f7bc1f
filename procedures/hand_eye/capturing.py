"""The steps of a capture: the board found and placed, the poses visited and measured, the answer solved."""

import asyncio
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from cell.devices import Arm, BoardView, DepthCamera, Frame
from cell.errors import AbortError, CellError, RefusedError, error
from cell.motion import MotionLease
from cell.poses import Array, to_pose6
from cell.procedure import Run
from cell.run_values import RunValues
from cell.standstill import measured_standstill
from procedures.arm_setup import arm_robot
from procedures.hand_eye.config import ConeCaptureConfig, corners_needed
from procedures.hand_eye.judging import BoardSeen, fault_of, moved_since, repeats, shows_board
from procedures.hand_eye.placing import Placement, likeness, placement_text
from procedures.hand_eye.plan import (
    BoardObservation,
    PlacementPlan,
    PlanRequest,
    Visit,
    plan_placement,
    plan_search,
    refine_calibration,
    target_point_count,
)
from procedures.hand_eye.record import CaptureRecord, camera_entry, observation_entry
from procedures.hand_eye.states import S
from procedures.hand_eye.verdict import error_so_far, solve_within_limits
from procedures.hand_eye.words import so_far_text

STANDSTILL_TIMEOUT_S = 2.0
FIRST_FRAME_TIMEOUT_S = 5.0
LOST_IN_A_ROW = 3
SAME_PLACE_PX = 2.0
# What an operator can put right at the board, and what is said of it round the error's own detail.
PROBLEMS = {
    "BOARD_NOT_SEEN": "the board was not seen ({}): put it in view of the camera, and see to the light",
    "PLAN_INFEASIBLE": "{}",
    "SOLVE_REFUSED": "the first look around told too little ({}): put the board nearer to the view's middle",
}
MOVE_IT = {
    "eye-in-hand": "move it to another place with another tilt",
    "eye-to-hand": "remount it on the flange at another place with another tilt",
}


@dataclass(frozen=True)
class _Found:
    """The board as seen, and the group of the data set that its poses belong to."""

    group: int
    seen: BoardSeen


def check_names(target: str, start_pose: str | None, values: RunValues) -> None:
    """``ARGUMENT_INVALID`` for a target or a pose that the cell does not have."""
    _check_name("target", target, values.targets)
    check_pose("start_pose", start_pose, values)


def check_pose(key: str, name: str | None, values: RunValues) -> None:
    """``ARGUMENT_INVALID`` for a pose that the cell does not have."""
    _check_name(key, name, values.poses)


def _check_name(key: str, name: str | None, known: Mapping[str, Any]) -> None:
    if name is not None and name not in known:
        raise error("ARGUMENT_INVALID", f"{key} '{name}' is unknown; there is {', '.join(known)}")


class CaptureRun:
    """The data and the devices of one run, and the steps that work on them."""

    def __init__(self, config: ConeCaptureConfig, run: Run, camera: DepthCamera) -> None:
        self.config, self.run, self.camera = config, run, camera
        self.arm: Arm = run.arm()
        self.target = dict(run.values.targets[config.target])
        self.points = target_point_count(self.target)
        self.min_corners = corners_needed(config.min_corners, self.points)
        self.record = CaptureRecord(run.folder)
        self.calibration: dict[str, Any] | None = run.values.calibration[config.setup]
        self._start_q: Array | None = None
        self._seen_before: BoardView | None = None  # from where the arm stood before
        self._known = ""  # of the answer, by the placements so far
        self._why_lost: str | None = None  # of the last pose that could not be used
        self._skipped = 0
        self._told_poor: int | None = None  # the placement whose poor place the operator knows of

    async def take_all(self) -> None:
        run, config = self.run, self.config
        await run.enter(S.PREPARE)
        await run.take_step("prepare the camera", partial(self.camera.set_target, self.target))
        await self._begin_record()
        self._show_progress()
        adopted, problem = self.record.unfinished_placement(), ""
        while (number := self._placements_done() + self._skipped) < config.placements:
            place = Placement.of(config, number)
            await run.enter(S.PLACE, problem or f"placement {number + 1} of {config.placements}")
            if adopted is None:
                text = placement_text(config, place, problem, self._known)
                if not await run.ask(text, skippable=True):
                    self._skipped, problem = self._skipped + 1, ""
                    continue
            problem = await self._take_placement(place, adopted)
            adopted = None

    def _placements_done(self) -> int:
        return len(self._done())

    def _done(self) -> set[int]:
        """Placements with enough poses; one that was cut short and could not go on does not count."""
        enough = self.config.min_poses_per_placement
        return {group for group in self.record.complete if len(self.record.in_group(group)) >= enough}

    def _show_progress(self) -> None:
        config = self.config
        self.run.progress(len(self.record.observations), config.placements * config.poses_per_placement)

    async def _take_placement(self, place: Placement, adopted: int | None) -> str:
        """Take the poses of one placement, where ``adopted`` those that an interrupted one lacks.

        Empty when all is well; else in words what kept poses from being taken, and what to do about it.
        """
        run, interrupted = self.run, None if adopted is None else self.record.placements[adopted]
        try:
            async with run.motion() as lease:
                start_q = await self._go_to_start(lease, interrupted)
                found = await self._find(lease, place, start_q, adopted is not None)
                if isinstance(found, str):
                    return found
                await run.enter(S.PLAN)
                plan = await self.plan(found.seen, self.calibration or {}, self.record.in_group(found.group))
                run.note("decision", event="plan", plan=plan.as_dict(), group=found.group)
                if plan.poor and self._told_poor != found.group:
                    self._told_poor = found.group
                    return f"{plan.poor}, or leave it there to take {len(plan.poses)} poses"
                problem = await self._take_poses(lease, found.group, plan)
                await run.enter(S.RETURN)
                await lease.move_joints(start_q)
        except CellError as exc:
            if exc.name not in PROBLEMS:
                raise
            run.note("decision", event="placement failed", why=str(exc))
            return PROBLEMS[exc.name].format(exc.detail)
        return await self._end_placement(found.group, problem)

    async def _end_placement(self, group: int, problem: str) -> str:
        """With enough poses it counts; else the board is asked for again."""
        taken, needed = len(self.record.in_group(group)), self.config.min_poses_per_placement
        if taken < needed:
            few = f"{taken} of {self.config.poses_per_placement} poses could be used, {needed} are needed"
            self.run.note("decision", event="placement failed", why=problem or few)
            return problem or f"{few}: see to light and view, or move the board"
        await asyncio.to_thread(self.record.complete_placement, group)
        await self.run.enter(S.REFINE)
        await self._refine()
        await self._look_at_what_is_known()
        return ""

    async def _find(
        self, lease: MotionLease, place: Placement, start_q: Array, adopted: bool
    ) -> "_Found | str":
        """The board, and the group that its poses belong to; or why it is to be placed anew."""
        run, record = self.run, self.record
        await run.enter(S.SEEK, f"looking for board '{self.config.target}'")
        seen = await run.take_step("look for the board", self.seek)
        begun = record.unfinished_placement()
        if begun is not None and not self._stands_as_in(begun, seen.board):
            # Its finished poses stay, as a placement of their own if they are enough.
            run.note("decision", event="board moved since its last pose", group=begun)
            await asyncio.to_thread(record.complete_placement, begun)
            begun = None
            if adopted:
                return "the board was moved since the interruption: put it where the next placement is to be"
        if self.calibration is None:
            self.calibration = await self._search(lease, seen)
            seen = await run.take_step("look for the board", self.seek)
        if begun is None:
            view = await self._view(seen)
            if (like := await self._like_an_earlier_one(view)) is not None:
                return f"{like}: {MOVE_IT[self.config.setup]}"
            begun = record.next_group()
            board = view.board()
            await asyncio.to_thread(record.begin_placement, begun, start_q.tolist(), board, place.base)
        self._seen_before = seen.board
        return _Found(begun, seen)

    def _stands_as_in(self, group: int, board: BoardView) -> bool:
        """Whether the board is seen where it was in a placement, with the arm where it was."""
        return moved_since(self.record.placements[group]["board"], board) <= SAME_PLACE_PX

    async def _like_an_earlier_one(self, view: BoardObservation) -> str | None:
        """In words, which finished placement the board has not moved since."""
        done = sorted(self._done())
        camera = self.record.header["camera"]
        before = {g: BoardObservation.of_board(self.record.placements[g]["board"], camera) for g in done}
        limits = (self.config.new_place_t_m, self.config.new_place_r_rad)
        calibration = self.calibration or {}
        like = await self.run.worker.call(
            likeness, self.config.setup, self.target, calibration, view, before, limits
        )
        if like is None:
            return None
        self.run.note(
            "decision", event="board not moved", group=like.group, moved_t_m=like.t, moved_r_rad=like.r
        )
        return like.text(done.index(like.group) + 1)

    async def _take_poses(self, lease: MotionLease, group: int, plan: PlacementPlan) -> str:
        """Visit the poses; why they were given up, where they were."""
        lost = 0
        for pose in plan.poses:
            taken = await self.run.take_step(
                f"pose {pose.index + 1} of placement {group + 1}",
                partial(self._visit, lease, group, pose),
            )
            if isinstance(taken, RefusedError):
                continue
            lost = 0 if taken else lost + 1
            if lost >= LOST_IN_A_ROW:
                return f"{lost} poses in a row could not be used, the last as {self._why_lost}: see to that"
            if taken:
                await self._keep(taken)
        return ""

    async def _visit(
        self, lease: MotionLease, group: int, pose: Visit
    ) -> dict[str, Any] | RefusedError | None:
        """Go to a pose and measure there: its observation, why the guard keeps the arm from it, or None when
        it failed."""
        run = self.run
        await run.enter(S.MOVE, f"pose {pose.index + 1} of placement {group + 1}", pose=pose.index)
        try:
            await lease.move_joints(np.array(pose.q))
        except RefusedError as refusal:
            if refusal.name not in ("MOTION_LIMIT", "MOTION_COLLISION", "MOTION_UNREACHABLE"):
                raise
            run.note("decision", event="pose skipped", pose=pose.index, why=str(refusal))
            return refusal
        return await self._take_pose(group, pose.index, self.record.next_index())

    async def _take_pose(self, group: int, pose_index: int, index: int) -> dict[str, Any] | None:
        """Settle and measure one pose, again where it fails; None when it had to be given up.

        ``index`` names its pictures.
        """
        run, config = self.run, self.config
        why: str | None = None
        for attempt in range(config.retries_per_pose + 1):
            await run.enter(S.SETTLE, f"attempt {attempt + 1}")
            if not await measured_standstill(self.arm, STANDSTILL_TIMEOUT_S):
                raise error("POSE_UNSTABLE", f"the arm did not come to rest in {STANDSTILL_TIMEOUT_S} s")
            await run.clock.sleep(config.settle_s)
            await run.enter(S.CAPTURE)
            started = run.clock.now()
            frames = await self.camera.capture(
                config.frames_per_pose, run.folder / "images", f"{index:04d}-{attempt}", started
            )
            states = self.arm.state.between(started, frames[-1].exposed_until)
            if repeats(self._seen_before, frames):
                raise error("CAMERA_FAULT", f"{self.camera.name} repeats one picture while the arm moves")
            why = fault_of(frames, states, config, self.min_corners)
            if why is None:
                usable = [f for f in frames if shows_board(f, self.min_corners)]
                entry = await asyncio.to_thread(
                    observation_entry, index, group, run.folder, usable, states, self.points
                )
                entry["planned"] = pose_index
                self._seen_before = usable[-1].board
                return entry
            run.note("decision", event="pose failed", pose=pose_index, attempt=attempt + 1, why=why)
        run.note("decision", event="pose skipped", pose=pose_index, why=why)
        self._why_lost = why
        return None

    async def _keep(self, entry: dict[str, Any]) -> None:
        """On disk only once the step is over: one that was touched by a silence is taken again."""
        await asyncio.to_thread(self.record.add_pose, entry)
        about = {"pose": entry["planned"], "index": entry["index"], "frames": len(entry["frames"])}
        self.run.note("decision", event="pose taken", **about)
        self._show_progress()

    async def seek(self) -> BoardSeen:
        """The board in a fresh frame, with the arm at rest; ``BOARD_NOT_SEEN`` after a time."""
        give_up = self.run.clock.now() + self.config.seek_timeout_s
        best = 0
        after = self.run.clock.now()
        while self.run.clock.now() < give_up:
            sample = self.camera.frames.last()
            if sample is not None and sample.t > after:
                frame, board = sample.value, sample.value.board
                best = max(best, 0 if board is None else len(board.ids))
                if board is not None and shows_board(frame, self.min_corners):
                    return BoardSeen(board, frame.intrinsics)
            await self.run.clock.sleep(0.02)
        raise error(
            "BOARD_NOT_SEEN",
            f"'{self.config.target}' for {self.config.seek_timeout_s:g} s; at best {best} corners of the "
            f"{self.min_corners} that are needed",
        )

    async def plan(
        self, seen: BoardSeen, calibration: dict[str, Any], finished: Sequence[dict[str, Any]] = ()
    ) -> PlacementPlan:
        """Plan the placement's poses in the worker; poses already finished are left out."""
        request = await self._plan_request(seen, calibration, finished)
        return await self.run.worker.call(plan_placement, request)

    async def _plan_request(
        self, seen: BoardSeen, calibration: dict[str, Any], finished: Sequence[dict[str, Any]]
    ) -> PlanRequest:
        return PlanRequest(
            setup=self.config.setup,
            values=self.run.values,
            target=self.target,
            calibration=calibration,
            view=await self._view(seen),
            poses=self.config.poses_per_placement,
            min_poses=self.config.min_poses_per_placement,
            cone_half_angle_rad=self.config.cone_half_angle_rad,
            distance_m=self.config.distance_m,
            second_distance_m=self.config.second_distance_m,
            finished=[int(o["planned"]) for o in finished],
            placements=self.config.placements,
        )

    async def _search(self, lease: MotionLease, seen: BoardSeen) -> dict[str, Any]:
        """Six small checked moves find a first X when no nominal one is configured."""
        run = self.run
        await run.enter(S.SEARCH, "no nominal pose is configured: six small moves find it")
        start, view = await run.arm_state(), await self._view(seen)
        moves = await run.worker.call(plan_search, run.values, view)
        views = [view]
        for i, q in enumerate(moves):
            await run.enter(S.MOVE, f"search move {i + 1} of {len(moves)}")
            await lease.move_joints(np.array(q))
            await run.enter(S.SETTLE)
            await run.clock.sleep(self.config.settle_s)
            await run.enter(S.CAPTURE)
            with suppress(AbortError):  # a search move may lose the board
                views.append(await self._view(await self.seek()))
        await run.enter(S.SEARCH, f"{len(views)} views")
        await lease.move_joints(start.q)
        found = await run.worker.call(refine_calibration, self.config.setup, self.target, views)
        run.note("decision", event="first estimate", **found)
        return found

    async def _refine(self) -> None:
        """A better X for the next placement's plan; the plan can live without it."""
        if self.calibration is None:
            return
        views = [
            BoardObservation.from_observation(o, self.record.header["camera"])
            for o in self.record.observations
            if o["group"] == self.record.observations[-1]["group"]
        ]
        try:
            self.calibration = await self.run.worker.call(
                refine_calibration, self.config.setup, self.target, views
            )
        except CellError as exc:
            self.run.note("decision", event="not refined", why=str(exc))
        else:
            self.run.note("decision", event="refined", **self.calibration)

    async def _look_at_what_is_known(self) -> None:
        """The 95 % errors so far, for journal and next question; after the last one comes the answer."""
        if self._placements_done() >= self.config.placements:
            return
        path = await asyncio.to_thread(self.record.write_data_set)
        try:
            error95 = await self.run.worker.call(error_so_far, path)
        except CellError as exc:
            self.run.note("decision", event="not known yet", why=str(exc))
            return
        if error95 is not None:
            self._known = so_far_text(error95)
            known = self.run.trace("known", ("placements", "error95_t_m", "limit_t_m"))
            known.add(self._placements_done(), error95["error95_t_m"], self.config.accept.max_error_t_m)
            self.run.note("decision", event="known so far", **error95)

    async def _go_to_start(self, lease: MotionLease, interrupted: Mapping[str, Any] | None) -> Array:
        """Where that is, (6,) rad: of the placement, of the config, or where the arm stood at first."""
        start_q = self._start_q
        if interrupted is not None:
            start_q = np.array(interrupted["start_q"])
        elif self.config.start_pose is not None:
            start_q = np.array(self.run.values.poses[self.config.start_pose])
        elif start_q is None:
            start_q = (await self.run.arm_state()).q
        self._start_q = start_q
        await self.run.enter(S.START_POSE)
        await lease.move_joints(start_q)
        return start_q

    async def _begin_record(self) -> None:
        frame = await self._any_frame()
        header: dict[str, Any] = {
            "setup": self.config.setup,
            "camera": camera_entry(frame.intrinsics, self.config.sigma_of_camera()),
            "target": self.target,
            "robot": arm_robot(self.run.values),
        }
        if (name := self.config.accept.task_pose) is not None:
            distance = self.config.accept.task_distance_m or self.config.distance_m
            header["task"] = {"q": list(self.run.values.poses[name]), "distance_m": distance}
        adopted = None
        if self.run.adopted is not None:
            adopted = await asyncio.to_thread(CaptureRecord.read, self.run.adopted)
            self.run.note("decision", event="adopted", poses=len(adopted.observations))
        await asyncio.to_thread(self.record.begin, header, adopted)

    async def _any_frame(self) -> Frame:
        """For the intrinsics only: what it shows may be old."""
        give_up = self.run.clock.now() + FIRST_FRAME_TIMEOUT_S
        while (sample := self.camera.frames.last()) is None:
            if self.run.clock.now() > give_up:
                raise error("CAMERA_FAULT", f"{self.camera.name}: no frame in {FIRST_FRAME_TIMEOUT_S:g} s")
            await self.run.clock.sleep(0.02)
        return sample.value

    async def _view(self, seen: BoardSeen) -> BoardObservation:
        state = await self.run.arm_state()
        return BoardObservation(
            q=[float(v) for v in state.q],
            T_base_flange=[float(v) for v in to_pose6(state.T_base_flange)],
            ids=[int(i) for i in seen.board.ids],
            corners=[[float(u), float(v)] for u, v in seen.board.corners],
            camera=camera_entry(seen.intrinsics, self.config.sigma_of_camera()),
        )

    async def solve(self) -> None:
        """Write the data set, solve it in the worker, and leave the result to be proposed."""
        run = self.run
        await run.enter(S.SOLVE, f"{len(self.record.observations)} poses")
        if not self.record.observations:
            raise error("CAPTURE_INCOMPLETE", "no pose was finished")
        path = await asyncio.to_thread(self.record.write_data_set)
        run.note("solve", event="started", observations=len(self.record.observations))
        run.result = await run.worker.call(solve_within_limits, path, self.config.accept)
