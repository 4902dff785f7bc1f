"""Data of other programs: each sample is written here as the program's documentation says, from one truth."""

import csv
import gzip
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import RigidTransform

from calibration.kinematics.ur import DhDeltas, UrArmModel
from calibration.kinematics.ur_models import ALPHA, UR_MODELS
from cell.poses import from_pose6, to_pose6
from tests.kit.cli_harness import CellOnDisk, CommandLine, Ran

X = from_pose6([0.02, -0.09, 0.05, 0.1, -0.2, 0.3])  # camera in flange, or in base
TARGET = from_pose6([0.6, 0.1, 0.02, 0.0, 0.0, 0.4])  # in base, or in flange
SEEN = [
    from_pose6(p)
    for p in (
        [0.0, 0.0, 0.5, 0.0, 0.0, 0.1],
        [0.05, 0.0, 0.5, 0.4, 0.0, 0.0],
        [0.0, 0.04, 0.45, 0.0, 0.4, 0.0],
        [0.0, 0.0, 0.5, -0.3, 0.3, 0.2],
        [-0.03, 0.02, 0.55, -0.3, -0.3, 0.0],
        [0.01, 0.02, 0.48, 0.2, -0.4, 0.3],
    )
]
FLANGES = {
    "eye-in-hand": [TARGET * seen.inv() * X.inv() for seen in SEEN],
    "eye-to-hand": [X * seen * TARGET.inv() for seen in SEEN],
}


@pytest.fixture
def subject(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> CommandLine:
    return CommandLine(monkeypatch, capsys, CellOnDisk(tmp_path).config)


def imported(done: Ran) -> dict[str, Any]:
    assert done.code == 0, done.err
    return dict(json.loads(done.out))


def assert_truth(document: dict[str, Any], setup: str, tolerance: float = 1e-9) -> None:
    assert document["setup"] == setup
    for entry, flange, seen in zip(document["observations"], FLANGES[setup], SEEN, strict=True):
        for key, true in (("T_base_flange", flange), ("T_camera_target", seen)):
            off = from_pose6(entry[key]).inv() * true
            assert np.abs(to_pose6(off)).max() < tolerance, (key, entry["index"])


def named(pose: RigidTransform) -> dict[str, Any]:
    """translation and rotation as ROS messages are printed in YAML."""
    t, q = pose.translation, pose.rotation.as_quat()
    return {
        "translation": {a: float(v) for a, v in zip("xyz", t, strict=True)},
        "rotation": {a: float(v) for a, v in zip("xyzw", q, strict=True)},
    }


def easy_handeye2(path: Path, setup: str, kind: str) -> None:
    """As its sampler looks the transforms up: the base in the effector when the camera stands on the base."""
    robots = [f if setup == "eye-in-hand" else f.inv() for f in FLANGES[setup]]
    samples = [{"robot": named(r), "tracking": named(s)} for r, s in zip(robots, SEEN, strict=True)]
    path.write_text(yaml.safe_dump({"parameters": {"calibration_type": kind}, "samples": samples}))


@pytest.mark.parametrize(("setup", "kind"), [("eye-in-hand", "eye_in_hand"), ("eye-to-hand", "eye_on_base")])
def test_samples_of_easy_handeye2(subject: CommandLine, tmp_path: Path, setup: str, kind: str) -> None:
    file = tmp_path / "cell.samples"
    easy_handeye2(file, setup, kind)
    assert_truth(imported(subject("import", "easy-handeye2", file)), setup)
    easy_handeye2(file, setup, "")
    done = subject("import", "easy-handeye2", file)
    assert (done.code, done.out) == (2, "")
    assert "does not say where the camera was" in done.err
    file.with_suffix(".calib").write_text(yaml.safe_dump({"parameters": {"calibration_type": kind}}))
    assert_truth(imported(subject("import", "easy-handeye2", tmp_path)), setup)
    other = "eye-to-hand" if setup == "eye-in-hand" else "eye-in-hand"
    assert "leave --setup out" in subject("import", "easy-handeye2", file, "--setup", other).err


@pytest.mark.parametrize("setup", FLANGES)
def test_samples_of_moveit_calibration(subject: CommandLine, tmp_path: Path, setup: str) -> None:
    """The panel writes 16 numbers one after the other, row by row."""
    samples = [
        {
            "effector_wrt_world": [float(v) for v in f.as_matrix().ravel()],
            "object_wrt_sensor": [float(v) for v in s.as_matrix().ravel()],
        }
        for f, s in zip(FLANGES[setup], SEEN, strict=True)
    ]
    file = tmp_path / "samples.yaml"
    file.write_text(yaml.safe_dump(samples))
    assert_truth(imported(subject("import", "moveit", file, "--setup", setup)), setup)
    assert "--setup eye-in-hand" in subject("import", "moveit", file).err
    samples[2]["object_wrt_sensor"] = [float(v) for v in SEEN[2].as_matrix().T.ravel()]
    file.write_text(yaml.safe_dump(samples))
    done = subject("import", "moveit", file, "--setup", setup)
    assert done.code == 2
    assert "sample 2, object_wrt_sensor: the matrix does not end with 0, 0, 0, 1" in done.err
    file.write_text(yaml.safe_dump({"joint_names": ["a"], "joint_values": [[0.0]]}))
    assert "joint states only" in subject("import", "moveit", file, "--setup", setup).err


@pytest.mark.parametrize("name", ["pose_rPe", "franka_pose_fPe"])
def test_a_folder_of_visp(subject: CommandLine, tmp_path: Path, name: str) -> None:
    folder = tmp_path / "visp"
    folder.mkdir()
    for n, (flange, seen) in enumerate(zip(FLANGES["eye-in-hand"], SEEN, strict=True), 8):  # 8 to 13
        for stem, pose in ((name, flange), (name[:-3] + "cPo", seen)):
            rows = "".join(f"  - [{v!r}]\n" for v in map(float, to_pose6(pose)))
            (folder / f"{stem}_{n}.yaml").write_text(f"rows: 6\ncols: 1\ndata: \n{rows}")
    (folder / f"{name}_99.yaml").write_text("rows: 6\ncols: 1\ndata:\n  - [0]\n")
    done = subject("import", "visp", folder, "--setup", "eye-in-hand")
    assert_truth(imported(done), "eye-in-hand")
    assert f"{name}_99.yaml has no partner" in done.err
    (folder / f"{name}_8.yaml").write_text("rows: 5\ncols: 1\ndata: [[1], [2], [3], [4], [5]]\n")
    assert "six numbers" in subject("import", "visp", folder, "--setup", "eye-in-hand").err


def quaternion_columns(pose: RigidTransform) -> dict[str, float]:
    return dict(
        zip(
            ["x", "y", "z", "qx", "qy", "qz", "qw"],
            [*pose.translation, *pose.rotation.as_quat()],
            strict=True,
        )
    )


def vector_columns(pose: RigidTransform) -> dict[str, float]:
    return dict(zip(["x", "y", "z", "rx", "ry", "rz"], to_pose6(pose), strict=True))


def matrix_columns(pose: RigidTransform) -> dict[str, float]:
    m = pose.as_matrix()
    return {f"m{r}{c}": m[r, c] for r in range(3) for c in range(4)}


def kuka_columns(pose: RigidTransform) -> dict[str, float]:
    """KUKA: millimetres; A about z, B about the new y, C about the newest x, degrees; by plain products."""
    m = pose.rotation.as_matrix()
    b = -np.arcsin(m[2, 0])
    a, c = np.arctan2(m[1, 0], m[0, 0]), np.arctan2(m[2, 1], m[2, 2])
    return dict(
        zip(
            ["x", "y", "z", "rx", "ry", "rz"],
            [*(pose.translation * 1e3), *np.degrees([a, b, c])],
            strict=True,
        )
    )


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize(
    ("columns", "options"),
    [
        (quaternion_columns, ()),
        (vector_columns, ()),
        (matrix_columns, ()),
        (kuka_columns, ("--euler", "kuka-abc", "--length", "mm", "--angle", "deg")),
    ],
)
def test_a_table_of_poses(
    subject: CommandLine,
    tmp_path: Path,
    columns: Callable[[RigidTransform], dict[str, float]],
    options: tuple[str, ...],
    separator: str,
) -> None:
    file = tmp_path / "poses.csv"
    rows = [
        {f"{part}_{key}": repr(float(v)) for part, pose in pair for key, v in columns(pose).items()}
        for pair in (
            (("flange", f), ("target", s)) for f, s in zip(FLANGES["eye-to-hand"], SEEN, strict=True)
        )
    ]
    with file.open("w", newline="", encoding="utf-8-sig") as stream:
        writer = csv.DictWriter(stream, list(rows[0]), delimiter=separator)
        writer.writeheader()
        writer.writerows(rows)
    assert_truth(imported(subject("import", "csv", file, "--setup", "eye-to-hand", *options)), "eye-to-hand")


@pytest.mark.parametrize("key", ["quaternion_xyzw", "quaternion_wxyz", "rotation_vector", "euler", "matrix"])
def test_poses_in_plain_json(subject: CommandLine, tmp_path: Path, key: str) -> None:
    def pose(of: RigidTransform) -> dict[str, Any]:
        if key == "matrix":
            return {"matrix": of.as_matrix().tolist()}
        r = of.rotation
        x, y, z, w = map(float, r.as_quat())
        numbers = {
            "quaternion_xyzw": [x, y, z, w],
            "quaternion_wxyz": [w, x, y, z],
            "rotation_vector": r.as_rotvec().tolist(),
            "euler": r.as_euler("xyz").tolist(),
        }
        return {"translation": of.translation.tolist(), key: numbers[key]}

    samples = [
        {"flange": pose(f), "target": pose(s)} for f, s in zip(FLANGES["eye-in-hand"], SEEN, strict=True)
    ]
    file = tmp_path / "poses.json"
    file.write_text(json.dumps({"setup": "eye-in-hand", "samples": samples}))
    options = ("--euler", "rpy") if key == "euler" else ()
    assert_truth(imported(subject("import", "json", file, *options)), "eye-in-hand")
    if key == "euler":
        assert "name the order" in subject("import", "json", file).err


@pytest.mark.parametrize(
    ("order", "angles", "matrix"),
    [
        ("rpy", (0.1, 0.2, 0.3), "z(0.3) y(0.2) x(0.1)"),
        ("fanuc-wpr", (0.1, 0.2, 0.3), "z(0.3) y(0.2) x(0.1)"),
        ("kuka-abc", (0.1, 0.2, 0.3), "z(0.1) y(0.2) x(0.3)"),
        ("staubli", (0.1, 0.2, 0.3), "x(0.1) y(0.2) z(0.3)"),
        ("kawasaki-oat", (0.1, 0.2, 0.3), "z(0.1) y(0.2) z(0.3)"),
    ],
)
def test_each_named_order_is_the_product_that_its_maker_writes(
    order: str, angles: tuple[float, float, float], matrix: str
) -> None:
    from daemon.importing.rotations import euler, euler_order

    def turn(axis: str, by: float) -> np.ndarray:
        c, s = np.cos(by), np.sin(by)
        i = "xyz".index(axis)
        j, k = (i + 1) % 3, (i + 2) % 3
        m = np.eye(3)
        m[j, j] = m[k, k] = c
        m[j, k], m[k, j] = -s, s
        return m

    product = np.eye(3)
    for word in matrix.split():
        product = product @ turn(word[0], float(word[2:-1]))
    made = euler([0.0, 0.0, 0.0], angles, euler_order(order)).rotation.as_matrix()
    assert np.abs(made - product).max() < 1e-12


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("0,0,0,0.9,0,0,0.9,0,0,0,0,0,0,1", "line 2: the quaternion has the length 1.273"),
        ("0,0,0,0,0,0,1,0,0,0,0,0,0,one", "line 2, column target_qw: 'one' is no number"),
        ("0,0,0,0,0,0,1,0,0,0,0,0,0,nan", "no finite number"),
        ("0,0,0,0,0,0,1", "not as many columns"),
    ],
)
def test_a_bad_row_is_named_by_its_line(subject: CommandLine, tmp_path: Path, line: str, says: str) -> None:
    names = ["x", "y", "z", "qx", "qy", "qz", "qw"]
    head = ",".join(f"{part}_{name}" for part in ("flange", "target") for name in names)
    file = tmp_path / "poses.csv"
    file.write_text(f"{head}\n{line}\n")
    done = subject("import", "csv", file, "--setup", "eye-in-hand")
    assert (done.code, done.out) == (2, "")
    assert str(file) in done.err
    assert says in done.err


@pytest.mark.parametrize(
    ("flange", "options", "says"),
    [
        (
            [0.4, 0, 0.5, 178, -1, 92],
            (),
            "an angle of 200.4 is more than one turn in radians: give --angle deg",
        ),
        ([0.4, 0, 0.5, 178, -1, 92], ("--euler", "ZYX"), "an angle of 178 is more than one turn in radians"),
        ([412, -105, 520, 3, 0, 0], (), "the flange would be 671.7 m from the base: give --length mm"),
        ([0.4, 0, 0.5, 6.28, 0.1, 0.1], (), ""),
        ([412, -105, 520, 178, -1, 92], ("--length", "mm", "--angle", "deg"), ""),
    ],
)
def test_degrees_are_not_read_as_radians_nor_millimetres_as_metres(
    subject: CommandLine, tmp_path: Path, flange: list[float], options: tuple[str, ...], says: str
) -> None:
    names = ["x", "y", "z", "rx", "ry", "rz"]
    table, plain = tmp_path / "poses.csv", tmp_path / "poses.json"
    head = ",".join(f"{part}_{name}" for part in ("flange", "target") for name in names)
    row = ",".join(map(str, [*flange, 0, 0, 0.5, 0, 0, 0]))
    table.write_text(f"{head}\n{row}\n")
    key = "euler" if "--euler" in options else "rotation_vector"
    poses = {
        part: {"translation": v[:3], key: v[3:]} for part, v in (("flange", flange), ("target", [0] * 6))
    }
    plain.write_text(json.dumps({"samples": [poses]}))
    for kind, file, where in (("csv", table, "line 2: "), ("json", plain, "samples[0].flange: ")):
        done = subject("import", kind, file, "--setup", "eye-in-hand", *options)
        if says:
            assert (done.code, done.out) == (2, "")
            assert where + says in done.err
            continue
        units = "mm and deg" if options else "m and rad"
        assert f"read as {units}." in done.err
        assert imported(done)["notes"]["read_as"] == units


def test_a_matrix_that_mirrors_or_stretches_is_refused() -> None:
    from daemon.importing.rotations import PoseFault, matrix

    with pytest.raises(PoseFault, match="mirrors"):
        matrix(np.diag([1.0, 1.0, -1.0, 1.0]).ravel().tolist())
    with pytest.raises(PoseFault, match="no rotation"):
        matrix(np.diag([1.02, 1.0, 1.0, 1.0]).ravel().tolist())


def test_an_imported_set_is_solved_and_an_existing_file_is_kept(subject: CommandLine, tmp_path: Path) -> None:
    samples, capture = tmp_path / "a.samples", tmp_path / "capture.json"
    easy_handeye2(samples, "eye-in-hand", "eye_in_hand")
    assert subject("import", "easy-handeye2", samples, "-o", capture).code == 0
    result = tmp_path / "result.json"
    assert subject("solve", "hand-eye", capture, "-o", result).code == 0
    found = from_pose6(json.loads(result.read_text())["result"]["T_flange_camera"])
    assert np.abs(to_pose6(found.inv() * X)).max() < 1e-6
    done = subject("import", "easy-handeye2", samples, "-o", capture)
    assert done.code == 2
    assert "not overwritten" in done.err


DELTAS = DhDeltas(
    delta_theta=np.array([1e-5, -0.21, 0.9, -0.69, 2e-6, -1e-7]),
    delta_d=np.array([2e-4, -12.0, 30.0, -18.0, 1e-4, 2e-4]),
    delta_a=np.array([1e-4, 2e-4, -1e-4, 5e-5, -8e-5, 0.0]),
    delta_alpha=np.array([-2e-4, 0.0, 0.0, -1e-4, 3e-4, 0.0]),
)


def kinematics_xml(model: str, deltas: DhDeltas, status: str = "LINEARIZED") -> bytes:
    """As PolyScope writes it: the angles by which the joints differ, and the whole lengths."""
    one = UR_MODELS[model]
    rows = {
        "deltaTheta": deltas.delta_theta,
        "a": one.a + deltas.delta_a,
        "d": one.d + deltas.delta_d,
        "alpha": ALPHA + deltas.delta_alpha,
    }
    values = "".join(f'<{k} value="{", ".join(repr(float(v)) for v in row)}"/>' for k, row in rows.items())
    return f'<URProgram><kinematics status="{status}">{values}</kinematics></URProgram>'.encode()


def small(scale: float = 1.0) -> DhDeltas:
    """Differences that move the flange by less than a millimetre or two."""
    return DhDeltas(
        delta_theta=np.array([1e-4, 2e-4, -1e-4, 1e-4, -2e-4, 0.0]) * scale,
        delta_d=np.array([2e-4, 0.0, 0.0, 1e-4, 1e-4, 2e-4]) * scale,
        delta_a=np.array([1e-4, 2e-4, -1e-4, 5e-5, -8e-5, 0.0]) * scale,
        delta_alpha=np.array([-2e-4, 1e-4, 0.0, -1e-4, 3e-4, 0.0]) * scale,
    )


@pytest.mark.parametrize("packed", [True, False])
def test_a_ur_arm_from_its_installation(subject: CommandLine, tmp_path: Path, packed: bool) -> None:
    data = kinematics_xml("ur3e", small())
    file = tmp_path / "default.installation"
    file.write_bytes(gzip.compress(data) if packed else data)
    robot = imported(subject("import", "ur", file))
    assert robot["model"] == "ur3e"
    arm = UrArmModel("ur3e", DhDeltas(**{k: np.array(v) for k, v in robot["calibration"].items()}))
    q = np.array([0.3, -1.0, 1.1, -0.4, 0.7, 0.2])
    true = UrArmModel("ur3e", small()).forward(q)
    assert np.abs(to_pose6(arm.forward(q).inv() * true)).max() < 1e-12


@pytest.mark.parametrize(
    ("data", "options", "says"),
    [
        (kinematics_xml("ur5e", small()), (), "ur5e or ur7e"),
        (kinematics_xml("ur3e", small()), ("--model", "ur5e"), "rather of ur3e"),
        (kinematics_xml("ur3e", DELTAS), (), "no known model"),
        (kinematics_xml("ur3e", small(), "NOT_INITIALIZED"), (), "saved without a robot"),
        (b"<Installation/>", (), "no element 'kinematics'"),
        (b'<!DOCTYPE x [<!ENTITY a "b">]><x>&a;</x>', (), "declares entities"),
        (gzip.compress(b"<x/>", mtime=0)[:-9], (), "cut short"),
        (b"delta_theta = [0, 0, 0, 0, 0, 0]", ("--model", "ur3e"), "no 'delta_a'"),
        (b"<x/>", ("--model", "ur99"), "there is"),
        (b"<x/>", ("--setup", "eye-in-hand"), "says nothing about 'ur'"),
    ],
)
def test_what_is_no_calibration_of_a_ur_arm(
    subject: CommandLine, tmp_path: Path, data: bytes, options: tuple[str, ...], says: str
) -> None:
    file = tmp_path / "default.installation"
    file.write_bytes(data)
    done = subject("import", "ur", file, *options)
    assert (done.code, done.out) == (2, "")
    assert says in done.err


def test_the_calibration_conf_of_a_ur_arm(subject: CommandLine, tmp_path: Path) -> None:
    lines = [
        f"{key} = [ {', '.join(repr(float(v)) for v in getattr(small(), key))} ]" for key in vars(small())
    ]
    file = tmp_path / "calibration.conf"
    file.write_text("[mounting]\n" + "\n".join(lines) + "\njoint_checksum = [ 0x1, 0x2 ]\n")
    robot = imported(subject("import", "ur", file, "--model", "ur10e"))
    assert robot["calibration"]["delta_d"] == small().delta_d.tolist()
    assert "does not name the arm" in subject("import", "ur", file).err


def test_euler_orders_that_are_none_are_refused(subject: CommandLine, tmp_path: Path) -> None:
    for order in ("xxz", "XyZ", "xy", "abc"):
        done = subject("import", "csv", tmp_path / "x.csv", "--euler", order)
        assert done.code == 2
        assert "no order of Euler angles" in done.err
