"""The verdict of a sampling on poses set aside, held against limits that mean 95 % of errors."""

from types import SimpleNamespace
from typing import Any

import pytest

from procedures.tracker.judging import _beyond, _warnings

FACTS: Any = SimpleNamespace(
    wanted=10,
    measured=10,
    off_plan=None,
    doubtful=None,
    monuments=SimpleNamespace(
        beyond_noise=False,
        beyond_limit=False,
        max_moved_m=0.0,
        limit_m=0.0001,
        samples_since_last_look=0,
    ),
)


def aside(calibrated_m: float, samples: int = 8) -> Any:
    return SimpleNamespace(rms=SimpleNamespace(calibrated=calibrated_m), tracker_3d=0.00003, samples=samples)


def test_the_rms_of_poses_set_aside_is_not_held_against_a_limit_of_95_percent_as_it_is() -> None:
    """An RMS of 0.2 mm means that 95 % of errors stay below 0.39 mm, whichever directions they have."""
    (reason,) = _beyond(aside(0.0002023), 0.0001, 0.0003)
    assert "0.2 mm off" in reason
    assert "95 % of errors stay below 0.392 mm" in reason
    assert _beyond(aside(0.00015), 0.0001, 0.0003) == []


@pytest.mark.parametrize(("samples", "surprises"), [(2, False), (8, True)])
def test_how_far_off_is_a_surprise_depends_on_how_many_poses_say_so(samples: int, surprises: bool) -> None:
    codes = [code for code, _ in _warnings(aside(0.000055, samples), 0.00003, FACTS)]
    assert codes == ["heldout.surprise"] * surprises
