"""Limits of single joints, from the base to the flange: one number for all of them, or one for each."""

from collections.abc import Sequence

import numpy as np

from cell.poses import Array

_RESTS_RAD = 1e-9
JOINTS = ("base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3")


def per_joint(limit: float | Sequence[float]) -> Array:
    """(6,): ``limit`` of each joint, where one number holds for all of them."""
    return np.broadcast_to(np.asarray(limit, dtype=float), (6,)).copy()


def leading_speed(turns: Array, speeds: Array) -> Array:
    """How fast the joint that turns farthest may be, (n,) rad/s, where joints turn by ``turns`` (n, 6) rad
    and each keeps to its own of ``speeds`` (6,) rad/s; infinite where none turns.

    All joints begin and end together, so each is slower than that one by the ratio of their turns.
    """
    turned = np.abs(turns)
    ratios = np.divide(
        turned.max(axis=-1, keepdims=True),
        turned,
        out=np.full_like(turned, np.inf),
        where=turned > _RESTS_RAD,
    )
    slowest: Array = np.min(speeds * ratios, axis=-1)
    return slowest


def limit_words(limit: float | Sequence[float]) -> str:
    """A limit as it stands in a configuration."""
    return f"{limit:g}" if isinstance(limit, int | float) else f"[{', '.join(f'{one:g}' for one in limit)}]"
