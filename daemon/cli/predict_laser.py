"""What ``cellward check`` expects of the crossed beams: slide, height, uncertainty, and what is reached."""

from math import degrees
from typing import Any

from calibration.tool_frame.prediction import Prediction, predict
from cell.errors import CellError
from daemon.config import CellConfig
from procedures.laser.config import LaserReferenceConfig, Search
from procedures.laser.plan import PlanRequest, plan_scan

NOISE_M = 1e-5  # what an arm repeats a short way to, when nothing else is known
PLACES = 2  # along each beam, for a reference


def predict_laser(config: CellConfig, job: LaserReferenceConfig) -> dict[str, Any]:
    """``text`` and the figures, for a tool that is compared with its reference."""
    device = config.robot.roles().get("beams")
    if device is None:
        return {"text": "no prediction without a device for [robot] beams"}
    period = getattr(config.device[device], "poll_period_s", None)
    depths = [job.measure_depth_m + h for h in ((0.0, job.tilt_height_m) if job.tilt_height_m else (0.0,))]
    text = []
    figures: dict[str, Any] = {}
    if period is None:
        text.append(f"no prediction of the uncertainty: {device} has no poll_period_s")
    else:
        expected = predict(
            job.measure_speed_m_s, period, job.passes, job.z_resolution_m, depths, noise_m=NOISE_M
        )
        text.append(_words(expected, job, period))
        figures = {
            "slide_m": expected.slide_m,
            "z_resolution_m": expected.z_resolution_m,
            "U_xy_m": expected.U_xy_m,
            "U_z_m": expected.U_z_m,
            "U_tilt_rad": expected.U_tilt_rad,
            "assumed_noise_m": NOISE_M,
        }
    reach = _reach(config, job, device)
    return {"text": "; ".join([*text, reach["text"]]), **figures, "problems": reach["problems"]}


def _words(expected: Prediction, job: LaserReferenceConfig, period: float) -> str:
    tilt = expected.U_tilt_rad
    turned = "" if tilt is None else f", {degrees(tilt):.3f} deg of tilt"
    v = 1e3 * job.measure_speed_m_s
    return (
        f"at {v:g} mm/s the tool slides {1e3 * expected.slide_m:.3f} mm between two polls of "
        f"{1e3 * period:g} ms, and each millisecond of delay moves an edge by {1e-3 * v:.3f} mm (out and "
        f"back cancel it); with {job.passes} passes there and back, heights to "
        f"{1e3 * expected.z_resolution_m:g} mm and an arm that repeats to {1e3 * NOISE_M:g} mm, 95 % of the "
        f"errors stay below {1e3 * expected.U_xy_m:.3f} mm across the beams and "
        f"{1e3 * expected.U_z_m:.3f} mm in height{turned}"
    )


def _reach(config: CellConfig, job: LaserReferenceConfig, device: str) -> dict[str, Any]:
    """Every sweep held against the guard, from the first auxiliary point."""
    missing = [name for name in (job.xs.aux, job.ys.aux) if name not in config.poses]
    if missing:
        text = f"[poses] has no '{missing[0]}', which is an auxiliary point"
        return {"text": text, "problems": [text]}
    values = {
        "robot": config.robot.robot_spec(),
        "tool": config.robot.tool.model_dump(mode="json"),
        "payload_kg": config.robot.payload_kg,
        "centre_of_mass_m": list(config.robot.centre_of_mass_m),
        "limits": config.limits.model_dump(mode="json"),
    }
    search = Search.from_config(job, config.poses, device)
    q = config.poses[job.xs.aux]
    try:
        plan = plan_scan(PlanRequest(values, search.model_dump(), None, PLACES, list(q)))
    except CellError as exc:
        return {"text": str(exc), "problems": [str(exc)]}
    problems = plan["problems"]
    text = "every sweep keeps the limits" if not problems else f"not all is reached: {problems[0]}"
    return {"text": text, "problems": problems}
