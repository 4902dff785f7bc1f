"""The shade of a strip beside an edge, from the shape of a blurred profile made without this code."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from calibration.items.silhouette import strip_widths, with_corners
from calibration.items.strip import about_middle, blur_of, shade_of

FINE = 0.01


def profile(width: float, shade: float, blur: float, noise: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """``s`` and the rise of a strip that begins at 0.3 px."""
    fine = np.arange(-25.0, 25.0, FINE)
    steps = np.where(fine < 0.3, 0.0, np.where(fine < 0.3 + width, shade, 1.0))
    s = np.arange(-12.0, 20.0, 0.25)
    rng = np.random.default_rng(4)
    rise = np.interp(s, fine, gaussian_filter1d(steps, blur / FINE))
    return s, rise + rng.normal(0.0, noise, (30, len(s)))


@pytest.mark.parametrize("width", [1.5, 3.0, 8.0])
@pytest.mark.parametrize("shade", [0.15, 0.45, 0.8])
def test_the_shade_is_read_from_strips_as_narrow_as_the_blur(width: float, shade: float) -> None:
    s, rise = profile(width, shade, 0.85, 0.01)
    middle = np.full(len(rise), 0.3 + width * (1.0 - shade))
    found = shade_of(about_middle(s, rise, middle, width), width, 0.85)
    assert width * abs(found.mean - shade) < 0.15
    assert abs(found.mean - shade) < 3.0 * found.sigma + 0.01


def test_a_strip_much_narrower_than_the_blur_is_not_guessed_at() -> None:
    s, rise = profile(0.4, 0.2, 0.85, 0.01)
    found = shade_of(about_middle(s, rise, np.full(len(rise), 0.62), 0.4), 0.4, 0.85)
    assert found.sigma > 0.2


def test_the_blur_is_read_where_no_strip_is_seen() -> None:
    s, rise = profile(0.0, 0.0, 1.1)
    assert blur_of(about_middle(s, rise, np.full(len(rise), 0.3), 0.0)) == pytest.approx(1.1, abs=0.03)


def test_a_strip_is_cut_where_the_foot_has_moved_along_its_side() -> None:
    square = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 20.0], [0.0, 20.0]])
    moved = np.array([8.0, 3.0])  # the foot, seen beyond the upper and the right side
    upper = np.array([[1.0, 20.0], [4.0, 20.0], [12.0, 20.0]])
    up = np.tile([0.0, 1.0], (3, 1))
    widths, alone = strip_widths(upper, up, square, lambda p: p + moved)
    assert widths == pytest.approx([3.0 / 8.0, 12.0 / 8.0, 3.0])
    assert alone.all()
    hidden, _ = strip_widths(upper - [0.0, 20.0], -up, square, lambda p: p + moved)
    assert hidden == pytest.approx([0.0, 0.0, 0.0])


def test_opposite_sides_that_follow_each_other_have_no_corner() -> None:
    """Where the side between them is hidden; their points are kept as they are."""
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 5.0], [0.0, 5.0]])
    normal = np.array([[0.0, -1.0], [0.0, -1.0], [0.0, 1.0], [0.0, 1.0]])
    assert np.array_equal(with_corners(points, normal, np.array([0, 0, 1, 1])), points)
