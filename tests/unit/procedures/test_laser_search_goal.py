"""How long a crossed-beam job looks for the height."""

from pathlib import Path

from bench._laser_world import P_REF, World, search, take
from calibration.tool_frame.repeatability import stated_sigma


def test_the_search_goes_on_until_the_height_is_known_as_well_as_the_limit_asks_for(tmp_path: Path) -> None:
    coarse = search(short=True)
    sigma = stated_sigma("ur10e")
    near = [
        take(World(3, sigma=sigma), tmp_path / f"{limit}", coarse, 1, sigma, P_REF, limit).near
        for limit in (2e-4, 2e-5)
    ]
    assert near[0] < near[1]
