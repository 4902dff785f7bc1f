"""The delay of an encoder's stamps, from items that a camera sees while their belt starts and stops.

At the time ``t`` of a picture the belt had the count that the encoder stamps ``tau`` later, so an item is at
``a + m n(t + tau)`` along the belt: linear in the item's own place ``a`` and the scale ``m``. At one speed
``tau`` is part of ``a``; a belt that changes its speed while an item is in view parts them. What the camera
gets wrong over its picture is the same at any speed: a smooth pattern of it is found with the rest.
"""

import numpy as np
from numpy.typing import NDArray

from calibration.latency.delay import Delay, DelayUndetermined, leave_out
from cell.poses import Array

FEWEST_SIGHTINGS = 30
LEAST_CHANGE_M_S = 0.01  # RMS of what the speed of the belt differs by while an item is in view
_BLOCKS = 12  # of the run's time, of which one after the other is left out
_STEPS, _SETTLED_S = 20, 1e-6
_SPEED_S = 0.02  # on both sides of a time: where the belt's speed is read
_OUTLIER = 5.0  # times the residuals' robust standard deviation
_BENDS = (2, 3)  # orders of the pattern over the picture


def solve_counts(t: Array, along: Array, item: NDArray[np.int64], stamps: Array, counts: Array) -> Delay:
    """From sightings at ``t`` (k,) s of each ``item`` (k,), at ``along`` (k,) m along the belt, and from
    ``counts`` (n,) with the encoder's ``stamps`` (n,) s. ``DelayUndetermined`` says what is missing."""
    use = np.ones(len(t), dtype=bool)
    tau = 0.0
    for again in (False, True):
        rows = _seen_twice(item, use)
        _require(t[rows])
        tau, J, r = _solved(tau, t[rows], along[rows], item[rows], stamps, counts)
        if not again:
            sigma = 1.4826 * float(np.median(np.abs(r)))
            use[np.flatnonzero(rows)[np.abs(r) > _OUTLIER * max(sigma, 1e-6)]] = False
    change = float(np.sqrt(np.mean(_beside(J[:, 1:], J[:, 0]) ** 2)))
    if change < LEAST_CHANGE_M_S:
        raise DelayUndetermined(
            f"steady-belt: while items were in view the speed of the belt changed by {1e3 * change:.1f} mm/s "
            f"(RMS), {1e3 * LEAST_CHANGE_M_S:g} mm/s are needed; start and stop it while items are in view"
        )
    noise = float(r @ r) / max(len(r) - np.linalg.matrix_rank(J), 1)
    left = leave_out(J, r, _blocks(t[rows]))
    sigma_tau = max(float(np.sqrt(left.cov[0, 0])), float(np.sqrt(noise / len(r))) / change)
    return Delay(tau, sigma_tau, None, None, r, left.heldout, None, left.sigmas)


def _require(t: Array) -> None:
    if len(t) < FEWEST_SIGHTINGS:
        raise DelayUndetermined(
            f"too-few-sightings: {len(t)} sightings of items that were seen more than once, "
            f"{FEWEST_SIGHTINGS} are needed"
        )


def _seen_twice(item: NDArray[np.int64], use: NDArray[np.bool_]) -> NDArray[np.bool_]:
    names, times = np.unique(item[use], return_counts=True)
    return np.asarray(use & np.isin(item, names[times > 2]))


def _solved(
    tau: float, t: Array, along: Array, item: NDArray[np.int64], stamps: Array, counts: Array
) -> tuple[float, Array, Array]:
    """The delay, the derivatives (k, p) by it and all else, and the residuals (k,) m."""
    own = (item[:, None] == np.unique(item)).astype(float)
    u = 2.0 * (along - along.min()) / max(float(np.ptp(along)), 1e-9) - 1.0
    bends = np.stack([u**order for order in _BENDS], axis=1)
    for _ in range(_STEPS):
        n = np.interp(t + tau, stamps, counts)
        places = np.column_stack([n - n.mean(), own, bends])
        fit, *_ = np.linalg.lstsq(places, along, rcond=None)
        r = along - places @ fit
        ahead, behind = (np.interp(t + tau + dt, stamps, counts) for dt in (_SPEED_S, -_SPEED_S))
        speed = fit[0] * (ahead - behind) / (2.0 * _SPEED_S)
        free = _beside(places, speed)
        if float(np.sqrt(np.mean(free**2))) < 1e-9:
            break
        step = float(free @ r / (free @ free))
        tau += step
        if abs(step) < _SETTLED_S:
            break
    return tau, np.column_stack([speed, places]), r


def _beside(places: Array, y: Array) -> Array:
    """``y`` (k,) without what the columns of ``places`` (k, p) explain."""
    return np.asarray(y - places @ np.linalg.lstsq(places, y, rcond=None)[0])


def _blocks(t: Array) -> NDArray[np.int64]:
    """(k,): number of the block of time that each sighting lies in, with as many sightings in each."""
    order = np.argsort(np.argsort(t, kind="stable"), kind="stable")
    return np.asarray(order * _BLOCKS // len(t), dtype=np.int64)
