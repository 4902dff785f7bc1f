"""Passes of a solid tool through two light beams with known truth, computed in space, by no estimator.

A beam is a segment with a radius, a tool is made of capsules or of cylinders with flat ends; the beam is
broken while the two touch. The arm speeds up, crosses at constant speed and slows down; the input switches
late, and later in one sense than in the other if asked to; polls come with a period, a phase and jitter.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

DOWN = Rotation.from_rotvec([np.pi, 0.0, 0.0])
P_REF, AXIS_REF = np.array([0.0, 0.0, 0.18]), np.array([0.0, 0.0, 1.0])
POINT = np.array([0.5, 0.1, 0.2])  # where the beams cross


@dataclass(frozen=True)
class Beam:
    """A true beam: its middle, its direction, half its length and its radius, m."""

    point: np.ndarray
    direction: np.ndarray
    half_length: float = 0.3
    radius: float = 0.0


def beams(angle: float = 0.0, slope: float = 0.0, radius: float = 0.0) -> dict[str, Beam]:
    """``xs`` along base x and ``ys`` along y, the latter turned by ``angle`` (rad) and both rising by
    ``slope``."""
    xs = np.array([np.cos(slope), 0.0, np.sin(slope)])
    ys = np.array([-np.sin(angle) * np.cos(slope), np.cos(angle) * np.cos(slope), np.sin(slope)])
    return {
        "xs": Beam(POINT + 0.02 * xs, xs, radius=radius),
        "ys": Beam(POINT - 0.03 * ys, ys, radius=radius),
    }


@dataclass(frozen=True)
class Part:
    """A capsule (``round``, its cap centred on its end), a cylinder with a flat end, or (``ideal``) one that
    is hit when the end of its axis is below the beam. The end is ``offset`` (3,) m off the tool's point."""

    radius: float = 0.003
    round: bool = False
    ideal: bool = False
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    length: float = 0.12


PIN = (Part(),)
IDEAL = (Part(ideal=True),)
BALL = (Part(round=True),)
APEX = (Part(round=True, offset=(0.0, 0.0, -0.003)),)  # the point is the lowest of the ball
GRIPPER = (Part(0.004, offset=(0.008, 0.006, 0.0)), Part(0.004, offset=(-0.008, -0.006, 0.0)))


@dataclass
class Bench:
    """Fixture, arm and input. ``shift`` (3,) m and ``turn`` (3,) rad bend the tool about its point."""

    seed: int = 0
    speed: float = 0.02
    poll: float = 0.005
    R: Rotation = DOWN
    p_ref: np.ndarray = field(default_factory=lambda: P_REF.copy())
    axis_ref: np.ndarray = field(default_factory=lambda: AXIS_REF.copy())
    parts: Sequence[Part] = PIN
    beams: dict[str, Beam] = field(default_factory=beams)
    shift: Sequence[float] = (0.0, 0.0, 0.0)
    turn: Sequence[float] = (0.0, 0.0, 0.0)
    tau: float = 0.004
    lag: float = 0.0  # how much later the input clears than it breaks, s
    hysteresis: float = 0.0  # the input switches that much further along the way, m, half of it each way
    jitter: float = 2e-4  # of the polls' times, which are recorded
    pose_noise: float = 0.0
    pose_rate: float = 250.0
    accel: float = 0.5
    reach: float = 0.009
    along: float = 0.0  # how far along each beam it is crossed, m
    counters: bool = False

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.t = 50.0

    @property
    def bent(self) -> tuple[np.ndarray, Rotation]:
        """The tool's point in the flange, and what turns its axis."""
        return self.p_ref + np.array(self.shift), Rotation.from_rotvec(self.turn)

    def clearance(self, beam: Beam, flange: np.ndarray) -> np.ndarray:
        """(n,) m between beam and tool, with the flange at (n, 3) in the base; negative is broken."""
        point, turn = self.bent
        frame = _frame(self.axis_ref)
        axis = (self.R * turn).apply(self.axis_ref)
        found = []
        for part in self.parts:
            end = flange + self.R.apply(point + turn.apply(frame @ np.array(part.offset)))
            if part.ideal:
                n = np.cross(axis, beam.direction)
                side = np.abs((end - beam.point) @ n) / np.linalg.norm(n) - part.radius - beam.radius
                found.append(np.maximum(side, (end - beam.point)[:, 2]))
            elif part.round:
                top = end - part.length * axis
                found.append(_segments(end, top, beam) - part.radius - beam.radius)
            else:
                found.append(_cylinder(end, axis, part, beam))
        return np.asarray(np.min(found, axis=0))

    def way(self, name: str, direction: int, above: float, phase: float | None = None) -> dict[str, Any]:
        """One PASS with the reference's point ``above`` (m) the beam's middle plane."""
        beam = self.beams[name]
        across = np.cross([0.0, 0.0, 1.0], beam.direction)
        across /= np.linalg.norm(across)
        middle = beam.point + self.along * beam.direction - self.R.apply(self.p_ref)
        middle = middle + np.array([0.0, 0.0, above])
        ramp = self.speed**2 / (2.0 * self.accel)
        up, flat = self.speed / self.accel, 2.0 * self.reach / self.speed
        rest = 0.02

        def s(t: np.ndarray) -> np.ndarray:
            u = np.clip(t - rest, 0.0, 2.0 * up + flat)
            first = 0.5 * self.accel * np.minimum(u, up) ** 2
            last = np.clip(u - up - flat, 0.0, up)
            return (
                first
                + self.speed * np.clip(u - up, 0.0, flat)
                + self.speed * last
                - 0.5 * self.accel * last**2
                - ramp
                - self.reach
            )

        length = 2.0 * (up + rest) + flat
        fine = np.arange(0.0, length, 5e-4)
        gap = self.clearance(beam, middle + direction * s(fine)[:, None] * across)
        changes = self._changes(fine, gap)
        t_pose = np.arange(0.0, length, 1.0 / self.pose_rate)
        xyz = middle + direction * s(t_pose)[:, None] * across
        xyz = xyz + self.rng.normal(size=xyz.shape) * self.pose_noise
        start = self.poll * (self.rng.random() if phase is None else phase)
        t_poll = np.arange(start, length, self.poll)
        # When it polls jitters, and is recorded; what it then sees is exact.
        t_poll = t_poll + np.clip(self.rng.normal(size=len(t_poll)), -2, 2) * self.jitter
        seen = np.searchsorted(changes, t_poll)
        self.t += length + 0.1
        entry = {
            "beam": name,
            "dir": direction,
            "z": float(middle[2]),
            "pose_t": (self.t + t_pose).tolist(),
            "pose_xyz": xyz.tolist(),
            "poll_t": (self.t + t_poll).tolist(),
            "poll_v": (seen % 2).tolist(),
        }
        if self.counters:
            entry["poll_n"] = seen.tolist()
            entry["poll_dt"] = [2e-4] * len(seen)
        return entry

    def _changes(self, t: np.ndarray, gap: np.ndarray) -> np.ndarray:
        """Times at which the input changes, late as it is."""
        at = np.flatnonzero((gap[1:] < 0.0) != (gap[:-1] < 0.0))
        times = t[at] + (t[1] - t[0]) * gap[at] / (gap[at] - gap[at + 1])
        sense = np.where(np.arange(len(times)) % 2 == 0, -1.0, 1.0)
        return np.asarray(times + self.tau + 0.5 * sense * self.lag + 0.5 * self.hysteresis / self.speed)

    def there_and_back(self, name: str, above: float, phase: float | None = None) -> list[dict[str, Any]]:
        return [self.way(name, direction, above, phase) for direction in (1, -1)]

    def scan(
        self,
        pairs: int = 1,
        depths: Sequence[float] = (0.006,),
        step: float = 0.003,
        resolution: float = 2.5e-5,
        staggered: bool = False,
        search_speed: float | None = None,
    ) -> list[dict[str, Any]]:
        """Search down, bisect, and measure ``pairs`` ways there and back at each of ``depths``."""
        found = []
        measure = self.speed
        for name in self.beams:
            self.speed = search_speed or measure
            above, missed = 0.0015 + self.rng.random() * step, None
            while True:
                ways = self.there_and_back(name, above)
                found += ways
                if all(any(w["poll_v"]) for w in ways):
                    break
                missed, above = above, above - step
            low, high = above, above + step if missed is None else missed
            while high - low > resolution:
                middle = 0.5 * (low + high)
                ways = self.there_and_back(name, middle)
                found += ways
                low, high = (middle, high) if all(any(w["poll_v"]) for w in ways) else (low, middle)
            self.speed = measure
            for depth in depths:
                for k in range(pairs):
                    phase = ((k + self.rng.random()) / pairs) % 1.0 if staggered else None
                    found += self.there_and_back(name, low - depth, phase)
        return found


def data_set(now: Bench, before: Bench | None = None, **scan: Any) -> dict[str, Any]:
    """``cellward.laser/1`` of a reference and of the bent tool ``now``, with the true beams."""
    if before is None:
        before = replace(now, seed=now.seed + 5000, shift=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0))
    data = without_passes(now)
    data["reference"]["passes"], data["current"]["passes"] = before.scan(**scan), now.scan(**scan)
    return data


def without_passes(now: Bench) -> dict[str, Any]:
    """The same with two empty sets."""
    return {
        "schema": "cellward.laser/1",
        "R_base_flange": now.R.as_rotvec().tolist(),
        "beams": {
            k: {"point": b.point.tolist(), "dir": (2.0 * b.direction).tolist()} for k, b in now.beams.items()
        },
        "tool": {
            "id": "pin",
            "p_ref": now.p_ref.tolist(),
            "axis_ref": now.axis_ref.tolist(),
            "radius": now.parts[0].radius,
        },
        "reference": {"passes": []},
        "current": {"passes": []},
    }


def write(folder: Path, data: dict[str, Any]) -> Path:
    path = folder / "laser.json"
    path.write_text(json.dumps(data), "utf-8")
    return path


def _frame(axis: np.ndarray) -> np.ndarray:
    """(3, 3) with the axis as its third column."""
    return np.asarray(Rotation.align_vectors([axis], [[0.0, 0.0, 1.0]])[0].as_matrix())


def _segments(a: np.ndarray, b: np.ndarray, beam: Beam) -> np.ndarray:
    """(n,) least distance of the segments a..b (n, 3) from the beam, by trying ends and the inside."""
    p, q = beam.point - beam.half_length * beam.direction, beam.point + beam.half_length * beam.direction
    u, v = b - a, q - p
    w = a - p
    uu, uv, vv = np.sum(u * u, axis=1), u @ v, float(v @ v)
    uw, vw = np.sum(u * w, axis=1), w @ v
    det = uu * vv - uv**2
    s = np.clip(np.where(det > 1e-15, (uv * vw - vv * uw) / np.maximum(det, 1e-15), 0.0), 0.0, 1.0)
    t = np.clip((uv * s + vw) / vv, 0.0, 1.0)
    s = np.clip((uv * t - uw) / uu, 0.0, 1.0)
    return np.asarray(np.linalg.norm(w + s[:, None] * u - t[:, None] * v, axis=1))


def _cylinder(end: np.ndarray, axis: np.ndarray, part: Part, beam: Beam) -> np.ndarray:
    """(n,) m between a flat-ended cylinder and the beam, negative inside.

    Projected along the beam both are convex, and their distance is the largest over all directions across the
    beam (separating axes). Directions are close together where the projection has straight sides.
    """
    d = beam.direction
    up = axis - (axis @ d) * d
    up /= np.linalg.norm(up)
    apart = 0.25 * np.pi * np.linspace(0.0, 1.0, 200) ** 3
    quarter = np.concatenate([apart, 0.5 * np.pi - apart])
    angle = np.concatenate([k * 0.5 * np.pi + quarter for k in range(4)])[:, None]
    across = np.cos(angle) * up + np.sin(angle) * np.cross(d, up)
    lean = across @ axis
    reach = part.radius * np.sqrt(np.maximum(1.0 - lean**2, 0.0)) + np.maximum(-part.length * lean, 0.0)
    return np.asarray(np.max((beam.point - end) @ across.T - reach, axis=1)) - beam.radius
