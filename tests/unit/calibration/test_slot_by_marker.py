"""A slot by the marker beside it, on pictures whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.slot.marker import find_by_marker
from calibration.slot.opening import Expected
from cell.errors import CellError
from cell.poses import exp_xi, log_xi
from tests.kit.slot_scene import KNOWN, blank, look_at, marker_at, spread

REACH_M = 0.012
LOOKS = 4
NEES_LIMIT = 2.74  # mean of 4 squared Mahalanobis distances over 3, 99.9 % of a chi-square with 12


def test_a_slot_is_found_by_its_marker_to_the_stated_uncertainty_also_with_a_part_in_it() -> None:
    rng = np.random.default_rng(5)
    nees, off = [], []
    for k in range(LOOKS):
        number = 1 + k
        picture = look_at(number, rng, k, marked=True)
        found = find_by_marker(picture.colour, picture.camera, marker_at(number), picture.expected, REACH_M)
        error = log_xi(found.T_camera.inv() * picture.T_camera_slot)[:3]
        nees.append(error @ np.linalg.solve(found.cov[:3, :3], error) / 3.0)
        off.append(np.abs(error[:2]).max())
    assert 0.05 < np.mean(nees) < NEES_LIMIT
    assert max(off) < 2e-4


def test_what_the_place_of_the_marker_leaves_open_is_told_apart() -> None:
    picture = look_at(1, np.random.default_rng(6), marked=True)
    sigma, turn = 2e-4, 5e-3
    by_shift, by_turn = (
        find_by_marker(picture.colour, picture.camera, marker, picture.expected, REACH_M)
        for marker in (marker_at(1, sigma), marker_at(1, 0.0, turn))
    )
    assert by_shift.cov == pytest.approx(by_turn.cov)
    assert by_shift.by_marker is not None
    assert by_turn.by_marker is not None
    assert spread(by_shift.by_marker)[:2] == pytest.approx(sigma, rel=0.1)
    # A marker that is turned on its place turns the slot only as far as its corners were believed.
    assert 0.0 < spread(by_turn.by_marker)[5] < turn
    after, before = spread(by_shift.cov), spread(picture.expected.cov)
    assert np.all(after[:2] < 0.1 * before[:2])
    assert np.all(after[3:5] > 0.9 * before[3:5])


def test_two_looks_follow_the_place_of_a_marker_as_far_as_is_told() -> None:
    # What is told of a turned marker, beside what both looks truly do when it is turned.
    turn, begins = 0.01, np.diag(np.square([5e-4, 5e-4, 2e-3, *KNOWN[3:]]))
    picture = look_at(1, np.random.default_rng(8), marked=True)
    marker, truly = marker_at(1, 0.0, turn), []
    middle = marker.T_slot
    for way in (-turn, turn):
        marker = replace(marker, T_slot=middle * exp_xi(np.array([0.0, 0.0, 0.0, 0.0, 0.0, way])))
        found = find_by_marker(picture.colour, picture.camera, marker, picture.expected, REACH_M)
        again = Expected(found.T_camera, begins)
        truly.append(find_by_marker(picture.colour, picture.camera, marker, again, REACH_M, looks=2))
    followed = np.abs(log_xi(truly[0].T_camera.inv() * truly[1].T_camera))[5] / 2.0
    assert truly[0].by_marker is not None
    assert spread(truly[0].by_marker)[5] == pytest.approx(followed, rel=0.05)


def test_a_marker_that_is_not_there_or_elsewhere_is_refused() -> None:
    picture = look_at(1, np.random.default_rng(7), marked=True)
    for colour, marker, words in (
        (blank(picture), marker_at(1), "is not in the picture"),
        (picture.colour, marker_at(2), "mm beside where it should be"),
        (picture.colour, replace(marker_at(1), cells=10), "px are needed: look from nearer"),
    ):
        with pytest.raises(CellError, match=words) as caught:
            find_by_marker(colour, picture.camera, marker, picture.expected, REACH_M)
        assert caught.value.name == "OPENING_NOT_SEEN"
