"""A six-axis arm that is no UR, from its ROBOT file: planned, guarded and driven through a cone capture."""

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.poses import from_pose6, log_xi
from daemon.config import ConfigInvalid
from fakes.object import run_virtual
from fakes.world.toml_text import to_toml
from tests.kit.ideal_world import ideal_text
from tests.kit.object_cell import no_report, open_cell, write_config

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

ROBOT: dict[str, Any] = json.loads(Path("docs/examples/robots/irb120.json").read_text("utf-8"))
HOME = [0.0, 0.19, 0.31, 0.0, 1.07, 0.0]
MOUNT = [0.006, -0.0520, 0.0310, 0.026, -0.031, 0.032]


@pytest.fixture
def scenario(tmp_path: Path) -> str:
    """The capture's shipped world with an IRB 120 above a smaller board."""
    tables = tomllib.loads(ideal_text("hand_eye"))
    world, cell = tables["world"], tables["cell"]
    arm = {key: value for key, value in world["arm"].items() if key != "model"}
    world["arm"] = arm | {"robot": ROBOT, "q_start": HOME}
    world["tool"] |= {"T_flange_tool": [0.0, 0.0, 0.06, 0.0, 0.0, 0.0], "radius_m": 0.02, "payload_kg": 0.4}
    world["camera"] |= {"T_flange_camera": MOUNT, "nominal": [0.0, -0.045, 0.025, 0.0, 0.0, 0.0]}
    world["target"] |= {"square_m": 0.018, "marker_m": 0.013}
    world["placement"] = [{"T_base_target": [0.26, 0.02, 0.07, 3.1, 0.05, 0.02]}]
    cell["poses"] = {"home": HOME}
    cell["limits"]["workspace"] = [{"min": [-0.8, -0.8, 0.0], "max": [0.8, 0.8, 1.1]}]
    cell["job"]["cone-capture"] |= {"placements": 1, "distance_m": 0.3}
    path = tmp_path / "scenario.toml"
    path.write_text(to_toml(tables), "utf-8")
    return str(path)


def test_the_camera_is_found_within_the_stated_uncertainty(scenario: str, tmp_path: Path) -> None:
    async def main() -> dict[str, Any]:
        config = write_config(tmp_path, scenario, job={"poses_per_placement": 8, "frames_per_pose": 3})
        assert config.robot.model == "robot.json"
        async with open_cell(config) as cell:
            end = await cell.run_job()
            assert end["outcome"] == "complete", end
            result: dict[str, Any] = cell.result(1)
            return result

    result = run_virtual(main())
    found = from_pose6(np.array(result["result"]["T_flange_camera"]))
    error = log_xi(from_pose6(np.array(MOUNT)).inv() * found)
    distance = error @ np.linalg.solve(np.array(result["result"]["cov"]), error)
    assert distance < 22.5, "one of 1000 errors is farther off"
    assert np.linalg.norm(error[:3]) < 5e-4


def test_a_speed_that_one_of_its_joints_cannot_reach_is_a_finding(scenario: str, tmp_path: Path) -> None:
    slow = ROBOT | {"joint_speeds_rad_s": [0.5, *ROBOT["joint_speeds_rad_s"][1:]]}
    text = Path(scenario).read_text("utf-8")
    tables = tomllib.loads(text)
    tables["world"]["arm"]["robot"] = slow
    Path(scenario).write_text(to_toml(tables), "utf-8")
    with pytest.raises(ConfigInvalid, match=r"0.8 is above 0.5 of joint 1 in robot.json; lower it"):
        write_config(tmp_path, scenario)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"joint_limits": [[1.0, -1.0]] * 6}, "joint 1: 1 is not below -1"),
        ({"capsules": []}, "capsules"),
        ({"familiy": "serial6"}, "familiy"),
        ({"family": "serial"}, "robot.json"),
    ],
)
def test_a_wrong_robot_file_is_one_finding_and_the_others_are_not_lost(
    scenario: str, tmp_path: Path, change: dict[str, Any], told: str
) -> None:
    path = tmp_path / "cell.toml"
    write_config(tmp_path, scenario)
    (tmp_path / "robot.json").write_text(json.dumps(ROBOT | change), "utf-8")
    path.write_text(path.read_text("utf-8").replace("settle_s", "setle_s"), "utf-8")
    from daemon.config import load_config

    with pytest.raises(ConfigInvalid) as caught:
        load_config(path)
    assert "robot.model" in str(caught.value)
    assert told in str(caught.value)
    assert "setle_s" in str(caught.value)
