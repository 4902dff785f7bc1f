"""The twin's splines against SciPy's."""

import subprocess
import sys

import numpy as np
import pytest
from scipy.interpolate import CubicSpline, RectBivariateSpline

from fakes.cubic_spline import coefficients, weights


@pytest.mark.parametrize("n", [4, 5, 6, 25])
def test_the_pieces_are_those_of_scipy(n: int) -> None:
    values = np.random.default_rng(n).normal(size=(n, 6))
    expected = CubicSpline(np.linspace(0.0, 0.3, n), values)
    np.testing.assert_allclose(coefficients(0.3 / (n - 1), values), expected.c, rtol=1e-9, atol=1e-6)


def test_weights_on_both_axes_are_the_spline_of_scipy_over_a_grid() -> None:
    grid = np.random.default_rng(1).normal(size=(7, 9))
    rows, columns = np.linspace(0.0, 6.0, 31), np.linspace(0.0, 8.0, 50)
    expected = RectBivariateSpline(np.arange(7.0), np.arange(9.0), grid)(rows, columns)
    np.testing.assert_allclose(weights(7, rows) @ grid @ weights(9, columns).T, expected, atol=1e-12)


def test_fewer_than_four_values_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 4 values, not 3"):
        weights(3, np.array([0.5]))


def test_a_twin_starts_without_the_slow_parts_of_scipy() -> None:
    names = "'scipy.interpolate', 'scipy.optimize', 'scipy.fft', 'scipy.stats'"
    code = f"import sys, fakes.twin.serve; print([n for n in ({names}) if n in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout == "[]\n"
