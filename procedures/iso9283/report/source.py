"""What the sections of a report on pose accuracy and repeatability ask for."""

from dataclasses import dataclass

import numpy as np

from cell.poses import Array
from procedures.iso9283.result import Iso9283Result, PoseResult
from procedures.report.source import Source


@dataclass
class IsoSource(Source[Iso9283Result]):
    """A result of kind ``iso9283``."""

    @property
    def poses(self) -> list[PoseResult]:
        """P1 to P5 as the result has them."""
        return [] if self.found is None else self.found.result.poses

    def arrivals(self, pose: str) -> tuple[list[int], Array]:
        """Cycles (n) and offsets (n, 3) m from the barycentre of one pose, in the base."""
        rows = [] if self.found is None else self.found.residuals.per_sample
        mine = [row for row in rows if row.pose == pose]
        off = np.array([row.off for row in mine], dtype=float).reshape(-1, 3)
        return [row.cycle for row in mine], off
