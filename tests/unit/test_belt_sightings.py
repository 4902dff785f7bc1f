"""What several sightings make of one item when one of them is wrong."""

import numpy as np
import pytest

from calibration.belt.estimator import BeltEstimator, Encoder
from calibration.belt.items import CAMERA_SIGMA, Sighting
from calibration.belt.tracking import BeltTracker, Track

V, M_PER_COUNT, PERIOD = 0.2, 1e-4, 0.005
LEVEL = np.array([1.0, 0.0, 0.0])
TIMES = tuple(np.arange(1.0, 2.99, 0.25))  # of exposures
Z = 0.18


def tracker(direction: np.ndarray = LEVEL) -> BeltTracker:
    """A steady belt, counted for three seconds."""
    out = BeltTracker(BeltEstimator(Encoder(M_PER_COUNT, None, PERIOD)), direction)
    out.belt.extend((float(t), round(V * t / M_PER_COUNT)) for t in np.arange(0.0, 3.0, PERIOD))
    return out


def see(subject: BeltTracker, t: float, off_m: float = 0.0, z: float = Z, ahead_m: float = 0.0) -> None:
    """The item, seen ``off_m`` across and at ``z`` at zero travel, ``ahead_m`` from where counts have it."""
    x, y, rise = subject.direction * (V * t + ahead_m) + [-0.6, off_m, z]
    subject.see("1", Sighting((float(x), float(y)), t, t + 0.02, True), float(rise))


def tracked(subject: BeltTracker) -> Track:
    track = subject.track("1")
    assert track is not None
    return track


def test_one_stray_sighting_is_left_out_also_when_a_single_item_tells_the_noise() -> None:
    subject, rng = tracker(), np.random.default_rng(3)
    for t in TIMES:
        see(subject, t, off_m=1.3e-4 * rng.standard_normal())
    see(subject, 2.99, off_m=0.02)
    track = tracked(subject)
    assert track.place.used.tolist() == [True] * len(TIMES) + [False]
    assert track.place.across == pytest.approx(0.0, abs=2e-4)
    assert subject.levels().camera <= CAMERA_SIGMA
