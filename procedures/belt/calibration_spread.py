"""How sure a belt's scale is when sightings are not independent of each other.

All items of one frame share the error of its count, all sightings of one item what the camera gets wrong
about it, and all sightings at one place of the picture what it gets wrong there. So the covariance is also
found with whole frames, items and places as the independent things (cluster-robust covariance; Liang and
Zeger 1986), and the largest counts.

What the camera gets wrong in proportion to the place in the picture looks like another scale, so no sighting
can show it. It is taken to be as large as the rest of the pattern over the picture, which they do show.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from calibration.belt.scale import BeltScale
from cell.poses import Array
from procedures.belt.calibration_rows import Rows

_FEWEST = 4  # clusters that say anything
_PLACES = 12  # of the picture
_PATTERN_M = 1e-3  # a sighting further off is a false one
_NORMAL95 = 1.96
_K95 = float(stdtrit(_PLACES - 2, 0.975))  # of what is as large as their pattern


@dataclass(frozen=True)
class Spread:
    """Halves of the 95 % intervals of scale (m) and direction (rad, in each plane), and the ``cov`` (3, 3) of
    ``m_per_count * dir``; ``by`` says what was taken as independent where it mattered most."""

    half_scale: float
    half_angle: float
    cov: Array
    by: str


def spread(answer: BeltScale, rows: Rows) -> Spread | None:
    """The widest of the intervals; None where the answer has none."""
    if answer.half_scale is None or answer.half_angle is None or answer.cov is None:
        return None
    found = [Spread(answer.half_scale, answer.half_angle, answer.cov, "sightings")]
    x, r = _parts(answer, rows)
    used = answer.used
    shared = (("frames", rows.t[used]), ("items", rows.items[used]), ("places", _places(answer, rows)))
    for by, of in shared:
        _, cluster = np.unique(of, return_inverse=True)
        if (count := int(cluster.max(initial=-1)) + 1) >= _FEWEST:
            found.append(_clustered(answer, x, r, cluster, count, by))
    widest = max(found, key=lambda s: s.half_scale)
    # Left out of the fit, sightings near by are part of the camera's pattern all the same.
    near = replace(answer, used=np.isfinite(answer.distance) & (answer.distance < _PATTERN_M))
    unseen = _unseen(near, rows, _parts(near, rows)[1])
    along = answer.direction
    reach = _K95 * answer.m_per_count
    across = float(np.sqrt(max(float(unseen @ unseen - (along @ unseen) ** 2), 0.0)))
    return Spread(
        float(np.hypot(widest.half_scale, reach * abs(float(along @ unseen)))),
        float(np.hypot(max(s.half_angle for s in found), _K95 * across)),
        widest.cov + answer.m_per_count**2 * np.outer(unseen, unseen),
        widest.by,
    )


def with_camera(sure: Spread, answer: BeltScale, turn_95_rad: float, share_95: float) -> Spread:
    """``sure`` with what all sightings share, which no pattern shows: a camera that is turned by up to
    ``turn_95_rad`` about any axis turns the direction as far, one whose distance from the belt is wrong by
    the share ``share_95`` has the scale wrong by it."""
    m, along = answer.m_per_count, answer.direction
    onto = np.outer(along, along)
    shared = share_95**2 * onto + turn_95_rad**2 * (np.eye(len(along)) - onto)
    return replace(
        sure,
        half_scale=float(np.hypot(sure.half_scale, m * share_95)),
        half_angle=float(np.hypot(sure.half_angle, turn_95_rad)),
        cov=sure.cov + (m / _NORMAL95) ** 2 * shared,
    )


def _unseen(answer: BeltScale, rows: Rows, r: Array) -> Array:
    """Standard deviation (3,), metres a metre of travel, of what the camera may get wrong in proportion.

    From the pattern of ``r`` (k, 3) over the picture: the effects of the places beside those of the items,
    less a line and their own noise. A line as strong as that over the length L has a slope of sqrt(12) / L
    times its RMS.
    """
    used = answer.used
    at, place = rows.points[used] @ answer.direction, _places(answer, rows)
    there, column, n = np.unique(place, return_inverse=True, return_counts=True)
    _, item = np.unique(rows.items[used], return_inverse=True)
    if len(there) <= _FEWEST or n.min() < 2:
        return np.zeros(3)
    design = np.concatenate([np.eye(len(there))[column], np.eye(int(item.max()) + 1)[item]], axis=1)
    inverse = np.linalg.pinv(design)
    effects = inverse @ r
    freedom = max(len(r) - np.linalg.matrix_rank(design), 1)
    noise = np.sum((r - design @ effects) ** 2, axis=0) / freedom
    middle = np.bincount(column, at) / n
    line = np.stack([np.ones_like(middle), middle - middle.mean()], axis=1)
    beside = np.eye(len(there)) - line @ np.linalg.pinv(line)
    pattern = beside @ effects[: len(there)]
    of_noise = float(np.trace(beside @ (inverse @ inverse.T)[: len(there), : len(there)] @ beside))
    square = np.maximum(np.sum(pattern**2, axis=0) - noise * of_noise, 0.0) / (len(there) - 2)
    return np.asarray(np.sqrt(12.0 * square) / float(np.ptp(at)))


def _places(answer: BeltScale, rows: Rows) -> NDArray[np.int64]:
    """Which part of the picture (k,) each sighting in use lies in, along the belt."""
    along = rows.points[answer.used] @ answer.direction
    share = (along - along.min()) / max(float(np.ptp(along)), 1e-9)
    return np.asarray(np.minimum(share * _PLACES, _PLACES - 1), dtype=np.int64)


def _parts(answer: BeltScale, rows: Rows) -> tuple[Array, Array]:
    """Counts (k,) beside the mean of their item, and positions (k, 3) beside its motion, of those in use."""
    used = answer.used
    counts, items = rows.counts[used], rows.items[used]
    origin = rows.points[used] - counts[:, None] * answer.m_per_count * answer.direction
    x, r = np.empty_like(counts), np.empty_like(origin)
    for i in np.unique(items):
        own = items == i
        x[own] = counts[own] - counts[own].mean()
        r[own] = origin[own] - origin[own].mean(axis=0)
    return x, r


def _clustered(
    answer: BeltScale, x: Array, r: Array, cluster: NDArray[np.int64], count: int, by: str
) -> Spread:
    score = np.zeros((count, r.shape[1]))
    np.add.at(score, cluster, x[:, None] * r)
    cov = score.T @ score / float(np.sum(x * x)) ** 2 * count / (count - 1.0)
    reach = float(stdtrit(count - 1, 0.975))
    along = answer.direction
    beside = np.eye(len(along)) - np.outer(along, along)
    turn = float(np.sqrt(max(float(np.linalg.eigvalsh(beside @ cov @ beside)[-1]), 0.0)))
    half = reach * float(np.sqrt(max(float(along @ cov @ along), 0.0)))
    return Spread(half, reach * turn / answer.m_per_count, cov, by)
