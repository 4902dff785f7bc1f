"""Belt calibration: metres per count and direction, their intervals, and what is refused."""

import numpy as np
import pytest

from calibration.belt.scale import BeltScale, fit_scale, two_points
from calibration.refusal import Refusal

DIRECTION = np.array([0.8, -0.6, 0.0]) @ np.array([[1, 0, 0.02], [0, 1, 0.01], [0, 0, 1]])
DIRECTION = DIRECTION / np.linalg.norm(DIRECTION)
SCALE = 1.037e-4


def sightings(seed: int, sigma: float = 3e-4, items: int = 1) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    counts = rng.integers(0, 6000, 24) + 2**25
    item = rng.integers(0, items, 24)
    start = rng.uniform(-0.2, 0.2, (items, 3))
    points = start[item] + SCALE * (counts - 2**25)[:, None] * DIRECTION + rng.normal(0.0, sigma, (24, 3))
    return points, counts, item


def fitted(answer: BeltScale | Refusal) -> BeltScale:
    assert isinstance(answer, BeltScale)
    return answer


def test_scale_and_direction_lie_in_their_intervals_as_often_as_these_say() -> None:
    inside, turned = [], []
    for seed in range(200):
        found = fitted(fit_scale(*sightings(seed, items=1 + seed % 2)))
        assert found.half_scale is not None
        assert found.half_angle is not None
        inside.append(abs(found.m_per_count - SCALE) <= found.half_scale)
        turned.append(abs(float(np.cross(found.direction, DIRECTION)[2])) <= found.half_angle)
    assert 0.91 <= np.mean(inside) <= 0.99  # 95 % of 200, three standard deviations about it
    assert 0.91 <= np.mean(turned) <= 0.995


def test_a_false_sighting_is_listed_and_left_out() -> None:
    points, counts, item = sightings(1)
    points[7] += [0.02, 0.0, 0.0]
    found = fitted(fit_scale(points, counts, item))
    assert np.flatnonzero(~found.used).tolist() == [7]
    assert found.m_per_count == pytest.approx(SCALE, rel=2e-3)


def test_the_held_out_figure_is_the_cameras_noise() -> None:
    found = fitted(fit_scale(*sightings(2)))
    assert found.sigma == pytest.approx(3e-4, rel=0.3)
    assert found.heldout == pytest.approx(np.sqrt(3) * 3e-4, rel=0.35)


def test_a_belt_counting_down_turns_the_direction_around() -> None:
    points, counts, item = sightings(3, sigma=0.0)
    found = fitted(fit_scale(points, -counts, item))
    assert found.m_per_count == pytest.approx(SCALE)
    assert found.direction == pytest.approx(-DIRECTION)


@pytest.mark.parametrize(
    ("points", "counts", "name"),
    [
        ([[0, 0, 0], [0.1, 0, 0]], [0, 1000], "too-few-sightings"),
        ([[0, 0, 0], [0.001, 0, 0], [0.002, 0, 0], [0.003, 0, 0]], [0, 10, 20, 30], "no-travel"),
        ([[0, 0, 0], [0, 0, 0], [0, 0, 0]], [5, 5, 5], "no-travel"),
        (np.zeros((0, 3)), [], "too-few-sightings"),
    ],
)
def test_sightings_that_cannot_tell_are_refused(points: object, counts: object, name: str) -> None:
    answer = fit_scale(np.array(points, dtype=float), np.array(counts, dtype=float))
    assert isinstance(answer, Refusal)
    assert answer.name == name


def test_two_taught_points_give_scale_direction_and_the_interval_of_their_touch() -> None:
    found = fitted(two_points([0.1, 0.0, 0.2], [0.1, 0.4, 0.2], (500, 4500), sigma=1e-4))
    assert found.m_per_count == pytest.approx(1e-4)
    assert found.direction == pytest.approx([0.0, 1.0, 0.0])
    assert found.half_scale == pytest.approx(1.96 * np.sqrt(2) * 1e-4 / 4000)
    alone = fitted(two_points([0.1, 0.0, 0.2], [0.1, 0.4, 0.2], (500, 4500)))
    assert alone.half_scale is None


def test_a_few_touches_are_all_taken_as_they_are() -> None:
    for seed in range(20):
        rng = np.random.default_rng(seed)
        counts = np.array([0.0, 2000.0, 4000.0])
        points = SCALE * counts[:, None] * DIRECTION + rng.normal(0.0, 3e-4, (3, 3))
        assert fitted(fit_scale(points, counts, doubt=False)).used.all()


def test_two_points_without_travel_between_them_are_refused() -> None:
    answer = two_points([0.0, 0.0, 0.0], [0.001, 0.0, 0.0], (0, 9))
    assert isinstance(answer, Refusal)
    assert answer.name == "no-travel"
