"""After the answer: the arm is driven to targets as given and corrected, and the camera sees what is off."""

import asyncio
import json
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import AsyncExitStack
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from calibration.planning import Volume
from cell.errors import RefusedError, error
from cell.formats.axbc import TARGETS_SCHEMA, How
from cell.motion import MotionLease
from cell.poses import to_pose6
from cell.procedure import FinishRequested
from cell.standstill import measured_standstill
from cell.store.files import write_atomic
from cell.where_left import STAYED_RAD
from procedures.eye_to_hand.config import EyeToHandCheckConfig
from procedures.eye_to_hand.result import AxbcResult
from procedures.eye_to_hand.targets import (
    Refusals,
    TargetMove,
    TargetsAsGiven,
    TargetView,
    commands_as_given,
    list_targets,
    near_joints,
    no_return,
    off_in_view,
    plan_moves,
    way_back,
)
from procedures.eye_to_hand.words import move_text, moves_text
from procedures.hand_eye.capturing import STANDSTILL_TIMEOUT_S, CaptureRun
from procedures.hand_eye.plan import BoardObservation, Visit
from procedures.hand_eye.states import S

TARGETS_FILE = "axbc-targets.json"
FINISHED, ENDED = "the run was finished early", "the run ended before"
BEFORE, BEGUN = "its place before the targets", "the place where the poses began"
# What the guard refuses before anything moves; any other refusal of a move ends the run.
_KEPT_FROM = ("MOTION_LIMIT", "MOTION_COLLISION", "MOTION_UNREACHABLE")
Keep = Callable[[Mapping[str, Any]], Awaitable[None]]  # ``driven`` of the data set, on disk
NEXT_STEP = "look whether its way from there is free before the next job, else jog it away"


@dataclass(frozen=True)
class _Refused:
    """Why the guard keeps the arm from a target from where it stands."""

    why: str


@dataclass(frozen=True)
class _Place:
    """Where the arm stood on its way, in words and by joints (6,) rad."""

    name: str
    q: list[float]


class TargetDrive(CaptureRun):
    """A capture that can drive to targets, which are poses of the flange in the camera."""

    check: EyeToHandCheckConfig
    given: list[float]  # T_base_camera
    _stood: list[_Place]  # on the way to the targets
    _bound_for: str  # by the last move that began; empty where none did
    _refused: Refusals  # targets that were put off

    async def ask_for_commands(self) -> Path:
        """The file of targets to solve with: each with joints that pick the branch of the arm."""
        check = self.check
        known = [[float(v) for v in o["q"]] for o in self.record.observations]
        near = await self.run.worker.call(near_joints, self.run.values, self.given, check.targets, known)
        path = self.run.folder / TARGETS_FILE
        asked = {"schema": TARGETS_SCHEMA, "targets": [list(t) for t in check.targets], "q_near": near}
        await asyncio.to_thread(write_atomic, path, json.dumps(asked, allow_nan=False))
        self._near = near
        return path

    async def list_targets(
        self, visits: Sequence[Visit], camera: Mapping[str, Any], volume: Volume
    ) -> list[dict[str, Any]]:
        """For a dry run each target as given, with joints on a way that was checked, or why it has none.

        ``visits`` are the poses that come before.
        """
        values, check = self.run.values, self.check
        q_now = await self._joints()
        start = q_now if check.start_pose is None else [float(v) for v in values.poses[check.start_pose]]
        known = [visit.q for visit in visits]
        view = TargetView(self.target, check.T_marker_flange, camera)
        of = TargetsAsGiven(self.given, check.targets, known, start, volume)
        return await self.run.worker.call(list_targets, values, view, of)

    async def drive(self, found: AxbcResult, camera: Mapping[str, Any], keep: Keep) -> dict[str, Any]:
        """Show the commands, and after a confirmation drive to each; the ``driven`` of the data set.

        ``keep`` gets it as it is at first, as planned, and after each target that was seen or lost, with
        what is still missing as lost: the run may end at any moment.
        """
        answer, check = found.result, self.check
        way = answer.correction.chosen
        given = [to_pose6(T).tolist() for T in commands_as_given(self.given, check.targets)]
        corrected = [None] * len(given) if way == "none" else answer.commands or [None] * len(given)
        driven: dict[str, Any] = {
            "way": way,
            "targets": [
                {"T_camera_flange": list(t), "given": g, "corrected": c}
                for t, g, c in zip(check.targets, given, corrected, strict=True)
            ],
            "arrivals": [],
            "lost": [],
        }
        if way != "none":
            driven["lost"] += [
                f"{move_text(k, 'corrected')}: out of the arm's reach"
                for k, command in enumerate(corrected)
                if command is None
            ]
        commands = _commands(given, corrected)
        wanted = [TargetMove(*command) for command in commands]
        if self.run.wants_finish:  # the arm is not asked for anything any more
            driven["lost"] += _unseen(wanted, FINISHED)
            return driven
        self._stood, self._bound_for, self._refused = [], "", Refusals()
        await self._keep_now(keep, driven, wanted)
        await self.run.enter(S.PLAN, "targets")
        home, moves = await self._planned(commands, camera)
        self.run.note("decision", event="targets", way=way, moves=[asdict(m) for m in moves])
        driven["lost"] += [f"{move_text(m.target, m.how)}: {m.why}" for m in moves if m.why]
        left = [m for m in moves if not m.why]
        await self._keep_now(keep, driven, left)  # with what the plan leaves out
        why = FINISHED
        try:
            asked = moves_text(found, driven, [(m.target, m.how) for m in left])
            if left and await self.run.ask(asked, skippable=True):
                why = await self._drive_all(left, driven, camera, home, keep)
            else:
                why = "skipped by the operator"
        except FinishRequested:
            self._tell_place(driven, FINISHED)
        driven["lost"] += _unseen(left, why, self._refused)
        return driven

    async def _keep_now(self, keep: Keep, driven: Mapping[str, Any], left: Sequence[TargetMove]) -> None:
        """Should the run end now, the moves ``left`` are lost."""
        await keep({**driven, "lost": [*driven["lost"], *_unseen(left, ENDED, self._refused)]})

    def _home(self, q_now: Sequence[float]) -> list[float]:
        """Where the capture began, (6,) rad: of this run, of the one that was taken over, or where the arm
        stands."""
        if self._start_q is not None:
            return [float(v) for v in self._start_q]
        begun = self.record.placements
        return [float(v) for v in begun[max(begun)]["start_q"]] if begun else list(q_now)

    async def _planned(
        self, commands: Sequence[tuple[int, How, list[float]]], camera: Mapping[str, Any]
    ) -> tuple[list[float], list[TargetMove]]:
        """Where the arm returns to, and the moves."""
        view = TargetView(self.target, self.check.T_marker_flange, camera)
        q_now = await self._joints()
        home = self._home(q_now)
        args = self.check.targets, commands, self._near, q_now, home
        return home, await self.run.worker.call(plan_moves, self.run.values, view, *args)

    async def _joints(self) -> list[float]:
        return [float(v) for v in (await self.run.arm_state()).q]

    async def _drive_all(
        self,
        left: list[TargetMove],
        driven: dict[str, Any],
        camera: Mapping[str, Any],
        home: list[float],
        keep: Keep,
    ) -> str:
        """Visit the moves ``left``, taking each out of it once it is done or lost; then return ``home``.

        One that is refused from where the arm stands is put off, and tried again from each place that it
        comes to, until none of those that were put off can be reached.
        Why those that are still left were not visited: the lease was refused.
        """
        run, first, moves = self.run, self.record.next_index(), len(left)
        self._stood = [_Place(BEFORE, await self._joints())]
        here: list[TargetMove] = []  # refused from where the arm stands now
        async with AsyncExitStack() as stack:
            try:
                lease = await stack.enter_async_context(run.motion())
            except RefusedError as refused:  # the arm never left, and what was found before stands
                run.note("decision", event="arm not lent", why=str(refused))
                return str(refused)
            while (move := next((m for m in left if m not in here), None)) is not None:
                number = moves - len(left)
                run.progress(number, moves)
                seen = await run.take_step(
                    move_text(move.target, move.how),
                    partial(self._see, lease, move, first + number, home),
                )
                about = {"target": move.target + 1, "how": move.how}
                if isinstance(seen, _Refused):
                    here.append(move)
                    self._refused.add(move, seen.why)
                    run.note("decision", event="target put off", why=seen.why, **about)
                    await self._keep_now(keep, driven, left)
                    continue
                here.clear()
                left.remove(move)
                if isinstance(seen, str):
                    self._lose(driven, move, seen)
                    await self._keep_now(keep, driven, left)
                    continue
                driven["arrivals"].append({"target": move.target, "how": move.how, "seen": seen})
                await self._keep_now(keep, driven, left)
                off_m = await self._show(move, seen, camera)
                run.note("decision", event="target seen", off_m=off_m, **about)
            if left:
                for move in left:
                    self._lose(driven, move, self._refused.why(move))
                left.clear()
                await self._keep_now(keep, driven, left)
            run.progress(moves, moves)
            await run.enter(S.RETURN)
            refusal = await self._return(lease, home)
            if not await measured_standstill(self.arm, STANDSTILL_TIMEOUT_S):
                raise error("POSE_UNSTABLE", f"the arm did not come to rest in {STANDSTILL_TIMEOUT_S} s")
        if refusal is not None:
            self._tell_place(driven, str(refusal))
        return ""

    def _lose(self, driven: dict[str, Any], move: TargetMove, why: str) -> None:
        driven["lost"].append(f"{move_text(move.target, move.how)}: {why}")
        about = {"target": move.target + 1, "how": move.how}
        self.run.note("decision", event="target lost", why=why, **about)

    async def _return(self, lease: MotionLease, home: list[float]) -> RefusedError | None:
        """Back ``home`` on a way that was checked; what keeps the arm from it where there is none."""
        stood = self._stood
        try:
            back = await self.run.worker.call(way_back, self.run.values, [at.q for at in stood], home)
        except RefusedError as refusal:
            return refusal
        for _ in range(back):
            if (refused := await self._move(lease, stood[-2])) is not None:
                return refused
            stood.pop()
        return await self._move(lease, _Place(BEGUN, home))

    async def _move(self, lease: MotionLease, place: _Place) -> RefusedError | None:
        """Go there; what keeps the arm from it where the guard refuses before anything moves. Any other
        refusal is raised: somebody took the arm."""
        before, self._bound_for = self._bound_for, place.name
        try:
            await lease.move_joints(np.array(place.q))
        except RefusedError as refusal:
            if refusal.name not in _KEPT_FROM:
                raise
            self._bound_for = before
            return refusal
        return None

    def _tell_place(self, driven: dict[str, Any], why: str) -> None:
        """Into ``driven`` where an arm that left was left, by its joints as measured, and what to do next."""
        if not self._bound_for:
            return
        last, newest = self._stood[-1], self.arm.state.last()
        off_rad = np.inf if newest is None else np.max(np.abs(newest.value.q - np.array(last.q)))
        place = f"at {last.name}" if off_rad <= STAYED_RAD else f"between {last.name} and {self._bound_for}"
        driven["stands"] = f"the arm stands {place}: {why}; {NEXT_STEP}"
        self.run.note("decision", event="arm not returned", why=driven["stands"])

    async def _show(self, move: TargetMove, seen: Mapping[str, Any], camera: Mapping[str, Any]) -> float:
        """How far off it looks in one frame, with the place as given (m): for whoever watches."""
        view = BoardObservation.from_observation(seen, camera)
        wanted = self.check.targets[move.target]
        off_m = await self.run.worker.call(off_in_view, view, self.target, self.check.T_marker_flange, wanted)
        rows = self.run.trace("targets", ("target", "corrected", "off_m"))
        rows.add(move.target + 1, float(move.how == "corrected"), off_m)
        return off_m

    async def _see(
        self, lease: MotionLease, move: TargetMove, index: int, home: Sequence[float]
    ) -> dict[str, Any] | _Refused | str:
        """What the camera saw with the arm at rest there, or why it could not be had."""
        place = _Place(move_text(move.target, move.how), move.q)
        await self.run.enter(S.MOVE, place.name, target=move.target + 1)
        if self._refused:  # the order is no longer the one that was planned
            stood = [at.q for at in self._stood]
            why = await self.run.worker.call(no_return, self.run.values, stood, move.q, home)
            if why is not None:
                return _Refused(why)
        if (refusal := await self._move(lease, place)) is not None:
            return _Refused(str(refusal))
        self._stood.append(place)
        taken = await self._take_pose(0, index, index)
        if taken is None:
            return self._why_lost or "it was not seen"
        return {k: v for k, v in taken.items() if k != "group"}


def _commands(
    given: Sequence[list[float]], corrected: Sequence[list[float] | None]
) -> list[tuple[int, How, list[float]]]:
    """Of each target as given and, where there is one, corrected: ``T_base_flange``."""
    out: list[tuple[int, How, list[float]]] = []
    for k, (one, other) in enumerate(zip(given, corrected, strict=True)):
        out.append((k, "given", one))
        if other is not None:
            out.append((k, "corrected", other))
    return out


def _unseen(moves: Sequence[TargetMove], why: str, refused: Refusals | None = None) -> list[str]:
    """What was not measured, in words; of those that were ``refused`` that is why."""
    return [
        f"{move_text(m.target, m.how)}: {refused.why(m) if refused and m in refused else why}" for m in moves
    ]
