"""The palletizer in a whole twin: what a daemon is told of it, and the person at its pendant."""

import asyncio
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.errors import CellError
from daemon.config import load_config
from fakes.twin.serve import Twin, TwinOptions
from fakes.world.scenario import Scenario
from tests.kit.ideal_world import ideal_text


@pytest.fixture
def subject(tmp_path: Path) -> Twin:
    """A twin that does not listen yet."""
    return Twin(TwinOptions("palletizer", tmp_path, "127.0.43.21"))


def ask(twin: Twin, q: list[Any]) -> Any:
    return asyncio.run(twin._handle({"do": "observed", "go": q}))


def test_the_twins_configuration_names_the_arm_and_what_its_controller_believes(
    subject: Twin, tmp_path: Path
) -> None:
    subject._write_cell_toml()
    config = load_config(subject.cell_toml)
    assert config.robot.roles()["observed_arm"] == "palletizer"
    truth = Scenario.load("palletizer:ideal").world.observed
    assert truth is not None
    assert config.robot.observed_robot_spec() == truth.robot
    section: Any = config.device["palletizer"]
    assert section.expect_serial == truth.serial
    assert section.url == "tcp://127.0.43.21:5503"
    job = config.job_section("tracker-sampling")
    assert job["joint_ranges_rad"] == truth.limits


def test_a_twin_that_writes_a_file_tells_the_daemon_where_it_is(tmp_path: Path) -> None:
    scenario = tmp_path / "file.toml"
    text = ideal_text("palletizer")
    scenario.write_text(text.replace("[fakes]\n", '[fakes]\nobserved_by = "file"\n'))
    twin = Twin(TwinOptions(str(scenario), tmp_path, "127.0.43.21"))
    twin._write_cell_toml()
    section: Any = load_config(twin.cell_toml).device["palletizer"]
    assert section.url == f"file://{tmp_path}/joints.csv"
    assert section.model == "Twin palletizer 4-280"
    assert not section.allow_requests


def test_somebody_at_the_pendant_moves_the_arm_within_its_limits(subject: Twin) -> None:
    arm = subject.world.observed
    assert arm is not None
    assert ask(subject, [0.1, 1.5, -1.5, 0.1]) > 0.1
    np.testing.assert_array_equal(arm.joints(arm.track.end_time), [0.1, 1.5, -1.5, 0.1])
    for wrong in ([0.1, 9.0, -1.5, 0.1], [0.1, 1.5], ["a", 1, 2, 3], [float("nan"), 1.5, -1.5, 0.0]):
        with pytest.raises(CellError) as caught:
            ask(subject, wrong)
        assert caught.value.name == "ARGUMENT_INVALID"


def test_a_twin_without_an_observed_arm_says_so(tmp_path: Path) -> None:
    twin = Twin(TwinOptions("laser", tmp_path, "127.0.43.21"))
    with pytest.raises(CellError, match="no observed arm"):
        ask(twin, [0.0, 0.0, 0.0, 0.0])


def test_faults_of_the_arm_and_of_its_wire_are_on_one_board(subject: Twin) -> None:
    offered = {fault.value for fault in subject.switchboard.devices["palletizer"].offers()}
    assert {"drop", "silence", "delay", "stuck", "skip-pose", "wrong-order", "unasked-move"} <= offered
    with pytest.raises(CellError, match="joints 1 to 4"):
        subject.switchboard.inject("palletizer", "stuck", {"joint": 5})
    with pytest.raises(CellError, match="does not take axis"):
        subject.switchboard.inject("palletizer", "stuck", {"axis": 5})
