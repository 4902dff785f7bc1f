"""The step of the item detector is the integral of the normal density."""

import numpy as np
from scipy.special import ndtr

from calibration.items.blurred_step import blurred_step


def test_it_is_that_of_scipy_between_the_places_of_the_table_and_beyond_its_ends() -> None:
    x = np.concatenate([np.linspace(-12.0, 12.0, 100_003), np.arange(-9.0, 9.1, 0.5), [-1e6, 1e6]])
    given = x.copy()
    np.testing.assert_allclose(blurred_step(x.reshape(-1, 2)).ravel(), ndtr(x), rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(x, given)
