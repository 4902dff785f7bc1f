"""The manual of data sets: its examples are valid files, and the complete one gives the stated answer."""

import json
import re
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from calibration.targets import make_target
from cell.formats import kincal, laser
from cell.formats.capture import SCHEMA, Capture, TargetTable
from cell.formats.reading import parse
from cell.poses import from_pose6, log_xi
from tests.kit.solved import solve_hand_eye, solve_kincal, solve_laser

MANUAL = (Path(__file__).parents[3] / "docs" / "data-sets.md").read_text("utf-8")
ALL: list[dict[str, Any]] = [json.loads(block) for block in re.findall(r"```json\n(.*?)```", MANUAL, re.S)]
EXAMPLES = [e for e in ALL if e["schema"] == SCHEMA]


def test_there_is_one_example_for_each_target() -> None:
    types = [get_args(t.model_fields["type"].annotation)[0] for t in get_args(get_args(TargetTable)[0])]
    assert sorted(e["target"]["type"] for e in EXAMPLES) == sorted(types)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda e: e["target"]["type"])
def test_example_is_a_valid_data_set(example: dict[str, Any]) -> None:
    capture = parse(Capture, example, SCHEMA, "the manual")
    points = len(make_target(capture.target.model_dump()).points)
    assert all(o.corners is None or len(o.corners) == points for o in capture.observations)


def test_complete_example_gives_the_stated_answer(tmp_path: Path) -> None:
    example = next(e for e in EXAMPLES if e["target"]["type"] == "points")
    (tmp_path / "capture.json").write_text(json.dumps(example))
    found = re.search(r"^T_flange_camera = (\[.*\])$", MANUAL, re.M)
    assert found is not None
    answer = from_pose6(solve_hand_eye(tmp_path)["result"]["T_flange_camera"])  # type: ignore[index]
    stated = from_pose6(json.loads(found[1]))
    assert np.abs(log_xi(stated.inv() * answer)).max() < 1e-5


def test_the_laser_example_gives_the_stated_answer(tmp_path: Path) -> None:
    (example,) = [e for e in ALL if e["schema"] == laser.SCHEMA]
    (tmp_path / "laser.json").write_text(json.dumps(example))
    stated = re.search(r"^dp_flange = (\[.*\]), 95 % of errors below ([0-9.]+) m$", MANUAL, re.M)
    assert stated is not None
    result = solve_laser(tmp_path)
    assert result["result"]["dp_flange"] == pytest.approx(json.loads(stated[1]), abs=5e-5)
    assert result["uncertainty"]["U_point_m"] == pytest.approx(float(stated[2]), rel=0.1)


def test_the_example_of_an_arm_gives_the_stated_figures(tmp_path: Path) -> None:
    (example,) = [e for e in ALL if e["schema"] == kincal.SCHEMA]
    (tmp_path / "kincal.json").write_text(json.dumps(example))
    result: Any = solve_kincal(tmp_path)
    for key in ("rms_nominal", "rms_registration_only", "rms_calibrated"):
        stated = re.search(rf"{key} = ([0-9.]+) m", MANUAL)
        assert stated is not None
        assert result["result"][key] == pytest.approx(float(stated[1]), abs=1e-5)
