"""Reading tracker points from files of others: every mistake is one sentence with file, field and fix."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from cell.errors import CellError, InputError
from procedures.tracker.solve.data import load_kincal
from tests.kit.kincal_scene import Scene, make_scene


@pytest.fixture(scope="module")
def scene() -> Scene:
    return make_scene("ur10e", 0, 30)


def robot_file(scene: Scene, folder: Path, inside: bool = False) -> Path:
    path = folder / "robot.json"
    robot = scene.data["robot"]
    path.write_text(json.dumps({"robot": robot} if inside else robot), "utf-8")
    return path


def rows(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    return scene.Q, np.array([s["p_tracker"] for s in scene.data["samples"]])


def write_csv(scene: Scene, path: Path, mark: str = ",", comma: bool = False, target: bool = True) -> Path:
    Q, p = rows(scene)
    with path.open("w", encoding="utf-8-sig", newline="") as file:
        table = csv.writer(file, delimiter=mark)
        table.writerow([*(f"Q{j + 1}" for j in range(6)), " x", "y", "z", *(["Target"] if target else [])])
        for q, point in zip(Q, p, strict=True):
            cells = [repr(float(v)) for v in (*q, *point)]
            cells = [c.replace(".", ",") for c in cells] if comma else cells
            table.writerow([*cells, *(["smr1"] if target else [])])
    return path


@pytest.mark.parametrize(
    ("mark", "comma", "target"), [(",", False, True), (";", True, False), ("\t", False, True)]
)
def test_csv_with_a_header_is_the_same_set_as_json(
    scene: Scene, tmp_path: Path, mark: str, comma: bool, target: bool
) -> None:
    plain = load_kincal(scene.write(tmp_path))
    table = load_kincal(
        write_csv(scene, tmp_path / "points.csv", mark, comma, target), robot_file(scene, tmp_path, comma)
    )
    np.testing.assert_array_equal(table.problem.Q, plain.problem.Q)
    np.testing.assert_array_equal(table.problem.p, plain.problem.p)
    assert table.model.targets == ("smr1",)


def test_matlab_columns_and_matlab_matrices_are_the_same_set_too(scene: Scene, tmp_path: Path) -> None:
    Q, p = rows(scene)
    names = np.array([["smr1"]] * len(Q), dtype=object)
    columns = {f"q{j + 1}": Q[:, [j]] for j in range(6)} | {a: p[:, [k]] for k, a in enumerate("xyz")}
    savemat(tmp_path / "columns.mat", columns | {"target": names, "comment": "made on Tuesday"})
    savemat(tmp_path / "rows.mat", {k: v.T if k != "comment" else v for k, v in columns.items()})
    savemat(tmp_path / "matrices.mat", {"q": Q, "p_tracker": p, "target": np.array(["smr1"] * len(Q))})
    robot = robot_file(scene, tmp_path)
    for name in ("columns", "rows", "matrices"):
        found = load_kincal(tmp_path / f"{name}.mat", robot)
        np.testing.assert_array_equal(found.problem.Q, Q)
        np.testing.assert_array_equal(found.problem.p, p.T)
        assert found.model.targets == ("smr1",)


def test_a_reading_that_is_missing_is_a_sample_without_one_in_every_format(
    scene: Scene, tmp_path: Path
) -> None:
    Q, p = rows(scene)
    p[4, 1] = np.nan
    savemat(tmp_path / "points.mat", {"q": Q, "p": p})
    path = write_csv(scene, tmp_path / "points.csv")
    lines = path.read_text("utf-8-sig").splitlines()
    cells = lines[5].split(",")
    cells[7] = ""
    path.write_text("\n".join([*lines[:5], ",".join(cells), *lines[6:], "", "# end"]), "utf-8")
    samples = [dict(s) for s in scene.data["samples"]]
    samples[4]["p_tracker"] = None
    changed = scene.changed(samples=samples).write(tmp_path)
    for found in (
        load_kincal(tmp_path / "points.mat", robot_file(scene, tmp_path)),
        load_kincal(path, robot_file(scene, tmp_path)),
        load_kincal(changed),
    ):
        assert found.unusable == {4: "the tracker had no reading"}
        assert found.problem.n == 29


def test_a_robot_given_beside_the_data_goes_before_the_one_inside(scene: Scene, tmp_path: Path) -> None:
    other = tmp_path / "other.json"
    other.write_text(json.dumps({"model": "ur10e", "tool": {"smr1": [0, 0, 0.1]}}), "utf-8")
    found = load_kincal(scene.write(tmp_path), other)
    np.testing.assert_array_equal(found.spec.tools["smr1"], [0, 0, 0.1])


def test_a_palletizers_own_reflector_and_others_are_told_apart(tmp_path: Path) -> None:
    tools = {"smr1": (0.1, 0.05, -0.1), "smr2": (0.2, -0.1, -0.1)}
    found = load_kincal(make_scene("palletizer", 1, 40, tools=tools).write(tmp_path))
    assert found.model.names[-6:] == ("tx", "ty", "tz", "smr2.x", "smr2.y", "smr2.z")


def edit(path: Path, change: Any) -> Path:
    data = json.loads(path.read_text("utf-8"))
    change(data)
    path.write_text(json.dumps(data), "utf-8")
    return path


@pytest.mark.parametrize(
    ("change", "needle"),
    [
        (lambda d: d.update(schema="cellward.kincal/9"), "cellward.kincal/9"),
        (lambda d: d.pop("robot"), "--robot FILE"),
        (lambda d: d.pop("samples"), "samples is missing"),
        (lambda d: d.update(sample=[]), "did you mean 'samples'"),
        (lambda d: d["samples"][3].update(q=[0.0] * 5), "samples[3].q has 5 joints; the robot has 6"),
        (lambda d: d["samples"][3].update(p_tracker=[1.0, 2.0]), "samples[3].p_tracker"),
        (lambda d: d["samples"][3].update(q="x"), "samples[3].q"),
        (lambda d: d["robot"].update(colour=1), "colour"),
        (lambda d: d["robot"].update(model="ur1"), "'ur1' is not supported"),
        (lambda d: d.update(noise={"sigma_per_m": 6e-6}), "sigma_per_m without sigma0"),
        (lambda d: d.update(noise={"sigma0": -1.0}), "noise.sigma0"),
        (
            lambda d: (d["robot"]["tool"].update(smr2=[0, 0, 1]), d["samples"][2].pop("target")),
            "samples[2].target is missing, and there are smr1, smr2",
        ),
    ],
)
def test_a_wrong_data_set_is_one_sentence_with_its_field(
    scene: Scene, tmp_path: Path, change: Any, needle: str
) -> None:
    with pytest.raises(InputError) as caught:
        load_kincal(edit(scene.write(tmp_path), change))
    assert needle in str(caught.value)
    assert "kincal.json" in str(caught.value)
    assert "\n" not in str(caught.value)


def _scaled(scene: Scene, q: float, p: float, swap: bool = False) -> Scene:
    samples = [
        {
            "q": [q * v for v in s["q"]],
            "p_tracker": [p * s["p_tracker"][k] for k in ((1, 0, 2) if swap else (0, 1, 2))],
        }
        for s in scene.data["samples"]
    ]
    return scene.changed(samples=samples)


@pytest.mark.parametrize("kind", ["ur10e", "palletizer"])
@pytest.mark.parametrize(
    ("q", "p", "swap", "needle"),
    [
        (180 / np.pi, 1.0, False, "q is in degrees; write radians"),
        (1.0, 1e3, False, "p_tracker is in millimetres; divide it by 1000"),
        (180 / np.pi, 1e3, False, "q is in degrees and p_tracker in millimetres"),
        (1.0, 1.0, True, "left-handed frame"),
    ],
)
def test_other_units_and_mirrored_frames_are_recognised(
    kind: str, q: float, p: float, swap: bool, needle: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError) as caught:
        load_kincal(_scaled(make_scene(kind, 2, 30), q, p, swap).write(tmp_path))
    assert needle in str(caught.value)


def test_a_tracker_far_away_and_many_turns_are_only_warned_of(tmp_path: Path) -> None:
    scene = make_scene("ur10e", 3, 30)
    samples = [
        {
            "q": [s["q"][0] + 6 * np.pi, *s["q"][1:]],
            "p_tracker": [s["p_tracker"][0] + 30.0, *s["p_tracker"][1:]],
        }
        for s in scene.data["samples"]
    ]
    found = load_kincal(scene.changed(samples=samples).write(tmp_path))
    assert [code for code, _ in found.warnings] == ["units.translation", "units.rotation"]


@pytest.mark.parametrize(
    ("name", "text", "needle"),
    [
        ("a.csv", "", "is empty"),
        ("a.csv", "q1,q2,q4,x,y,z\n1,2,3,4,5,6\n", "q1, q2, ... without a gap"),
        ("a.csv", "q1,q2,x,y\n1,2,3,4\n", "columns x, y and z"),
        ("a.csv", "q1,x,y,z\n1,2,3\n", "row 1 has 3 cells, the header 4"),
        ("a.csv", "q1,x,y,z\none,2,3,4\n", "row 1: q1 is 'one'"),
        ("a.csv", "q1,x,y,z\n,2,3,4\n", "row 1: q1 is missing"),
        ("a.csv", "q1,q1,x,y,z\n1,1,2,3,4\n", "names a column twice"),
        ("a.mat", "not a MATLAB file at all", "is no MATLAB file"),
    ],
)
def test_a_broken_table_is_one_sentence(
    scene: Scene, tmp_path: Path, name: str, text: str, needle: str
) -> None:
    path = tmp_path / name
    path.write_text(text, "utf-8")
    with pytest.raises(CellError) as caught:
        load_kincal(path, robot_file(scene, tmp_path))
    assert isinstance(caught.value, InputError)
    assert needle in str(caught.value)
    assert name in str(caught.value)


def test_matlab_columns_of_different_lengths_are_refused(scene: Scene, tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"q1": np.zeros((3, 1)), "x": np.zeros((2, 1)), "y": 1.0, "z": 1.0})
    with pytest.raises(InputError, match="different lengths"):
        load_kincal(tmp_path / "a.mat", robot_file(scene, tmp_path))


def test_a_path_that_is_not_there_says_so(tmp_path: Path) -> None:
    for name in ("none", "none.csv", "none.mat"):
        with pytest.raises(InputError, match="does not exist"):
            load_kincal(tmp_path / name)


def test_matlab_variables_without_joints_are_listed(scene: Scene, tmp_path: Path) -> None:
    savemat(tmp_path / "a.mat", {"joints": np.zeros((3, 6)), "data": {"q": np.zeros((3, 6))}})
    with pytest.raises(InputError, match=r"columns q1, q2, ...; it has joints, data"):
        load_kincal(tmp_path / "a.mat", robot_file(scene, tmp_path))
