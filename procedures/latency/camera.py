"""A camera as a source: the arm carries it past a target, or the target past it, to and fro."""

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import asdict, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from calibration.latency.pictures import FEWEST_POINTS
from calibration.targets import make_target
from cell.devices import Arm, ArmState, DepthCamera, Frame, Speed, flange_poses
from cell.errors import error
from cell.motion import MotionLease
from cell.poses import to_pose6
from cell.procedure import Run
from cell.run_values import RunValues
from cell.samples import Sample
from cell.store.files import append_lines
from procedures.arm_setup import lease_settings
from procedures.belt.camera_to_belt import NAME as T_BASE_CAMERA
from procedures.hand_eye_in_use import HAND_EYE, solved_lens
from procedures.latency.camera_way import WayRequest, ends_of, plan_way
from procedures.latency.config import LatencyCalibrationConfig
from procedures.latency.solver import TARGET_IN_PICTURES
from procedures.latency.states import S
from procedures.latency.to_and_fro import to_and_fro

PASSES_FILE = "passes.jsonl"
SEEN_WITHIN_S = 5.0
LOOK_S = 0.05
POSES_OF_SETUP = {"eye-in-hand": HAND_EYE, "eye-to-hand": T_BASE_CAMERA}
PLACES_OF_SETUP = {
    "eye-in-hand": "T_flange_camera_nominal",
    "eye-to-hand": "T_base_camera_nominal",
}


class _DelayedCamera:
    """A :class:`.DelayedDevice`: the target is seen while the arm goes along the picture's rows."""

    role: ClassVar[str]
    setup: ClassVar[str]
    signal: ClassVar[str] = TARGET_IN_PICTURES

    def __init__(self, config: LatencyCalibrationConfig, run: Run) -> None:
        self.config, self.run = config, run
        self.camera = run.device(self.role, DepthCamera)  # its own stamps
        self.arm: Arm = run.arm()
        self.target = dict(run.values.targets[config.target or ""])
        self.X = [float(v) for v in (run.values.calibration[self.setup] or {})["X"]]
        self.passes: list[dict[str, Any]] = []
        self._q: list[float] | None = None  # in the middle of the way
        self._lens: dict[str, Any] | None = None  # that of the pose X; the camera's own where X has none

    @classmethod
    def uses(cls) -> tuple[str, ...]:
        return ("arm", cls.role)

    @classmethod
    def refuse(cls, config: LatencyCalibrationConfig, values: RunValues) -> None:
        """Without a target whose points are numbered, a pose that exists, and the camera's place."""
        if (target := values.targets.get(config.target or "")) is None:
            known = ", ".join(values.targets) or "none"
            raise error("ARGUMENT_INVALID", f"target '{config.target}' is unknown; there is {known}")
        if len(make_target(target).symmetries) > 1:
            raise error(
                "ARGUMENT_INVALID",
                f"target '{config.target}' looks the same when it is turned, so its points have no numbers; "
                "take a ChArUco board or a marker",
            )
        if config.pose is not None and config.pose not in values.poses:
            known = ", ".join(values.poses) or "none"
            raise error("ARGUMENT_INVALID", f"pose '{config.pose}' is unknown; there is {known}")
        if "X" not in (values.calibration.get(cls.setup) or {}):
            raise error(
                "ARGUMENT_INVALID",
                f"where the camera is is unknown: give [robot] {PLACES_OF_SETUP[cls.setup]}",
            )

    @property
    def device(self) -> str:
        return self.camera.name

    def data(self) -> dict[str, Any]:
        """The ways with their pictures, the lens, the target, and what is known of the camera's pose."""
        return {
            "setup": self.setup,
            "X": self.X,
            "target": self.target,
            "camera": self._lens,
            "passes": self.passes,
        }

    def amount(self) -> str:
        pictures = sum(len(way["frames"]) for way in self.passes)
        return f"{len(self.passes)} ways with {pictures} pictures" if self.passes else ""

    async def plan(self) -> dict[str, Any]:
        """Every move, held against the guard; nothing moves."""
        return await self.run.worker.call(plan_way, await self._request())

    async def check(self) -> None:
        """The camera looks for the target, and its pictures come."""
        await self.run.take_step("prepare the camera", partial(self.camera.set_target, self.target))
        await self.camera.wait_fresh(SEEN_WITHIN_S)

    async def take(self) -> None:
        """To and fro; refused before anything moves when the guard forbids a move."""
        plan = await self.plan()
        self.run.note("decision", event="plan", plan=plan)
        if plan["problems"]:
            raise error("LATENCY_WAY_REFUSED", plan["problems"][0])
        await to_and_fro(self, self.config, self.run)

    async def approach(self, lease: MotionLease) -> None:
        """To the middle of the way, where the target has to be seen, and to its begin."""
        _, begin, _ = ends_of(await self._request())
        await lease.move_joints(np.array(self._q))
        await self._see_target()
        await lease.move_linear(begin, self._speed(max(self.config.speeds)))

    async def excite(self, lease: MotionLease, speed_m_s: float, number: int) -> None:
        """Out and back, with pictures of both ways."""
        run, (_, begin, end) = self.run, ends_of(await self._request())
        speed = self._speed(speed_m_s)
        pair, begun = len(self.passes) // 2, False

        async def work() -> list[dict[str, Any]]:
            nonlocal begun
            if begun:  # an interruption left the arm somewhere on the way
                await lease.move_linear(begin, speed)
            begun = True
            ways = []
            for direction, to, state in ((1, end, S.SWEEP), (-1, begin, S.RETURN)):
                await run.enter(state, f"{1e3 * speed_m_s:g} mm/s, {number + 1}")
                about = {"pair": pair, "dir": direction, "speed": speed_m_s}
                ways.append(about | await self._recorded(partial(lease.move_linear, to, speed)))
            return ways

        ways = await run.take_step(f"pass {number + 1} at {1e3 * speed_m_s:g} mm/s", work)
        await asyncio.to_thread(append_lines, run.folder / PASSES_FILE, ways)
        self.passes += ways

    async def leave(self, lease: MotionLease) -> None:
        """Back to the middle of the way."""
        middle, _, _ = ends_of(await self._request())
        await lease.move_linear(middle, self._speed(max(self.config.speeds)))

    def _speed(self, speed_m_s: float) -> Speed:
        return replace(lease_settings(self.run.values)[2], tcp_m_s=speed_m_s)

    async def _request(self) -> WayRequest:
        config, values = self.config, self.run.values
        here = (await self.run.arm_state()).q.tolist()
        if self._q is None:
            self._q = here if config.pose is None else [float(v) for v in values.poses[config.pose]]
        way = config.way_m, config.speeds, config.passes
        return WayRequest(values, here, self._q, *way, self.setup, self.X)

    async def _see_target(self) -> None:
        """``BOARD_NOT_SEEN`` when no picture shows enough of it."""
        clock = self.run.clock
        since = clock.now()
        while clock.now() < since + SEEN_WITHIN_S:
            sample = self.camera.frames.last()
            if sample is not None and sample.t > since:
                board = sample.value.board
                if board is not None and len(board.ids) >= FEWEST_POINTS:
                    told, name = sample.value.intrinsics, POSES_OF_SETUP[self.setup]
                    self._lens = asdict(solved_lens(self.run.values, name, told) or told)
                    return
            await clock.sleep(LOOK_S)
        raise error(
            "BOARD_NOT_SEEN",
            f"{self.camera.name} does not see target '{self.config.target}' in the middle of the way",
        )

    async def _recorded(self, move: Callable[[], Awaitable[None]]) -> dict[str, Any]:
        """What both streams give while the arm moves, and at rest before and after."""
        states: list[Sample[ArmState]] = []
        frames: list[Sample[Frame]] = []
        rest_s = self.config.settle_s
        ends = [self.arm.state.subscribe(states.append), self.camera.frames.subscribe(frames.append)]
        try:
            await self.run.clock.sleep(rest_s)
            await move()
            await self.run.clock.sleep(rest_s)
            await self.camera.wait_fresh(SEEN_WITHIN_S)  # the last picture of the way is here then
        finally:
            for end in ends:
                end()
        return await asyncio.to_thread(way_entry, states, frames)


class FlangeCamera(_DelayedCamera):
    """The arm carries the camera past a target that stands in the cell."""

    role: ClassVar[str] = "flange_camera"
    setup: ClassVar[str] = "eye-in-hand"


class FixedCamera(_DelayedCamera):
    """The arm carries the target past the camera."""

    role: ClassVar[str] = "fixed_camera"
    setup: ClassVar[str] = "eye-to-hand"


def way_entry(states: list[Sample[ArmState]], frames: list[Sample[Frame]]) -> dict[str, Any]:
    """One way in the data set: the flange in the base by the arm's stamps, and what the pictures show."""
    flange = to_pose6(flange_poses([s.value for s in states]))
    return {
        "pose_t": [round(s.t, 7) for s in states],
        "pose": np.round(flange, 8).tolist(),
        "frames": [
            {
                "t": round(frame.t_exposure, 7),
                "row_time_s": frame.row_time_s,
                "ids": frame.board.ids.tolist(),
                "corners": np.round(frame.board.corners, 4).tolist(),
            }
            for frame in (s.value for s in frames)
            if frame.board is not None and len(frame.board.ids) >= FEWEST_POINTS
        ],
    }
