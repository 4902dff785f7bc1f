"""After the answer: the arm is driven to targets as given and corrected, and the camera sees what is off."""

import asyncio
import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from cell.errors import RefusedError, error
from cell.formats.axbc import TARGETS_SCHEMA, How
from cell.motion import MotionLease
from cell.poses import to_pose6
from cell.procedure import FinishRequested
from cell.standstill import measured_standstill
from cell.store.files import write_atomic
from procedures.eye_to_hand.config import EyeToHandCheckConfig
from procedures.eye_to_hand.result import AxbcAnswer
from procedures.eye_to_hand.targets import (
    TargetMove,
    TargetView,
    commands_as_given,
    near_joints,
    off_in_view,
    plan_moves,
)
from procedures.eye_to_hand.words import move_text, moves_text
from procedures.hand_eye.capturing import STANDSTILL_TIMEOUT_S, CaptureRun
from procedures.hand_eye.plan import BoardObservation
from procedures.hand_eye.states import S

TARGETS_FILE = "axbc-targets.json"
_KEPT_FROM = ("MOTION_LIMIT", "MOTION_COLLISION", "MOTION_UNREACHABLE")


class TargetDrive(CaptureRun):
    """A capture that can drive to targets, which are poses of the flange in the camera."""

    check: EyeToHandCheckConfig
    given: list[float]  # T_base_camera

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

    async def drive(self, answer: AxbcAnswer, camera: Mapping[str, Any]) -> dict[str, Any]:
        """Show the commands, and after a confirmation drive to each; the ``driven`` of the data set."""
        check, way = self.check, answer.correction.chosen
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
        await self.run.enter(S.PLAN, "targets")
        moves = await self._planned(given, corrected, camera)
        self.run.note("decision", event="targets", way=way, moves=[asdict(m) for m in moves])
        driven["lost"] += [f"{move_text(m.target, m.how)}: {m.why}" for m in moves if m.why]
        left = [m for m in moves if not m.why]
        why = "the run was finished early"
        with suppress(FinishRequested):
            if left and await self.run.ask(moves_text(way, driven, len(left)), skippable=True):
                await self._drive_all(left, driven, camera)
            else:
                why = "skipped by the operator"
        driven["lost"] += [f"{move_text(m.target, m.how)}: {why}" for m in left]
        return driven

    async def _planned(
        self, given: Sequence[list[float]], corrected: Sequence[list[float] | None], camera: Mapping[str, Any]
    ) -> list[TargetMove]:
        commands: list[tuple[int, How, list[float]]] = []
        for k, (one, other) in enumerate(zip(given, corrected, strict=True)):
            commands.append((k, "given", one))
            if other is not None:
                commands.append((k, "corrected", other))
        view = TargetView(self.target, self.check.T_marker_flange, camera)
        q_now = [float(v) for v in (await self.run.arm_state()).q]
        return await self.run.worker.call(
            plan_moves, self.run.values, view, self.check.targets, commands, self._near, q_now
        )

    async def _drive_all(
        self, left: list[TargetMove], driven: dict[str, Any], camera: Mapping[str, Any]
    ) -> None:
        """Visit the moves ``left``, taking each out of it once it is done or lost; then return."""
        run, first, moves = self.run, self.record.next_index(), len(left)
        async with run.motion() as lease:
            while left:
                move, number = left[0], moves - len(left)
                run.progress(number, moves)
                seen = await run.take_step(
                    move_text(move.target, move.how), partial(self._see, lease, move, first + number)
                )
                del left[0]
                about = {"target": move.target + 1, "how": move.how}
                if isinstance(seen, str):
                    driven["lost"].append(f"{move_text(move.target, move.how)}: {seen}")
                    run.note("decision", event="target lost", why=seen, **about)
                    continue
                driven["arrivals"].append({"target": move.target, "how": move.how, "seen": seen})
                off_m = await self._show(move, seen, camera)
                run.note("decision", event="target seen", off_m=off_m, **about)
            run.progress(moves, moves)
            await run.enter(S.RETURN)
            if self._start_q is not None:
                await lease.move_joints(self._start_q)
            if not await measured_standstill(self.arm, STANDSTILL_TIMEOUT_S):
                raise error("POSE_UNSTABLE", f"the arm did not come to rest in {STANDSTILL_TIMEOUT_S} s")

    async def _show(self, move: TargetMove, seen: Mapping[str, Any], camera: Mapping[str, Any]) -> float:
        """How far off it looks in one frame, with the place as given (m): for whoever watches."""
        view = BoardObservation.from_observation(seen, camera)
        wanted = self.check.targets[move.target]
        off_m = await self.run.worker.call(off_in_view, view, self.target, self.check.T_marker_flange, wanted)
        rows = self.run.trace("targets", ("target", "corrected", "off_m"))
        rows.add(move.target + 1, float(move.how == "corrected"), off_m)
        return off_m

    async def _see(self, lease: MotionLease, move: TargetMove, index: int) -> dict[str, Any] | str:
        """What the camera saw with the arm at rest there, or why it could not be had."""
        await self.run.enter(S.MOVE, move_text(move.target, move.how), target=move.target + 1)
        try:
            await lease.move_joints(np.array(move.q))
        except RefusedError as refusal:
            if refusal.name not in _KEPT_FROM:
                raise
            return str(refusal)
        taken = await self._take_pose(0, index, index)
        if taken is None:
            return self._why_lost or "it was not seen"
        return {k: v for k, v in taken.items() if k != "group"}
