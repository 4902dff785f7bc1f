"""``[limits]`` of single joints: one number or six, and how far each may turn."""

from pathlib import Path

import pytest

from cell.errors import CellError
from cell.joint_limits import limit_words
from daemon.config import CellConfig, ConfigInvalid, init_text, load_config
from daemon.values import configured_values
from procedures.arm_setup import with_job_limits
from procedures.belt.config import BeltTrackingConfig
from tests.kit.picking_cell import picking_config

EACH = [0.5, 0.5, 0.8, 1.0, 1.0, 1.0]
RANGES = "[[-3.2, 3.2], [-3.2, 0.5], [0.0, 3.1], [-3.2, 3.2], [-3.2, 3.2], [-3.2, 3.2]]"


def load(folder: Path, speed: str = "0.8", ranges: str = "") -> CellConfig:
    """The shipped example with these limits."""
    old = next(line for line in init_text().splitlines() if line.startswith("joint_speed_rad_s"))
    text = init_text().replace(old, f"joint_speed_rad_s = {speed}\n{ranges}")
    path = folder / "cell.toml"
    path.write_text(text)
    return load_config(path)


def findings(folder: Path, speed: str = "0.8", ranges: str = "") -> list[str]:
    with pytest.raises(ConfigInvalid) as caught:
        load(folder, speed, ranges)
    return [sentence.split(": ", 1)[1] for sentence in caught.value.findings]


def test_one_number_holds_for_all_joints_and_six_for_each(tmp_path: Path) -> None:
    assert load(tmp_path).limits.joint_speed_rad_s == 0.8
    assert load(tmp_path).limits.joint_ranges_rad is None
    subject = load(tmp_path, str(EACH), f"joint_ranges_rad = {RANGES}").limits
    assert subject.joint_speed_rad_s == EACH
    assert subject.model_dump(mode="json")["joint_ranges_rad"][1] == [-3.2, 0.5]


@pytest.mark.parametrize(
    ("speed", "ranges", "told"),
    [
        ("[0.5, 0.5]", "", "limits.joint_speed_rad_s: should have 6 entries"),
        ("0.0", "", "limits.joint_speed_rad_s: should be greater than or equal to 0.001"),
        (
            "[0.5, 0.5, 0.8, 1.0, 1.0, 11.0]",
            "",
            "limits.joint_speed_rad_s[5]: should be less than or equal to 10",
        ),
        ('"fast"', "", "limits.joint_speed_rad_s: should be a valid number"),
        ("0.8", "joint_ranges_rad = [[-1.0, 1.0]]", "limits.joint_ranges_rad: should have 6 entries"),
        (
            "0.8",
            f"joint_ranges_rad = {RANGES.replace('[0.0, 3.1]', '[3.1, 0.0]')}",
            "limits.joint_ranges_rad[2]: 3.1 is not below 0; write [low, high]",
        ),
    ],
)
def test_a_limit_of_another_form_is_one_finding(tmp_path: Path, speed: str, ranges: str, told: str) -> None:
    (found,) = findings(tmp_path, speed, ranges)
    assert found.startswith(told)


def test_a_pose_beyond_the_range_of_a_joint_is_a_finding(tmp_path: Path) -> None:
    (found,) = findings(tmp_path, ranges=f"joint_ranges_rad = {RANGES.replace('[0.0, 3.1]', '[2.0, 3.1]')}")
    assert found == (
        "poses.home[2]: 1.57 rad is beyond limits.joint_ranges_rad of joint 3, 2 to 3.1 rad; widen it, or "
        "teach the pose elsewhere"
    )


@pytest.mark.parametrize(("speed", "warned"), [(0.5, False), (0.6, True), (EACH, False), ([0.6] * 6, True)])
def test_a_job_faster_than_one_of_the_joints_may_be_is_warned_of_and_refused(
    tmp_path: Path, speed: float | list[float], warned: bool
) -> None:
    job = {"limits": {"speed_m_s": 0.5, "accel_m_s2": 1.0, "joint_speed_rad_s": speed}}
    box = {"min": [-1.3, -1.3, 0.0], "max": [1.3, 1.3, 1.8]}
    limits = {"speed_m_s": 0.5, "accel_m_s2": 1.0, "joint_speed_rad_s": EACH, "workspace": [box]}
    subject = picking_config(tmp_path, job, limits=limits)
    words = f"{limit_words(speed)} is above [0.5, 0.5, 0.8, 1, 1, 1] of [limits]"
    assert any(words in text for text in subject.warnings) == warned
    wanted = BeltTrackingConfig.model_validate(subject.job["belt-tracking"]).limits
    if warned:
        with pytest.raises(CellError, match=r"joint_speed_rad_s .* is above .*; lower it"):
            with_job_limits(configured_values(subject), wanted)
    else:
        assert with_job_limits(configured_values(subject), wanted).limits["joint_speed_rad_s"] == speed
