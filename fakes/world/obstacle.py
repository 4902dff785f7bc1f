"""Something solid that the tool may touch."""

import numpy as np
from pydantic import Field

from cell.formats.reading import Strict
from cell.poses import Array
from fakes.world.beams.truth import Three


class Obstacle(Strict):
    """An elastic half-space that pushes the tool's tip back along ``normal``."""

    point: Three
    normal: Three
    stiffness_n_m: float = Field(default=20000.0, gt=0)

    def push(self, tip: Array) -> Array:
        """Force (3,) on the ``tip`` (3,), N, in the base."""
        normal = np.array(self.normal) / np.linalg.norm(self.normal)
        depth = float(normal @ (np.array(self.point) - tip))
        force: Array = normal * (self.stiffness_n_m * max(depth, 0.0))
        return force
