"""A segment of the track at many times in one call, and how fast its joints turn at most."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cell.poses import Array
from fakes.world.arm.profile import Ramp, Trapezoid
from fakes.world.arm.ripple import Rippled
from fakes.world.arm.segments import Hold, JointMove, JointSpeed, JointStop, PathMove, Polynomial, Segment
from fakes.world.arm.smoothed import Smoothed


def joints(segment: Segment, times: Array) -> Array:
    """Joints (n, 6) rad at ``times`` (n,), which ascend and are not before the start of ``segment``."""
    if len(times) == 1:
        return segment.at(float(times[0]))[0][None]
    match segment:
        case Hold():
            return np.tile(segment.q, (len(times), 1))
        case JointMove():
            part = distances(segment.profile, times - segment.begun) / max(segment.profile.length, 1e-300)
            out: Array = segment.q0 + part[:, None] * (segment.q1 - segment.q0)
            return out
        case PathMove():
            s = distances(segment.profile, times - segment.begun)
            i = _piece(segment.knots, s)
            c3, c2, c1, c0 = segment.coefficients[:, i]
            x = (s - segment.knots[i])[:, None]
            on_path: Array = ((c3 * x + c2) * x + c1) * x + c0
            return on_path
        case Polynomial() if times[-1] <= segment.t1:
            tau = (times - segment.origin)[:, None]
            q = np.zeros((len(times), segment.coefficients.shape[1]))
            for c in segment.coefficients[::-1]:
                q = q * tau + c
            return q
    return np.array([segment.at(float(t))[0] for t in times])


def states(segment: Segment, times: Sequence[float]) -> tuple[Array, Array]:
    """Joints and joint speeds, (n, 6) each, at ``times`` (n,): bit by bit what the track has.

    ``segment`` is in force at all of them, or is the oldest that is known."""
    if times[0] < segment.t0:
        q = segment.at(segment.t0)[0]
        return np.tile(q, (len(times), 1)), np.zeros((len(times), len(q)))
    match segment:
        case Hold():
            return np.tile(segment.q, (len(times), 1)), np.zeros((len(times), len(segment.q)))
        case JointMove() if segment.profile.length > 0.0:
            s, v = _along(segment, times)
            per_length = (segment.q1 - segment.q0) / segment.profile.length
            under_way = s < segment.profile.length
            q = np.where(under_way, segment.q0 + per_length * s, segment.q1)
            return q, np.where(under_way, per_length * v, 0.0)
        case PathMove():
            s, v = _along(segment, times)
            knots = segment.knots
            i = _piece(knots, s[:, 0])
            c3, c2, c1, c0 = segment.coefficients[:, i]
            x = s - knots[i][:, None]
            return ((c3 * x + c2) * x + c1) * x + c0, ((3.0 * c3 * x + 2.0 * c2) * x + c1) * v
    each = [segment.at(t) for t in times]
    return np.array([q for q, _ in each]), np.array([qd for _, qd in each])


def _piece(knots: Array, s: Array) -> NDArray[np.intp]:
    """Which of the pieces between ``knots`` each of ``s`` (n,) is on."""
    found: NDArray[np.intp] = np.searchsorted(knots, s, side="right") - 1
    return np.minimum(np.maximum(found, 0), len(knots) - 2)


def _along(segment: JointMove | PathMove, times: Sequence[float]) -> tuple[Array, Array]:
    """Distance and speed on the way, (n, 1) each."""
    both = np.array([segment.profile.at(t - segment.begun) for t in times])
    return both[:, :1], both[:, 1:]


def fastest(segment: Segment) -> Array:
    """A bound (6,) on the joint speeds, rad/s, from the start of ``segment`` to its end."""
    match segment:
        case JointMove():
            peak = segment.profile.peak if segment.profile.length > 0.0 else 0.0
            turn: Array = np.abs(segment.q1 - segment.q0)
            return turn * peak / max(segment.profile.length, 1e-300)
        case PathMove():
            c3, c2, c1, _ = np.abs(segment.coefficients)
            x = np.diff(segment.knots)[:, None]
            per_length: Array = ((3.0 * c3 * x + 2.0 * c2) * x + c1).max(axis=0)
            profile = segment.profile
            on_way: Array = per_length * (profile.peak if isinstance(profile, Trapezoid) else abs(profile.v0))
            return on_way
        case JointStop():
            return np.abs(segment.qd0)
        case JointSpeed():
            return np.maximum(np.abs(segment.qd0), np.abs(segment.qd1))
        case Polynomial():
            longest = max(abs(segment.t0 - segment.origin), abs(segment.t1 - segment.origin))
            powers = np.arange(1, len(segment.coefficients))
            terms = np.abs(segment.coefficients[1:]) * (powers * longest ** (powers - 1.0))[:, None]
            total: Array = terms.sum(axis=0)
            return total
        case Smoothed():
            return np.maximum(np.abs(segment.at(segment.t0)[1]), fastest(segment.sent))
        case Rippled():
            return segment.ripple.fastest(fastest(segment.way))
    return np.zeros(6)


def distances(profile: Trapezoid | Ramp, tau: Array) -> Array:
    """Distances (n,) along a profile ``tau`` (n,) seconds after its start."""
    tau = np.minimum(np.maximum(tau, 0.0), profile.duration)  # in a third of the time that np.clip takes
    if isinstance(profile, Ramp):
        T = profile.duration
        if T == 0.0:
            return np.full_like(tau, profile.s0)
        slowed: Array = profile.s0 + profile.v0 * (tau - 0.5 * tau * tau / T)
        return slowed
    left, ramp = profile.duration - tau, profile.peak / profile.a if profile.length > 0.0 else 0.0
    out: Array = np.where(
        tau < ramp,
        0.5 * profile.a * tau * tau,
        np.where(
            left < ramp,
            profile.length - 0.5 * profile.a * left * left,
            profile.peak * (tau - 0.5 * ramp),
        ),
    )
    return out
