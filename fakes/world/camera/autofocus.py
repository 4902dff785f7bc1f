"""A lens that an autofocus moves all the time, and what that does to the picture.

The focal lengths that ARKit tells differ by 0.27 % within one recording (github.com/zju3dv/NeuralRecon issue
101); how fast, and over which positions, is an assumption.
"""

import numpy as np

_BREATHES, _LENS_STEPS, _BREATH_S = 0.00135, 8, 7.0


def lens_position(t: float) -> int:
    """Of 255, as a camera tells it of an exposure at ``t`` (s)."""
    return 128 + round(_LENS_STEPS * _breath(t))


def focal_share(t: float) -> float:
    """The focal length at ``t`` (s) as a share of that of the lens in the middle of its range."""
    return 1.0 + _BREATHES * _breath(t)


def _breath(t: float) -> float:
    """Where in its range the lens is, -1 to 1."""
    return float(np.sin(2.0 * np.pi * t / _BREATH_S))
