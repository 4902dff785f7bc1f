"""What ``cellward check`` expects of the crossed beams: slide, height, uncertainty, and what is reached."""

from collections.abc import Iterable, Iterator, Mapping
from math import degrees, sqrt
from typing import Any

from calibration.tool_frame.budget import END, HELPS, POLLS, REPEATABILITY, budget, dominating
from calibration.tool_frame.expected_height import ExpectedHeight, SearchPlan, expected_height
from calibration.tool_frame.prediction import ExpectedComparison, predict
from calibration.tool_frame.repeatability import UNDER_WAY, stated_sigma
from cell.errors import CellError
from procedures.laser.config import LaserCheckConfig, LaserReferenceConfig, LaserUpdateConfig, Search
from procedures.laser.expected_gates import SLOWER, expected_gates
from procedures.laser.measurement import SPEEDS
from procedures.laser.plan import PlanRequest, plan_scan
from procedures.laser.reference import PLACES
from procedures.laser.sought_height import height_goal
from procedures.setup import Setup

REACHED = "every move keeps the limits"


def laser_expectation(setup: Setup, job: LaserReferenceConfig) -> dict[str, Any]:
    """``text`` and the figures for a tool that is compared with its reference, and what was found.

    ``problems``: the jobs cannot succeed with these; ``cautions``: they can, but not as well as is asked.
    """
    device = setup.roles.get("beams")
    if "arm" not in setup.roles:
        return {"text": "no prediction without a device for [robot] arm"}
    if device is None:
        return {"text": "no prediction without a device for [robot] beams"}
    period = getattr(setup.devices[device], "poll_period_s", None)
    problems = [*_speeds(setup, job), *_pin(setup, job), *_polls(device, period, job)]
    problems += _reach(setup, job, device)
    if problems:
        return {"text": "no prediction before its errors are corrected", "problems": problems}
    if period is None:
        text = f"no prediction of the uncertainty: {device} has no poll_period_s"
        return {"text": f"{text}; {REACHED}", "problems": []}
    sigma = UNDER_WAY * stated_sigma(setup.values.robot.get("model"))
    with_noise, perfect = (_predicted(setup, job, period, noise) for noise in (sigma, 0.0))
    expected, parts = with_noise[0], budget(*with_noise, *perfect)
    check = setup.job(LaserCheckConfig) or LaserCheckConfig()
    update = setup.job(LaserUpdateConfig) or LaserUpdateConfig()
    gates = expected_gates(expected, check, update)
    limits = list(_limits(job, check, update, expected.U_point_m))
    return {
        "text": "; ".join((_words(expected, job, period, sigma), _term_words(parts), *gates.words, REACHED)),
        **gates.figures,
        "slide_m": expected.slide_m,
        "z_resolution_m": job.z_resolution_m,
        "U_xy_m": expected.U_xy_m,
        "U_z_m": expected.U_z_m,
        "U_point_m": expected.U_point_m,
        "U_tilt_rad": expected.U_tilt_rad,
        "assumed_noise_m": sigma,
        "budget_m2": parts,
        "dominating": dominating(parts),
        "limits": limits,
        "problems": [],
        "cautions": [*_beyond(limits), *gates.cautions],
    }


def _predicted(
    setup: Setup, job: LaserReferenceConfig, period: float, noise: float
) -> tuple[ExpectedComparison, ExpectedHeight]:
    """For polls each ``period`` (s), and an arm whose ways scatter by ``noise`` (m)."""
    search = SearchPlan(
        job.search_speed_m_s,
        job.measure_speed_m_s,
        period,
        job.most_height_pairs,
        job.descend_step_m,
        height_goal(job.z_resolution_m, job.max_U_m),
        2.0 * _pin_radius(setup, job),
        job.edges > 2,
    )
    height = expected_height(search, noise)
    across = predict(
        job.measure_speed_m_s,
        period,
        job.passes,
        height.variance,
        job.heights,
        noise_m=noise,
        first_edge=_first_edge(setup, job),
    )
    return across, height


def _first_edge(setup: Setup, job: LaserReferenceConfig) -> float:
    """At which share of a measuring way the tool meets the beam."""
    lead = job.lead_m + job.measure_speed_m_s**2 / (2.0 * setup.values.limits["accel_m_s2"])
    return float(lead / (2.0 * (lead + _pin_radius(setup, job))))


def _pin_radius(setup: Setup, job: LaserReferenceConfig) -> float:
    return float(job.pin_radius_m or setup.values.tool["radius_m"])


def _term_words(parts: dict[str, float]) -> str:
    """Which term is the largest, its share of the variance, and what helps."""
    term = dominating(parts)
    name = {
        POLLS: "the polls",
        REPEATABILITY: "the arm's repeatability",
        END: "the tool's end, whose shape polls so far apart do not tell",
    }
    share = 100.0 * parts[term] / sum(parts.values())
    return f"{share:.0f} % of the variance of the tool's point comes from {name[term]}: {HELPS[term]}"


def _words(expected: ExpectedComparison, job: LaserReferenceConfig, period: float, sigma: float) -> str:
    tilt = expected.U_tilt_rad
    turned = "" if tilt is None else f", {degrees(tilt):.3f} deg of tilt"
    v = 1e3 * job.measure_speed_m_s
    return (
        f"at {v:g} mm/s the tool slides {1e3 * expected.slide_m:.3f} mm between two polls of "
        f"{1e3 * period:g} ms, and each millisecond of delay moves an edge by {1e-3 * v:.3f} mm (out and "
        f"back cancel it); with {job.passes} passes there and back, heights to "
        f"{1e3 * job.z_resolution_m:g} mm and an arm whose ways scatter by {1e3 * sigma:.3f} mm, 95 % "
        f"of the errors stay below {1e3 * expected.U_xy_m:.3f} mm across the beams and "
        f"{1e3 * expected.U_z_m:.3f} mm in height, by a flat end{turned}"
    )


def _speeds(setup: Setup, job: LaserReferenceConfig) -> Iterator[str]:
    allowed = setup.values.limits["speed_m_s"]
    for key in SPEEDS:
        if (wanted := getattr(job, key)) > allowed:
            yield (
                f"{key} is {wanted:g} m/s and [limits] speed_m_s {allowed:g} m/s; lower the one or raise the "
                "other"
            )


def _pin(setup: Setup, job: LaserReferenceConfig) -> Iterator[str]:
    """A sweep begins and ends with a free beam, and is at constant speed from edge to edge."""
    wide = 2.0 * _pin_radius(setup, job)
    source = "pin_radius_m" if job.pin_radius_m else "[robot] tool.radius_m, as there is no pin_radius_m"
    for name, beam in (("xs", job.xs), ("ys", job.ys)):
        if wide + 2.0 * job.lead_m > beam.distance_m:
            yield (
                f"{name}.distance_m is {1e3 * beam.distance_m:g} mm, and a tool {1e3 * wide:g} mm wide (by "
                f"{source}) with lead_m of {1e3 * job.lead_m:g} mm on both sides needs "
                f"{1e3 * (wide + 2.0 * job.lead_m):g} mm; make {name}.distance_m longer"
            )


def _polls(device: str, period: float | None, job: LaserReferenceConfig) -> Iterator[str]:
    if period is not None and period > job.max_poll_gap_s:
        yield (
            f"[device.{device}] poll_period_s is {1e3 * period:g} ms, longer than max_poll_gap_s of "
            f"{1e3 * job.max_poll_gap_s:g} ms, so every pass would be refused; poll more often"
        )


def _limits(
    job: LaserReferenceConfig, check: LaserCheckConfig, update: LaserUpdateConfig, U: float
) -> Iterator[dict[str, Any]]:
    """What each job that measures a tool will hold against its limit; ``U`` has the reference's part, too."""
    for name, value, limit in (
        ("laser-reference", U / sqrt(2.0), job.max_U_m),
        ("laser-check", U, check.max_U_m),
        ("laser-update", U, update.max_U_m),
    ):
        yield {"job": name, "name": "U_point_m", "value": value, "limit": limit}


def _beyond(limits: Iterable[Mapping[str, Any]]) -> Iterator[str]:
    """Limits that the expected uncertainty is beyond: such a run ends with the verdict fail."""
    for one in limits:
        if one["value"] > one["limit"]:
            yield (
                f"95 % of the errors of the point are expected below {1e3 * one['value']:.3f} mm, and "
                f"[job.{one['job']}] max_U_m is {1e3 * one['limit']:g} mm; {SLOWER}"
            )


def _reach(setup: Setup, job: LaserReferenceConfig, device: str) -> list[str]:
    """Every move held against the guard, from the first auxiliary point; one sentence for all that is not."""
    aux = {"xs": job.xs.aux, "ys": job.ys.aux}
    missing = [f"{name}.aux '{pose}'" for name, pose in aux.items() if pose not in setup.poses]
    if missing:
        return [f"[poses] has no entry for {' and '.join(missing)}; teach it there"]
    search = Search.from_config(job, setup.poses, device)
    q = list(setup.poses[job.xs.aux])
    request = PlanRequest(setup.values, search.model_dump(), None, PLACES, q, job.retract_pose)
    try:
        problems = plan_scan(request)["problems"]
    except CellError as exc:
        return [f"{exc.detail}"]
    if not problems:
        return []
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    return [
        f"not every move is possible: {problems[0]}{more}; change '{aux['xs']}' or '{aux['ys']}', floor_m, "
        "max_descents, or what [limits] has there"
    ]
