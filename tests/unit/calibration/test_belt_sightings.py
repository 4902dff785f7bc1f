"""What several sightings make of one item: its place and its height, when one of them is wrong."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from calibration.belt.estimator import BeltEstimator, EncoderScale
from calibration.belt.items import CAMERA_SIGMA, Sighting
from calibration.belt.pursuit import Ride
from calibration.belt.slip import Slip
from calibration.belt.tracking import BeltTracker, ItemTrack
from procedures.belt.config import BeltTrackingConfig, Zone
from procedures.belt.items import Item
from procedures.belt.motion.meeting import strategy

V, M_PER_COUNT, PERIOD = 0.2, 1e-4, 0.005
LEVEL, UPHILL = np.array([1.0, 0.0, 0.0]), np.array([0.995, 0.0, np.sqrt(1.0 - 0.995**2)])
TIMES = tuple(np.arange(1.0, 2.99, 0.25))  # of exposures
Z = 0.18


def tracker(direction: np.ndarray = LEVEL) -> BeltTracker:
    """A steady belt, counted for three seconds."""
    out = BeltTracker(BeltEstimator(EncoderScale(M_PER_COUNT, None, PERIOD)), direction)
    out.belt.extend((float(t), round(V * t / M_PER_COUNT)) for t in np.arange(0.0, 3.0, PERIOD))
    return out


def see(subject: BeltTracker, t: float, off_m: float = 0.0, z: float = Z, ahead_m: float = 0.0) -> None:
    """The item, seen ``off_m`` across and at ``z`` at zero travel, ``ahead_m`` from where counts have it."""
    x, y, rise = subject.direction * (V * t + ahead_m) + [-0.6, off_m, z]
    subject.see("1", Sighting((float(x), float(y)), t, t + 0.02, True), float(rise))


def tracked(subject: BeltTracker) -> ItemTrack:
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


@pytest.mark.parametrize("z", [0.36, 0.02])
def test_a_stray_sighting_says_nothing_of_the_height(z: float) -> None:
    subject = tracker()
    for t in TIMES:
        see(subject, t)
    see(subject, 2.99, off_m=0.02, z=z)
    track = tracked(subject)
    assert not track.place.used[-1]
    assert track.height == pytest.approx(Z)


def test_one_false_height_where_the_item_truly_is_does_not_count_either() -> None:
    subject = tracker()
    for t in TIMES[:2]:
        see(subject, t)
    see(subject, TIMES[2], z=0.02)
    track = tracked(subject)
    assert track.place.used.all()
    assert track.height == pytest.approx(Z)


def test_of_two_heights_that_differ_the_tool_keeps_to_the_upper_one() -> None:
    subject = tracker()
    see(subject, TIMES[0])
    see(subject, TIMES[1], z=0.02)
    assert tracked(subject).height == pytest.approx(Z)


def test_heights_are_those_of_one_place_on_a_belt_that_climbs() -> None:
    subject = tracker(UPHILL)
    for t in TIMES:
        see(subject, t)
    see(subject, 2.99, off_m=0.02, z=0.36)
    track = tracked(subject)
    assert track.place.at == TIMES[-1]
    for t in (2.999, 3.4):
        assert Ride(track, 0.0).at(t).p[2] == pytest.approx(Z + UPHILL[2] * V * t, abs=1e-5)
        assert track.along(np.array([t]))[0] == pytest.approx(
            -0.6 * UPHILL[0] + UPHILL[2] * Z + V * t, abs=1e-4
        )


def test_a_slip_on_a_belt_that_climbs_is_one_of_heights_too() -> None:
    subject, by = tracker(UPHILL), -0.04
    for t in TIMES[:5]:
        see(subject, t)
    subject.slipped(Slip(TIMES[5], by, 1e-4, 3))
    ahead = by / float(np.linalg.norm(UPHILL[:2]))
    for t in TIMES[5:]:
        see(subject, t, ahead_m=ahead)
    track = tracked(subject)
    assert track.place.used.all()
    heights = Ride(track, 0.0).at(3.0).p[2]
    assert heights == pytest.approx(Z + UPHILL[2] * (V * 3.0 + ahead), abs=1e-5)


@pytest.mark.parametrize("method", ["ml", "classic"])
def test_a_tool_that_does_not_follow_goes_down_to_the_height_at_contact(method: Any) -> None:
    subject = tracker(UPHILL)
    for t in TIMES:
        see(subject, t)
    if method == "ml":  # classic goes by the newest sighting alone, but for the height
        see(subject, 2.99, off_m=0.02, z=0.02)
    config = BeltTrackingConfig(
        wait_pose="wait", place_pose="place", zone=Zone(min_m=-1.0, max_m=2.0), belt_z_m=0.0, method=method
    )
    watch: Any = SimpleNamespace(tracker=subject, track=lambda item: subject.track(item.key))
    chosen, item = strategy(config, watch, np.array([0.15, 0.0, 0.5]), 0.1), Item(1, 0.0, 0.0, 0.0)
    aim = chosen.meet(item, 3.0)
    assert aim is not None
    assert aim.contact > 3.1
    assert aim.height == pytest.approx(Z + UPHILL[2] * V * aim.contact, abs=1e-4)
    aim.height = 0.0
    chosen.improve(item, aim, 3.0)
    assert aim.height == pytest.approx(Z + UPHILL[2] * V * aim.contact, abs=1e-4)
