"""From what an instrument tells to points in the tracker frame, and back.

The tracker frame is right-handed, in metres, with its origin where the instrument's axes meet: z up along its
standing axis, y where its horizontal circle reads zero, x to the right of that. So x, y, z are easting,
northing and height of an instrument that is oriented, less those of its station.
"""

import math

import numpy as np

from cell.poses import Array


def from_station(hz: float, v: float, slope_m: float) -> Array:
    """Point (3,) from the horizontal angle (clockwise from y seen from above), the zenith angle, rad."""
    flat = slope_m * math.sin(v)
    return np.array([flat * math.sin(hz), flat * math.cos(hz), slope_m * math.cos(v)])


def to_station(point: Array) -> tuple[float, float, float]:
    """Horizontal angle in [0, 2 pi), zenith angle (rad) and slope distance (m) of a point (3,)."""
    x, y, z = map(float, point)
    flat = math.hypot(x, y)
    return math.atan2(x, y) % (2 * math.pi), math.atan2(flat, z), math.hypot(flat, z)


def from_mathematical(azimuth: float, elevation: float, range_m: float) -> Array:
    """Point (3,) from the azimuth (from x towards y) and the elevation above the horizon, rad."""
    flat = range_m * math.cos(elevation)
    return np.array([flat * math.cos(azimuth), flat * math.sin(azimuth), range_m * math.sin(elevation)])
