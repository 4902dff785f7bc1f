"""Items that differ from the belt in colour, for a camera without depth that knows how high they are.

What stands out in colour is the whole silhouette of an item: its upper face and the sides that are seen. Of
upright walls and a convex face that silhouette is the hull of face and foot, so the face is those of its
points whose foot, straight below at the known height, lies in the silhouette, too.
"""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from cell.poses import Array

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

_CONTRAST = 15.0  # grey levels from the belt, at least
_LARGEST = 255  # px of a median that OpenCV takes
_CLOSE = 5  # px: print and glare on an item


def belt_without_items(colour: Image, item_px: float) -> Image:
    """``colour`` (h, w, 3) as it would be without items of up to ``item_px``: the median around each point,
    over so much that an item is less than half of it. Uneven light and the belt's edges stay."""
    size = int(np.clip(2.0 * item_px, 5.0, _LARGEST)) | 1
    return np.asarray(cv2.medianBlur(colour, size))


def away_from(colour: Image, belt: Image) -> Array:
    """(h, w): how far each point's colour is from the belt's, grey levels."""
    smooth = cv2.GaussianBlur(colour, (3, 3), 0).astype(np.float32)
    out: Array = np.linalg.norm(smooth - belt.astype(np.float32), axis=2)
    return out


def stands_out(away: Array) -> NDArray[np.uint8]:
    """(h, w): 1 where there is something that is not the belt."""
    return (away > _CONTRAST).astype(np.uint8)


def silhouette(away: Array, margin_px: int) -> Mask | None:
    """What stands out most within a window less its margin, with the blur of its edge; None where nothing
    does, or where it goes on beyond the window, as things do that lie against each other.

    The window was made around one thing, and its margin may show a larger one beside it. A side in shadow may
    differ little from a dark belt, so whatever differs at all belongs to it.
    """
    mask = cv2.morphologyEx(stands_out(away), cv2.MORPH_CLOSE, np.ones((_CLOSE, _CLOSE), np.uint8))
    count, labels = cv2.connectedComponents(mask, connectivity=8)
    inner = labels[margin_px:-margin_px, margin_px:-margin_px]
    areas = np.bincount(inner.ravel(), minlength=count)[1:]
    if not areas.any():
        return None
    one = (labels == 1 + int(np.argmax(areas))).astype(np.uint8)
    if one[[0, -1]].any() or one[:, [0, -1]].any():
        return None
    contours, _ = cv2.findContours(one, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    cv2.drawContours(one, contours, -1, 1, thickness=cv2.FILLED)
    return np.asarray(one > 0)


def face_of(whole: Mask, foot: Callable[[Array], Array]) -> Mask:
    """The points of a silhouette ``whole`` (h, w) whose foot lies in it, too.

    ``foot(points)`` (n, 2) px is where the belt is below ``points`` (n, 2) px of the upper face.
    """
    v, u = np.nonzero(whole)
    below = np.round(foot(np.column_stack([u, v]).astype(float))).astype(np.int64)
    inside = np.all((below >= 0) & (below < np.array(whole.shape[::-1])), axis=1)
    below = np.where(inside[:, None], below, 0)
    out = np.zeros_like(whole)
    out[v, u] = inside & whole[below[:, 1], below[:, 0]]
    return out
