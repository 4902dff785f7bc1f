"""Points spread evenly over a cube: those of SciPy's Sobol sequence."""

import numpy as np
import pytest

from cell.even_points import MOST_DIMENSIONS, even_points


@pytest.mark.parametrize("dimensions", [1, 2, 6, 7, MOST_DIMENSIONS])
@pytest.mark.parametrize("power", [0, 1, 7])
def test_they_are_those_of_scipy(dimensions: int, power: int) -> None:
    from scipy.stats.qmc import Sobol  # which every worker would import that collects the tests

    subject = even_points(dimensions, power, seed=dimensions)
    assert np.array_equal(subject, Sobol(dimensions, seed=dimensions).random_base2(power))
