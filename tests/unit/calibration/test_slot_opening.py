"""The opening of a slot by its edges in colour, on pictures whose truth is known."""

import numpy as np
import pytest

from calibration.slot.inside import depth_inside
from calibration.slot.opening import find_opening
from calibration.slot.rack import Rack
from cell.errors import CellError
from cell.poses import log_xi
from tests.kit.slot_scene import OPENING, blank, look_at, spread

EMPTY, OCCUPIED = (1, 3, 4, 5, 6), 2
REACH_M = 0.012
LOOKS = 6
NEES_LIMIT = 2.35  # mean of 6 squared Mahalanobis distances over 3, 99.9 % of a chi-square with 18


def test_the_place_of_an_opening_is_found_to_its_stated_uncertainty() -> None:
    rng = np.random.default_rng(5)
    nees, off = [], []
    for k in range(LOOKS):
        picture = look_at(EMPTY[k % len(EMPTY)], rng, k)
        found = find_opening(picture.colour, picture.camera, OPENING, picture.expected, REACH_M)
        error = log_xi(found.T_camera.inv() * picture.T_camera_slot)[:3]
        nees.append(error @ np.linalg.solve(found.cov[:3, :3], error) / 3.0)
        off.append(np.abs(error[:2]).max())
    assert 0.1 < np.mean(nees) < NEES_LIMIT
    assert max(off) < 1e-4


def test_what_edges_do_not_tell_stays_as_it_was_known() -> None:
    picture = look_at(1, np.random.default_rng(6))
    found = find_opening(picture.colour, picture.camera, OPENING, picture.expected, REACH_M)
    before, after = spread(picture.expected.cov), spread(found.cov)
    assert np.all(after[:2] < 0.02 * before[:2])  # across the sight
    assert np.all(after[3:5] > 0.9 * before[3:5])  # tilt
    assert after[2] < 0.2 * before[2]  # by the known size


def test_a_plate_without_an_opening_is_refused() -> None:
    picture = look_at(1, np.random.default_rng(7))
    with pytest.raises(CellError) as caught:
        find_opening(blank(picture), picture.camera, OPENING, picture.expected, REACH_M)
    assert caught.value.name == "OPENING_NOT_SEEN"


def test_depth_tells_an_empty_slot_from_an_occupied_one_though_it_is_off_by_millimetres() -> None:
    rng = np.random.default_rng(8)
    deeper = {}
    for number in (1, OCCUPIED):
        picture = look_at(number, rng)
        deeper[number] = depth_inside(picture.depth, picture.camera, picture.T_camera_slot, OPENING).deeper
    assert deeper[1] == pytest.approx(0.07, abs=0.005)
    assert deeper[OCCUPIED] == pytest.approx(-0.04, abs=0.005)


def test_pixels_without_depth_tell_nothing() -> None:
    picture = look_at(1, np.random.default_rng(9))
    found = depth_inside(np.zeros_like(picture.depth), picture.camera, picture.T_camera_slot, OPENING)
    assert found.deeper is None


def test_slots_are_counted_along_the_columns() -> None:
    subject = Rack(rows=2, columns=3, row_pitch=0.05, column_pitch=0.06)
    assert subject.slots == 6
    assert subject.row_and_column(4) == (2, 1)
    assert subject.T_rack_slot(6).translation == pytest.approx([0.12, 0.05, 0.0])
