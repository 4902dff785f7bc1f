"""The upper face of an item: where depth has it, and where colour has it.

Depth of a stereo pair has holes of some pixels, edges that are several pixels fat, and noise that neighbours
share. So what it says of single pixels is not believed: holes are closed from what is around them, and the
face is the part of the picture that has the colour of what depth has in the middle of the item.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.items.middle import median
from cell.poses import Array

Mask = NDArray[np.bool_]

_SMOOTH = 5  # points of the first look over which depth is smoothed
_CLOSE_PX = 25  # holes are no larger
_CORE_PX = 9  # from depth's rim inward, where the colour of the face is read
_APART_PX, _FEWEST_PX = 17, 50  # from what stands out, where the belt's colour is read; px of either
_OF_THE_WAY = 0.4  # from the face's colour to the belt's, at most
_SIGMAS = 4.0  # of the colours of the face itself: a side in its own shade lies beyond
_LEAST_CONTRAST = 15.0  # grey levels
_SIDE_PX = 5  # over which a side is told from noise
_FAT_PX = 15  # square about depth's face, outside of which nothing is taken for it
_AGREE = 0.5  # of both together, where depth is known; else colour says something else, and depth is taken
_NEAR_PX, _JOINED_PX = 11, 20  # about a hole of depth, where colour may go on to another face; px of that
_BLOCK_PX = 16  # noise of depth is one within
_SCALE = 0.02  # of a height: what data sheets of stereo cameras state for their depth


def without_holes(depth: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """A coarse look at ``depth`` (h, w) mm: smoothed, with 0 only where nothing near has a depth."""
    known = depth > 0
    near = cv2.dilate(depth, np.ones((_SMOOTH, _SMOOTH), np.uint8))
    whole = np.where(known, depth, 0).astype(np.float32)
    kernel = np.ones((_SMOOTH, _SMOOTH), np.float32)
    count = cv2.filter2D(known.astype(np.float32), -1, kernel, borderType=cv2.BORDER_CONSTANT)
    total = cv2.filter2D(whole, -1, kernel, borderType=cv2.BORDER_CONSTANT)
    mean = np.where(count > 0.5, total / np.maximum(count, 1.0), near)
    smooth = cv2.medianBlur(np.where(known, depth, mean).astype(np.uint16), _SMOOTH)
    return np.asarray(smooth, dtype=np.uint16)


def spread(heights: Array) -> float:
    """Standard deviation of ``heights`` (n,), m, whatever a few of them are."""
    return 1.4826 * float(median(np.abs(heights - median(heights)))) if len(heights) else 0.0


def mostly(mask: Mask, near_px: int = 17) -> Mask:
    """Where most of what is near is in ``mask``: noise that stands out of the belt here and there is not."""
    return np.asarray(cv2.blur(mask.astype(np.float32), (near_px, near_px)) > 0.5)


def filled(mask: Mask, unknown: Mask) -> Mask | None:
    """The largest connected part of ``mask``, without specks, and closed where depth is ``unknown``: the gap
    to another item is not."""
    grey = np.pad(mask.astype(np.uint8), _CLOSE_PX)
    closing = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_CLOSE_PX, _CLOSE_PX))
    grey = cv2.morphologyEx(grey, cv2.MORPH_CLOSE, closing)[_CLOSE_PX:-_CLOSE_PX, _CLOSE_PX:-_CLOSE_PX]
    grey *= (mask | unknown).astype(np.uint8)
    grey = cv2.morphologyEx(grey, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    return _largest(cv2.morphologyEx(grey, cv2.MORPH_OPEN, np.ones((5, 5), np.uint8)))


def face_in_colour(
    colour: NDArray[np.uint8], face: Mask | None, stands: Mask, level_with: Mask, lower: Mask, unknown: Mask
) -> Mask | None:
    """What of ``colour`` (h, w, 3) has the colour of ``face``, as depth has it, and not that of the belt
    beside what ``stands`` out. What is ``lower`` by depth is an item's side, and what is ``level_with`` the
    face and no part of it is another item. Where depth is ``unknown``, colour alone tells: a hole at a corner
    may reach far into the face. ``face`` itself where colour does not tell, or tells otherwise; None where
    colour goes on through a hole to what depth has for another one: is that one item, or are they two?
    """
    if face is None:
        return None
    core = cv2.erode(face.astype(np.uint8), np.ones((_CORE_PX, _CORE_PX), np.uint8)).astype(bool)
    apart = cv2.dilate((stands | face).astype(np.uint8), np.ones((_APART_PX, _APART_PX), np.uint8))
    belt = apart == 0
    if core.sum() < _FEWEST_PX or belt.sum() < _FEWEST_PX:
        return face
    smooth = cv2.GaussianBlur(colour, (3, 3), 0).astype(np.float32)
    own, other = median(smooth[core].T), median(smooth[belt].T)
    way = other - own
    contrast = float(np.linalg.norm(way))
    if contrast < _LEAST_CONTRAST:
        return face
    gone = (smooth - own) @ (way / contrast)
    aside = np.linalg.norm(smooth - own - gone[..., None] * (way / contrast), axis=2)
    varies = 1.4826 * float(median(np.linalg.norm(smooth[core] - own, axis=1)))
    most = min(_OF_THE_WAY * contrast, max(_LEAST_CONTRAST, _SIGMAS * varies))
    alike = (gone < most) & (aside < most)
    alike &= ~mostly(lower, _SIDE_PX) & ~mostly(level_with & ~face, _SIDE_PX)
    alike &= unknown | cv2.dilate(face.astype(np.uint8), np.ones((_FAT_PX, _FAT_PX), np.uint8)).astype(bool)
    found = _largest(cv2.morphologyEx(alike.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8)))
    if found is None or (found & face).sum() < _AGREE * (found & ~unknown | face).sum():
        return face
    return None if _goes_on(found, unknown, level_with & ~face, (gone < most) & (aside < most)) else found


def _goes_on(found: Mask, unknown: Mask, other: Mask, alike: Mask) -> bool:
    """Whether what is ``alike`` in colour goes on from what was ``found`` in a hole, where depth is
    ``unknown``, to the ``other`` faces that depth has."""
    near = cv2.dilate((found & unknown).astype(np.uint8), np.ones((_NEAR_PX, _NEAR_PX), np.uint8)) > 0
    _, labels = cv2.connectedComponents((alike & (found | near)).astype(np.uint8), connectivity=4)
    own = np.isin(labels, np.unique(labels[found & alike]))
    return int(np.count_nonzero(own & near & other & alike)) >= _JOINED_PX


def height_sigma(height: Array, inner: Mask, above_m: float) -> float:
    """Standard deviation (m) of the mean ``height`` (h, w) over ``inner``: of noise that neighbours share, of
    depth that comes in steps, and of an unknown scale; the face is ``above_m`` over the belt."""
    v, u = np.nonzero(inner)
    _, block = np.unique(v // _BLOCK_PX * height.shape[1] + u // _BLOCK_PX, return_inverse=True)
    size = np.bincount(block)
    means = np.bincount(block, height[inner])[size > _BLOCK_PX] / size[size > _BLOCK_PX]
    shared = float(np.std(means, ddof=1)) / np.sqrt(len(means)) if len(means) > 2 else spread(height[inner])
    return float(np.hypot(shared, _SCALE * above_m))


def _largest(mask: NDArray[np.uint8]) -> Mask | None:
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    if count < 2:
        return None
    one = (labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))).astype(np.uint8)
    contours, _ = cv2.findContours(one, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    cv2.drawContours(one, contours, -1, 1, thickness=cv2.FILLED)
    return np.asarray(one > 0)
