"""``cellward check`` of a cell that picks from a belt."""

import json
from pathlib import Path
from typing import Any

import pytest

from tests.kit.cli_harness import CellOnDisk, CommandLine
from tests.kit.picking_cell import picking_config

WAIT = "wait = [-2.067451, -1.757146, 2.164129, -1.977778, -1.570796, -0.496655]"


@pytest.fixture
def subject(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> CommandLine:
    return CommandLine(monkeypatch, capsys, CellOnDisk(tmp_path).config)


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    picking_config(tmp_path)
    return tmp_path / "cell.toml"


def belt_of(shown: str) -> dict[str, Any]:
    found: dict[str, Any] = next(
        row for row in json.loads(shown)["predictions"] if row["job"] == "belt-tracking"
    )
    return found


def change(path: Path, was: str, now: str) -> None:
    text = path.read_text()
    assert text.count(was) == 1, (was, text)
    path.write_text(text.replace(was, now))


def test_slide_window_and_rate_are_told_for_each_speed(subject: CommandLine, cell: Path) -> None:
    shown = subject("check", "-c", cell, "--json")
    assert shown.code == 0, shown.err
    belt = belt_of(shown.out)
    assert belt["problems"] == []
    for row, speed in zip(belt["speeds"], (0.1, 0.2, 0.3), strict=True):
        assert row["window_s"] == pytest.approx(0.55 / speed)
        assert row["slide_m"] == pytest.approx(0.05 * speed)
        low, high = row["per_minute"]
        # Two level ways of 0.3 m at 1 m/s, 6 m/s2 and 80 m/s3 take 0.54 s each, grip and release 0.1 s each.
        assert 5.0 < low <= high < 60.0 / (2 * 0.54 + 2 * 0.1)
    assert belt["slides"][0] == {"speed_m_s": 0.01, "slide_m": pytest.approx(0.0005)}
    assert "the tool moves with the item" in belt["text"]


@pytest.mark.parametrize(
    ("was", "now", "told"),
    [
        ("max_m = 0.45", "max_m = 2.0", "zone.max_m = 2 m cannot be worked in"),
        ("min_m = -0.1", "min_m = -1.9", "zone.min_m = -1.9 m cannot be worked in"),
        ("speed_m_s = 1.5", "speed_m_s = 0.5", "limits.speed_m_s 1 is above 0.5 of [limits]"),
        (WAIT, WAIT.replace("-1.977778", "-1.877778"), "wait_pose 'wait': the tool leans by 5.7 deg"),
        ("max = [1.3, 1.3, 1.8]", "max = [1.3, 0.3, 1.8]", "cannot be worked in"),
    ],
)
def test_what_would_be_refused_is_told_at_once(
    subject: CommandLine, cell: Path, was: str, now: str, told: str
) -> None:
    change(cell, was, now)
    shown = subject("check", "-c", cell)
    assert shown.code == 2
    assert told in shown.err
    assert "Traceback" not in shown.err


@pytest.mark.parametrize(
    ("was", "now", "told"),
    [
        ("m_per_count = 0.0001", "m_per_count = 0.1", "the rounding of a count alone is 28.9 mm RMS"),
        ("dir = [0.9998, -0.02, 0.0]", "dir = [-0.9998, 0.02, 0.0]", "behind the end of the zone at 0.45 m"),
        (
            "[job.belt-calibration]\nbelt_z_m = 0.15",
            "[job.belt-calibration]\nbelt_z_m = 0.2",
            "belt_z_m is 0.15 m here and 0.2 m in [job.belt-calibration]",
        ),
        (
            "T_base_camera_nominal = [-0.75, 0.55, 0.95,",
            "T_base_camera_nominal = [-0.75, 0.55, 0.2,",
            "the camera at 0.2 m does not look down on the belt",
        ),
    ],
)
def test_what_looks_mistaken_is_a_warning_that_says_what_to_look_at(
    subject: CommandLine, cell: Path, was: str, now: str, told: str
) -> None:
    change(cell, was, now)
    shown = subject("check", "-c", cell)
    assert shown.code == 0, shown.err
    assert told in shown.err


def test_a_missing_device_is_told_by_its_role(subject: CommandLine, cell: Path) -> None:
    change(cell, 'gripper = "gripper"', "")
    change(cell, "[device.gripper]", "[device.claw]")
    shown = subject("check", "-c", cell)
    assert shown.code == 2
    assert "[robot] names no device for gripper, which the job needs; add it" in shown.err


def test_a_zone_that_is_left_before_the_grip_ends_is_a_warning(subject: CommandLine, cell: Path) -> None:
    change(cell, "max_m = 0.45", "max_m = 0.0")
    shown = subject("check", "-c", cell)
    assert shown.code == 0, shown.err
    assert "at 0.3 m/s an item is in the zone for 0.33 s, less than dwell_s and grip_timeout_s" in shown.err
