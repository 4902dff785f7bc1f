"""What an encoder's delay has of its camera's."""

from typing import Any

import pytest

from cell.calibrations import camera_in_delay

CAMERA = "time_offset_s.camera"
BY = {"camera_calibration": CAMERA, "camera_version": 2}


@pytest.mark.parametrize(
    ("stated", "part_s"),
    [
        ({**BY, "camera_sigma_s": 1e-4}, 1e-4),
        (BY, None),  # by this camera, and nobody says how well it was known
        ({**BY, "camera_version": 1, "camera_sigma_s": 1e-4}, 0.0),
        ({**BY, "camera_calibration": "time_offset_s.other", "camera_sigma_s": 1e-4}, 0.0),
        ({"camera_version": 2, "camera_sigma_s": 1e-4}, None),
    ],
)
def test_a_part_counts_of_the_same_version_of_the_same_camera(
    stated: dict[str, Any], part_s: float | None
) -> None:
    assert camera_in_delay(stated, CAMERA, 2) == part_s
