"""What is expected of a belt calibration: what it leaves open, and limits that it will miss."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from daemon.predictions import setup_of
from drivers.oak.config import OakConfig
from procedures.belt.calibrating.config import BeltCalibrationConfig
from procedures.belt.calibrating.expectation import calibration_expectation
from procedures.setup import Setup
from tests.kit.picking_cell import picking_config

Z_M = 0.15  # of the belt


@pytest.fixture
def setup(tmp_path: Path) -> Setup:
    return setup_of(picking_config(tmp_path, {}, {}))


def expected(setup: Setup, **keys: Any) -> dict[str, Any]:
    job = BeltCalibrationConfig.model_validate({"belt_z_m": Z_M, **keys})
    return calibration_expectation(setup, job)


def test_what_the_cameras_place_and_depth_leave_is_told(setup: Setup) -> None:
    found = expected(setup)
    height = float(setup.nominal["T_base_camera_nominal"][2]) - Z_M  # type: ignore[index]
    share = 100.0 * float((0.0005 / height) ** 2 + 0.0008**2) ** 0.5
    assert f"m_per_count at best to {share:.3f} % (95 %)" in found["text"]
    assert "0.5 mrad seen from above and 3.4 mrad of its rise" in found["text"]
    assert found["problems"] == found["cautions"] == []


def test_items_of_a_known_height_leave_the_steps_of_depth_out(setup: Setup) -> None:
    assert expected(setup, items={"height_m": 0.03})["leaves"]["rise_rad"] == 0.0005


@pytest.mark.parametrize(
    ("limit", "said"),
    [
        ({"max_scale_share": 0.0005}, ("max_scale_share = 0.0005 is 0.05 %", "give items.height_m")),
        ({"max_dir_rad": 0.0004}, ("max_dir_rad = 0.0004 is 0.4 mrad", "lower camera_turn_95_rad")),
        ({"max_rise_rad": 0.002}, ("max_rise_rad = 0.002 is 2 mrad", "by the steps of its depth")),
    ],
)
def test_a_limit_that_cannot_be_met_is_named(
    setup: Setup, limit: dict[str, float], said: tuple[str, str]
) -> None:
    (caution,) = expected(setup, accept=limit)["cautions"]
    assert all(words in caution for words in said), caution


def test_a_camera_without_depth_and_a_height_that_is_not_known_is_a_problem(setup: Setup) -> None:
    colour = OakConfig.model_validate({"depth": False})
    without = replace(setup, devices={**setup.devices, setup.roles["fixed_camera"]: colour})
    (problem,) = expected(without)["problems"]
    assert "give [job.belt-calibration.items] height_m" in problem


def test_touches_need_no_camera(setup: Setup) -> None:
    without = replace(setup, roles={k: v for k, v in setup.roles.items() if k != "fixed_camera"})
    found = calibration_expectation(without, BeltCalibrationConfig.model_validate({"source": "touch"}))
    assert found["problems"] == []
    assert "2 touches of a mark" in found["text"]
