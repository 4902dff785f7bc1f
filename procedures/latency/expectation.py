"""What ``cellward check`` expects of a latency calibration, by the configuration alone."""

from typing import Any

from calibration.targets import make_target
from cell.calibrations import time_offset
from cell.errors import CellError
from procedures.belt.setup_checks import needs_depth
from procedures.latency.camera import PLACES_OF_SETUP, FixedCamera, FlangeCamera
from procedures.latency.config import LatencyCalibrationConfig
from procedures.latency.encoder import CAMERA
from procedures.setup import Setup
from procedures.words import mm

CAMERAS = {camera.role: camera for camera in (FlangeCamera, FixedCamera)}


def delay_expectation(setup: Setup, job: LatencyCalibrationConfig) -> dict[str, Any]:
    """``text``, what keeps the job from its answer (``problems``), and what it will lack (``cautions``)."""
    cautions: list[str] = []
    if job.source == "belt":
        problems = setup.missing("belt", CAMERA)
        problems += needs_depth(setup, "latency-calibration", job.items)
        text = (
            f"items seen by the camera over {job.changes} starts and stops of the belt; nothing is moved, so "
            "somebody has to start and stop it"
        )
        if not problems and not _camera_known(setup):
            cautions.append(
                "how late the fixed camera is was not measured yet: run the job with source = "
                f"'{CAMERA}' first, the encoder is measured against it"
            )
    else:
        problems = setup.missing("arm", job.source)
        allowed = setup.values.limits.get("speed_m_s", job.speeds[0])
        if (fastest := max(job.speeds)) > allowed:
            problems.append(
                f"speeds_m_s has {fastest:g} m/s, [limits] speed_m_s is {allowed:g} m/s; lower it"
            )
        speeds = ", ".join(f"{1e3 * v:g}" for v in job.speeds)
        text = f"{job.passes} times out and back at each of {speeds} mm/s"
        if (camera := CAMERAS.get(job.source)) is not None:
            problems += _of_camera(setup, job, camera.setup)
            text += f", {mm(job.way_m, 0)} along the picture's rows"
    return {"text": problems[0] if problems else text, "problems": problems, "cautions": cautions}


def _of_camera(setup: Setup, job: LatencyCalibrationConfig, of: str) -> list[str]:
    problems = []
    target = setup.values.targets.get(job.target or "")
    if target is None:
        problems.append(f"target = '{job.target}' is no [target.NAME] section; add it or name another")
    elif len(make_target(target).symmetries) > 1:
        problems.append(
            f"target '{job.target}' looks the same when it is turned; take a ChArUco board or a marker"
        )
    if job.pose is not None and job.pose not in setup.poses:
        problems.append(f"pose '{job.pose}' is not in [poses]; teach it there")
    if setup.nominal.get(PLACES_OF_SETUP[of]) is None:
        problems.append(f"[robot] has no {PLACES_OF_SETUP[of]}, along whose rows the arm goes; give it")
    return problems


def _camera_known(setup: Setup) -> bool:
    device = setup.roles[CAMERA]
    if getattr(setup.devices[device], "time_offset_s", 0.0):
        return True
    try:
        return setup.committed(time_offset(device)) is not None
    except CellError:
        return True  # another check says that the ledger cannot be read
