"""Job ``eye-to-hand-check``: a fixed camera judged by a target at a known place on the flange.

The target is found, poses over the camera's volume are planned and checked, and each is visited and measured
by the steps of a capture. Raw data are on disk before anything is solved.
"""

import asyncio
import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar

from cell.calibrations import kinematics
from cell.errors import error
from cell.formats.capture import Camera
from cell.formats.result import Envelope
from cell.poses import from_pose6, to_pose6
from cell.procedure import FinishRequested, Procedure, Proposal, Run
from cell.run_values import RunValues
from cell.store.files import write_atomic
from procedures.eye_to_hand.config import EyeToHandCheckConfig
from procedures.eye_to_hand.driving import TargetDrive
from procedures.eye_to_hand.plan import VolumeRequest, plan_volume
from procedures.eye_to_hand.result import AxbcAnswer, AxbcResult
from procedures.eye_to_hand.solve.data import FILE_NAME
from procedures.eye_to_hand.solve.solver import solve_axbc
from procedures.hand_eye.capturing import check_names
from procedures.hand_eye.judging import BoardSeen
from procedures.hand_eye.plan import PlacementPlan
from procedures.hand_eye.record import camera_entry
from procedures.hand_eye.states import TRANSITIONS, S, State
from procedures.hand_eye_in_use import solved_lens, solved_lens_sigma

CAMERA, SETUP, HAND_EYE = "fixed_camera", "eye-to-hand", "T_base_camera"


class EyeToHandCheck(Procedure):
    """A given hand-eye of a fixed camera, against a target at a known place on the flange."""

    name: ClassVar[str] = "eye-to-hand-check"
    number: ClassVar[int] = 8
    kind: ClassVar[str] = "axbc"
    Config = EyeToHandCheckConfig
    State = State
    TRANSITIONS: ClassVar[dict[Any, frozenset[Any]]] = TRANSITIONS | {
        S.PLACE: frozenset({S.START_POSE, S.SOLVE}),  # there is one placement
        S.REFINE: frozenset({S.SOLVE}),
        S.SOLVE: frozenset({None, S.PLAN}),  # it ends, or plans the ways to targets
        S.PLAN: TRANSITIONS[S.PLAN] | {S.SOLVE},
        S.RETURN: TRANSITIONS[S.RETURN] | {S.SOLVE},
    }
    CHECKPOINTS: ClassVar[frozenset[Any]] = frozenset({S.PLACE, S.SEEK, S.MOVE})

    config: EyeToHandCheckConfig

    def uses(self) -> tuple[str, ...]:
        return ("arm", CAMERA)

    def check(self, values: RunValues) -> None:
        check_names(self.config.target, self.config.start_pose, values)

    def pictures(self) -> tuple[str, int]:
        arrivals = self.config.poses + 2 * len(self.config.targets)  # each target as given and corrected
        return CAMERA, arrivals * self.config.frames_per_pose

    def proposal(self, run: Run) -> Proposal | None:
        if not isinstance(run.result, AxbcResult) or self.config.propose == "none":
            return None
        answer = run.result.result
        auto = self.config.accept.auto
        if self.config.propose == "camera":
            X = to_pose6(from_pose6(answer.T_camera_base).inv())
            return Proposal(HAND_EYE, [float(v) for v in X], auto)
        correction = answer.correction
        if correction.chosen != ("constant" if self.config.propose == "constant" else "model"):
            return None
        if self.config.propose == "constant":
            constant = correction.T_base_camera
            return None if constant is None else Proposal(HAND_EYE, constant, auto)
        if answer.robot is None:
            return None
        device = run.cell.device("arm").name
        return Proposal(kinematics(device), kinematics_value(answer, run.values), auto)

    async def run(self, run: Run) -> None:
        capture = CheckCapture(self.config, run)
        with suppress(FinishRequested):
            await capture.take_all()
        await capture.solve()

    async def dry_run(self, run: Run) -> dict[str, Any]:
        """The plan from the target as it is seen now, with every check; nothing moves."""
        capture = CheckCapture(self.config, run)
        await capture.camera.set_target(capture.target)
        seen = await capture.seek()
        plan = await capture.plan(seen, capture.calibration or {})
        if not self.config.targets:
            return plan.as_dict()
        camera = camera_entry(seen.intrinsics)
        return {
            **plan.as_dict(),
            "targets": await capture.list_targets(plan.poses, camera, self.config.volume()),
        }

    @classmethod
    def solve_again(cls, path: Path, info: Mapping[str, Any], recorded: Mapping[str, Any]) -> Envelope:
        return solve_axbc(path, calls=1)


class CheckCapture(TargetDrive):
    """A capture of one placement whose poses lie over the camera's volume."""

    def __init__(self, config: EyeToHandCheckConfig, run: Run) -> None:
        super().__init__(config.capture(), run, run.camera(CAMERA))
        self.check = config
        if self.calibration is None or "X" not in self.calibration:
            raise error(
                "ARGUMENT_INVALID",
                "there is no hand-eye to check: give [robot] T_base_camera_nominal, or calibrate with "
                'cone-capture, setup = "eye-to-hand", and accept its result',
            )
        self.given: list[float] = [float(v) for v in self.calibration["X"]]

    async def plan(
        self, seen: BoardSeen, calibration: dict[str, Any], finished: Sequence[dict[str, Any]] = ()
    ) -> PlacementPlan:
        """Plan the poses in the worker; poses already finished are left out."""
        common = await self._plan_request(seen, calibration, finished)
        return await self.run.worker.call(plan_volume, VolumeRequest(common, self.check.volume()))

    async def solve(self) -> None:
        """Write ``axbc.json``, solve it in the worker, and leave the result to be proposed."""
        run, taken = self.run, len(self.record.observations)
        await run.enter(S.SOLVE, f"{taken} poses")
        if taken < self.check.min_poses:
            needed = self.check.min_poses
            raise error("CAPTURE_INCOMPLETE", f"{taken} poses were finished, {needed} are needed")
        path = await asyncio.to_thread(self._write)
        targets = await self.ask_for_commands() if self.check.targets else None
        run.note("solve", event="started", observations=taken)
        run.result = found = await run.worker.call(solve_run, path, targets)
        if targets is None or not isinstance(found, AxbcResult):
            return
        run.answered = True  # whatever becomes of the targets
        driven = await self.drive(found, self._camera(), self._keep_driven)
        if run.state is not S.SOLVE:
            await run.enter(S.SOLVE, f"{len(driven['arrivals'])} targets seen")
        path = await asyncio.to_thread(self._write, driven)
        run.result = await run.worker.call(solve_run, path)
        run.answered = False

    async def _keep_driven(self, driven: Mapping[str, Any]) -> None:
        await asyncio.to_thread(self._write, driven)

    def _write(self, driven: Mapping[str, Any] | None = None) -> Path:
        check, header = self.check, self.record.header
        T_camera_base = to_pose6(from_pose6(self.given).inv())
        data = {
            "schema": "cellward.axbc/1",
            "robot": header["robot"],
            "camera": self._camera(),
            "marker": header["target"],
            "T_marker_flange": list(check.T_marker_flange),
            "sigma_C": {"t": check.place_sigma_t_m, "r": check.place_sigma_r_rad},
            "C_from": check.place_from,
            "X_measured_T_camera_base": [float(v) for v in T_camera_base],
            "limits": {"t": check.accept.max_error_t_m, "r": check.accept.max_error_r_rad},
            "observations": [_observation(o) for o in self.record.observations],
        }
        if driven is not None:
            arrivals = [a | {"seen": _observation(a["seen"])} for a in driven["arrivals"]]
            data["driven"] = {**driven, "arrivals": arrivals}
        path = self.run.folder / FILE_NAME
        write_atomic(path, json.dumps(data, allow_nan=False))
        return path

    def _camera(self) -> dict[str, Any]:
        """With the lens that was found together with the pose that is judged, and as well as it was found;
        as told where there is none."""
        told: dict[str, Any] = self.record.header["camera"]
        lens = solved_lens(self.run.values, HAND_EYE, Camera.model_validate(told).intrinsics())
        if lens is None:
            return told
        sigma = self.config.sigma_of_camera() or solved_lens_sigma(self.run.values, HAND_EYE)
        return camera_entry(lens, sigma)


def solve_run(path: Path, targets: Path | None = None) -> Envelope:
    """The result of a run's data set, for the worker process; with the commands for ``targets``."""
    return solve_axbc(path, targets=targets, calls=1)


def kinematics_value(answer: AxbcAnswer, values: RunValues) -> dict[str, Any]:
    """What ``kinematics.<device>`` holds: the arm with its errors, as a fixed camera found them."""
    return {
        "schema": "cellward.kinematics/1",
        "robot": answer.robot,
        "controller": dict(values.robot),
        "payload_kg": values.payload_kg,
        "rms_registration_only": answer.correction.cv_constant,
        "rms_calibrated": answer.correction.cv_model,
        "held_out": len(answer.places),
    }


def _observation(taken: Mapping[str, Any]) -> dict[str, Any]:
    own = {k: v for k, v in taken.items() if k not in ("group", "planned")}
    return own | {"notes": {"planned": taken["planned"]}}
