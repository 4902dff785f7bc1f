"""A reflector's constant that is wrong hides in link lengths; the residuals along the beams still tell."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.identification.range_offset import RangeOffset, range_offset
from calibration.identification.solution import identify
from tests.kit.kincal_scene import SIGMA0, SIGMA_PER_M, make_scene

NOISE = {"sigma0": SIGMA0, "sigma_per_m": SIGMA_PER_M}


def asked(kind: str, offset_m: float, seed: int) -> RangeOffset:
    problem = make_scene(kind, seed, 40, noise=1.0).problem
    p = problem.p * (1.0 + offset_m / problem.range_m)
    found = range_offset(identify(replace(problem, p=p), NOISE))
    assert found is not None
    return found


@pytest.mark.parametrize("kind", ["ur10e", "palletizer"])
@pytest.mark.parametrize("offset_m", [0.0007, -0.0007])
def test_ranges_that_are_too_long_or_short_by_one_length_are_told_with_it(kind: str, offset_m: float) -> None:
    found = asked(kind, offset_m, 3)
    assert found.significant
    assert found.targets == ("smr1",)
    assert found.offset_m == pytest.approx(offset_m, abs=4.0 * found.sigma_m)
    assert found.sigma_m < 0.00015


@pytest.mark.parametrize("kind", ["ur10e", "palletizer"])
def test_a_right_constant_is_not_blamed(kind: str) -> None:
    found = [asked(kind, 0.0, seed) for seed in range(4)]
    assert not any(f.significant for f in found)
    assert np.median([abs(f.offset_m / f.sigma_m) for f in found]) < 2.5


def test_too_few_readings_are_asked_nothing() -> None:
    problem = make_scene("ur10e", 0, 7, noise=1.0).problem
    assert range_offset(identify(problem, NOISE)) is None
