"""The tracker's job in a cell on virtual time: short plans, and what the arm truly does."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from cell.poses import Array, from_pose6
from daemon.config import CellConfig
from fakes.world.scenario import Scenario
from fakes.world.world import World
from procedures.tracker.judging import places
from procedures.twin_arm import observed_flange
from tests.kit.object_cell import write_config

JOB = "tracker-sampling"
BRISK = {
    "speed_m_s": 1.0,
    "accel_m_s2": 10.0,
    "joint_speed_rad_s": 3.0,
    "joint_accel_rad_s2": 20.0,
    "workspace": [{"min": [-1.4, -1.4, 0.0], "max": [1.4, 1.4, 1.8]}],
}
QUICK = {
    "poses": 12,
    "settle_s": 0.1,
    "window_s": 0.2,
    "reacquire_wait_s": 0.2,
    "find_timeout_s": 2.0,
    "max_predicted_m": 0.01,
    "accept": {"max_error_m": 0.01},
}


def reflectors(scenario: str, *names: str) -> dict[str, Any]:
    """Those of the scenario as the operator believes them: where they sit, and which way they look."""
    truth = Scenario.load(scenario).world.reflectors
    return {
        name: {"point": truth[name].point}
        | ({"normal": truth[name].normal, "half_angle_rad": 0.9} if truth[name].normal else {})
        for name in names
    }


def monuments(scenario: str) -> dict[str, Any]:
    """The scenario's monuments, as configured to a centimetre."""
    truth = Scenario.load(scenario).world.reflectors
    return {
        name: {"point": [round(v + 0.01, 3) for v in r.point]} for name, r in truth.items() if r.on == "base"
    }


def nominal_tracker(scenario: str) -> list[float]:
    """Where the drawing has the tracker: a few centimetres and 0.4 degrees off."""
    tracker = Scenario.load(scenario).world.tracker
    assert tracker is not None
    x, y, z, rx, ry, rz = tracker.T_base_tracker
    return [x + 0.015, y - 0.015, z + 0.01, rx, ry, rz + 0.007]


def tracker_config(
    folder: Path,
    job: Mapping[str, Any] | None = None,
    quick: bool = True,
    scenario: str = "tracker:ideal",
    **overrides: Any,
) -> CellConfig:
    """The cell of a tracker and a UR10e with fast moves and few poses; ``job`` goes into its section."""
    section: dict[str, Any] = {
        "reflectors": reflectors(scenario, "smr1"),
        "monuments": monuments(scenario),
        "T_base_tracker_nominal": nominal_tracker(scenario),
        **(QUICK if quick else {}),
        **(job or {}),
    }
    observed = Scenario.load(scenario).world.observed
    if observed is not None:
        p = observed.parameters
        section |= {
            "arm": "observed_arm",
            "payload_kg": 40.0,
            "joint_ranges_rad": [list(low_high) for low_high in observed.limits],
            "reflectors": {"smr1": {"point": [p.tx, p.ty, p.tz]}},
            **(job or {}),
        }
    overrides.setdefault("limits", BRISK)
    return write_config(folder, scenario, jobs={JOB: section}, **overrides)


def true_errors(world: World, result: Mapping[str, Any], Q: Array, reflector: str = "smr1") -> Array:
    """(n,) m: how far off a result predicts where the tracker truly has a reflector, at joints ``Q`` (n, j).

    The truth is the twin's own kinematics; no noise is in it.
    """
    truth = world.config.reflectors[reflector]
    assert world.tracker is not None
    stand = world.tracker.stand.at(world.t0)
    if truth.on == "arm":
        flange = world.true.forward(Q)
    else:  # gears and weight of an observed arm turn its joints, too
        flange = RigidTransform.from_matrix(observed_flange(world.truth()["observed"], Q))
    true = stand.inv().apply(flange.apply(truth.point))
    samples = [{"q": q.tolist(), "target": reflector} for q in Q]
    answer = result["result"]
    predicted = from_pose6(answer["T_tracker_base"]).apply(places(answer["robot"], samples))
    out: Array = np.linalg.norm(predicted - true, axis=1)
    return out


def rms(x: Array) -> float:
    return float(np.sqrt(np.mean(np.square(x))))
