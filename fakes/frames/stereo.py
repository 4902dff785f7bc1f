"""Depth as a stereo pair makes it, from depth as it is.

640 x 400 pixels with a focal length of 440 and a baseline of 75 mm, as the OAK-D has them by its data sheet.
Steps are of three subpixel bits. Noise that neighbours share over 8 px, holes of 16 px, edges that
are 4 px fat and a wrong scale are assumptions in the sizes that data sheets allow.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from fakes.world.camera.truth import StereoTruth

SHARED_PX, HOLE_PX, FAT_PX = 8, 16, 4
_FAT = np.ones((2 * FAT_PX + 1, 2 * FAT_PX + 1), np.uint8)


def stereo_depth(
    depth: NDArray[np.uint16] | NDArray[np.float32], stereo: StereoTruth, rng: np.random.Generator
) -> NDArray[np.uint16]:
    """What is told of ``depth`` (h, w) in mm, 0 where there is none."""
    h, w = depth.shape
    product = np.float32(stereo.focal_px * 1000.0 * stereo.baseline_m)  # px mm
    near = cv2.erode(depth.astype(np.float32), _FAT)
    shared = rng.normal(0.0, stereo.noise_px, (h // SHARED_PX + 1, w // SHARED_PX + 1))
    disparity = product / np.maximum(near, np.float32(1.0))
    disparity += cv2.resize(shared.astype(np.float32), (w, h))
    disparity = np.round(stereo.steps * disparity) / np.float32(stereo.steps)
    told = np.float32(stereo.scale) * product / np.maximum(disparity, np.float32(1.0 / stereo.steps))
    gone = rng.random((h // HOLE_PX + 1, w // HOLE_PX + 1)) < stereo.holes
    told[cv2.resize(gone.astype(np.uint8), (w, h), interpolation=cv2.INTER_NEAREST) > 0] = 0.0
    out: NDArray[np.uint16] = np.clip(told + 0.5, 0.0, 65535.0).astype(np.uint16)
    return out
