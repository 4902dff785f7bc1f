"""Inverse kinematics: Newton steps from good starts, and which of the turns of a joint to take."""

import numpy as np
from numpy.typing import NDArray

from calibration.kinematics.chain import SerialChain, pose_gap
from cell.poses import Array

TOLERANCE = 1e-10  # m and rad: far below what an arm resolves, far above rounding
_STEPS = 30
_MAX_STEP = 0.5  # rad; a start near a singularity must slow down instead of leaping
_LAST_STEP, _LAST_STEP_ERRORS = 1e-6, 1e-7  # rad; its square, or what gears add to it, is below TOLERANCE
_SAME = 1e-6  # rad; two solutions closer than this are one

_UNIT = np.eye(6)


def polish(chain: SerialChain, goal: Array, starts: Array) -> Array:
    """(k, 6): where Newton steps take the ``starts`` (m, 6); without those that miss ``goal`` (4, 4)."""
    q, reached = converge(chain, np.broadcast_to(goal, (len(starts), 4, 4)), starts)
    found: Array = q[reached]
    return found


def converge(chain: SerialChain, goals: Array, starts: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Where Newton steps take each of ``starts`` (m, 6) on the way to its goal (m, 4, 4), and who got there.

    Damped least squares (Nakamura and Hanafusa 1986) with a damping that vanishes with the error: it stays
    finite at singular starts and converges quadratically. Where all steps are so small that their squares do
    not matter, what they leave is known without looking: the part of the gap that they do not close.
    """
    q = np.array(starts, dtype=float).reshape(-1, 6)
    last_step = _LAST_STEP if chain.errors is None else _LAST_STEP_ERRORS  # the Jacobian leaves errors out
    for step in range(_STEPS + 1):
        frames = chain.frames(q)
        gap = pose_gap(goals, frames[:, -1])
        error = np.abs(gap).max(axis=1)
        if step == _STEPS or error.max(initial=0.0) < TOLERANCE:
            break
        J = chain.jacobians(frames)
        Jt = J.swapaxes(1, 2)
        damping = np.minimum(1e-3, error**2)[:, None, None] + 1e-15
        dq = (Jt @ np.linalg.solve(J @ Jt + damping * _UNIT, gap[:, :, None]))[:, :, 0]
        largest = np.abs(dq).max()
        if largest < _MAX_STEP:
            q = q + dq
        else:
            most = np.maximum(np.abs(dq).max(axis=1, keepdims=True), _MAX_STEP)
            q = q + dq * (_MAX_STEP / most)
        if largest < last_step:
            left = np.abs(gap - (J @ dq[:, :, None])[:, :, 0]).max(axis=1)
            if left.max() < 0.5 * TOLERANCE:
                return q, np.ones(len(q), dtype=bool)
    return q, error < TOLERANCE


def nearest_turns(q: Array, q_near: Array, limits: Array) -> Array | None:
    """``q`` (6,) with each angle shifted by full turns to be closest to ``q_near`` within ``limits`` (6, 2).

    None when an angle has no turn inside its limits.
    """
    turn = 2.0 * np.pi
    low = np.ceil((limits[:, 0] - q) / turn - 1e-12)
    high = np.floor((limits[:, 1] - q) / turn + 1e-12)
    if np.any(low > high):
        return None
    shifted: Array = q + turn * np.clip(np.round((q_near - q) / turn), low, high)
    return np.clip(shifted, limits[:, 0], limits[:, 1])


def distinct(solutions: list[Array]) -> list[Array]:
    """The solutions without repetitions, full turns not counted."""
    kept: list[Array] = []
    for q in solutions:
        if all(np.max(np.abs(_wrapped(q - other))) > _SAME for other in kept):
            kept.append(q)
    return kept


def _wrapped(angle: Array) -> Array:
    wrapped: Array = (angle + np.pi) % (2.0 * np.pi) - np.pi
    return wrapped
