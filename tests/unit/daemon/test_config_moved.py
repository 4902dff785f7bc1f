"""A key of an earlier version is read at its old place, and the file is told where it belongs."""

import re
from pathlib import Path

import pytest

from daemon.config import ConfigInvalid, load_config
from fakes.world.scenario import Scenario
from tests.kit.object_cell import write_config

NOMINAL = "{ m_per_count = 0.0001, dir = [0.9998, -0.02, 0.0] }"


JOB = "[job.belt-tracking]\n"


def picking_file(folder: Path) -> Path:
    write_config(folder, "picking")
    return folder / "cell.toml"


def moved_back(folder: Path, nominal: str = NOMINAL) -> Path:
    """The picking cell's file with the nominal belt where it stood before."""
    path = picking_file(folder)
    text = re.sub(r"\[robot\.belt_nominal\]\n[^\[]*\[[^\[]*", "", path.read_text("utf-8"))
    assert "belt_nominal" not in text
    path.write_text(text.replace(JOB, f"{JOB}belt = {nominal}\n"), "utf-8")
    return path


def test_the_nominal_belt_is_read_where_it_stood_before(tmp_path: Path) -> None:
    subject = load_config(moved_back(tmp_path))
    assert subject.robot.belt_nominal is not None
    assert (
        subject.robot.belt_nominal.model_dump(exclude_none=True) == Scenario.load("picking").cell.belt_nominal
    )
    (warning,) = subject.warnings
    assert "job.belt-tracking.belt: belongs to [robot] belt_nominal; move it there" in warning
    assert "belt" not in subject.job_section("belt-tracking")


def test_what_is_wrong_with_it_is_found_in_its_old_line(tmp_path: Path) -> None:
    path = moved_back(tmp_path, "{ m_per_count = 0.0001, dir = [2.0, 0.0, 0.0] }")
    lines = path.read_text("utf-8").splitlines()
    number = 1 + [line.startswith("belt = {") for line in lines].index(True)
    with pytest.raises(ConfigInvalid) as caught:
        load_config(path)
    (finding,) = caught.value.findings
    assert f"cell.toml:{number}: " in finding
    assert "dir must be a unit vector" in finding


def test_two_places_that_differ_are_a_finding(tmp_path: Path) -> None:
    other = "belt = { m_per_count = 0.0002, dir = [0.9998, -0.02, 0.0] }"
    path = picking_file(tmp_path)
    path.write_text(path.read_text("utf-8").replace(JOB, f"{JOB}{other}\n"), "utf-8")
    with pytest.raises(ConfigInvalid) as caught:
        load_config(path)
    assert "differs from [robot] belt_nominal, where it belongs; remove it here" in caught.value.findings[0]
