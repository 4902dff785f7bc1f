"""Bending the tool of a twin: the command, the request, and what the twin says is true."""

import asyncio
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform
from typer.testing import CliRunner

from cell.errors import CellError
from fakes import cli
from fakes.twin.serve import Twin, TwinOptions
from fakes.ur.variables import OUTPUTS


@pytest.fixture
def subject(tmp_path: Path) -> Twin:
    return Twin(TwinOptions("laser", tmp_path))


def ask(twin: Twin, **request: Any) -> Any:
    return asyncio.run(twin._handle(request))


def test_a_bend_is_in_force_at_once_and_both_poses_are_told(subject: Twin) -> None:
    pose = ask(subject, do="tool", bend=[0.0012, -0.0007, 0.0005, 0.01, 0.0, 0.0])
    assert pose[:3] == pytest.approx([0.0012, -0.0007, 0.1805])
    truth = ask(subject, do="truth")
    assert truth["T_flange_tool"] == pose
    assert truth["T_flange_tool_nominal"] == pytest.approx([0, 0, 0.18, 0, 0, 0])
    assert ask(subject, do="tool", straighten=True) == pytest.approx([0, 0, 0.18, 0, 0, 0])


@pytest.mark.parametrize("bend", [[0.1], ["x"] * 6, [float("nan")] * 6, 5])
def test_a_bend_that_is_none_is_refused(subject: Twin, bend: Any) -> None:
    with pytest.raises(CellError, match="does not know the request"):
        ask(subject, do="tool", bend=bend)


def test_the_controllers_packages_carry_the_beams_wired_to_its_inputs(subject: Twin) -> None:
    world, robot = subject.world, subject.controller.robot
    t = world.t0 + 1.0
    tip = (world.true_flange(t) * world.T_flange_tool).translation
    below = np.array(world.config.beams["ys"].point) - tip - [0.0, 0.05, 0.01]
    flange = RigidTransform.from_translation(below) * world.believed_flange(t)
    bits = OUTPUTS["actual_digital_input_bits"].read
    assert bits(robot, robot.instant(t)) == 0
    world.track.hold(t, world.believed.inverse(flange, world.track.at(t)[0]))
    assert bits(robot, robot.instant(t + 0.0021)) == 0b10
    robot.io.digital_in = 0b1000
    assert bits(robot, robot.instant(t + 0.0021)) == 0b1010


def test_the_command_sends_metres_and_radians(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    sent: list[Any] = []

    def answer(folder: Path, request: Any) -> list[float]:
        sent.append((folder, request))
        return [0.0] * 6

    monkeypatch.setattr(cli, "ask", answer)
    run = CliRunner().invoke(
        cli.app, ["tool", "bend", "--dx", "0.0012", "--ry", "-0.01", "--out", str(tmp_path)]
    )
    assert run.exit_code == 0, run.output
    assert CliRunner().invoke(cli.app, ["tool", "straighten", "--out", str(tmp_path)]).exit_code == 0
    assert sent == [
        (tmp_path, {"do": "tool", "bend": [0.0012, 0.0, 0.0, 0.0, -0.01, 0.0]}),
        (tmp_path, {"do": "tool", "straighten": True}),
    ]
    assert CliRunner().invoke(cli.app, ["tool", "bend", "--dx", "12"]).exit_code == 2
