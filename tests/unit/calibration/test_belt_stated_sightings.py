"""What the detector states of sightings, in what is known of an item's place."""

from collections.abc import Callable

import numpy as np
import pytest

from calibration.belt.estimator import BeltEstimator, EncoderScale
from calibration.belt.items import Sighting
from calibration.belt.tracking import BeltTracker

V, M_PER_COUNT, PERIOD = 0.15, 1e-4, 0.005
TIMES = np.arange(1.0, 4.9, 0.5)  # of exposures
ITEMS, DRAWS = 6, 40
INSIDE = 1.96
Draw = Callable[[np.random.Generator], np.ndarray]  # errors (k, 2) of one item's sightings, along and across


def belt() -> BeltTracker:
    """A steady belt along x, counted for five seconds."""
    out = BeltTracker(BeltEstimator(EncoderScale(M_PER_COUNT, None, PERIOD)), np.array([1.0, 0.0, 0.0]))
    out.belt.extend((float(t), round(V * t / M_PER_COUNT)) for t in np.arange(0.0, 5.0, PERIOD))
    return out


def inside(draw: Draw, sigma_m: float) -> np.ndarray:
    """(2,): the share of items whose place is within its 95 %, along and across."""
    within = []
    for seed in range(DRAWS):
        rng, subject = np.random.default_rng([seed, 11]), belt()
        for item in range(ITEMS):
            for t, (along, across) in zip(TIMES, draw(rng), strict=True):
                xy = float(V * t - 0.35 * item + along), float(across)
                subject.see(str(item), Sighting(xy, float(t), float(t) + 0.03, True, sigma_m), 0.18)
        for item in range(ITEMS):
            track = subject.track(str(item))
            assert track is not None
            place = track.place
            off = np.array([place.along + 0.35 * item, place.across])
            within.append(np.abs(off) <= INSIDE * np.sqrt([place.var_along, place.var_across]))
    return np.asarray(np.mean(within, axis=0))


def test_items_that_smear_along_the_belt_lie_within_what_is_known_of_their_place() -> None:
    def smeared(rng: np.random.Generator) -> np.ndarray:
        return rng.standard_normal((len(TIMES), 2)) * [8e-4, 3e-4]

    found = inside(smeared, 8.5e-4)
    assert np.all((found >= 0.90) & (found <= 0.99)), found


def test_an_error_that_all_sightings_of_an_item_share_does_not_get_less_with_their_number() -> None:
    def alike(rng: np.random.Generator) -> np.ndarray:
        return 3e-4 * rng.standard_normal(2) + 6e-5 * rng.standard_normal((len(TIMES), 2))

    found = inside(alike, 3.1e-4)
    assert np.all((found >= 0.90) & (found <= 0.99)), found


def test_a_detector_that_states_too_little_is_not_believed() -> None:
    def worse(rng: np.random.Generator) -> np.ndarray:
        return rng.standard_normal((len(TIMES), 2)) * [8e-4, 3e-4]

    found = inside(worse, 3e-4)
    assert np.all((found >= 0.90) & (found <= 0.99)), found


def test_where_nothing_is_stated_the_scatter_across_the_belt_is_all_that_is_known() -> None:
    rng, subject = np.random.default_rng(5), belt()
    for t in TIMES:
        along, across = 3e-4 * rng.standard_normal(2)
        subject.see("1", Sighting((V * t + along, across), t, t + 0.03, True), 0.18)
    track = subject.track("1")
    assert track is not None
    assert track.place.var_shared == 0.0
    assert track.place.var_along == pytest.approx(track.place.var_across)
