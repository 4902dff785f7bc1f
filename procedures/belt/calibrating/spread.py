"""How sure a belt's scale is when sightings are not independent of each other.

All items of one frame share the error of its count, what the camera gets wrong about an item may grow over
its way, and at one place of the picture it gets the same wrong for every item. These are effects of unknown
size beside the noise of each sighting. How large each is follows from how far the residuals go together with
it (variance components by the method of moments; Searle, Casella and McCulloch 1992, chapter 5), and what
all of them together do to the scale is its variance. Where the sightings show no such effect, the interval
is that of independent sightings.

What the camera gets wrong in proportion to the place in the picture looks like another scale, so no sighting
can show it. It is taken to be as large as the rest of the pattern over the picture, which they do show.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray
from scipy.special import stdtrit

from calibration.adjustment.lens_terms import lens_prior
from calibration.belt.placing import POSE, off_by_camera
from calibration.belt.scale import BeltScale
from cell.formats.intercept import ItemsCamera
from cell.poses import Array, from_pose6
from procedures.belt.calibrating.rows import SightingRows, rounding_variance
from procedures.report.numbers import K95

_FEWEST = 4  # of what is to say how large an effect is
_ORDERS = (2, 3, 4, 5)  # of the pattern over the picture, beside a line
_OF_PATTERN = 2.0  # degrees of freedom
FEWEST_OF_PATTERN = 12  # sightings, beside one of each item
_PATTERN_M = 1e-3  # a sighting further off is a false one
LENS, PICTURE = "lens", "picture"  # in ``by``
_NOISE, _SLIPS = "sightings", "slips"


@dataclass(frozen=True)
class BeltUncertainty:
    """Halves of the 95 % intervals of scale (m) and of direction (rad): ``half_level`` seen from above, by
    which picks go, and ``half_rise`` of how it rises, by which the tool is too high or too low; and the
    ``cov`` (3, 3) of ``m_per_count * dir``.

    ``by`` names what makes most of the scale's: single ``sightings``, what all of one of the ``frames``, of
    the ``items`` or at one place of the ``picture`` share, the rounding of ``counts``, ``slips`` that may be
    none, a ``delay`` of the counts, or the camera's ``lens``."""

    half_scale: float
    half_level: float
    half_rise: float
    cov: Array
    by: str

    @property
    def half_angle(self) -> float:
        """The wider of the two planes."""
        return max(self.half_level, self.half_rise)


def spread(answer: BeltScale, rows: SightingRows) -> BeltUncertainty | None:
    """From the residuals of the fit; None where the answer has no interval."""
    if answer.half_scale is None:
        return None
    axes = _axes(answer.direction)
    # Left out of the fit, sightings near by are part of what the camera gets wrong all the same.
    near = answer.used | (answer.distance < _PATTERN_M)
    effects = _Effects(answer, rows, near)
    origin = rows.points[near] - rows.counts[near, None] * answer.m_per_count * answer.direction
    found = [effects.slope(origin @ axis, k == 0) for k, axis in enumerate(axes)]
    m = answer.m_per_count
    return BeltUncertainty(
        half_scale=m * found[0].half,
        half_level=found[1].half,
        half_rise=found[2].half,
        cov=m * m * axes.T @ np.diag([slope.variance for slope in found]) @ axes,
        by=found[0].by,
    )


def with_camera(
    sure: BeltUncertainty, answer: BeltScale, turn_95_rad: float, share_95: float
) -> BeltUncertainty:
    """``sure`` with what all sightings share, which no pattern shows: a camera that is turned by up to
    ``turn_95_rad`` about any axis turns the direction as far, one whose distance from the belt is wrong by
    the share ``share_95`` has the scale wrong by it."""
    m, along = answer.m_per_count, answer.direction
    onto = np.outer(along, along)
    shared = share_95**2 * onto + turn_95_rad**2 * (np.eye(len(along)) - onto)
    return replace(
        sure,
        half_scale=float(np.hypot(sure.half_scale, m * share_95)),
        half_level=float(np.hypot(sure.half_level, turn_95_rad)),
        half_rise=float(np.hypot(sure.half_rise, turn_95_rad)),
        cov=sure.cov + (m / K95) ** 2 * shared,
    )


def with_doubt(sure: BeltUncertainty, answer: BeltScale, doubt: float) -> BeltUncertainty:
    """``sure`` with a scale that may be off by ``doubt`` (m): the interval holds by either of two answers."""
    return widened(sure, answer, doubt, _SLIPS)


def widened(sure: BeltUncertainty, answer: BeltScale, doubt: float, by: str) -> BeltUncertainty:
    """``sure`` with a half interval of the scale that is longer by ``doubt`` (m), and the ``cov`` of that."""
    if doubt == 0.0:
        return sure
    half, onto = sure.half_scale + doubt, np.outer(answer.direction, answer.direction)
    return replace(
        sure,
        half_scale=half,
        cov=sure.cov + (half**2 - sure.half_scale**2) / K95**2 * onto,
        by=by if doubt > sure.half_scale else sure.by,
    )


def lens_slopes(answer: BeltScale, rows: SightingRows, camera: ItemsCamera) -> Array:
    """(2, 8) m/m, along the belt and across it: by how much the sightings' motion is longer and turned for
    one standard deviation of each number of the lens that the ``camera`` told."""
    T, told, used = from_pose6(camera.T_base_camera), camera.told, answer.used
    known = lens_prior(None if told.sigma is None else told.sigma.model_dump())
    by_lens = off_by_camera(rows.points[used], T, told.intrinsics())[:, :, POSE:] * known.sigma()
    item = indicators(rows.items[used])
    weight = beside_own_mean(rows.counts[used] * answer.m_per_count, item)
    return _axes(answer.direction)[:2, :2] @ np.tensordot(weight / (weight @ weight), by_lens, 1)


def with_lens(sure: BeltUncertainty, answer: BeltScale, slopes: Array) -> BeltUncertainty:
    """``sure`` with what a lens that was not found with the camera's pose is known to: ``slopes`` (2, c)."""
    m, axes = answer.m_per_count, _axes(answer.direction)[:2]
    half = K95 * np.linalg.norm(slopes, axis=1)
    return replace(
        sure,
        half_scale=float(np.hypot(sure.half_scale, m * half[0])),
        half_level=float(np.hypot(sure.half_level, half[1])),
        cov=sure.cov + m * m * axes.T @ slopes @ slopes.T @ axes,
        by=LENS if m * half[0] > sure.half_scale else sure.by,
    )


def _axes(along: Array) -> Array:
    """(3, 3) rows: along the belt, across it in the plane, and up from it."""
    across = np.cross([0.0, 0.0, 1.0] if abs(along[2]) < 0.9 else [0.0, 1.0, 0.0], along)
    across /= np.linalg.norm(across)
    return np.stack([along, across, np.cross(along, across)])


@dataclass(frozen=True)
class _Slope:
    """Of what sightings show along one axis over the belt's travel, m/m: its ``variance``, half of its 95 %
    interval, and what makes most of it."""

    variance: float
    half: float
    by: str


class _Effects:
    """What the sightings of a fit may share.

    Each effect has columns (k, c): by what one unit of each of its c values moves each sighting. All are
    taken beside what the fit itself takes up, a place of each item and the common slope.
    """

    def __init__(self, answer: BeltScale, rows: SightingRows, near: NDArray[np.bool_]) -> None:
        used = answer.used[near]
        travel, at = rows.counts[near] * answer.m_per_count, rows.points[near] @ answer.direction
        item, frame = indicators(rows.items[near]), indicators(rows.t[near])
        self._weight = beside_own_mean(travel, item, used)
        self._weight /= float(self._weight @ self._weight)  # of each sighting in the slope
        self._rounding = 0.0  # variance in the slope along the belt
        if rows.rounding is not None:
            left = rounding_variance(self._weight, rows.rounding[near])
            self._rounding = answer.m_per_count**2 * left
        taken = np.column_stack([item / np.linalg.norm(item, axis=0), beside_own_mean(travel, item)])
        taken[:, -1] /= np.linalg.norm(taken[:, -1])
        self._taken = taken
        self._freedom = len(at) - taken.shape[1]
        self._columns: dict[str, Array] = {}
        if _FEWEST <= frame.shape[1] <= len(at) - item.shape[1] - _FEWEST:  # else nothing tells it from noise
            self._columns["frames"] = frame
        if item.shape[1] >= _FEWEST:
            self._columns["items"] = item * taken[:, -1:]
        self._line = 0.0  # slope (m/m) of a line over the picture that has an RMS of 1 m
        if len(at) - item.shape[1] > FEWEST_OF_PATTERN:
            self._columns[PICTURE] = waves(at)
            self._line = float(np.sqrt(12.0)) / float(np.ptp(at))
        seen = [self._beside(columns) for columns in self._columns.values()]
        grams = [columns.T @ columns for columns in seen]
        self._expected = np.zeros((1 + len(seen), 1 + len(seen)))
        self._expected[0, 0] = self._freedom
        self._expected[0, 1:] = self._expected[1:, 0] = [np.trace(gram) for gram in grams]
        self._expected[1:, 1:] = [[np.sum((a.T @ b) ** 2) for b in seen] for a in seen]
        # Degrees of freedom of each variance: Satterthwaite's, of the effect's sum of squares alone.
        squares = [gram @ gram for gram in grams]
        degrees = {
            name: np.trace(square) ** 2 / np.sum(square**2)
            for name, square in zip(self._columns, squares, strict=True)
        }
        if PICTURE in degrees:  # two orders or so make most of a smooth pattern
            degrees[PICTURE] = _OF_PATTERN
        self._degrees = [float(self._freedom), *degrees.values(), np.inf]

    def slope(self, y: Array, counted: bool) -> _Slope:
        """From ``y`` (k,), m: each sighting beside the motion that was found, along one axis; ``counted`` is
        the one along the belt."""
        r = self._beside(y)
        sums = np.array([r @ r, *(np.sum((columns.T @ r) ** 2) for columns in self._columns.values())])
        variances = _not_negative(self._expected, sums)
        shares = [variances[0] * float(self._weight @ self._weight)]
        for (name, columns), variance in zip(self._columns.items(), variances[1:], strict=True):
            reach = float(np.sum((columns.T @ self._weight) ** 2))
            if name == PICTURE:
                reach += len(_ORDERS) * self._line**2
            shares.append(variance * reach)
        shares.append(self._rounding if counted else 0.0)
        total = float(np.sum(shares))
        if total == 0.0:
            return _Slope(0.0, 0.0, _NOISE)
        degrees = total**2 / sum(share**2 / d for share, d in zip(shares, self._degrees, strict=True))
        half = float(stdtrit(degrees, 0.975)) * float(np.sqrt(total))
        return _Slope(total, half, (_NOISE, *self._columns, "counts")[int(np.argmax(shares))])

    def _beside(self, columns: Array) -> Array:
        return np.asarray(columns - self._taken @ (self._taken.T @ columns))


def indicators(of: NDArray[np.generic]) -> Array:
    """(k, c): 1 where a sighting is of that one of the c values in ``of`` (k,)."""
    _, column, count = np.unique(of, return_inverse=True, return_counts=True)
    return np.eye(len(count))[column]


def beside_own_mean(x: Array, item: Array, used: NDArray[np.bool_] | None = None) -> Array:
    """``x`` (k,) beside its mean over the same ``item`` (k, c); of those in use alone, and 0 elsewhere."""
    use = np.ones(len(x)) if used is None else used.astype(float)
    mean = (item.T @ (use * x)) / np.maximum(item.T @ use, 1.0)
    return np.asarray(use * (x - item @ mean))


def noise_variance(rest: Array, t: Array, freedom: int) -> float:
    """m^2 of one sighting, from what is left of each (k,), m: that of single sightings, or that of frames (at
    ``t``), whose items share an error, where it is larger."""
    frames, column = np.unique(t, return_inverse=True)
    each = np.bincount(column, rest) ** 2 / np.bincount(column)
    return max(float(rest @ rest), float(each.sum()) * len(rest) / len(frames)) / freedom


def waves(at: Array) -> Array:
    """(k, orders): how a pattern over the picture may bend, each with an RMS of 1 over the sightings."""
    u = 2.0 * (at - at.min()) / max(float(np.ptp(at)), 1e-9) - 1.0
    basis, _ = np.linalg.qr(legvander(u, _ORDERS[-1]))
    return np.asarray(basis[:, _ORDERS] * np.sqrt(len(at)))


def _not_negative(expected: Array, sums: Array) -> Array:
    """Variances (n,) that explain ``sums`` (n,); one that comes out negative is left out."""
    variances, left = np.zeros(len(sums)), list(range(len(sums)))
    while left:
        found = np.linalg.lstsq(expected[np.ix_(left, left)], sums[left], rcond=None)[0]
        worst = int(np.argmin(found * expected[left, left]))
        if found[worst] >= 0.0:
            variances[left] = found
            break
        left.pop(worst)
    return variances
