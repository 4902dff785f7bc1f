"""The vision child finds items with the lens of the camera's calibration."""

from dataclasses import asdict, replace

import pytest

from cell.devices import Intrinsics
from daemon.vision_child import make_items

TOLD = Intrinsics(64, 48, (60.0, 60.0, 31.5, 23.5), (0.0,) * 5)
FOUND = replace(TOLD, K=(60.2, 60.1, 33.0, 22.0), dist=(0.01, 0.0, 0.0, 0.0, 0.0))
SPEC = {
    "normal": [0.0, 0.0, -1.0], "offset_m": -0.8, "min_height_m": 0.005, "max_height_m": 0.05,
    "size_m": [0.01, 0.3],
}  # fmt: skip


@pytest.mark.parametrize(
    ("lens", "used"),
    [(asdict(FOUND), FOUND), (asdict(replace(FOUND, width=128)), TOLD), (None, TOLD)],
    ids=["found", "of larger pictures", "none"],
)
def test_items_are_found_with_the_lens_of_the_calibration_where_it_is_of_such_pictures(
    lens: dict[str, object] | None, used: Intrinsics
) -> None:
    assert make_items({**SPEC, "lens": lens})(TOLD).camera == used
