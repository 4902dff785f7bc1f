"""A camera above a belt has a fixed exposure, or somebody is told how far items smear."""

from pathlib import Path

import pytest

from daemon.config import load_config

CELL = """schema = 1
[cell]
name = "bay"
[robot]
fixed_camera = "eye"
belt = "belt"
[device.belt]
driver = "canopen-encoder"
bus = "socketcan:can0"
node = 5
[device.eye]
driver = "oak"
"""


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ("", "smears an item over 10 mm"),
        ("fps = 25.0", "smears an item over 4 mm"),
        ("exposure_s = 0.002", ""),
        ('source = "frames+unix:///run/eye.sock"', ""),
    ],
)
def test_a_belt_under_automatic_exposure_is_told_how_far_items_smear(
    keys: str, told: str, tmp_path: Path
) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(f"{CELL}{keys}\n")
    path.chmod(0o600)
    found = [w for w in load_config(path).warnings if "device.eye.exposure_s" in w]
    assert len(found) == bool(told)
    assert all(told in warning for warning in found)


def test_a_camera_without_a_belt_may_expose_as_it_likes(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(CELL.replace('belt = "belt"\n', ""))
    path.chmod(0o600)
    assert not [w for w in load_config(path).warnings if "exposure_s" in w]
