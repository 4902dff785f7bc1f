"""Passes of a cylinder through two thin beams, computed exactly, and the run folder of a crossed-beam job."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from cell.poses import Array
from tests.kit.whole_results import whole

DOWN = Rotation.from_rotvec([np.pi, 0.0, 0.0])
BEAMS: dict[str, dict[str, list[float]]] = {
    "xs": {"point": [0.50, 0.10, 0.200], "dir": [1.0, 0.0, 0.0]},
    "ys": {"point": [0.52, 0.08, 0.200], "dir": [0.02, 0.9998, 0.0]},
}
P_REF, AXIS_REF, RADIUS = np.array([0.0, 0.0, 0.18]), np.array([0.0, 0.0, 1.0]), 0.003
DEPTHS = (0.006, 0.031)  # of the tool's point below the beams
POLL_S, SPEED, LATENCY_S, REACH = 0.005, 0.02, 0.008, 0.012


@dataclass
class Bench:
    """Makes passes; ``shift`` (3,) m and ``turn`` (3,) rad of the tool in the flange."""

    shift: Array = field(default_factory=lambda: np.zeros(3))
    turn: Array = field(default_factory=lambda: np.zeros(3))
    seed: int = 1

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)
        self._t = 100.0

    def passes(self, ways: int = 4, nominal: Array = P_REF) -> list[dict[str, Any]]:
        """``ways`` out and back at each of two depths of ``nominal``, and three ways that look for z."""
        found = []
        for beam in BEAMS:
            for depth in DEPTHS:
                for _ in range(ways):
                    found += [self.way(beam, direction, -depth, nominal) for direction in (1, -1)]
            for height in (0.0002, -0.0002, 0.00001):
                found.append(self.way(beam, 1, height + float(self.shift[2]), nominal))
        return found

    def way(self, beam: str, direction: int, height: float, nominal: Array) -> dict[str, Any]:
        """One PASS with the nominal point ``height`` above the beam."""
        point, along = (np.array(BEAMS[beam][key]) for key in ("point", "dir"))
        across = np.cross([0.0, 0.0, 1.0], along / np.linalg.norm(along))
        middle = point - DOWN.apply(nominal) + np.array([0.0, 0.0, height])
        n = round(2 * REACH / SPEED / 0.002)
        s = direction * np.linspace(-REACH, REACH, n)
        pose_t = self._t + 0.002 * np.arange(n)
        xyz = middle + s[:, None] * across
        poll_t = np.arange(pose_t[0] + POLL_S * self._rng.random(), pose_t[-1], POLL_S)
        poll_t = poll_t + self._rng.normal(0.0, 2e-4, poll_t.shape)
        seen = np.interp(poll_t - LATENCY_S, pose_t, s)
        broken = self._broken(middle + seen[:, None] * across, point, across)
        self._t += 0.002 * n + 0.3
        return {
            "beam": beam,
            "dir": direction,
            "z": float(middle[2]),
            "pose_t": np.round(pose_t, 6).tolist(),
            "pose_xyz": np.round(xyz, 8).tolist(),
            "poll_t": np.round(poll_t, 6).tolist(),
            "poll_v": broken.astype(int).tolist(),
        }

    def _broken(self, flange: Array, point: Array, across: Array) -> Array:
        """(n,) whether the axis is nearer than its radius to the beam, and its point not above it."""
        tip = flange + DOWN.apply(P_REF + self.shift)
        axis = DOWN.apply(Rotation.from_rotvec(self.turn).apply(AXIS_REF))  # points down
        up = (point[2] - tip[:, 2]) / axis[2]
        at_beam = tip + up[:, None] * axis
        return (tip[:, 2] <= point[2]) & (np.abs((at_beam - point) @ across) < RADIUS)


def data_set(shift: Sequence[float], turn: Sequence[float], ways: int = 4, seed: int = 1) -> dict[str, Any]:
    """``cellward.laser/1`` of a straight reference and a tool that is off by ``shift`` and ``turn``."""
    return {
        "schema": "cellward.laser/1",
        "R_base_flange": DOWN.as_rotvec().tolist(),
        "beams": BEAMS,
        "tool": {"id": "pin", "p_ref": P_REF.tolist(), "axis_ref": AXIS_REF.tolist(), "radius": RADIUS},
        "reference": {"passes": Bench(seed=seed).passes(ways)},
        "current": {"passes": Bench(np.array(shift), np.array(turn), seed + 1).passes(ways)},
    }


def measured(shift: Sequence[float], turn: Sequence[float] | None) -> dict[str, Any]:
    """A judged result of kind ``laser`` with 9 um across, 6 um along the tool and 0.15 mrad."""
    sigma = [9e-6, 9e-6, 6e-6, 1.5e-4, 1.5e-4, 0.0]
    tilt = float(np.linalg.norm(turn if turn is not None else 0.0))
    moved = {"shift_m": list(shift), "shift": float(np.linalg.norm(shift)), "tilt_rad": tilt}
    days = [1.7e9 + 86400.0 * k for k in range(12)]
    trend = {
        "beams.latency_s.beams": [[t, LATENCY_S + 1e-4 * np.sin(k)] for k, t in enumerate(days)],
        "beams.hysteresis_m.beams": [[t, 5e-5] for t in days],
    }
    for axis, value in zip("xyz", shift, strict=True):
        trend[f"tool.offset_{axis}_m.pin"] = [[t, value * k / 11] for k, t in enumerate(days)]
    second = {"apart_m": [8e-6, -5e-6, 4e-6], "apart": 1.02e-5, "U_m": 3.3e-5, "meets": True}
    return whole(
        {
            "schema": "cellward.result/1",
            "kind": "laser",
            "verdict": "pass",
            "reasons": [],
            "warnings": [],
            "result": {
                "dp_flange": list(shift),
                "drot_flange": None if turn is None else list(turn),
                "flange_offset_base": (-DOWN.apply(shift)).tolist(),
                "tau": LATENCY_S,
                "latency_s": LATENCY_S,
                "cov": np.diag(np.square(sigma)).tolist(),
                "rejected": [],
                "against_reference": moved,
                "against_last": moved,
            },
            "uncertainty": {"U_point_m": 0.0000229},
            "inputs": {
                "solve_seconds": 0.012,
                "trend": trend,
                "update": {"second_scan": second, "committed": True, "accepted_by": "policy"},
            },
        }
    )


def reference_document(passes: Sequence[Any]) -> dict[str, Any]:
    """What ``laser-reference`` keeps: the beams as found, and where the flange was at the hits."""
    hits = {name: (np.array(beam["point"]) - DOWN.apply(P_REF)).tolist() for name, beam in BEAMS.items()}
    return {
        "schema": "cellward.laser-reference/1",
        "tool": {"id": "pin", "p_ref": P_REF.tolist(), "axis_ref": AXIS_REF.tolist(), "radius": RADIUS},
        "R_base_flange": DOWN.as_rotvec().tolist(),
        "beams": BEAMS,
        "hits": hits,
        "passes": list(passes),
        "tau": LATENCY_S,
        "tau_s": LATENCY_S,
        "cov": np.diag([1e-10] * 3 + [4e-8] * 2 + [0.0]).tolist(),
        "plane": {"gap_m": -0.0003, "slope_rad": {"xs": 0.0, "ys": -0.001}},
    }


def make_run(folder: Path, result: dict[str, Any], data: dict[str, Any], job: str = "laser-update") -> Path:
    """A run folder as it is when its report is drawn."""
    limits = {
        "against_reference": {"max_shift_m": 0.003, "max_tilt_rad": 0.03},
        "against_last": {"max_shift_m": 0.001, "max_tilt_rad": 0.02},
        "max_U_m": 0.0002,
        "max_plane_gap_m": 0.002,
        "max_slope_rad": 0.02,
        "accept": {"auto": True},
    }
    run = {
        "run_id": 31,
        "job": job,
        "started": "2026-01-02T03:04:05+00:00",
        "config": {"cell": {"name": "bay-3", "twin": True}},
        "identities": {"beams": {"model": "generic", "serial": "99993300001"}},
        "job_config": limits,
        "values": {
            "payload_kg": 1.2,
            "tool": {"name": "pin", "T_flange_tool": [0, 0, 0.18, 0, 0, 0], "radius_m": 0.03},
            "versions": {"T_flange_tool.pin": 2},
            "laser_reference": reference_document(data["reference"]["passes"]),
        },
    }
    states = ["prepare", "plan", "approach", *["sweep", "return"] * 4, "retract", "solve", "commit"]
    journal = [{"t": 10.0 + k, "kind": "state", "state": name, "why": ""} for k, name in enumerate(states)]
    journal.append({"t": 30.0, "kind": "decision", "event": "pass not used", "why": "no poll for 40 ms"})
    journal.append(
        {"t": 31.0, "kind": "decision", "event": "committed", "name": "T_flange_tool.pin", "version": 3}
    )
    for name, content in (("result", result), ("laser", data), ("run", run)):
        (folder / f"{name}.json").write_text(json.dumps(content))
    (folder / "journal.jsonl").write_text("".join(json.dumps(line) + "\n" for line in journal))
    return folder
