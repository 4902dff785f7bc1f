"""What ``cellward check`` expects of picking from a belt: slide, time in the zone, rate, and reach."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from cell.errors import CellError
from cell.guard import GuardLimits, MotionGuard, Tool
from cell.poses import Array, from_pose6
from procedures.arm_setup import believed_arm, with_job_limits
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.contact_expectation import expected_contacts
from procedures.belt.motion.cycle_estimate import SPEEDS_M_S, CycleEstimate, ExpectedCycle, ZoneTimes, slides
from procedures.belt.motion.tool_joints import ToolJoints
from procedures.belt.setup_checks import belt_setup, needs_depth
from procedures.belt.tracking import UPRIGHT_RAD
from procedures.setup import Setup
from procedures.words import mm

_FALL_M = 0.005  # of an item onto those below, more is told


def belt_expectation(setup: Setup, job: BeltTrackingConfig) -> dict[str, Any]:
    """``text``, the figures for each speed of the belt, and what was found.

    ``problems``: the job is refused or cannot pick with these; ``cautions``: it can, but not at every speed,
    or something looks mistaken.
    """
    problems = [*setup.missing(*job.roles()), *_poses(setup, job), *_place_input(setup, job)]
    problems += needs_depth(setup, "belt-tracking", job.items)
    slow, tight = setup.gripper_in_time("grip_timeout_s", job.grip_timeout_s)
    problems += slow
    values = setup.values
    try:
        values = with_job_limits(values, job.limits)
    except CellError as exc:
        problems.append(exc.detail)
    if problems:
        return {"text": "no prediction before its errors are corrected", "problems": problems, "cautions": []}
    model = believed_arm(values)
    q_wait, q_place = (np.array(values.poses[name]) for name in (job.wait_pose, job.place_pose))
    tool = ToolJoints(model, from_pose6(values.tool["T_flange_tool"]), q_wait)
    problems = list(_leans(job, tool, q_wait, q_place))
    slide, mistaken = _slide_words(job), list(belt_setup(setup, job))
    mistaken += _overlaps(job)
    mistaken += [*_falls(job), *tight, *setup.gripper_confirms_nothing()]
    if values.belt is None:
        text = f"{slide}; no prediction of the zone without [robot] belt_nominal"
        return {"text": text, "problems": problems, "cautions": mistaken}
    if problems:
        return {"text": slide, "problems": problems, "cautions": mistaken}
    guard = MotionGuard(model, GuardLimits.from_mapping(values.limits), Tool.from_mapping(values.tool))
    expectation = CycleEstimate(
        job, tool, q_wait, q_place, np.array(values.belt["dir"]), setup.gripper_moves_s
    )
    problems = expectation.unreachable(guard)
    if problems:
        return {"text": slide, "problems": problems, "cautions": mistaken}
    contacts = expected_contacts(setup, job)
    expected, times = [expectation.at_speed(v) for v in SPEEDS_M_S], expectation.zone_times()
    return {
        "text": f"{_words(expected, setup.gripper_moves_s)}; {_zone_words(times)}; {slide}; "
        f"{contacts['text']}; it needs a calibrated camera above the belt when it starts",
        "zone": times.as_dict(),
        "speeds": [row.as_dict() for row in expected],
        "contacts": contacts["contacts"],
        "slides": [{"speed_m_s": v, "slide_m": slide} for v, slide in slides(job.dwell_s)],
        "problems": [],
        "cautions": [
            *mistaken,
            *_cautions(job, expectation, expected),
            *_zone_cautions(job, times),
            *contacts["cautions"],
        ],
    }


def _poses(setup: Setup, job: BeltTrackingConfig) -> Iterator[str]:
    for key in ("wait_pose", "place_pose"):
        if (name := getattr(job, key)) not in setup.poses:
            yield f"{key} '{name}' is not in [poses]; teach it there"


def _place_input(setup: Setup, job: BeltTrackingConfig) -> Iterator[str]:
    """An input for a clear place that its device does not have, where that names its inputs."""
    device = setup.roles.get("place_inputs")
    inputs = getattr(setup.devices.get(device or ""), "inputs", None)
    if job.place_clear is not None and inputs and job.place_clear not in inputs:
        yield (
            f"place_clear = '{job.place_clear}' is no input of [device.{device}], which has "
            f"{', '.join(inputs)}; correct the name, or add the input there"
        )


def _overlaps(job: BeltTrackingConfig) -> Iterator[str]:
    """Items that are picked, and longer than the grid has room for along the tool's x, where they lie."""
    if (grid := job.place_grid) is None:
        return
    along = "column_pitch_m" if grid.columns_along.endswith("x") else "row_pitch_m"
    if (pitch := getattr(grid, along)) < job.items.max_size_m:
        yield (
            f"place_grid.{along} = {pitch:g} m is shorter than items.max_size_m = "
            f"{job.items.max_size_m:g} m: longer items would lie on each other, as their longer side is "
            "along the tool's x; make items.max_size_m as small as the items are"
        )


def _falls(job: BeltTrackingConfig) -> Iterator[str]:
    """How far items fall in the uppermost layer, where a layer is higher than the lowest of them."""
    grid, items = job.place_grid, job.items
    if grid is None or grid.layer_m is None:
        return
    key = "min_height_m" if items.height_m is None else "height_m"
    low_m = items.min_height_m if items.height_m is None else items.height_m
    if (fall_m := (grid.layers - 1) * (grid.layer_m - low_m)) > _FALL_M:
        yield (
            f"place_grid.layer_m = {grid.layer_m:g} m is higher than items.{key} = {low_m:g} m: where "
            f"nothing lies between the layers an item may fall {mm(fall_m)} farther in layer {grid.layers} "
            f"than in the lowest; make items.{key}, items.max_height_m and place_grid.layer_m as items are"
        )


def _leans(job: BeltTrackingConfig, tool: ToolJoints, q_wait: Array, q_place: Array) -> Iterator[str]:
    for key, q in (("wait_pose", q_wait), ("place_pose", q_place)):
        if (lean := tool.lean(q)) > UPRIGHT_RAD:
            yield (
                f"{key} '{getattr(job, key)}': the tool leans by {np.degrees(lean):.1f} deg, at most "
                f"{np.degrees(UPRIGHT_RAD):.1f} deg are possible; teach it pointing straight down"
            )


def _slide_words(job: BeltTrackingConfig) -> str:
    rows = ", ".join(f"{1e3 * slide:.1f} mm at {v:g} m/s" for v, slide in slides(job.dwell_s))
    dwell = f"a dwell of {1e3 * job.dwell_s:g} ms"
    if job.follow:
        return f"the tool moves with the item, which would slide in {dwell} by {rows} without follow"
    return f"without follow an item slides in {dwell} by {rows}"


def _words(expected: list[ExpectedCycle], moves_s: float | None) -> str:
    rows = []
    for row in expected:
        rate = "cannot be met"
        if row.per_minute is not None:
            low, high = row.per_minute
            rate = f"about {low:.0f} to {high:.0f} can be picked a minute"
        rows.append(f"at {row.speed_m_s:g} m/s an item is in the zone for {row.window_s:.2f} s, {rate}")
    each = "a third of grip_timeout_s" if moves_s is None else f"{moves_s:g} s (moves_s)"
    return "; ".join(rows) + f" (met at its end or in its middle, with {each} for each motion of the gripper)"


def _cautions(
    job: BeltTrackingConfig, expectation: CycleEstimate, expected: list[ExpectedCycle]
) -> Iterator[str]:
    least = job.dwell_s + job.grip_timeout_s
    for row in expected:
        if row.cycle_s is None:
            yield f"at {row.speed_m_s:g} m/s the arm cannot meet an item: {row.why}"
            continue
        if row.window_s < least:
            yield (
                f"at {row.speed_m_s:g} m/s an item is in the zone for {row.window_s:.2f} s, less than "
                f"dwell_s and grip_timeout_s together ({least:.2f} s); make the zone longer"
            )
        if job.follow and (beyond := expectation.too_fast_to_follow(row.speed_m_s)) is not None:
            joint, speed, limit = beyond
            yield (
                f"following at {row.speed_m_s:g} m/s at an end of the zone turns joint '{joint}' at "
                f"{speed:.2f} rad/s, its limits.joint_speed_rad_s is {limit:g} rad/s; shorten the zone"
            )


def _zone_words(times: ZoneTimes) -> str:
    return (
        f"an item that comes into the zone as the arm sets out is met and gripped within it up to "
        f"{times.fastest_m_s:.2f} m/s (approach {times.approach_s:.2f} s, descent {times.descent_s:.2f} s, "
        f"grip {times.grip_s:.2f} s)"
    )


def _zone_cautions(job: BeltTrackingConfig, times: ZoneTimes) -> Iterator[str]:
    """T1 against the longest way, and the zone against what an item needs of it."""
    classic = job.method == "classic"
    if classic and job.T1_s < times.farthest_s:
        yield (
            f"T1_s = {job.T1_s:g} s is shorter than the way above the farther end of the zone, "
            f"{times.farthest_s:.3f} s: items that would be met there are let pass; raise T1_s to "
            f"{_up(times.farthest_s):g} s, or shorten the zone"
        )
    if (wanted := SPEEDS_M_S[-1]) <= times.fastest_m_s:
        return
    length = _up(wanted * times.needed_s)
    fix = f"for {wanted:g} m/s make it {length:g} m long"
    shorter = times.length_m / wanted - times.descent_s - times.grip_s
    if classic and shorter >= times.farthest_s:
        fix += f", or T1_s {int(1e3 * shorter) / 1e3:g} s"
    elif not classic:
        fix += ", or teach wait_pose nearer to its end"
    yield (
        f"above {times.fastest_m_s:.2f} m/s the zone of {times.length_m:g} m is too short for "
        f"{'T1_s' if classic else 'the approach'} ({times.approach_s:.2f} s), descent "
        f"({times.descent_s:.2f} s) and grip ({times.grip_s:.2f} s) of an item that comes in as the arm sets "
        f"out, and it is let pass; {fix}"
    )


def _up(value: float) -> float:
    """To the next hundredth."""
    return float(np.ceil(100.0 * value - 1e-9) / 100.0)
