"""In the run of a twin the report puts what was found and stated beside the truth."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from procedures.documents import read_result
from procedures.hand_eye.report.source import HandEyeSource
from procedures.hand_eye.report.truth import TITLE, truth_section
from procedures.report.source import TRUTH_FILE
from procedures.report.write import write_report
from tests.kit.solved import solve_hand_eye
from tests.unit.procedures.test_report_page import X_TRUE, K, capture

OFF = 0.004  # of the focal length that the camera tells


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder with its result, of a camera that tells its focal length 0.4 % too long."""
    folder = tmp_path_factory.mktemp("run")
    told = capture(placements=1, noise_px=0.02)
    told["camera"]["K"] = [K[0] * (1.0 + OFF), K[1] * (1.0 + OFF), K[2], K[3]]
    (folder / "capture.json").write_text(json.dumps(told), "utf-8")
    result = solve_hand_eye(folder)
    (folder / "result.json").write_text(json.dumps(result), "utf-8")
    return folder


@pytest.fixture
def truth() -> dict[str, Any]:
    return {
        "T_flange_camera": [*X_TRUE.translation.tolist(), *X_TRUE.rotation.as_rotvec().tolist()],
        "camera": {"K": list(K)},
        "target_print": {"scale_x": 0.0, "scale_y": 0.0},
    }


def rows(folder: Path, truth: Mapping[str, Any]) -> str:
    source = HandEyeSource(
        read_result(json.loads((folder / "result.json").read_text("utf-8"))), folder=folder
    )
    source.truth = truth
    found = truth_section(source)
    assert found is not None
    return str(found)


def test_the_lens_that_was_found_stands_beside_the_true_one(folder: Path, truth: dict[str, Any]) -> None:
    text = rows(folder, truth)
    for told in ("camera, place", "camera, rotation", "principal point y", "printed size y"):
        assert told in text
    focal = text[text.index("focal length x") :].split("</tr>")[0]
    assert "900.00 px" in focal
    answer = json.loads((folder / "result.json").read_text("utf-8"))["result"]
    assert f"{answer['lens']['K'][0]:.2f} px" in focal
    assert abs(answer["lens"]["K"][0] - K[0]) < 0.5 * OFF * K[0], "most of the error was found"


def test_a_report_has_the_section_only_where_the_truth_is_known(folder: Path, truth: dict[str, Any]) -> None:
    assert TITLE not in write_report(folder).read_text("utf-8")
    (folder / TRUTH_FILE).write_text(json.dumps(truth), "utf-8")
    assert TITLE.replace("'", "&#x27;") in write_report(folder).read_text("utf-8")
    (folder / TRUTH_FILE).unlink()
