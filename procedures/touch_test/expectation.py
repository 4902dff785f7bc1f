"""What ``cellward check`` expects of a touch test, by the configuration alone."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import BaseModel

from calibration.adjustment.lens_terms import target_prior
from calibration.targets import make_target
from cell.calibrations import laser_reference
from cell.errors import CellError
from procedures.hand_eye_in_use import HAND_EYE
from procedures.setup import Setup
from procedures.touch_test.config import TouchTestConfig
from procedures.touch_test.judging import SIGMAS
from procedures.words import mm

_USUAL = 4  # corners
_FAR_M = 1.0  # farther no camera on a flange looks at a board: an assumption


def touch_expectation(setup: Setup, job: TouchTestConfig) -> dict[str, Any]:
    """``text``, what keeps the job from its answer, and what will be known less well than wished."""
    problems = setup.missing("arm", "flange_camera") + setup.unseen(job.target)
    target = setup.values.targets.get(job.target)
    points = 0 if target is None else len(make_target(target).points)
    if target is not None and job.corners is not None and max(job.corners) >= points:
        problems.append(f"corners has {max(job.corners)}, and '{job.target}' has points 0 to {points - 1}")
    if job.look_pose not in setup.poses:
        problems.append(f"look_pose = '{job.look_pose}' is not in [poses]; add the pose or name another")
    cautions = _cautions(setup)
    if target is not None and (nearer := _size_allows_m(setup, job, target)) < _FAR_M:
        share = target_prior(target).scale
        cautions.append(
            f"stand_off_m = {job.stand_off_m:g} is enough only where the camera looks at the board from "
            f"nearer than {nearer:.2f} m: the size of '{job.target}' is known to {100.0 * share:.2g} % (one "
            "standard deviation), which counts along the camera's axis by the distance; measure it and state "
            f"scale_sigma in [target.{job.target}], take a thicker gauge, or calibrate the camera with this "
            "board (else the job refuses after its look, before the tool goes down)"
        )
    count = _USUAL if job.corners is None else len(job.corners)
    alone = float(np.hypot(job.tool_sigma_m, job.stand_sigma_m / np.sqrt(count)))
    text = (
        f"{count} corners at {mm(job.stand_off_m, 1)}; hand and tool alone leave {mm(alone)} open along an "
        "axis (one standard deviation), hand-eye, arm and look come on top"
    )
    return {"text": problems[0] if problems else text, "problems": problems, "cautions": cautions}


def _size_allows_m(setup: Setup, job: TouchTestConfig, target: Mapping[str, Any]) -> float:
    """From how far away a board of so well known a size may be looked at; a hand-eye finds the size of the
    board that it is made with."""
    captured = [getattr(one, "target", None) for one in setup.jobs if _calibrates_the_camera(one)]
    if job.target in captured:
        return np.inf
    return job.stand_off_m / (SIGMAS * target_prior(target).scale)


def _calibrates_the_camera(section: BaseModel) -> bool:
    """Whether a job's section is that of a capture with the flange's camera; which job that is is not known
    here."""
    return getattr(section, "setup", None) == "eye-in-hand"


def _cautions(setup: Setup) -> list[str]:
    try:
        rows = setup.calibrations()
    except CellError:
        rows = []
    names = {str(row["name"]) for row in rows if row["state"] == "committed"}
    found = []
    if HAND_EYE not in names:
        found.append("no hand-eye of the camera is in effect: run cone-capture and accept its result")
    tool = setup.values.tool.get("name")  # None where a start names one of several
    if tool is not None and laser_reference(tool) not in names:
        found.append(
            f"no laser reference of tool '{tool}' is in effect, so nothing checks the tool's point: run "
            "laser-reference with the good tool, and laser-check before each test"
        )
    return found
