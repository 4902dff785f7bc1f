"""Scenario files: strict reading, and the cell.toml that goes with them."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from cell.errors import CellError, InputError
from cell.poses import from_pose6, log_xi
from fakes.kinematics import chain
from fakes.scenario import Scenario
from fakes.targets import target_points
from fakes.world import World

SHIPPED = ("hand_eye", "hand_eye_to_hand")
FOLDER = Path(__file__).parents[2] / "fakes" / "scenarios"


@pytest.fixture(params=SHIPPED)
def subject(request: pytest.FixtureRequest) -> Scenario:
    return Scenario.load(request.param)


def broken(old: str, new: str) -> str:
    text = (FOLDER / "hand_eye.toml").read_text("utf-8")
    assert old in text
    with pytest.raises(InputError) as caught:
        Scenario.parse(text.replace(old, new), "test.toml")
    return str(caught.value)


def test_a_file_and_a_shipped_name_read_the_same() -> None:
    assert Scenario.load("hand_eye") == Scenario.load(FOLDER / "hand_eye.toml")


def test_a_missing_scenario_is_said_to_be_missing() -> None:
    with pytest.raises(CellError, match="nowhere"):
        Scenario.load("nowhere")


def test_an_unknown_key_gets_its_place_and_a_suggestion() -> None:
    assert "world.camera.nois_px is not a known key, did you mean noise_px?" in broken("noise_px", "nois_px")


def test_all_findings_come_at_once() -> None:
    text = (FOLDER / "hand_eye.toml").read_text("utf-8")
    with pytest.raises(InputError) as caught:
        Scenario.parse(text.replace('"ur10e"', '"ur11"').replace("exposure_s = 0.008", "exposure_s = -1"))
    assert "ur11" in str(caught.value)
    assert "world.camera.exposure_s" in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"99991100001"', '"20235500123"', "world.arm.serial"),
        ("T_flange_camera =", "T_base_camera =", "T_flange_target"),
        ("dist = [0.021, -0.043, 0.0006, -0.0004, 0.0]", "dist = [0.1]", "dist has 1 entries"),
        ('bind = "127.0.0.2"', 'bind = "0.0.0.0"', "fakes.bind"),
        ("[world.arm]", "[world.arm", "is not TOML"),
        ("q_start = [0.0,", "q_start = [", "world.arm.q_start"),
    ],
)
def test_wrong_values_are_named(old: str, new: str, said: str) -> None:
    assert said in broken(old, new)


def test_faults_have_a_device_a_kind_and_a_time() -> None:
    text = (FOLDER / "hand_eye.toml").read_text("utf-8")
    fault = '[[fault]]\ndevice = "arm"\nkind = "protective-stop"\nwhen_s = 12.5\n'
    (entry,) = Scenario.parse(text + fault).fault
    assert (entry.device, entry.kind, entry.when_s) == ("arm", "protective-stop", 12.5)


def test_the_generated_cell_is_toml_that_says_twin_and_names_the_serials(subject: Scenario) -> None:
    arm = {"driver": "ur", "host": "127.0.0.2"}
    camera = {"driver": "oak", "source": 'frames+unix:///tmp/a b\\c".sock'}
    text = subject.cell_toml(arm, camera, "/tmp/state", "/tmp/c.sock", modbus={"bind": "127.0.0.1:5020"})
    cell = tomllib.loads(text)
    assert cell["cell"]["twin"] is True
    assert cell["device"]["camera"]["source"] == camera["source"]
    assert cell["device"]["arm"]["expect_serial"].startswith("9999")
    assert cell["device"]["camera"]["expect_serial"].startswith("9999")
    assert cell["target"]["board"] == subject.world.target
    assert cell["robot"]["tool"]["T_flange_tool"] == subject.world.tool.T_flange_tool
    assert cell["limits"]["workspace"][0]["min"] == [-1.3, -1.3, 0.0]
    assert cell["job"]["cone-capture"]["placements"] == 3


def test_overrides_replace_generated_tables(subject: Scenario) -> None:
    own = {"poses": {"other": [0.0] * 6}, "http": {"bind": "x"}}
    text = subject.cell_toml({}, {}, "a", "b", overrides=own, clock="fakes.object:VirtualClock")
    cell = tomllib.loads(text)
    assert cell["poses"] == {"other": [0.0] * 6}
    assert cell["http"] == {"bind": "x"}
    assert cell["cell"]["clock"] == "fakes.object:VirtualClock"


def test_the_drawing_is_ten_millimetres_and_three_degrees_off(subject: Scenario) -> None:
    nominal = from_pose6(subject.world.camera.nominal)
    true = from_pose6(subject.world.camera_mount)
    assert np.linalg.norm(true.translation - nominal.translation) == pytest.approx(0.010, abs=1e-4)
    assert np.linalg.norm(log_xi(nominal.inv() * true)[3:]) == pytest.approx(np.deg2rad(3.0), abs=1e-4)


@pytest.mark.parametrize("distance", [0.45, 0.5])
def test_every_placement_offers_a_whole_cone_that_the_arm_reaches(subject: Scenario, distance: float) -> None:
    world = World.from_scenario(subject)
    arm, start = chain(subject.world.arm.model), np.array(subject.world.arm.q_start)
    centre = target_points(subject.world.target).mean(axis=0)
    directions = []
    for mount in world.T_mount_target:
        for azimuth in np.arange(0.0, 2 * np.pi, np.pi / 4):
            tilt = Rotation.from_rotvec(0.44 * np.array([np.cos(azimuth), np.sin(azimuth), 0.0]))
            T_target_camera = RigidTransform.from_components(centre - tilt.apply([0, 0, distance]), tilt)
            if subject.world.eye_in_hand:
                flange = mount * T_target_camera * world.T_mount_camera.inv()
            else:
                flange = world.T_mount_camera * T_target_camera.inv() * mount.inv()
            q = arm.inverse(flange, start)
            assert np.max(np.abs(q - start)) < 2.5
            assert flange.translation[2] > 0.2
        directions.append(mount.rotation.as_matrix()[:, 2])
    angles = [np.arccos(a @ b) for i, a in enumerate(directions) for b in directions[:i]]
    assert min(angles) > np.deg2rad(8.0), "the placements tilt differently"


def test_the_board_shows_whole_from_the_start_pose_in_every_placement(subject: Scenario) -> None:
    world = World.from_scenario(subject)
    points = target_points(subject.world.target)
    fx, fy, cx, cy = subject.world.camera.K
    for placement in range(len(world.T_mount_target)):
        world.operator.confirm(placement, 1.0 + placement)
        T = world.scene(1.0 + placement).T_camera_target
        assert T is not None
        x, y, z = T.apply(points).T
        u, v = fx * x / z + cx, fy * y / z + cy
        assert 20 < u.min() < u.max() < subject.world.camera.width - 20
        assert 20 < v.min() < v.max() < subject.world.camera.height - 20
