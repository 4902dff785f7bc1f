"""The beams that a reference found beside the true ones, with an arm that is not as it is believed to be."""

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from calibration.kinematics import robot_from_spec
from procedures.laser.truth import judge_beams
from procedures.twin_arm import true_flange

Q_AUX = {
    "xs": [-1.08745, -1.665038, 2.09094, -1.996698, -1.570796, 0.483346],
    "ys": [-1.020579, -1.626522, 2.055822, -2.000097, -1.570796, 0.550218],
}
TOOL = [0.0, 0.0, 0.18, 0.0, 0.0, 0.0]
WAYS = {"xs": np.array([1.0, 0.0, 0.0]), "ys": np.array([0.0, 1.0, 0.0])}
RADIUS_M, HYSTERESIS_M, MIDDLE_M = 5e-4, 5e-5, 0.025
ROBOT = {
    "model": "ur10e",
    "factory": {"delta_theta": [0.0] * 6},
    "error": {"delta_theta": [0.0, 3e-4, -5e-4, 4e-4, 2e-4, 0.0]},
    "joint_errors": [
        {"joint": 2, "of": [0.0, 1.0, 0.0, 0.0, 0.0, 0.0], "sin": 1e-4, "cos": 5e-5, "name": "w"}
    ],
}


def crossed(name: str) -> tuple[np.ndarray, dict[str, Any]]:
    """Where the arm says that it met a beam, and the true beam: 30 mm below where the way across began."""
    believed = robot_from_spec({"model": "ur10e"})
    start = believed.forward(np.array(Q_AUX[name]))
    R = believed.forward(np.array(Q_AUX["xs"])).rotation
    flange = RigidTransform.from_components(start.translation + np.array([0.01, 0.01, -0.03]), R)
    q = cast(np.ndarray, believed.inverse(flange, np.array(Q_AUX[name])))
    met = RigidTransform.from_matrix(true_flange(ROBOT, q[None])[0]).apply(np.array(TOOL[:3]))
    light = met - [0.0, 0.0, RADIUS_M - 0.5 * HYSTERESIS_M] + MIDDLE_M * WAYS[name]
    beam = {
        "point": light.tolist(),
        "dir": WAYS[name].tolist(),
        "radius_m": RADIUS_M,
        "hysteresis_m": HYSTERESIS_M,
    }
    return flange.apply(np.array(TOOL[:3])), beam


def test_the_arms_own_error_is_taken_off_where_the_tool_met_a_beam(tmp_path: Path) -> None:
    found = {name: crossed(name) for name in Q_AUX}
    values = {"robot": {"model": "ur10e"}, "tool": {"T_flange_tool": TOOL}, "poses": Q_AUX}
    job = {name: {"input": name, "aux": name} for name in Q_AUX}
    (tmp_path / "run.json").write_text(json.dumps({"values": values, "job_config": job}), "utf-8")
    beams = {name: SimpleNamespace(point=point, dir=WAYS[name]) for name, (point, _) in found.items()}
    result = SimpleNamespace(result=SimpleNamespace(beams=beams), uncertainty=SimpleNamespace(U_point_m=2e-5))
    truth = {"robot": ROBOT, "beams": {name: beam for name, (_, beam) in found.items()}}
    judged = judge_beams(cast(Any, result), truth, tmp_path)
    assert judged.good
    assert float(judged.off.split()[0]) == pytest.approx(0.0, abs=1e-3)  # mm
