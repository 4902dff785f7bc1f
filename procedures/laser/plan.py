"""The plan of a scan, for the worker process: every move that may come, held against the guard."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.errors import CellError, error
from cell.guard import MotionGuard, Tool
from cell.poses import Array
from procedures.arm_setup import lease_settings
from procedures.laser.config import Search
from procedures.laser.path import Course, Station, course, deepest

MOTION_ERRORS = ("MOTION_LIMIT", "MOTION_COLLISION", "MOTION_UNREACHABLE")


@dataclass(frozen=True)
class PlanRequest:
    """A scan to plan; ``q`` (6,) rad is where the arm stands, ``p_ref`` the tool's point of the reference."""

    values: dict[str, Any]
    search: dict[str, Any]
    p_ref: list[float] | None
    places: int
    q: list[float]


def plan_scan(request: PlanRequest) -> dict[str, Any]:
    """Every sweep from the auxiliary points to the greatest depth, each with the guard's findings.

    The guard knows the tool as longer by ``tool_margin_m``. ``problem`` of a sweep names what forbids it.
    """
    values, search = request.values, Search.model_validate(request.search)
    guard, tool, _ = lease_settings(values)
    way = course(search, values["robot"], values["tool"]["T_flange_tool"], request.p_ref, request.places)
    longer = _longer(guard, values["tool"], search.tool_margin_m)
    rows: list[dict[str, Any]] = []
    q = np.array(request.q)
    for station in way.stations:
        if station.place == 0:
            rows.append(_approach(longer, station, q))
            q = station.q
        rows += _sweeps(longer, way, search, station)
    total = sum(row["sweeps"] for row in rows)
    problems = [f"{row['index']}: {row['problem']}" for row in rows if row["problem"]]
    return {
        "sweeps": rows,
        "note": (
            f"{total} sweeps at most, each there and back; checked with a tool that is "
            f"{1e3 * search.tool_margin_m:g} mm longer than {values['tool']['name']} is believed to be "
            f"({1e3 * float(np.linalg.norm(tool.T_flange_tool.translation)):.1f} mm)"
        ),
        "floor_m": search.floor_m,
        "problems": problems,
    }


def check_plan(plan: Mapping[str, Any]) -> None:
    """``PLAN_INFEASIBLE`` with the first problem when the plan has any."""
    problems = plan["problems"]
    if problems:
        more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
        raise error("LASER_PLAN_REFUSED", f"{problems[0]}{more}")


def _longer(guard: MotionGuard, tool: Mapping[str, Any], margin_m: float) -> MotionGuard:
    drawn = Tool.from_mapping(tool)
    length = float(np.linalg.norm(drawn.T_flange_tool.translation))
    stretch = 1.0 + margin_m / length if length > 0.0 else 1.0
    T = RigidTransform.from_components(
        drawn.T_flange_tool.translation * stretch, drawn.T_flange_tool.rotation
    )
    return MotionGuard(guard.model, guard.limits, Tool(T, drawn.radius_m, drawn.name, drawn.attachments))


def _approach(guard: MotionGuard, station: Station, q: Array) -> dict[str, Any]:
    problem = None
    try:
        guard.check_path_joints(q, station.q)
    except CellError as exc:
        problem = _told(exc)
    return {
        "index": f"{station.beam} approach",
        "beam": station.beam,
        "q": station.q.tolist(),
        "checks": guard.describe(station.q).as_dict(),
        "problem": problem,
        "sweeps": 0,
    }


def _sweeps(guard: MotionGuard, way: Course, search: Search, station: Station) -> list[dict[str, Any]]:
    """One row a height: the descents of the search, and at last the deepest that is measured at."""
    limit = deepest(search, way, station)
    if limit < 0.0:
        low = 1e3 * (float(way.tip(station.start)[2]) - search.floor_m)
        text = (
            f"no room to search: the point is {low:.1f} mm above the floor, and measuring needs "
            f"{1e3 * (search.measure_depth_m + search.tilt_height_m):.1f} mm"
        )
        return [_row(station, 0.0, way, station.q, guard, 0, text)]
    steps = int(np.floor(limit / search.descend_step_m + 1e-9))
    depths = [k * search.descend_step_m for k in range(steps + 1)]
    tilt = search.tilt_height_m if station.place == 0 else 0.0  # one height is enough to find the beam
    measured = [d for d in (search.measure_depth_m, tilt) if d > 0.0]
    bisections = int(np.ceil(np.log2(max(search.descend_step_m / search.z_resolution_m, 1.0))))
    rows, before, q, problem = [], station.start, station.q, None
    try:
        q = _line(guard, guard.model.forward(q), station.start, q)
    except CellError as exc:
        problem = _told(exc)
    q_far = q
    for depth in (*depths, depths[-1] + sum(measured)):
        last = depth > depths[-1]
        count = bisections + len(measured) * (1 + search.passes) if last else 1
        here = station.at(0.0, depth)
        try:
            if problem is None:
                q = _line(guard, before, here, q)
                q_far = _line(guard, here, station.at(station.distance_m, depth), q)
        except CellError as exc:
            problem = _told(exc)
        worst = min((q, q_far), key=lambda joints: _tightest(guard, joints))
        rows.append(_row(station, depth, way, worst, guard, count, problem))
        if problem is not None:
            break
        before = here
    return rows


def _line(guard: MotionGuard, a: RigidTransform, b: RigidTransform, q: Array) -> Array:
    """Check a line of the tool and give the joints (6,) at its end."""
    guard.check_path_linear(a, b, q)
    found = guard.model.inverse(b, q)
    if found is None:
        raise error("MOTION_UNREACHABLE", "the end of the line has no joints within range")
    return found


def _row(
    station: Station,
    depth: float,
    way: Course,
    q: Array,
    guard: MotionGuard,
    sweeps: int,
    problem: str | None,
) -> dict[str, Any]:
    tip, end = way.tip(station.at(0.0, depth)), way.tip(station.at(station.distance_m, depth))
    return {
        "index": f"{station.beam} {station.place + 1} at {1e3 * depth:.1f} mm",
        "beam": station.beam,
        "place": station.place,
        "depth_m": depth,
        "from": tip.tolist(),
        "to": end.tolist(),
        "q": [float(v) for v in q],
        "checks": guard.describe(q).as_dict(),
        "problem": problem,
        "sweeps": sweeps,
    }


def _tightest(guard: MotionGuard, q: Array) -> float:
    margins = guard.describe(q)
    clearance = np.inf if margins.clearance_m is None else margins.clearance_m
    return min(clearance, margins.workspace_m, margins.floor_m, margins.self_m)


def _told(exc: CellError) -> str:
    """A finding of the guard; anything else is not for a plan."""
    if exc.name not in MOTION_ERRORS:
        raise exc
    return str(exc)
