"""What ``cellward check`` expects of an insertion, by the configuration alone."""

from typing import Any

import numpy as np

from calibration.slot.budget import quantile_radius
from cell.errors import CellError
from procedures.setup import Setup
from procedures.slot.config import SlotInsertionConfig
from procedures.slot.marking import marker_problem
from procedures.words import mm


def slot_expectation(setup: Setup, job: SlotInsertionConfig) -> dict[str, Any]:
    """``text``, what keeps the job from its end, and what leaves little room.

    Hand-eye and arm are only known when the job starts; what part, rack and
    marker alone leave open is known now.
    """
    problems = setup.missing("arm", "flange_camera", "gripper")
    if setup.without_depth("flange_camera"):
        problems.append(
            f"[device.{setup.roles['flange_camera']}] has depth = false, and the job looks into a slot by "
            "depth: use a camera with depth"
        )
    if why := marker_problem(job):
        problems.append(why)
    for key in ("start_pose", "fetch_pose", "put_down_pose"):
        name = getattr(job, key)
        if name is not None and name not in setup.poses:
            problems.append(f"{key} = '{name}' is not in [poses]; add the pose or name another")
    slow, tight = setup.gripper_in_time("insertion.grip_timeout_s", job.insertion.grip_timeout_s)
    problems += slow
    alone = _part_and_rack(job)
    if alone > job.clearance_m:
        problems.append(
            f"part.sigma_m, part.sigma_rad and rack.sigma_rad{_of_marker(job)} alone leave {mm(alone)} "
            f"(95 %) open, and {mm(job.clearance_m)} is free: every insertion would be refused"
        )
    cautions = [*_cautions(setup, job, alone), *tight, *setup.gripper_confirms_nothing()]
    text = (
        f"slot {job.slot} of {job.rack.rows * job.rack.columns}, {mm(job.clearance_m)} free on each side; "
        f"{_known_now(job)} alone leave {mm(alone)} (95 %) open, hand-eye, arm and look come on top"
    )
    return {
        "text": problems[0] if problems else text,
        "limits": [
            {"job": "slot-insertion", "name": "left_open_m", "value": alone, "limit": job.clearance_m}
        ],
        "clearance_m": job.clearance_m,
        "part_and_rack_95_m": alone,
        "problems": problems,
        "cautions": cautions,
    }


def _part_and_rack(job: SlotInsertionConfig) -> float:
    """95 % of what the part's place in the gripper, the rack's direction and a marker's place do at the end
    of the travel."""
    turns = np.hypot(job.part.sigma_rad, job.rack.sigma_rad) * job.opening.depth_m
    marker_m = 0.0 if job.marker is None else job.marker.sigma_m
    return quantile_radius(np.eye(2) * (job.part.sigma_m**2 + turns**2 + marker_m**2))


def _known_now(job: SlotInsertionConfig) -> str:
    return "part and rack" if job.marker is None else "part, rack and marker"


def _of_marker(job: SlotInsertionConfig) -> str:
    return "" if job.marker is None else ", with marker.sigma_m,"


def _cautions(setup: Setup, job: SlotInsertionConfig, alone: float) -> list[str]:
    found = []
    if job.clearance_m >= alone > 0.7 * job.clearance_m:
        found.append(
            f"{_known_now(job)} alone take most of the room: measure them better, or expect refusals"
        )
    try:
        known = setup.committed("T_flange_camera") is not None
    except CellError:
        known = False
    if not known:
        found.append("no hand-eye of the camera is in effect: run cone-capture and accept its result")
    return found
