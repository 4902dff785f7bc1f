"""What ``cellward check`` expects of an eye-to-hand check, by configuration and hand-eye in effect."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from calibration.kinematics import robot_from_spec
from calibration.planning.view import project
from calibration.targets import make_target
from cell.devices import Intrinsics
from cell.errors import AbortError, CellError
from cell.poses import from_pose6, to_pose6
from procedures.expected_camera import expected_camera
from procedures.eye_to_hand.config import EyeToHandCheckConfig
from procedures.eye_to_hand.plan import VolumeRequest, plan_volume
from procedures.eye_to_hand.targets import TargetsAsGiven, TargetView, list_targets
from procedures.eye_to_hand.words import outside_text
from procedures.hand_eye.plan import BoardObservation, PlanRequest
from procedures.setup import Setup
from procedures.words import deg, mm

HAND_EYE = "T_base_camera"
Lens = Mapping[str, Any]
# Of a camera that is not calibrated yet no picture is known; what is out of one as wide as this (135 degrees)
# is out of any.
_WIDE: Lens = {"width": 3840, "height": 2400, "K": [800.0, 800.0, 1919.5, 1199.5], "dist": []}
_LEFT_OUT = "so it is left out: move it to where camera and arm can have it, or take it out of the list"


def eye_to_hand_expectation(setup: Setup, job: EyeToHandCheckConfig) -> dict[str, Any]:
    """``text``, what keeps the job from its answer, and what will be known less well than wished."""
    problems = setup.missing("arm", "fixed_camera") + setup.unseen(job.target, job.min_corners)
    if job.start_pose is not None and job.start_pose not in setup.poses:
        problems.append(f"start_pose = '{job.start_pose}' is not in [poses]; add the pose or name another")
    cautions = []
    for what, sigma, limit, words in (
        ("place_sigma_t_m", job.place_sigma_t_m, job.accept.max_error_t_m, mm),
        ("place_sigma_r_rad", job.place_sigma_r_rad, job.accept.max_error_r_rad, deg),
    ):
        if 2.0 * sigma > limit:
            cautions.append(
                f"{what} is {words(sigma)}, and the hand-eye is to be judged to {words(limit)}: an error "
                "of the place is the same in all poses, so measure the place better or allow more"
            )
    text = (
        f"{job.poses} poses from {mm(job.nearest_m, 0)} to {mm(job.farthest_m, 0)} before the camera; the "
        f"target's place is known to {mm(job.place_sigma_t_m)} and {deg(job.place_sigma_r_rad)}, which no "
        "number of poses lowers"
    )
    if not problems:
        reach = _reached(setup, job)
        problems += reach.problems
        text = f"{text}; {reach.text}"
        cautions += reach.cautions
    return {"text": problems[0] if problems else text, "problems": problems, "cautions": cautions}


@dataclass(frozen=True)
class _Reach:
    text: str
    problems: Sequence[str] = ()
    cautions: Sequence[str] = ()


def _reached(setup: Setup, job: EyeToHandCheckConfig) -> _Reach:
    """Of the poses and targets, by what a dry run would plan with the target seen where it is expected."""
    look, camera = job.start_pose or "home", _camera(setup)
    q = setup.poses.get(look)
    if camera is None or q is None:
        missing = (
            "a hand-eye: give [robot] T_base_camera_nominal, or calibrate with cone-capture"
            if camera is None
            else "start_pose"
        )
        unchecked = [f"targets: none was checked without {missing}"] if job.targets else []
        return _Reach(f"no prediction of what is reached without {missing}", cautions=unchecked)
    lens, expected = setup.stated(HAND_EYE).get("lens"), expected_camera(setup, "fixed_camera")
    table = setup.values.targets[job.target]
    widest = TargetView(table, job.T_marker_flange, lens or _WIDE)
    flange = robot_from_spec(setup.values.robot).forward(np.array(q))
    looks_at = to_pose6(from_pose6(camera).inv() * flange).tolist()
    view = _view(table, q, flange, widest.seen(looks_at), lens or expected.table)
    if why := widest.fault(looks_at):
        text = (
            f"start_pose: with the arm at '{look}' {why}, by {HAND_EYE} and T_marker_flange: name a pose of "
            "[poses] where the camera sees the target, or correct these two"
        )
        return _Reach(f"nothing is seen from '{look}'", *(((text,), ()) if job.start_pose else ((), (text,))))
    problems, known = [], list[list[float]]()
    try:
        plan = plan_volume(VolumeRequest(_request(setup, job, camera, view), job.volume()))
        known = [visit.q for visit in plan.poses]
    except AbortError as exc:
        problems.append(f"poses: from '{look}': {exc}. {exc.hint}")
    text = f"{len(known)} of {job.poses} poses are reached from '{look}'"
    if not job.targets:
        return _Reach(text, problems)
    rows = list_targets(
        setup.values,
        widest,
        TargetsAsGiven(camera, job.targets, known, q, job.volume()),
    )
    left_out = [f"{_key(row)}: {row['why']}, {_LEFT_OUT}" for row in rows if row["why"]]
    cautions = [
        f"{_key(row)}: {outside_text(row['outside'])}: move it, or set nearest_m, farthest_m, "
        "tilt_rad or, for the roll, start_pose for it"
        for row in rows
        if row["outside"] and not row["why"]
    ]
    if lens is None:
        assumed = TargetView(table, job.T_marker_flange, expected.table)
        cautions += [
            f"{_key(row)}: {why}, by {expected.words}, which is assumed before "
            "it is calibrated; a dry run tells it by this camera"
            for row in rows
            if not row["why"] and (why := assumed.fault(row["T_camera_flange"]))
        ]
    count = len(rows) - len(left_out)
    text += f"; {count} of {len(rows)} targets can be driven to"
    if not count:
        return _Reach(text, [*problems, *left_out], cautions)
    return _Reach(text, problems, [*left_out, *cautions])


def _key(row: Mapping[str, Any]) -> str:
    return f"targets[{row['number'] - 1}]"


def _camera(setup: Setup) -> list[float] | None:
    """T_base_camera (6,) as a start would have it: the version in effect, else the nominal one."""
    try:
        accepted = setup.committed(HAND_EYE)
    except CellError:
        accepted = None  # another check says that the ledger cannot be read
    pose = setup.nominal["T_base_camera_nominal"] if accepted is None else accepted["value"]
    return None if pose is None else [float(v) for v in pose]


def _view(
    table: Mapping[str, Any], q: Sequence[float], flange: RigidTransform, seen: RigidTransform, lens: Lens
) -> BoardObservation:
    """The target as it is expected where the poses begin: at the joints ``q`` (6,), with the flange there and
    the target ``seen`` there in the camera."""
    points = make_target(table).points
    intrinsics = Intrinsics(lens["width"], lens["height"], tuple(lens["K"]), tuple(lens["dist"]))
    return BoardObservation(
        q=[float(v) for v in q],
        T_base_flange=to_pose6(flange).tolist(),
        ids=list(range(len(points))),
        corners=project(seen.apply(points), intrinsics).tolist(),
        camera=dict(lens),
    )


def _request(
    setup: Setup, job: EyeToHandCheckConfig, camera: Sequence[float], view: BoardObservation
) -> PlanRequest:
    capture = job.capture()
    return PlanRequest(
        setup="eye-to-hand",
        values=setup.values,
        target=dict(setup.values.targets[job.target]),
        calibration={"X": list(camera)},
        view=view,
        poses=job.poses,
        min_poses=job.min_poses,
        cone_half_angle_rad=capture.cone_half_angle_rad,
        distance_m=capture.distance_m,
        finished=[],
        placements=1,
    )
