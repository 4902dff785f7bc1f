"""What ``cellward check`` expects of a test of pose accuracy: the poses, and what the tracker can resolve."""

from dataclasses import replace
from typing import Any

import numpy as np

from calibration.iso9283 import CYCLES, figures
from cell.calibrations import kinematics
from cell.errors import CellError
from cell.poses import from_pose6
from procedures.iso9283.config import Iso9283Config
from procedures.iso9283.plan import (
    is_corrected,
    kinematics_of,
    plan_iso,
    require_same_devices,
    wanted_poses,
)
from procedures.laser_tracker.noise import stated_noise
from procedures.setup import Setup
from procedures.words import mm

_RANGE_M = 3.0  # where the place of the tracker is unknown


def iso9283_expectation(setup: Setup, job: Iso9283Config) -> dict[str, Any]:
    """``text``, the tracker's own figures, and what was found.

    The poses are planned from 'near' and by the controller's own model: calibrated kinematics, which are only
    known when the job starts, move them by millimetres.
    """
    if missing := setup.missing("arm", "tracker"):
        return {"text": missing[0], "problems": missing[:1], "cautions": []}
    if (near := setup.poses.get(job.near)) is None:
        text = f"near = '{job.near}' is not in [poses]; add the pose or name another"
        return {"text": text, "problems": [text], "cautions": []}
    noise, assumed = stated_noise(setup)
    values = setup.values
    uncorrected = job.model_copy(update={"corrected": False, "registration": "fit"})
    try:
        plan = plan_iso(values, uncorrected.model_dump(), list(near)).listing
    except CellError as exc:
        return {"text": f"no plan: {exc}", "problems": [f"{exc}. {exc.hint}"], "cautions": []}
    distance = _range_m(job)
    sigma = noise["sigma0"] + noise["sigma_per_m"] * distance
    own = figures(np.eye(3), np.zeros(3), sigma)
    floors = {"AP": own.tracker_AP, "RP": own.tracker_RP}
    problems = [
        f"max_{key}_m is {mm(limit)}, and the tracker alone reads {key} {mm(floors[key])} of a perfect arm: "
        "raise it, bring the tracker nearer or use a better one"
        for key in floors
        if (limit := getattr(job, f"max_{key}_m")) is not None and limit < floors[key]
    ]
    cautions = []
    if job.cycles < CYCLES:
        cautions.append(f"cycles is {job.cycles}; the standard has {CYCLES}")
    needs = is_corrected(values, job) or job.registration == "kinematics"
    if needs:
        problems += _not_of_this_arm(setup, job)
    text = (
        f"{plan['arrivals']} arrivals at {len(plan['poses'])} poses, all free and in reach; at "
        f"{distance:.1f} m the tracker alone reads AP {mm(floors['AP'])} (95 %) and RP "
        f"{mm(floors['RP'])}, {assumed}"
        + ("; needs kinematics of the arm that are accepted when it starts" if needs else "")
    )
    return {"text": text, "tracker": floors, "problems": problems, "cautions": cautions}


def _not_of_this_arm(setup: Setup, job: Iso9283Config) -> list[str]:
    """Why the job would refuse the kinematics that are accepted now, by what the config says of arm and
    tracker; nothing while none are accepted."""
    roles, name = setup.roles, kinematics(setup.roles["arm"])
    serials = {
        role: getattr(setup.devices[roles[role]], "expect_serial", None) or "" for role in ("arm", "tracker")
    }
    try:
        if (accepted := setup.committed(name)) is not None:
            found = kinematics_of(replace(setup.values, kinematics={"arm": accepted["value"]}), job)
            require_same_devices(found, job, serials)
    except CellError as exc:
        return [f"{exc}. {exc.hint}"]
    return []


def _range_m(job: Iso9283Config) -> float:
    """From the tracker to the middle of the poses."""
    if job.T_base_tracker_nominal is None:
        return _RANGE_M
    middle = np.mean([T.apply(job.point) for T in wanted_poses(job, job.point).values()], axis=0)
    return float(np.linalg.norm(from_pose6(job.T_base_tracker_nominal).translation - middle))
