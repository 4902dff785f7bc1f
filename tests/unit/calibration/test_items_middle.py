"""The median of the item detector is NumPy's."""

import numpy as np
import pytest

from calibration.items.middle import median


@pytest.mark.parametrize("n", [1, 2, 5, 6, 1000, 1001])
@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_it_is_that_of_numpy_along_the_last_axis(n: int, kind: type[np.floating]) -> None:
    values = np.random.default_rng(n).normal(size=(3, n)).astype(kind)
    subject = median(values)
    assert subject.dtype == kind
    np.testing.assert_array_equal(subject, np.median(values, axis=-1))
