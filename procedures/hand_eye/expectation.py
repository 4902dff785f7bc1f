"""What ``cellward check`` expects of a cone capture: which poses are reached, and how well they tell."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.kinematics import robot_from_spec
from calibration.planning import board_centre
from calibration.planning.view import project
from calibration.targets import make_target
from cell.devices import Intrinsics
from cell.errors import AbortError
from cell.poses import Array, to_pose6
from procedures.expected_camera import expected_camera
from procedures.hand_eye.config import ConeCaptureConfig
from procedures.hand_eye.plan import BoardObservation, PlanRequest, plan_placement
from procedures.hand_eye.words import MEASURES, prediction_text
from procedures.setup import Setup

ROLES = {"eye-in-hand": "flange_camera", "eye-to-hand": "fixed_camera"}
NOMINAL = {
    "eye-in-hand": {"X": "T_flange_camera_nominal"},
    "eye-to-hand": {"X": "T_base_camera_nominal", "W": "T_flange_target_nominal"},
}


def cone_expectation(setup: Setup, job: ConeCaptureConfig) -> dict[str, Any]:
    """``text``, how many poses are reached, the predicted uncertainty, the ``problems`` and ``cautions``.

    The target is taken to stand before the camera, at right angles to the line of sight, and the camera to be
    the one of :func:`procedures.expected_camera.expected_camera`; both are said.
    """
    problems = setup.unseen(job.target, job.min_corners)
    found: dict[str, Any] = {"text": problems[0]} if problems else _reached(setup, job)
    return found | {"problems": problems + found.get("problems", []), "cautions": list(_cautions(job))}


def _cautions(job: ConeCaptureConfig) -> Iterator[str]:
    if (poses := job.poses_per_placement) % 2:
        yield (
            f"poses_per_placement is {poses}, an odd number: no pose has one opposite to it on the cone, and "
            f"the two distances are not taken equally often; make it {poses + 1}"
        )


def _reached(setup: Setup, job: ConeCaptureConfig) -> dict[str, Any]:
    """Of the poses around a target that can be seen."""
    if "arm" not in setup.roles:
        return {"text": "no prediction without a device for [robot] arm"}
    nominal = {k: setup.nominal[key] for k, key in NOMINAL[job.setup].items()}
    calibration = {k: list(v) for k, v in nominal.items() if v is not None}
    q = setup.poses.get(job.start_pose or "home")
    if not calibration or q is None:
        missing = "start_pose" if q is None else f"[robot] {NOMINAL[job.setup]['X']}"
        return {"text": f"no prediction without {missing}"}
    where = (
        f"from pose '{job.start_pose or 'home'}' with the board facing the camera {job.distance_m:g} m away"
    )
    camera = expected_camera(setup, ROLES[job.setup])
    try:
        plan = plan_placement(_request(setup, job, calibration, camera.table, np.array(q))).as_dict()
    except AbortError as exc:
        return {"text": where, "reached": 0, "problems": [f"{where}: {exc}. {exc.hint}"]}
    reached, wanted = len(plan["poses"]), job.poses_per_placement
    text = f"{where}: {reached} of {wanted} poses are reached"
    predicted = plan.get("predicted")
    if predicted is not None:
        text += f"; {prediction_text(predicted)}, and {camera.words}"
    found = {"text": text, "reached": reached, "wanted": wanted, "predicted": predicted}
    limits = list(_limits(job, predicted or {}))
    return found | {"limits": limits, "problems": list(_beyond_acceptance(limits, predicted or {}))}


def _limits(job: ConeCaptureConfig, predicted: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    for key in ("error95_t_m", "error95_r_rad"):
        if (value := predicted.get(key)) is not None:
            limit = getattr(job.accept, key.replace("error95", "max_error"))
            yield {"job": "cone-capture", "name": key, "value": value, "limit": limit}


def _beyond_acceptance(limits: Iterable[Mapping[str, Any]], predicted: Mapping[str, Any]) -> Iterator[str]:
    """Limits of acceptance that the best case misses already: no result can pass them."""
    for one in limits:
        key, error95, limit = one["name"], one["value"], one["limit"]
        limit_key, unit = key.replace("error95", "max_error"), key.rpartition("_")[2]
        if error95 > limit:
            yield (
                f"accept.{limit_key} = {limit:g} {unit} is below the predicted 95 % error of "
                f"{error95:.2g} {unit}, so a result will hardly pass; "
                + _advice(key, limit, predicted["limit"])
            )


def _advice(key: str, limit: float, at_best: Mapping[str, Any]) -> str:
    """What to change: more placements, where they lead below the limit; else what keeps it up."""
    if at_best[key] <= limit:
        return "allow more, or plan more placements"
    cause = at_best["block_" + key.split("_")[1]]
    return f"no number of placements gets there: allow more, or {MEASURES[cause]}"


def _request(
    setup: Setup, job: ConeCaptureConfig, calibration: dict[str, Any], camera: dict[str, Any], q: Array
) -> PlanRequest:
    target = dict(setup.values.targets[job.target])
    flange = robot_from_spec(setup.values.robot).forward(q)
    return PlanRequest(
        setup=job.setup,
        values=setup.values,
        target=target,
        calibration=calibration,
        view=_assumed_view(target, q, flange, job.distance_m, camera, job.sigma_of_camera()),
        poses=job.poses_per_placement,
        min_poses=job.min_poses_per_placement,
        cone_half_angle_rad=job.cone_half_angle_rad,
        distance_m=job.distance_m,
        second_distance_m=job.second_distance_m,
        finished=[],
        placements=job.placements,
    )


def _assumed_view(
    target: dict[str, Any],
    q: Array,
    flange: RigidTransform,
    distance: float,
    camera: dict[str, Any],
    camera_sigma: dict[str, float] | None,
) -> BoardObservation:
    """The target's points as seen along a sight line that meets its centre at right angles."""
    points = make_target(target).points
    # A marker's z points out of it, the other targets' z into them.
    facing = Rotation.from_euler("x", np.pi if target["type"] == "aruco-marker" else 0.0)
    in_camera = facing.apply(points - board_centre(points)) + np.array([0.0, 0.0, distance])
    intrinsics = Intrinsics(camera["width"], camera["height"], tuple(camera["K"]), tuple(camera["dist"]))
    return BoardObservation(
        q=[float(x) for x in q],
        T_base_flange=[float(x) for x in to_pose6(flange)],
        ids=list(range(len(points))),
        corners=project(in_camera, intrinsics).tolist(),
        camera=camera | ({} if camera_sigma is None else {"sigma": camera_sigma}),
    )
