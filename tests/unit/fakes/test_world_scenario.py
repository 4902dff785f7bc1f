"""Scenario files: strict reading, and the cell.toml that goes with them."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from typer.testing import CliRunner

from cell.errors import CellError, InputError
from cell.known_cell import KnownBeams, KnownCell
from cell.poses import from_pose6, log_xi
from fakes import cli
from fakes.likely.arm import draw_tool
from fakes.world.arm.kinematics import chain
from fakes.world.scenario import Scenario, shipped_scenarios
from fakes.world.targets import target_points
from fakes.world.world import World

SHIPPED = ("hand_eye", "hand_eye_to_hand")
WITH_BEAMS = ("laser", "bay")
FOLDER = Path(__file__).parents[3] / "fakes" / "scenarios"


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


def test_the_command_names_every_shipped_scenario_and_what_stands_in_it() -> None:
    names = {path.stem for path in FOLDER.glob("*.toml")}
    listed = CliRunner().invoke(cli.app, ["scenarios"])
    assert {line.split()[0] for line in listed.output.splitlines() if line[:1].isalpha()} == names
    assert len(listed.output) > 40 * len(names), "each with a description"
    without = CliRunner().invoke(cli.app, ["--bind", "127.0.0.2"])
    assert without.exit_code == 2
    assert all(name in without.output for name in names)


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
        ('model = "ur10e"', 'model = "ur10e"\nversion = "3.15.0"', "no UR10E has version 3.15.0"),
        ('model = "ur10e"', 'model = "ur10"\nversion = "5.12.4"', "no UR10 has version 5.12.4"),
        ('model = "ur10e"', 'model = "ur10e"\nversion = "new"', "world.arm.version"),
    ],
)
def test_wrong_values_are_named(old: str, new: str, said: str) -> None:
    assert said in broken(old, new)


def test_an_arm_has_a_controller_of_its_series() -> None:
    text = (FOLDER / "hand_eye.toml").read_text("utf-8")
    versions = [Scenario.parse(text.replace("ur10e", model)).world.arm.version for model in ("ur10e", "ur10")]
    assert versions == ["5.12.4", "3.15.0"]


def test_a_scenario_that_is_like_another_says_only_what_differs() -> None:
    subject, other = Scenario.load("picking_auto_exposure"), Scenario.load("picking")
    assert subject.world.camera.exposure().time_s == pytest.approx(0.081)
    assert other.world.camera.exposure().time_s == 0.004
    assert subject.world.model_copy(update={"camera": other.world.camera}) == other.world
    assert subject.cell.poses == other.cell.poses
    assert Scenario.load("picking_auto_exposure:ideal").world == Scenario.load("picking:ideal").world


def test_depth_of_shipped_scenarios_is_off_by_a_scale_that_ideal_ones_have_not() -> None:
    cameras = {name: Scenario.load(name).world.camera for name in shipped_scenarios()}
    scales = {n: camera.stereo.scale for n, camera in cameras.items() if camera and camera.stereo}
    assert list(scales) == [name for name, camera in cameras.items() if camera]
    off = np.abs(np.array(list(scales.values())) - 1.0)
    assert np.all((off > 0.002) & (off < 0.03))
    assert len(set(scales.values())) == 5  # and two are of cells like others
    for name in scales:
        ideal = Scenario.load(f"{name}:ideal").world.camera
        assert ideal is not None
        assert ideal.stereo is None


def test_what_a_scenario_is_like_has_to_be_a_shipped_one() -> None:
    with pytest.raises(CellError, match=r"mine: like = 'pickin' is not a shipped scenario: .*picking,"):
        Scenario.parse('schema = "cellward.scenario/1"\nlike = "pickin"', "mine")


def test_faults_have_a_device_a_kind_and_a_time() -> None:
    text = (FOLDER / "hand_eye.toml").read_text("utf-8")
    fault = '[[fault]]\ndevice = "arm"\nkind = "protective-stop"\nwhen_s = 12.5\n'
    (entry,) = Scenario.parse(text + fault).fault
    assert (entry.device, entry.kind, entry.when_s) == ("arm", "protective-stop", 12.5)


def test_the_generated_cell_is_toml_that_says_twin_and_names_the_serials(subject: Scenario) -> None:
    arm = {"driver": "ur", "host": "127.0.0.2"}
    camera = {"driver": "oak", "source": 'frames+unix:///tmp/a b\\c".sock'}
    text = subject.cell_toml(
        {"arm": arm, "camera": camera}, "/tmp/state", "/tmp/c.sock", modbus={"bind": "127.0.0.1:5020"}
    )
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
    text = subject.cell_toml(
        {"arm": {}, "camera": {}}, "a", "b", overrides=own, clock="fakes.object:VirtualClock"
    )
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


# -- cells with beams


@pytest.fixture(params=WITH_BEAMS)
def beamed(request: pytest.FixtureRequest) -> Scenario:
    return Scenario.load(request.param)


def test_the_generated_cell_has_a_role_and_a_table_for_the_input_module(beamed: Scenario) -> None:
    device = {"driver": "fakes.object:ObjectInputs", "scenario": "laser"}
    cell = tomllib.loads(beamed.cell_toml({"arm": {}, "camera": {}, "beams": device}, "a", "b"))
    assert cell["robot"]["beams"] == "beams"
    assert cell["device"]["beams"] == {**device, "expect_serial": "99993300001"}
    assert cell["job"]["laser-reference"]["xs"]["aux"] == "aux_xs"
    assert "beams" not in tomllib.loads(beamed.cell_toml({"arm": {}, "camera": {}}, "a", "b"))["device"]


def test_a_scenario_without_a_camera_makes_a_cell_without_one() -> None:
    cell = tomllib.loads(
        Scenario.load("laser:ideal").cell_toml(
            {"arm": {}, "camera": {"driver": "oak"}, "beams": {}}, "a", "b"
        )
    )
    assert sorted(cell["device"]) == ["arm", "beams"]
    assert not {"flange_camera", "fixed_camera", "T_base_camera_nominal"} & set(cell["robot"])
    assert "target" not in cell


def test_a_world_without_a_camera_has_the_rest_of_the_truth_and_says_what_it_lacks() -> None:
    world = World.from_scenario(Scenario.load("laser:ideal"))
    truth = json.loads(json.dumps(world.truth(), allow_nan=False))
    assert truth["T_flange_tool"] == truth["T_flange_tool_nominal"]
    assert set(truth["beams"]) == {"xs", "ys"}
    assert "camera" not in truth
    with pytest.raises(CellError, match=r"no \[world.camera\]"):
        _ = world.camera


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("inputs = { xs = 0, ys = 1 }", "inputs = { xs = 0, zs = 1 }", "zs is wired to an input"),
        ("hysteresis_m", "hysteresys_m", "did you mean hysteresis_m?"),
        ("dir = [1.0, 0.004, 0.0008]", "dir = [0.0, 0.0, 0.0]", "dir has no length"),
        ("from = [0.0, 0.0, -0.003],", "", "world.tool.shape.0.from"),
    ],
)
def test_wrong_tables_of_beams_are_named(old: str, new: str, said: str) -> None:
    text = (FOLDER / "laser.toml").read_text("utf-8")
    assert old in text
    with pytest.raises(InputError) as caught:
        Scenario.parse(text.replace(old, new))
    assert said in str(caught.value)


def test_a_camera_without_a_target_is_refused() -> None:
    text = (FOLDER / "hand_eye.toml").read_text("utf-8")
    lines = [line for line in text.splitlines() if "placement]]" not in line and "T_base_target" not in line]
    with pytest.raises(InputError, match="belong together"):
        Scenario.parse("\n".join(lines))


def test_the_beams_cross_slightly_askew_in_a_level_plane(beamed: Scenario) -> None:
    xs, ys = (beamed.world.beams[name] for name in ("xs", "ys"))
    u, v = (np.array(b.dir) / np.linalg.norm(b.dir) for b in (xs, ys))
    assert np.rad2deg(np.arccos(u @ v)) == pytest.approx(88.5, abs=0.01)
    assert max(abs(u[2]), abs(v[2])) < 1e-3
    assert abs(xs.point[2] - ys.point[2]) < 5e-4


def test_the_auxiliary_poses_are_beside_and_above_the_beams_with_the_tool_straight_down(
    beamed: Scenario,
) -> None:
    arm, tool = chain(beamed.world.arm.model), from_pose6(beamed.world.tool.T_flange_tool)
    job = beamed.cell.job["laser-reference"]
    for name in ("xs", "ys"):
        pose = arm.forward(beamed.cell.poses[f"aux_{name}"]) * tool
        beam = beamed.world.beams[name]
        off = pose.translation - np.array(beam.point)
        across = np.array(job[name]["across"])
        assert off @ across == pytest.approx(-0.015, abs=1e-4)
        assert off[2] == pytest.approx(0.008, abs=4e-4)
        down = Rotation.from_rotvec([np.pi, 0.0, 0.0])
        assert (down.inv() * pose.rotation).magnitude() < 1e-5


def test_a_pass_at_either_place_breaks_its_own_beam_and_no_other(beamed: Scenario) -> None:
    """The search's plan, lowest pass included, done in the world with the true arm."""
    job = beamed.cell.job["laser-reference"]
    for name, other in (("xs", "ys"), ("ys", "xs")):
        search = job[name]
        across = np.array(search["across"])
        along = np.array([-across[1], across[0], 0.0]) * search["along_m"]
        for place in (np.zeros(3), along):
            world = World.from_scenario(beamed)
            tool = world.T_flange_tool
            world.track.hold(0.0, beamed.cell.poses[f"aux_{name}"])
            here = world.believed_flange(0.0) * tool
            t = 1.0
            for way in (place, [0.0, 0.0, -0.008 - 0.006 - job["tilt_height_m"]]):
                here = RigidTransform.from_translation(way) * here
                t = world.track.start_linear_move(t, world.believed, here, tool, 0.05, 0.5) + 0.1
            assert world.beams.edges("xs", 0.0, t) == [] == world.beams.edges("ys", 0.0, t)
            here = RigidTransform.from_translation(search["distance_m"] * across) * here
            assert here.translation[2] > job["floor_m"]
            end = world.track.start_linear_move(t, world.believed, here, tool, 0.05, 0.5)
            (on, _), (off, _) = world.beams.edges(name, t, end)
            assert off - on == pytest.approx(0.007 / 0.05, abs=0.003)
            assert world.beams.count(other, end) == 0


def test_nothing_of_the_board_is_near_the_beams() -> None:
    bay = Scenario.load("bay:ideal").world
    assert bay.target is not None
    points = target_points(bay.target)
    for mount in bay.target_mounts:
        corners = from_pose6(mount).apply(points)
        for beam in bay.beams.values():
            assert np.linalg.norm(corners - np.array(beam.point), axis=1).min() > 0.4


def test_a_tool_that_leans_stands_on_its_point_and_straight_in_an_ideal_world() -> None:
    leaning, straight = (World.from_scenario(Scenario.load(name)).tool for name in ("laser", "laser:ideal"))
    point, reach = straight.T_nominal.translation, 0.054
    leaning_ends, straight_ends = leaning.ends_at(0.0)[0][0], straight.ends_at(0.0)[0][0]
    off = leaning_ends - straight_ends
    # About x by 1.5 mrad and about y by -1 mrad: the far end of an axis that points back along z.
    assert off[1] - off[0] == pytest.approx([0.001 * reach, 0.0015 * reach, 0.0], abs=2e-7)
    for ends in (leaning_ends, straight_ends):
        assert np.linalg.norm(ends[0] - point) == pytest.approx(0.003, abs=1e-9)


def test_likely_tools_lean_by_a_few_milliradians() -> None:
    known = KnownCell(
        robot={"model": "ur10e"},
        tool={"name": "pin", "T_flange_tool": [0.0, 0.0, 0.18, 0.0, 0.0, 0.0], "radius_m": 0.03},
        payload_kg=1.0,
        q_start=[0.0] * 6,
        beams=KnownBeams({}, 0.003, 0.05),
    )
    leans = [draw_tool(known, np.random.default_rng(seed))["lean_rad"] for seed in range(200)]
    assert np.std(leans, axis=0) == pytest.approx([0.002, 0.002], rel=0.15)
