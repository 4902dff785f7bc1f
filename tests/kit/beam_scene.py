"""A twin's arm above light beams, and how far its tool is from them by other means than the twin's own."""

from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from cell.poses import from_pose6
from fakes.world.arm.kinematics import chain
from fakes.world.scenario import Scenario
from fakes.world.world import World

ARM = chain("ur10e")
HOME = np.array([0.0, -1.8, 1.8, -1.57, -1.57, 0.0])
# The tool's point is here, and the tool points straight down.
OVER = RigidTransform.from_components([-0.65, -0.15, 0.35], Rotation.from_rotvec([np.pi, 0.0, 0.0]))
TOOL = from_pose6([0.0, 0.0, 0.18, 0.0, 0.0, 0.0])
Q0 = ARM.inverse(OVER * TOOL.inv(), HOME)
PIN, BEAM = 0.003, 0.0005
Beam = dict[str, Any]
Edges = list[tuple[float, bool]]


def beam(point: Any, way: Any, **more: Any) -> Beam:
    """A beam at ``point`` relative to where the tool's point is at first."""
    middle = (OVER.translation + np.asarray(point)).tolist()
    return {"point": middle, "dir": list(way), "latency_s": 0.0, "radius_m": BEAM, **more}


def world(repeatability_m: float = 0.0, shape: Any = None, **beams: Beam) -> World:
    raw: dict[str, Any] = {
        "seed": 3,
        "arm": {"model": "ur10e", "q_start": Q0.tolist(), "repeatability_t_m": repeatability_m},
        "beams": beams,
    }
    if repeatability_m:
        raw["arm"]["repeatability_r_rad"] = 1e-4
    if shape is not None:
        raw["tool"] = {"shape": shape}
    return World.from_scenario(Scenario.model_validate({"schema": "cellward.scenario/1", "world": raw}))


def shift(subject: World, t: float, way: Any, v: float, a: float = 1.0) -> float:
    """Move the tool straight by ``way`` in the base; returns when it rests."""
    goal = RigidTransform.from_translation(way) * subject.believed_flange(subject.track.end_time) * TOOL
    return subject.track.start_linear_move(t, subject.believed, goal, TOOL, v, a)


def gap(subject: World, name: str, t: float) -> float:
    """Least distance (m) of the tool's surface from the light, where both truly are."""
    flange = subject.true_flange(t).as_matrix()[None]
    return float(gaps(subject, name, flange @ subject.T_flange_tool_at(t).as_matrix())[0])


def gaps(subject: World, name: str, tools: np.ndarray) -> np.ndarray:
    """The same for many poses of the tool (n, 4, 4)."""
    truth = subject.config.beams[name]
    way = np.array(truth.dir) / np.linalg.norm(truth.dir)
    c, d = (np.array(truth.point) + s * 0.5 * truth.length_m * way for s in (-1, 1))
    found = []
    for capsule in subject.config.tool.shape:
        a, b = (tools[:, :3, :3] @ np.array(end) + tools[:, :3, 3] for end in (capsule.from_, capsule.to))
        found.append(segments_apart(a, b, c, d) - capsule.radius_m)
    return np.min(found, axis=0) - truth.radius_m


def segments_apart(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """The least of all candidates: each end against the other segment, and line against line."""

    def to_segment(p: np.ndarray, s: np.ndarray, e: np.ndarray) -> np.ndarray:
        u = e - s
        f = np.clip(np.sum((p - s) * u, axis=-1) / np.maximum(np.sum(u * u, axis=-1), 1e-30), 0.0, 1.0)
        return np.linalg.norm(p - s - f[..., None] * u, axis=-1)

    least = np.min(
        [to_segment(a, c, d), to_segment(b, c, d), to_segment(c, a, b), to_segment(d, a, b)], axis=0
    )
    normal = np.cross(b - a, d - c)
    size = np.linalg.norm(normal, axis=-1)
    skew = size > 1e-12
    size = np.where(skew, size, 1.0)
    # The lines' nearest points lie inside when either segment's ends are on both sides of the plane that
    # holds the other line and the common normal.
    inside = skew
    for start, end, other, along in ((a, b, c, d - c), (c, d, a, b - a)):
        plane = np.cross(along, normal)
        before = np.sum((start - other) * plane, axis=-1)
        inside = inside & (before * np.sum((end - other) * plane, axis=-1) < 0.0)
    lines = np.abs(np.sum((c - a) * normal, axis=-1)) / size
    return np.where(inside, np.minimum(least, lines), least)


def assert_crossings(subject: World, name: str, edges: Edges) -> None:
    """At every edge the gap passes its threshold within a microsecond, and in the direction that it says."""
    half = 0.5 * subject.config.beams[name].hysteresis_m
    for t, broken in edges:
        threshold = -half if broken else half
        before, after = gap(subject, name, t - 1e-6) - threshold, gap(subject, name, t + 1e-6) - threshold
        assert before * after < 0.0
        assert (after < 0.0) == broken


def looked_up(subject: World, name: str, times: np.ndarray, values: np.ndarray) -> Edges:
    """The edges that looks at ``times`` see, each at the time of the look that sees it first."""
    half = 0.5 * subject.config.beams[name].hysteresis_m
    broken, out = bool(values[0] < 0.0), []
    for t, g in zip(times.tolist(), values.tolist(), strict=True):
        if (g > half) if broken else (g < -half):
            broken = not broken
            out.append((t, broken))
    return out
