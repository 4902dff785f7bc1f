"""``cellward solve`` on data sets from anywhere: good ones, degenerate ones, and every kind of broken one."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from cell.poses import exp_xi, from_pose6, log_xi, to_pose6
from daemon.cli import main

X_TRUE = [0.006, -0.0864, 0.0548, 0.026254, -0.031504, 0.032554]
K = [800.0, 800.0, 639.5, 399.5]
SIGMA_PX = 0.05
POINTS = np.array([[0.05 * i, 0.05 * j, 0.0] for i in range(4) for j in range(3)])


def capture_set(tilt_rad: float = 0.35) -> dict[str, Any]:
    """Two placements with ten views each of twelve points; without tilt all rotations share one axis."""
    rng = np.random.default_rng(7)
    X = from_pose6(X_TRUE)
    observations = []
    for group in range(2):
        W = from_pose6([-0.7, 0.2 * group, 0.1, 3.0, 0.2 * group, 0.1])
        for k in range(10):
            f = 2 * np.pi * k / 10
            turn = Rotation.from_rotvec([tilt_rad * np.sin(f), -tilt_rad * np.cos(f), 0.0 if tilt_rad else f])
            C = RigidTransform.from_components([-0.08, -0.05, 0.45 + 0.01 * (k % 3)], turn)
            F = W * C.inv() * X.inv()
            p = C.apply(POINTS)
            uv = p[:, :2] / p[:, 2:] * K[:2] + K[2:] + SIGMA_PX * rng.standard_normal((len(p), 2))
            measured = F * exp_xi(rng.standard_normal(6) * ([3e-5] * 3 + [1e-5] * 3))
            observations.append(
                {"index": len(observations), "group": group, "corners": uv.tolist(),
                 "T_base_flange": to_pose6(measured).tolist()}
            )  # fmt: skip
    return {
        "schema": "cellward.capture/1",
        "setup": "eye-in-hand",
        "camera": {"width": 1280, "height": 800, "K": K, "dist": []},
        "target": {"type": "points", "points": POINTS.tolist()},
        "observations": observations,
    }


@pytest.fixture
def subject(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """``subject(data, *words)`` writes a data set, solves it, and gives exit code, stdout and stderr."""

    def solve(data: Any, *words: object) -> tuple[int, str, str]:
        text = data if isinstance(data, str) else json.dumps(data)
        (tmp_path / "capture.json").write_text(text)
        monkeypatch.setattr("sys.argv", ["cellward", "solve", "hand-eye", str(tmp_path), *map(str, words)])
        capsys.readouterr()
        return main(), *capsys.readouterr()

    return solve


def test_a_good_set_gives_the_camera_with_an_uncertainty_that_holds(subject: Any) -> None:
    code, out, _ = subject(capture_set(), "--json")
    assert code == 0
    answer = json.loads(out)["result"]
    xi = log_xi(from_pose6(answer["T_flange_camera"]).inv() * from_pose6(X_TRUE))
    assert np.linalg.norm(xi[:3]) < 2e-4
    assert xi @ np.linalg.solve(np.array(answer["cov"]), xi) < 22.5  # chi-square, 6 degrees: 99.9 %


def test_the_summary_is_in_millimetres_and_degrees_with_its_uncertainty(subject: Any, tmp_path: Path) -> None:
    code, out, err = subject(capture_set(), "-o", tmp_path / "result.json")
    assert code == 0
    for told in ("camera in flange", " mm, rotation vector [", "standard uncertainty", "px RMS"):
        assert told in out
    assert str(tmp_path / "result.json") in err
    assert json.loads((tmp_path / "result.json").read_text())["schema"] == "cellward.result/1"


def test_the_same_data_give_the_same_answer_to_the_last_bit(subject: Any) -> None:
    first, second = (json.loads(subject(capture_set(), "--json")[1]) for _ in range(2))
    assert first["result"] == second["result"]


def test_rotations_about_one_axis_are_refused_by_name_with_exit_code_1(subject: Any) -> None:
    code, out, _ = subject(capture_set(tilt_rad=0.0), "--json")
    result = json.loads(out)
    assert (code, result["verdict"], result["result"]) == (1, "fail", None)
    assert result["reasons"][0].startswith("rigid-roll")
    assert "no answer" in subject(capture_set(tilt_rad=0.0))[1]


def without(key: str) -> Callable[[dict[str, Any]], Any]:
    return lambda data: {k: v for k, v in data.items() if k != key}


def with_first(**fields: Any) -> Callable[[dict[str, Any]], Any]:
    def change(data: dict[str, Any]) -> dict[str, Any]:
        data["observations"][0] |= fields
        return data

    return change


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda data: "{not json", "capture.json"),
        (lambda data: "[1, 2]", "capture.json"),
        (lambda data: json.dumps(data).replace("800.0", "NaN", 1), "NaN"),
        (without("setup"), "setup"),
        (without("observations"), "observations"),
        (lambda data: data | {"schema": "cellward.capture/9"}, "schema"),
        (lambda data: data | {"obervations": []}, "obervations"),
        (lambda data: data | {"setup": "eye-on-hand"}, "setup"),
        (lambda data: data | {"target": {"type": "chesboard", "columns": 3}}, "chesboard"),
        (with_first(T_base_flange=[0.1, 0.2]), "T_base_flange"),
        (with_first(T_base_flang=[0.0] * 6), "T_base_flang"),
        (with_first(corners=[[1.0, 2.0]]), "corners"),
        (with_first(image="../../etc/passwd", corners=None), "passwd"),
    ],
)
def test_a_broken_data_set_is_one_sentence_that_names_the_place(subject: Any, change: Any, told: str) -> None:
    code, out, err = subject(change(capture_set()))
    assert (code, out) == (2, "")
    assert told in err
    assert "Traceback" not in err
    assert "Error 9001" not in err


@pytest.mark.parametrize(
    ("content", "told"), [(None, "missing"), (b"", "000.png"), (b"\x89PNG junk", "000.png")]
)
def test_a_missing_or_corrupt_image_is_named(
    subject: Any, tmp_path: Path, content: bytes | None, told: str
) -> None:
    data = capture_set()
    data["target"] = {"type": "chessboard", "columns": 4, "rows": 3, "square_m": 0.05}
    for observation in data["observations"]:
        del observation["corners"]
        observation["image"] = "images/000.png"
    if content is not None:
        (tmp_path / "images").mkdir()
        (tmp_path / "images" / "000.png").write_bytes(content)
    code, out, err = subject(data)
    assert (code, out) == (2, "")
    assert "000.png" in err
    assert told in err


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("solve", "hand-eye", "/no/such/folder"), "/no/such/folder"),
        (("solve", "handeye", "."), "did you mean hand-eye?"),
        (("solve", "belt", "."), "there is: axbc, cross-check, hand-eye"),
        (("solve", "hand-eye", ".", "-o", "/no/such/folder/result.json"), "/no/such/folder"),
    ],
)
def test_wrong_words_are_explained(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: Any, told: str
) -> None:
    monkeypatch.setattr("sys.argv", ["cellward", *words])
    assert main() == 2
    assert told in capsys.readouterr().err


def test_an_unknown_method_names_those_there_are(subject: Any) -> None:
    code, _, err = subject(capture_set(), "--method", "magic")
    assert code == 2
    assert "magic" in err


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("name", ["ur5_realsense_eye_in_hand", "ic_charuco_eye_to_hand"])
def test_real_images_solve_from_the_command_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], data_folder: Path, name: str
) -> None:
    monkeypatch.setattr("sys.argv", ["cellward", "solve", "hand-eye", str(data_folder / name), "--json"])
    code = main()
    result = json.loads(capsys.readouterr().out)
    assert code == (1 if result["verdict"] == "fail" else 0)
    assert result["result"] is not None
