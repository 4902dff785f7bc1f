"""Depth as a stereo pair makes it, from depth as it is.

640 x 400 pixels with a focal length of 440 and a baseline of 75 mm, as the OAK-D has them by its data sheet.
Steps are of three subpixel bits. Noise that neighbours share over 8 px, holes of 16 px, edges that
are 4 px fat and a wrong scale are assumptions in the sizes that data sheets allow.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

FOCAL_TIMES_BASELINE = 440.0 * 75.0  # px mm
STEPS, SHARED_PX, HOLE_PX, FAT_PX = 8, 8, 16, 4


@dataclass(frozen=True)
class Stereo:
    """``noise_px`` of the disparity (sigma), share of ``holes``, and ``scale`` of what is told."""

    noise_px: float = 0.1
    holes: float = 0.0
    scale: float = 1.0

    def seen(self, depth: NDArray[np.uint16], rng: np.random.Generator) -> NDArray[np.uint16]:
        """``depth`` (h, w) in mm, 0 where there is none."""
        h, w = depth.shape
        near = cv2.erode(depth.astype(np.float32), np.ones((2 * FAT_PX + 1, 2 * FAT_PX + 1), np.uint8))
        shared = rng.normal(0.0, self.noise_px, (h // SHARED_PX + 1, w // SHARED_PX + 1))
        disparity = FOCAL_TIMES_BASELINE / np.maximum(near, 1.0)
        disparity += cv2.resize(shared.astype(np.float32), (w, h))
        disparity = np.round(STEPS * disparity) / STEPS
        told = self.scale * FOCAL_TIMES_BASELINE / np.maximum(disparity, 1.0 / STEPS)
        gone = rng.random((h // HOLE_PX + 1, w // HOLE_PX + 1)) < self.holes
        told[cv2.resize(gone.astype(np.uint8), (w, h), interpolation=cv2.INTER_NEAREST) > 0] = 0.0
        return np.clip(told + 0.5, 0.0, 65535.0).astype(np.uint16)
