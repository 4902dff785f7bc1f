"""Tracker points of an arm that is a little off, for tests: the truth is made without our own kinematics.

The arms are composed here from 4x4 matrices, link by link.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.identification.estimator import Problem
from calibration.identification.model import make_model
from calibration.kinematics.families import arm_spec
from cell.formats.robot import parse_robot
from cell.poses import Array

SIGMA0, SIGMA_PER_M = 15e-6, 6e-6
PALLETIZER: dict[str, float] = {
    "a1": 0.3, "a2": 1.2, "a3": 1.1, "a4": 0.2, "a5": 0.05, "d1": 0.8, "d5": -0.2,
    "k1": 1.0, "k2": 1.0, "k3": 1.0, "k5": -1.0, "t1": 0.0, "t2": 0.0, "t3": 0.0, "t5": 0.0,
    "tx": 0.1, "ty": 0.05, "tz": -0.1,
}  # fmt: skip
UR10E_A = (0.0, -0.6127, -0.57155, 0.0, 0.0, 0.0)
UR10E_D = (0.1807, 0.0, 0.0, 0.17415, 0.11985, 0.11655)
UR10E_ALPHA = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)
TOOL = (0.03, 0.05, 0.12)
RANGES = {
    "palletizer": ((-2.5, 0.6, -2.4, -3.0), (2.5, 2.3, -0.6, 3.0)),
    "ur10e": ((-2.9, -2.6, -2.4, -3.0, -2.6, -3.0), (2.9, -0.4, 2.4, 3.0, 2.6, 3.0)),
}


def turn(axis: str, angle: Array | float) -> Array:
    """(..., 4, 4) for angles (...)."""
    i, j = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    T = np.tile(np.eye(4), (*np.shape(angle), 1, 1))
    T[..., i, i] = T[..., j, j] = np.cos(angle)
    T[..., j, i] = np.sin(angle)
    T[..., i, j] = -T[..., j, i]
    return T


def shift(x: float, y: float, z: float) -> Array:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def link(theta: Array | float, d: float, a: float, alpha: float, beta: float = 0.0) -> Array:
    return turn("z", theta) @ shift(0, 0, d) @ shift(a, 0, 0) @ turn("x", alpha) @ turn("y", beta)


def palletizer_flange(p: Mapping[str, float], Q: Array) -> Array:
    """The model of a palletizer, row by row; (..., 4, 4) for joints (..., 4)."""
    q = np.moveaxis(Q, -1, 0)
    two, three = p["k2"] * q[1] + p["t2"], p["k3"] * q[2] + p["t3"]
    return (
        link(p["k1"] * q[0] + p["t1"], p["d1"], p["a1"], np.pi / 2)
        @ link(two, 0, p["a2"], 0)
        @ link(three, 0, p["a3"], 0)
        @ link(-two - three, 0, p["a4"], -np.pi / 2)
        @ link(p["k5"] * q[3] + p["t5"], p["d5"], p["a5"], 0)
    )


def ur_flange(rows: Array, Q: Array) -> Array:
    """(..., 4, 4) for joints (..., 6); ``rows`` (6, 5): theta, d, a, alpha, beta."""
    T = np.eye(4)
    for row, angle in zip(rows, np.moveaxis(Q, -1, 0), strict=True):
        T = T @ link(row[0] + angle, *row[1:])
    return T


@dataclass(frozen=True)
class Truth:
    """An arm with errors and where the tracker stands; ``flange(Q)`` is (..., 4, 4) in the base."""

    kind: str
    table: Any
    tools: dict[str, Array]
    T_tracker_base: Array

    def flange(self, Q: Sequence[float] | Array) -> Array:
        return (palletizer_flange if self.kind == "palletizer" else ur_flange)(self.table, np.asarray(Q))

    def p_tracker(self, Q: Array, targets: Sequence[str]) -> Array:
        """(n, 3)"""
        tools = np.array([[*self.tools[t], 1.0] for t in targets])
        points = self.flange(Q) @ tools[:, :, None]
        return np.asarray((self.T_tracker_base @ points)[:, :3, 0])


@dataclass(frozen=True)
class Scene:
    """A measured set: ``data`` as its file holds it, and what it was made from."""

    data: dict[str, Any]
    truth: Truth
    blunders: list[int]

    def write(self, folder: Path, name: str = "kincal.json") -> Path:
        path = folder / name
        path.write_text(json.dumps(self.data), "utf-8")
        return path

    def changed(self, **keys: Any) -> "Scene":
        return replace(self, data={k: v for k, v in {**self.data, **keys}.items() if v is not None})

    @property
    def Q(self) -> Array:
        return np.array([s["q"] for s in self.data["samples"]])

    @property
    def problem(self) -> Problem:
        """In memory, without the file."""
        spec = arm_spec(parse_robot(self.data["robot"], "robot"))
        names = [s["target"] for s in self.data["samples"]]
        targets = list(dict.fromkeys(names))
        p = np.array([s["p_tracker"] for s in self.data["samples"]]).T.copy()
        return Problem(make_model(spec, targets), self.Q, p, np.array([targets.index(t) for t in names]))


def joints(kind: str, rng: np.random.Generator, count: int) -> Array:
    low, high = RANGES[kind]
    return rng.uniform(low, high, (count, len(low)))


def make_scene(
    kind: str,
    seed: int = 0,
    count: int = 60,
    *,
    blunders: int = 0,
    noise: float = 1.0,
    tools: Mapping[str, Sequence[float]] | None = None,
) -> Scene:
    """Errors of 1 mm, 2 mrad, half a per mille; a tracker 3.5 m away, 15 um + 6 um/m times ``noise``."""
    rng = np.random.default_rng(seed)
    places = {"smr1": TOOL} if tools is None else dict(tools)
    table: Any
    if kind == "palletizer":
        sd = {"k": 5e-4, "t": 2e-3, "a": 1e-3, "d": 1e-3}
        sizes = {name: 1e-3 if name in ("tx", "ty", "tz") else sd[name[0]] for name in PALLETIZER}
        table = {name: v + sizes[name] * rng.normal() for name, v in PALLETIZER.items()}
        robot: dict[str, Any] = {"family": "palletizer4", "parameters": PALLETIZER}
        true = {name: np.array(v) + 1e-3 * rng.normal(size=3) for name, v in places.items()}
        true["smr1"] = np.array([table["tx"], table["ty"], table["tz"]])
        if more := {name: list(v) for name, v in places.items() if name != "smr1"}:
            robot["tool"] = more
    else:
        nominal = np.column_stack([np.zeros(6), UR10E_D, UR10E_A, UR10E_ALPHA, np.zeros(6)])
        table = nominal + rng.normal(size=(6, 5)) * [2e-3, 1e-3, 1e-3, 2e-3, 2e-3]
        table[[0, 3, 4, 5], 4] = 0.0  # only where axes are near parallel
        robot = {"model": "ur10e", "tool": {name: list(v) for name, v in places.items()}}
        true = {name: np.array(v) + 1e-3 * rng.normal(size=3) for name, v in places.items()}
    T = np.eye(4)
    T[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    away = rng.normal(size=3)
    T[:3, 3] = 3.5 * away / np.linalg.norm(away)
    truth = Truth(kind, table, true, T)
    Q = joints(kind, rng, count)
    targets = [list(places)[k % len(places)] for k in range(count)]
    p = truth.p_tracker(Q, targets)
    p += rng.normal(size=p.shape) * noise * (SIGMA0 + SIGMA_PER_M * np.linalg.norm(p, axis=1))[:, None]
    bad = sorted(int(k) for k in rng.permutation(count)[:blunders])
    for k in bad:
        direction = rng.normal(size=3)
        p[k] += 1e-3 * direction / np.linalg.norm(direction)
    samples = [
        {"q": q.tolist(), "p_tracker": point.tolist(), "target": t}
        for q, point, t in zip(Q, p, targets, strict=True)
    ]
    return Scene({"schema": "cellward.kincal/1", "robot": robot, "samples": samples}, truth, bad)
