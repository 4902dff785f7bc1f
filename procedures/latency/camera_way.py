"""The way of the arm before a camera, for the worker process: each move held against the guard."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.errors import CellError
from cell.poses import from_pose6
from cell.run_values import RunValues
from procedures.arm_setup import lease_settings

MOTION_ERRORS = ("MOTION_LIMIT", "MOTION_COLLISION", "MOTION_UNREACHABLE")


@dataclass(frozen=True)
class WayRequest:
    """A way of ``length_m`` about the pose at the joints ``middle`` (6,) rad, along the camera's rows.

    From joints ``q`` (6,) rad, where the arm stands; at ``speeds_m_s``, each ``passes`` times out and back.
    ``setup`` and ``X`` (6,) say where the camera is.
    """

    values: RunValues
    q: list[float]
    middle: list[float]
    length_m: float
    speeds_m_s: list[float]
    passes: int
    setup: str
    X: list[float]


def ends_of(request: WayRequest) -> tuple[RigidTransform, RigidTransform, RigidTransform]:
    """T_base_flange in the middle of the way, and where it begins and ends."""
    middle = lease_settings(request.values)[0].model.forward(np.array(request.middle))
    camera = from_pose6(request.X)
    looks = camera.rotation if request.setup == "eye-to-hand" else middle.rotation * camera.rotation
    half = RigidTransform.from_translation(0.5 * request.length_m * looks.apply([1.0, 0.0, 0.0]))
    return middle, half.inv() * middle, half * middle


def plan_way(request: WayRequest) -> dict[str, Any]:
    """Every move in order, each checked from where the one before it ended; ``problems`` forbid it."""
    guard = lease_settings(request.values)[0]
    tool = from_pose6(request.values.tool["T_flange_tool"])
    middle, begin, end = ends_of(request)
    q, rows = np.array(request.q), list[dict[str, Any]]()

    def told(index: str, to: RigidTransform | None, sweeps: int = 0, speed_m_s: float | None = None) -> None:
        nonlocal q
        problem, before = None, q
        try:
            if to is None:
                guard.check_path_joints(q, q := np.array(request.middle))
            else:
                guard.check_path_linear(guard.model.forward(q), to, q, speed_m_s)
                found = guard.model.inverse(to, q)
                q = q if found is None else found
        except CellError as exc:
            if exc.name not in MOTION_ERRORS:
                raise
            problem = str(exc)
        start, goal = (guard.model.forward(joints) * tool for joints in (before, q))
        rows.append(
            {
                "index": index,
                "q": [float(v) for v in q],
                "problem": problem,
                "sweeps": sweeps,
                "from": start.translation.tolist(),
                "to": goal.translation.tolist(),
                "checks": guard.describe(q).as_dict(),
            }
        )

    told("to the pose", None)
    fastest = max(request.speeds_m_s)
    told("to the way's begin", begin, 0, fastest)
    for speed in request.speeds_m_s:
        told(f"out at {1e3 * speed:g} mm/s", end, request.passes, speed)
        told(f"back at {1e3 * speed:g} mm/s", begin, 0, speed)
    told("to the middle", middle, 0, fastest)
    total = len(request.speeds_m_s) * request.passes
    return {
        "sweeps": rows,
        "note": f"{total} ways of {1e3 * request.length_m:g} mm along the picture's rows, there and back",
        "problems": [f"{row['index']}: {row['problem']}" for row in rows if row["problem"]],
    }
