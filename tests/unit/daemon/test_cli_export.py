"""``cellward export``: what other programs would read is what is in effect, and says what it is."""

import configparser
import json
import math
import os
import re
import shlex
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from calibration.identification.exports import ros_kinematics
from calibration.kinematics.families import arm_spec, ur_chain
from cell.formats.robot import parse_robot
from cell.poses import Array
from cell.store.ledger import Ledger
from tests.kit.cli_harness import CellOnDisk, CommandLine
from tests.kit.kincal_scene import joints, make_scene
from tests.kit.solved import solve_kincal
from tests.kit.whole_results import whole as whole_result

CAMERA = [0.0125, -0.0811, 0.0502, 0.031, -0.024, 1.571]
TOOL = [0.0012, -0.0007, 0.1805, 0.006, 0.008, 0.0]
COV = np.diag([1e-10, 1e-10, 4e-10, 1e-8, 1e-8, 1e-8]).tolist()


def result(kind: str, answer: dict[str, Any] | None, **parts: Any) -> dict[str, Any]:
    whole: dict[str, Any] = {
        "schema": "cellward.result/1",
        "kind": kind,
        "verdict": "pass",
        "reasons": [],
        "warnings": [],
        "result": answer,
        "uncertainty": {},
        "inputs": {},
    }
    return whole | parts


HAND_EYE = result("hand-eye", {"T_flange_camera": CAMERA, "cov": COV})
LASER = result("laser", {"T_flange_tool": TOOL}, uncertainty={"U_point_m": 3.1e-5, "U_tilt_rad": 4e-4})


@pytest.fixture(scope="module")
def arms(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    """Solved sets of a UR10e and a palletizer, geometry alone: what every form can carry."""
    folder = tmp_path_factory.mktemp("sets")
    sets = {kind: make_scene(kind, 3, 40).write(folder, f"{kind}.json") for kind in ("ur10e", "palletizer")}
    return {kind: solve_kincal(path, method="ml") for kind, path in sets.items()}


class Cell(CellOnDisk):
    def commit(self, name: str, value: Any, document: dict[str, Any], configured: Any = None) -> int:
        """A version that an operator accepted."""
        self.state.mkdir(exist_ok=True)
        ledger = Ledger(self.state / "ledger.sqlite", lambda: 1_700_000_000.0)
        result_id = ledger.propose(name, value, document, 12, configured)
        ledger.accept(result_id, "anna")
        ledger.close()
        return result_id


@pytest.fixture
def cell(tmp_path: Path) -> Cell:
    return Cell(tmp_path)


@pytest.fixture
def subject(cell: Cell, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> CommandLine:
    return CommandLine(monkeypatch, capsys, cell.config)


def matrix(xyz: Any, rotation: Rotation) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), xyz
    return T


def matrix_of(pose: list[float]) -> Array:
    return matrix(pose[:3], Rotation.from_rotvec(pose[3:]))


def rpy(origin: dict[str, float]) -> Array:
    """URDF's and ROS' fixed axes, multiplied out by hand."""
    (sr, cr), (sp, cp), (sy, cy) = (
        (math.sin(origin[k]), math.cos(origin[k])) for k in ("roll", "pitch", "yaw")
    )
    T = np.eye(4)
    T[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    T[:3, 3] = [origin[k] for k in "xyz"]
    return T


def spin(angle: float) -> Array:
    return matrix([0, 0, 0], Rotation.from_rotvec([0, 0, angle]))


# -- poses


@pytest.mark.parametrize("form", ["urscript", "ros", "urdf", "yaml", "json"])
def test_every_form_says_direction_version_date_and_uncertainty(
    cell: Cell, subject: CommandLine, form: str
) -> None:
    cell.commit("T_flange_camera", CAMERA, HAND_EYE)
    ran = subject("export", "T_flange_camera", "--format", form)
    assert ran.code == 0, ran.err
    for told in ("camera in flange", "2023-11-14T22:13:20Z", "result 1 of run 12, accepted by anna"):
        assert told in ran.out
    assert "95 % of errors below" in ran.out
    assert re.search(r'version"?:? ?1\b', ran.out)


def test_urscript_holds_the_pose_in_the_controllers_own_form(cell: Cell, subject: CommandLine) -> None:
    cell.commit("T_flange_tool.pin-2", TOOL, LASER)
    lines = subject("export", "T_flange_tool.pin-2", "--format", "urscript").out.splitlines()
    code = [line for line in lines if not line.startswith("#")]
    found = re.fullmatch(r"T_flange_tool_pin_2 = p\[(.*)\]", code[0])
    assert found is not None
    assert [float(v) for v in found[1].split(", ")] == TOOL
    assert code[1:] == ["set_tcp(T_flange_tool_pin_2)"]
    assert "95 % of errors below 0.0310 mm and 0.0229 deg" in "\n".join(lines)


def test_ros_transform_and_its_command_are_the_pose(cell: Cell, subject: CommandLine) -> None:
    cell.commit("T_flange_camera", CAMERA, HAND_EYE)
    text = subject("export", "T_flange_camera", "--format", "ros").out
    found = yaml.safe_load(text)
    assert (found["header"]["frame_id"], found["child_frame_id"]) == ("tool0", "camera")
    t, q = found["transform"]["translation"], found["transform"]["rotation"]
    T = matrix([t[k] for k in "xyz"], Rotation.from_quat([q[k] for k in "xyzw"]))
    np.testing.assert_allclose(T, matrix_of(CAMERA), atol=1e-15)
    (line,) = re.findall(r"static_transform_publisher (.*)", text)
    words = shlex.split(line)
    given = dict(zip(words[::2], words[1::2], strict=True))
    assert [float(given[f"--{k}"]) for k in ("x", "y", "z")] == CAMERA[:3]
    assert [float(given[f"--q{k}"]) for k in "xyzw"] == [q[k] for k in "xyzw"]
    assert (given["--frame-id"], given["--child-frame-id"]) == ("tool0", "camera")


def test_urdf_of_a_pose_is_a_fixed_joint_with_the_pose(cell: Cell, subject: CommandLine) -> None:
    cell.commit("T_base_camera", CAMERA, result("hand-eye", {"T_base_camera": CAMERA, "cov": COV}))
    root = ElementTree.fromstring(subject("export", "T_base_camera", "--format", "urdf").out.encode())
    (joint,) = root.iter("joint")
    assert joint.get("type") == "fixed"
    assert [joint.find(k).get("link") for k in ("parent", "child")] == ["base", "camera"]  # type: ignore[union-attr]
    np.testing.assert_allclose(origin_of(joint), matrix_of(CAMERA), atol=1e-12)


@pytest.mark.parametrize(("form", "read"), [("yaml", yaml.safe_load), ("json", json.loads)])
def test_documents_hold_pose_and_uncertainty_in_full(
    cell: Cell, subject: CommandLine, form: str, read: Any
) -> None:
    cell.commit("T_flange_camera", CAMERA, HAND_EYE)
    found = read(subject("export", "T_flange_camera", "--format", form).out)
    assert found["pose"] == CAMERA
    assert (found["parent"], found["child"], found["version"]) == ("flange", "camera", 1)
    assert found["uncertainty"]["sigma_m"] == pytest.approx([1e-5, 1e-5, 2e-5])
    assert found["uncertainty"]["error_95_rad"] == pytest.approx(2.795e-4, rel=1e-3)  # chi, 3 degrees


def test_newer_version_is_the_one_in_effect_and_rollback_brings_the_old_one_back(
    cell: Cell, subject: CommandLine
) -> None:
    cell.commit("T_flange_tool.pin", TOOL, LASER)
    cell.commit("T_flange_tool.pin", [0.0] * 6, LASER)
    assert json.loads(subject("export", "T_flange_tool.pin", "-f", "json").out)["pose"] == [0.0] * 6
    ledger = Ledger(cell.state / "ledger.sqlite")
    ledger.rollback("T_flange_tool.pin", "anna")
    ledger.close()
    found = json.loads(subject("export", "T_flange_tool.pin", "-f", "json").out)
    assert (found["pose"], found["version"]) == (TOOL, 1)


# -- kinematics


def origin_of(joint: ElementTree.Element) -> Array:
    origin = joint.find("origin")
    assert origin is not None
    xyz, angles = ([float(v) for v in str(origin.get(k)).split()] for k in ("xyz", "rpy"))
    return rpy(dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), (*xyz, *angles), strict=True)))


def flange_of(document: dict[str, Any], q: Array) -> Array:
    found: Array = arm_spec(parse_robot(document["result"]["robot"], "robot")).arm.base.flange(q[None])[0]
    return found


def test_ros_kinematics_multiply_out_to_the_calibrated_flange(
    cell: Cell, subject: CommandLine, arms: dict[str, Any]
) -> None:
    arm = arms["ur10e"]
    cell.commit("kinematics.arm", {"robot": arm["result"]["robot"]}, arm)
    text = subject("export", "kinematics.arm", "--format", "ros").out
    found = yaml.safe_load(text)
    names = ["shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3", "hash"]
    assert list(found["kinematics"]) == names
    assert isinstance(found["kinematics"]["hash"], str)
    assert "ur_type:=ur10e" in text
    for q in joints("ur10e", np.random.default_rng(1), 5):
        T = np.eye(4)
        for name, angle in zip(names[:-1], q, strict=True):
            T = T @ rpy(found["kinematics"][name]) @ spin(angle)
        np.testing.assert_allclose(T @ rpy(found["wrist_3_to_tool0"]), flange_of(arm, q), atol=1e-12)


# config/ur30/default_kinematics.yaml of ur_description (UniversalRobots/Universal_Robots_ROS2_Description)
PUBLISHED_UR30 = {
    "shoulder": (0, 0, 0.2363, 0, 0, 0),
    "upper_arm": (0, 0, 0, 1.570796327, 0, 0),
    "forearm": (-0.637, 0, 0, 0, 0, 0),
    "wrist_1": (-0.5037, 0, 0.201, 0, 0, 0),
    "wrist_2": (0, -0.1593, 0, 1.570796327, 0, 0),
    "wrist_3": (0, 0.1543, -3.1647459019915597e-11, 1.5707963265897931, math.pi, math.pi),
}


def test_ros_kinematics_of_a_drawn_arm_are_the_published_ones() -> None:
    found = ros_kinematics(ur_chain("ur30"))
    for name, numbers in PUBLISHED_UR30.items():
        published = rpy(dict(zip(("x", "y", "z", "roll", "pitch", "yaw"), numbers, strict=True)))
        np.testing.assert_allclose(rpy(found[name]), published, atol=2e-9)


@pytest.mark.parametrize("kind", ["ur10e", "palletizer"])
def test_urdf_moves_the_flange_and_the_reflector_as_the_calibrated_arm_does(
    cell: Cell, subject: CommandLine, arms: dict[str, Any], kind: str
) -> None:
    arm = arms[kind]
    cell.commit("kinematics.arm", {"robot": arm["result"]["robot"]}, arm)
    root = ElementTree.fromstring(subject("export", "kinematics.arm", "--format", "urdf").out.encode())
    spec = arm_spec(parse_robot(arm["result"]["robot"], "robot"))
    by_parent: dict[str, list[ElementTree.Element]] = {}
    for joint in root.iter("joint"):
        by_parent.setdefault(joint.find("parent").get("link") or "", []).append(joint)  # type: ignore[union-attr]
    for q in joints(kind, np.random.default_rng(2), 3):
        links = spec.arm.base.coupling @ q
        values = {f"joint_{i + 1}": float(v) for i, v in enumerate(links)}
        T, at = np.eye(4), "base"
        while at in by_parent:
            (joint,) = by_parent[at]
            mimic = joint.find("mimic")
            value = values.get(str(joint.get("name")), 0.0)
            if mimic is not None:
                value = float(str(mimic.get("multiplier"))) * values[str(mimic.get("joint"))]
            T = T @ origin_of(joint) @ (spin(value) if joint.get("type") == "revolute" else np.eye(4))
            at = str(joint.find("child").get("link"))  # type: ignore[union-attr]
            if at == "flange":
                np.testing.assert_allclose(T, flange_of(arm, q), atol=1e-11)
        assert at == "smr1"
        place = flange_of(arm, q) @ [*spec.tools["smr1"], 1.0]
        np.testing.assert_allclose(T[:3, 3], place[:3], atol=1e-11)


def test_ur_calibration_is_read_back_as_the_same_arm_and_carries_its_warning(
    cell: Cell, subject: CommandLine, arms: dict[str, Any]
) -> None:
    arm = arms["ur10e"]
    cell.commit("kinematics.arm", {"robot": arm["result"]["robot"]}, arm)
    text = subject("export", "kinematics.arm", "--format", "ur-calibration").out
    assert "WARNING" in text
    assert "Do not write them to a controller" in text
    parser = configparser.ConfigParser()
    parser.read_string(text)
    deltas = {key: np.array(json.loads(value)) for key, value in parser["mounting"].items()}
    drawn = ur_chain("ur10e")
    for q in joints("ur10e", np.random.default_rng(3), 5):
        T = np.eye(4)
        for i in range(6):  # UR's own order: theta, d, a, alpha
            theta, d, a, alpha = (
                getattr(drawn, key)[i] + deltas[f"delta_{key}"][i] for key in ("theta", "d", "a", "alpha")
            )
            T = T @ spin(q[i] + theta) @ matrix([a, 0, d], Rotation.from_rotvec([alpha, 0, 0]))
        np.testing.assert_allclose(T, flange_of(arm, q), atol=1e-9)  # over hundreds of metres


def test_a_result_file_can_be_exported_and_its_json_is_a_robot_for_the_solver(
    cell: Cell, subject: CommandLine, arms: dict[str, Any], tmp_path: Path
) -> None:
    file, robot = tmp_path / "found.json", tmp_path / "robot.json"
    file.write_text(json.dumps(arms["palletizer"]))
    os.utime(file, (1_700_000_000, 1_700_000_000))
    ran = subject("export", file, "--format", "json", "-o", robot)
    assert (ran.code, ran.out) == (0, "")
    found = json.loads(robot.read_text())
    assert (found["version"], found["date"]) == (None, "2023-11-14T22:13:20Z")
    assert found["robot"] == arms["palletizer"]["result"]["robot"]
    assert found["uncertainty"]["held_out_rms_m"] == arms["palletizer"]["result"]["rms_calibrated"]
    scene = make_scene("palletizer", 3, 40).write(tmp_path)
    solved = subject("solve", "kincal", scene, "--robot", robot, "--json")
    assert solved.code == 0, solved.err
    before = arms["palletizer"]["result"]["rms_registration_only"]
    assert json.loads(solved.out)["result"]["rms_registration_only"] < 0.1 * before


@pytest.mark.parametrize("form", ["ros", "urdf", "ur-calibration"])
def test_a_form_without_a_place_for_gears_and_sag_says_what_that_costs(
    form: str, cell: Cell, subject: CommandLine, arms: dict[str, Any]
) -> None:
    gear = {"name": "gear2.1", "joint": 2, "of": [0.0, 1.0, 0.0, 0.0, 0.0, 0.0], "sin": 1e-4, "cos": 0.0}
    robot = {**arms["ur10e"]["result"]["robot"], "joint_errors": [gear]}
    cell.commit("kinematics.arm", {"robot": robot}, arms["ur10e"])
    text = subject("export", "kinematics.arm", "--format", form).out
    assert (
        "WARNING: errors of gears and sag have no place in this form; without them the flange is 0.0" in text
    )


@pytest.mark.parametrize("form", ["ros", "urdf", "yaml", "json", "ur-calibration"])
def test_an_arm_goes_out_with_its_load_and_the_figure_of_the_poses_set_aside(
    cell: Cell, subject: CommandLine, arms: dict[str, Any], form: str
) -> None:
    solved = arms["ur10e"]
    judged = {**solved["result"], "payload_kg": 7.5, "absolute_accuracy": {"after": 0.000123}}
    cell.commit("kinematics.arm", {"robot": judged["robot"]}, {**solved, "result": judged})
    ran = subject("export", "kinematics.arm", "--format", form)
    assert ran.code == 0, ran.err
    assert "0.1230 mm RMS on held-out poses" in ran.out
    if form == "json":
        assert json.loads(ran.out)["payload_kg"] == 7.5
    else:
        assert "measured with 7.5 kg on the flange" in ran.out


# -- what is refused


@pytest.mark.parametrize(
    ("name", "form", "told"),
    [
        ("T_flange_camera", "ur-calibration", "is a pose, and ur-calibration holds an arm's kinematics; "
         "it can be exported as urscript, ros, urdf, yaml, json"),
        ("kinematics.arm", "urscript", "is an arm's kinematics, which URScript cannot set; "
         "it can be exported as ros, urdf, yaml, json, ur-calibration"),
        ("kinematics.pal", "ros", "is not of a Universal Robots arm"),
        ("kinematics.pal", "ur-calibration", "it can be exported as urdf, yaml, json"),
        ("time_offset_s.beams", "ros", "is neither a pose nor an arm's kinematics; it can be "
         "exported as yaml, json"),
        ("T_flange_camera", "urdff", "did you mean urdf?"),
    ],
)  # fmt: skip
def test_a_form_that_makes_no_sense_is_refused_with_what_works(
    cell: Cell, subject: CommandLine, arms: dict[str, Any], name: str, form: str, told: str
) -> None:
    cell.commit("T_flange_camera", CAMERA, HAND_EYE)
    for arm, kind in (("arm", "ur10e"), ("pal", "palletizer")):
        cell.commit(f"kinematics.{arm}", {"robot": arms[kind]["result"]["robot"]}, arms[kind])
    cell.commit("time_offset_s.beams", 0.008, result("latency", {"time_offset_s": 0.008}))
    ran = subject("export", name, "--format", form)
    assert (ran.code, ran.out) == (2, "")
    assert told in ran.err


def test_a_delay_is_exported_as_its_value(cell: Cell, subject: CommandLine) -> None:
    cell.commit("time_offset_s.beams", 0.008, result("latency", {"time_offset_s": 0.008}))
    found = yaml.safe_load(subject("export", "time_offset_s.beams", "--format", "yaml").out)
    assert found["value"] == 0.008
    assert found["uncertainty"] == {"meaning": "the result states no uncertainty"}


def test_a_name_without_a_form_is_told_its_forms(cell: Cell, subject: CommandLine) -> None:
    cell.commit("time_offset_s.beams", 0.008, result("latency", {"time_offset_s": 0.008}))
    ran = subject("export", "time_offset_s.beams")
    assert (ran.code, ran.out) == (2, "")
    assert "give --format for time_offset_s.beams; it can be exported as yaml, json" in ran.err


def test_what_is_not_committed_is_not_exported(cell: Cell, subject: CommandLine) -> None:
    assert "nothing is committed in this cell yet" in subject("export", "T_flange_camera", "-f", "json").err
    cell.commit("T_flange_tool.pin", TOOL, LASER)
    assert "there is T_flange_tool.pin" in subject("export", "T_flange_camera", "-f", "json").err
    ledger = Ledger(cell.state / "ledger.sqlite")
    waiting = ledger.propose("T_flange_camera", CAMERA, HAND_EYE, 13, None)
    ledger.close()
    ran = subject("export", "T_flange_camera", "-f", "json")
    assert (ran.code, ran.out) == (2, "")
    assert f"'cellward accept {waiting}'" in ran.err


def test_a_version_that_the_configuration_contradicts_is_refused(cell: Cell, subject: CommandLine) -> None:
    cell.commit("T_flange_camera", CAMERA, HAND_EYE, configured=[0.0] * 6)
    ran = subject("export", "T_flange_camera", "-f", "json")
    assert (ran.code, ran.out) == (4, "")
    assert "was edited since version 1" in ran.err


ARM = """
[robot]
model = "ur10e"
[device.arm]
driver = "fakes.object:ObjectArm"
scenario = "tracker"
expect_serial = "99991100001"
[limits]
workspace = [{ min = [-1.0, -1.0, 0.0], max = [1.0, 1.0, 1.5] }]
"""


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ({"serials": {"arm": "99991100001"}, "controller": {"model": "ur10e"}}, None),
        ({"serials": {"arm": "20991234"}}, "measured with arm 20991234, and this is arm 99991100001"),
        ({"controller": {"model": "ur5e"}}, "are of another arm: its model or factory calibration is not"),
    ],
)
def test_kinematics_of_another_arm_than_the_config_names_are_not_exported(
    cell: Cell, subject: CommandLine, arms: dict[str, Any], value: dict[str, Any], told: str | None
) -> None:
    text = cell.config.read_text().replace("[cell]", "[cell]\ntwin = true")
    cell.config.write_text(text + ARM)
    cell.commit("kinematics.arm", {"robot": arms["ur10e"]["result"]["robot"], **value}, arms["ur10e"])
    ran = subject("export", "kinematics.arm", "--format", "ros")
    assert ran.code == (0 if told is None else 4), ran.err
    if told is not None:
        assert (ran.out, ran.err.count("kinematics.arm:")) == ("", 1)
        assert told in ran.err


@pytest.mark.parametrize(
    ("document", "told"),
    [
        (result("hand-eye", None, verdict="fail", reasons=["parallel-axes: ..."]), "parallel-axes"),
        (LASER | {"verdict": "fail", "reasons": ["bent tool: 4 mm"]}, "bent tool: 4 mm"),
        (result("intercept", {"answers": []}), "a job's result of hand-eye, laser, kincal has one"),
        (result("laser", {"dp_flange": [0, 0, 0]}), "kind 'laser' without a calibration to export"),
        ({"schema": "cellward.kincal/1"}, "is no result"),
    ],
)
def test_a_file_without_a_usable_answer_is_refused(
    subject: CommandLine, tmp_path: Path, document: dict[str, Any], told: str
) -> None:
    file = tmp_path / "x.json"
    file.write_text(json.dumps(whole_result(document) if "kind" in document else document))
    ran = subject("export", file, "--format", "json")
    assert (ran.code, ran.out) == (2, "")
    assert told in ran.err


def test_warnings_of_a_result_go_with_it(cell: Cell, subject: CommandLine) -> None:
    text = "noise is large\nset_tcp(p[9,9,9,0,0,0])"
    cell.commit("T_flange_tool.pin", TOOL, LASER | {"warnings": [{"code": "x", "text": text}]})
    ran = subject("export", "T_flange_tool.pin", "--format", "urscript")
    assert "# WARNING: noise is large set_tcp(p[9,9,9,0,0,0])" in ran.out.splitlines()
    assert "noise is large" in ran.err


def test_a_tool_with_a_strange_name_breaks_no_form(cell: Cell, subject: CommandLine) -> None:
    name = 'T_flange_tool.a--b"<c> d'
    cell.commit(name, TOOL, LASER)
    root = ElementTree.fromstring(subject("export", name, "--format", "urdf").out.encode())
    assert [link.get("name") for link in root.iter("link")] == ["tool0", 'a--b"<c> d']
    assert yaml.safe_load(subject("export", name, "--format", "ros").out)["child_frame_id"] == 'a--b"<c> d'
    script = subject("export", name, "--format", "urscript").out
    assert "T_flange_tool_a__b__c__d = p[" in script
