"""What ``cellward check`` expects of a touch test, by the configuration alone."""

from typing import Any

import numpy as np

from calibration.targets import make_target
from cell.calibrations import laser_reference
from cell.errors import CellError
from procedures.hand_eye_in_use import HAND_EYE
from procedures.setup import Setup
from procedures.touch_test.config import TouchTestConfig
from procedures.words import mm

_USUAL = 4  # corners


def touch_expectation(setup: Setup, job: TouchTestConfig) -> dict[str, Any]:
    """``text``, what keeps the job from its answer, and what will be known less well than wished."""
    problems = setup.missing("arm", "flange_camera")
    target = setup.values.targets.get(job.target)
    if target is None:
        problems.append(f"target = '{job.target}' is no [target.NAME] section; add it or name another")
    elif job.corners is not None and max(job.corners) >= (points := len(make_target(target).points)):
        problems.append(f"corners has {max(job.corners)}, and '{job.target}' has points 0 to {points - 1}")
    if job.look_pose not in setup.poses:
        problems.append(f"look_pose = '{job.look_pose}' is not in [poses]; add the pose or name another")
    cautions = _cautions(setup)
    count = _USUAL if job.corners is None else len(job.corners)
    alone = float(np.hypot(job.tool_sigma_m, job.stand_sigma_m / np.sqrt(count)))
    text = (
        f"{count} corners at {mm(job.stand_off_m, 1)}; hand and tool alone leave {mm(alone)} open along an "
        "axis (one standard deviation), hand-eye, arm and look come on top"
    )
    return {"text": problems[0] if problems else text, "problems": problems, "cautions": cautions}


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
