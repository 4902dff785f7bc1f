"""Job ``cone-capture``: camera poses on cones around a board, and the hand-eye result.

For each placement of the board: find it, plan a cone with constant roll, then move, settle and take several
frames at each pose. Raw data are on disk before anything is solved.
"""

import asyncio
from collections.abc import Mapping, Sequence
from contextlib import suppress
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from cell.devices import Arm, BoardView, DepthCamera, Frame
from cell.errors import AbortError, CellError, RefusedError, error
from cell.motion import MotionLease
from cell.poses import Array, to_pose6
from cell.procedure import FinishRequested, Procedure, Proposal, Run
from cell.run_values import RunValues
from cell.standstill import measured_standstill
from procedures.arm_setup import arm_robot
from procedures.hand_eye.config import ConeCaptureConfig
from procedures.hand_eye.health import keep_trends
from procedures.hand_eye.judging import BoardSeen, fault_of, moved_since, repeats, shows_board
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
from procedures.hand_eye.solve.solver import solve_hand_eye
from procedures.hand_eye.verdict import error_so_far, judged, solve_within_limits
from procedures.hand_eye.words import so_far_text

STANDSTILL_TIMEOUT_S = 2.0
FIRST_FRAME_TIMEOUT_S = 5.0
LOST_IN_A_ROW = 3
SAME_PLACE_PX = 2.0


class State(StrEnum):
    """Where the job is."""

    PREPARE = "prepare"
    PLACE = "place"
    START_POSE = "start-pose"
    SEEK = "seek"
    SEARCH = "search"
    PLAN = "plan"
    MOVE = "move"
    SETTLE = "settle"
    CAPTURE = "capture"
    RETURN = "return"
    REFINE = "refine"
    SOLVE = "solve"


S = State


class ConeCapture(Procedure):
    """Hand-eye calibration, eye-in-hand or eye-to-hand."""

    name: ClassVar[str] = "cone-capture"
    number: ClassVar[int] = 1
    kind: ClassVar[str] = "hand-eye"
    Config = ConeCaptureConfig
    State = State
    TRANSITIONS: ClassVar[dict[Any, frozenset[Any]]] = {
        None: frozenset({S.PREPARE}),
        S.PREPARE: frozenset({S.PLACE, S.SOLVE}),
        S.PLACE: frozenset({S.START_POSE, S.SOLVE}),
        S.START_POSE: frozenset({S.SEEK}),
        S.SEEK: frozenset({S.SEARCH, S.PLAN, S.PLACE, S.SOLVE}),
        S.SEARCH: frozenset({S.MOVE, S.PLAN}),
        S.PLAN: frozenset({S.MOVE, S.RETURN}),
        S.MOVE: frozenset({S.SETTLE, S.MOVE, S.RETURN, S.SOLVE}),
        S.SETTLE: frozenset({S.CAPTURE}),
        S.CAPTURE: frozenset({S.SETTLE, S.MOVE, S.RETURN, S.SEARCH}),
        S.RETURN: frozenset({S.REFINE}),
        S.REFINE: frozenset({S.PLACE, S.SOLVE}),
        S.SOLVE: frozenset(),
    }
    CHECKPOINTS: ClassVar[frozenset[Any]] = frozenset({S.PLACE, S.SEEK, S.MOVE})

    config: ConeCaptureConfig

    def uses(self) -> tuple[str, ...]:
        return ("arm", self._camera_role)

    def check(self, values: RunValues) -> None:
        for key, known in (("target", values.targets), ("start_pose", values.poses)):
            name = getattr(self.config, key)
            if name is not None and name not in known:
                raise error("ARGUMENT_INVALID", f"{key} '{name}' is unknown; there is {', '.join(known)}")

    def proposal(self, run: Run) -> Proposal | None:
        answer = (run.result or {}).get("result")
        if answer is None:
            return None
        return Proposal(self._pose_name, answer[self._pose_name], self.config.accept.auto)

    @property
    def _pose_name(self) -> str:
        return "T_flange_camera" if self.config.setup == "eye-in-hand" else "T_base_camera"

    @property
    def _camera_role(self) -> str:
        return "flange_camera" if self.config.setup == "eye-in-hand" else "fixed_camera"

    async def run(self, run: Run) -> None:
        capture = _Capture(self.config, run, run.camera(self._camera_role))
        with suppress(FinishRequested):
            await capture.take_all()
        await capture.solve()
        await keep_trends(run, self.config.setup, self._pose_name)

    async def dry_run(self, run: Run) -> dict[str, Any]:
        """The plan from the board as it is seen now, with every check; nothing moves."""
        capture = _Capture(self.config, run, run.camera(self._camera_role))
        await capture.camera.set_target(capture.target)
        seen = await capture.seek()
        if capture.calibration is None:
            return {"note": "no nominal pose in [robot]: six small moves come first", "poses": []}
        plan = await capture.plan(seen, capture.calibration)
        return plan.as_dict()

    @classmethod
    def solve_again(cls, path: Path, info: Mapping[str, Any], recorded: Mapping[str, Any]) -> dict[str, Any]:
        again = solve_hand_eye(path, method=(recorded.get("inputs") or {}).get("method"), calls=1)
        limits = (info.get("job_config") or {}).get("accept")
        return judged(again, limits) if limits else again


class _Capture:
    """The data and the devices of one run, and the steps that work on them."""

    def __init__(self, config: ConeCaptureConfig, run: Run, camera: DepthCamera) -> None:
        self.config, self.run, self.camera = config, run, camera
        self.arm: Arm = run.arm()
        self.target = dict(run.values.targets[config.target])
        self.points = target_point_count(self.target)
        self.record = CaptureRecord(run.folder)
        self.calibration: dict[str, Any] | None = run.values.calibration[config.setup]
        self._start_q: Array | None = None
        self._seen_before: BoardView | None = None  # from where the arm stood before
        self._known = ""  # of the answer, by the placements so far

    async def take_all(self) -> None:
        run, config = self.run, self.config
        await run.enter(S.PREPARE)
        await run.take_step("prepare the camera", partial(self.camera.set_target, self.target))
        await self._begin_record()
        self._show_progress()
        interrupted = self.record.unfinished_placement()
        while (done := self._placements_done()) < config.placements:
            await run.enter(S.PLACE, f"placement {done + 1} of {config.placements}")
            group = self.record.next_group() if interrupted is None else interrupted
            if interrupted is None and group > 0:
                await run.ask(self._placement_text(done))
            await self._take_placement(group, resumed=interrupted is not None)
            interrupted = None

    def _placements_done(self) -> int:
        """Placements with enough poses; one that was cut short and could not go on does not count."""
        enough = self.config.min_poses_per_placement
        return sum(len(self.record.in_group(group)) >= enough for group in self.record.complete)

    def _show_progress(self) -> None:
        config = self.config
        self.run.progress(len(self.record.observations), config.placements * config.poses_per_placement)

    async def _take_placement(self, group: int, resumed: bool) -> None:
        run = self.run
        async with run.motion() as lease:
            start_q = await self._go_to_start(lease, self.record.placements.get(group))
            await run.enter(S.SEEK, f"looking for board '{self.config.target}'")
            seen = await run.take_step("look for the board", self.seek)
            if (
                resumed
                and (wander := moved_since(self.record.placements[group]["board"], seen.board))
                > SAME_PLACE_PX
            ):
                # Its finished poses stay, as a placement of their own if they are enough.
                run.note("decision", event="board moved since the interruption", group=group, pixels=wander)
                await asyncio.to_thread(self.record.complete_placement, group)
                return
            if (calibration := self.calibration) is None:
                calibration = self.calibration = await self._search(lease, seen)
                seen = await run.take_step("look for the board", self.seek)
            if not resumed:
                board = (await self._view(seen)).board()
                await asyncio.to_thread(self.record.begin_placement, group, start_q.tolist(), board)
            self._seen_before = seen.board
            await run.enter(S.PLAN)
            plan = await self.plan(seen, calibration, self.record.in_group(group))
            run.note("decision", event="plan", plan=plan.as_dict(), group=group)
            await self._take_poses(lease, group, plan)
            await run.enter(S.RETURN)
            await lease.move_joints(start_q)
        taken = len(self.record.in_group(group))
        if taken < self.config.min_poses_per_placement:
            raise error("CAPTURE_INCOMPLETE", f"placement {group + 1} has {taken} usable poses")
        await asyncio.to_thread(self.record.complete_placement, group)
        await run.enter(S.REFINE)
        await self._refine()
        await self._look_at_what_is_known()

    async def _take_poses(self, lease: MotionLease, group: int, plan: PlacementPlan) -> None:
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
                raise error("BOARD_NOT_SEEN", f"at {lost} poses in a row, last pose {pose.index + 1}")
            if taken:
                await self._keep(taken)

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
        return await self._take_pose(group, pose.index)

    async def _take_pose(self, group: int, pose_index: int) -> dict[str, Any] | None:
        """Settle and measure one pose, again where it fails; None when it had to be given up."""
        run, config = self.run, self.config
        why: str | None = None
        for attempt in range(config.retries_per_pose + 1):
            await run.enter(S.SETTLE, f"attempt {attempt + 1}")
            if not await measured_standstill(self.arm, STANDSTILL_TIMEOUT_S):
                raise error("POSE_UNSTABLE", f"the arm did not come to rest in {STANDSTILL_TIMEOUT_S} s")
            await run.clock.sleep(config.settle_s)
            await run.enter(S.CAPTURE)
            index = self.record.next_index()
            started = run.clock.now()
            frames = await self.camera.capture(
                config.frames_per_pose, run.folder / "images", f"{index:04d}-{attempt}", started
            )
            states = self.arm.state.between(started, frames[-1].t_exposure + frames[-1].exposure_s)
            if repeats(self._seen_before, frames):
                raise error("CAMERA_FAULT", f"{self.camera.name} repeats one picture while the arm moves")
            why = fault_of(frames, states, config)
            if why is None:
                usable = [f for f in frames if shows_board(f, config.min_corners)]
                entry = await asyncio.to_thread(
                    observation_entry, index, group, run.folder, usable, states, self.points
                )
                entry["planned"] = pose_index
                self._seen_before = usable[-1].board
                return entry
            run.note("decision", event="pose failed", pose=pose_index, attempt=attempt + 1, why=why)
        run.note("decision", event="pose skipped", pose=pose_index, why=why)
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
                if board is not None and shows_board(frame, self.config.min_corners):
                    return BoardSeen(board, frame.intrinsics)
            await self.run.clock.sleep(0.02)
        raise error(
            "BOARD_NOT_SEEN",
            f"'{self.config.target}' for {self.config.seek_timeout_s:g} s; at best {best} corners of the "
            f"{self.config.min_corners} that are needed",
        )

    async def plan(
        self, seen: BoardSeen, calibration: dict[str, Any], finished: Sequence[dict[str, Any]] = ()
    ) -> PlacementPlan:
        """Plan the placement's poses in the worker; poses already finished are left out."""
        request = PlanRequest(
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
        return await self.run.worker.call(plan_placement, request)

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

    def _placement_text(self, group: int) -> str:
        what = "Move the board" if self.config.setup == "eye-in-hand" else "Remount the board on the flange"
        return (
            f"Placement {group + 1} of {self.config.placements}: {what} to another place with another tilt, "
            "in view of the camera, then confirm."
            + (f" ({self._known[0].upper()}{self._known[1:]}.)" if self._known else "")
        )

    async def solve(self) -> None:
        """Write the data set, solve it in the worker, and leave the result to be proposed."""
        run = self.run
        await run.enter(S.SOLVE, f"{len(self.record.observations)} poses")
        if not self.record.observations:
            raise error("CAPTURE_INCOMPLETE", "no pose was finished")
        path = await asyncio.to_thread(self.record.write_data_set)
        run.note("solve", event="started", observations=len(self.record.observations))
        limits = self.config.accept.model_dump()
        run.result = await run.worker.call(solve_within_limits, path, limits)
