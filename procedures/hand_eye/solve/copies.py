"""Observations that were given twice: a copy says nothing new, and an image cannot belong to two poses."""

from collections.abc import Hashable
from hashlib import blake2b

import numpy as np

from cell.poses import Array
from procedures.hand_eye.solve.capture import CaptureSet

CODE = "poses.copies"
_SAME_T, _SAME_R = 1e-4, 1e-3  # m, rad: an arm that did not move reports no more


def leave_copies_out(loaded: CaptureSet) -> list[tuple[str, str]]:
    """Mark copies as not usable, with the reason; the warnings that name them.

    Corners measured to hundredths of a pixel are never the same twice: where two observations share all of
    them they share the image. With the same pose the later one is a copy; with another pose one of the two
    images is stale, and nothing tells which.
    """
    first: dict[Hashable, int] = {}
    copies: list[tuple[int, int]] = []
    stale: list[tuple[int, int]] = []
    for k in range(len(loaded.F)):
        seen = _measured(loaded, k)
        if seen is None or k in loaded.unusable:
            continue
        i = first.setdefault(seen, k)
        if i != k:
            (copies if _same_pose(loaded.F[i], loaded.F[k]) else stale).append((i, k))
    index, warnings = loaded.indices, []
    for i, k in copies:
        loaded.unusable[k] = f"a copy of observation {index[i]}"
    if copies:
        warnings.append((CODE, f"observations given twice, each used once: {_pairs(index, copies)}"))
    for i, k in stale:
        loaded.unusable[k] = f"its image is that of observation {index[i]}, and the arm had moved"
        loaded.unusable[i] = f"its image is also that of observation {index[k]}, and the arm had moved"
    if stale:
        text = f"the same image at two poses of the arm: {_pairs(index, stale)}; they were left out"
        warnings.append((CODE, f"{text}, as nothing tells to which pose it belongs"))
    return warnings


def _measured(loaded: CaptureSet, k: int) -> Hashable | None:
    view, pose = loaded.views[k], loaded.poses[k]
    if view is not None:
        return blake2b(view.corners.tobytes() + view.points.tobytes()).digest()
    return None if pose is None else pose.tobytes()


def _same_pose(first: Array, second: Array) -> bool:
    near = np.linalg.norm(first[:3, 3] - second[:3, 3]) < _SAME_T
    return bool(near and np.abs(first[:3, :3] - second[:3, :3]).max() < _SAME_R)


def _pairs(index: list[int], pairs: list[tuple[int, int]]) -> str:
    named = ", ".join(f"{index[i]} and {index[k]}" for i, k in pairs[:8])
    return named + (f" and {len(pairs) - 8} more" if len(pairs) > 8 else "")
