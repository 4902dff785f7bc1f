"""The blend between level and straight ways fits into the way down, or the configuration is refused."""

from typing import Any

import pytest

from procedures.belt.config import BeltTrackingConfig
from procedures.belt.motion.blend import blend_for
from procedures.belt.motion.tool_path import pursuit_limits

GRID = {"rows": 2, "columns": 2, "column_pitch_m": 0.1, "row_pitch_m": 0.1}


def config_of(**job: Any) -> BeltTrackingConfig:
    keys = {"wait_pose": "wait", "place_pose": "place", "zone": {"min_m": 0.0, "max_m": 0.3}, "belt_z_m": 0.0}
    return BeltTrackingConfig.model_validate({**keys, **job})


@pytest.mark.parametrize("job", [{"grip_m": 0.002, "place_grid": GRID}, {"grip_m": 0.04}])
def test_a_way_down_shorter_than_its_straight_part_is_straight_from_the_level_way_on(
    job: dict[str, Any],
) -> None:
    config = config_of(**job)
    limits = pursuit_limits(config.limits)
    blend = blend_for(config, limits, config.items.max_height_m if config.place_grid else 0.0)
    assert blend.reach_s == 0.0
    assert 0.0 < blend.last_s < 0.2


def test_the_straight_part_of_a_grid_is_as_high_as_an_item() -> None:
    config = config_of(above_m=0.08, grip_m=0.002, place_grid=GRID)
    blend = blend_for(config, pursuit_limits(config.limits), config.items.max_height_m)
    assert blend.reach_s > 0.0
    assert blend.clear_m == config.items.max_height_m


def test_a_straight_part_longer_than_the_way_down_to_an_item_is_refused() -> None:
    with pytest.raises(ValueError, match=r"straight_m = 0.05 m is longer than the way down, 0.048 m"):
        config_of(grip_m=0.002, straight_m=0.05)


def test_a_straight_part_of_the_whole_way_down_is_taken() -> None:
    config = config_of(grip_m=0.002, straight_m=0.048)
    assert blend_for(config, pursuit_limits(config.limits)).reach_s == pytest.approx(0.0, abs=0.05)
