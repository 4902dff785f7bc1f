"""What the sections of a report on pose accuracy and repeatability ask for."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from cell.poses import Array
from procedures.report.numbers import dig
from procedures.report.source import Source


@dataclass
class IsoSource(Source):
    """A result of kind ``iso9283``."""

    @property
    def poses(self) -> list[Mapping[str, Any]]:
        """P1 to P5 as the result has them."""
        rows = dig(self.answer, "poses")
        return [p for p in rows if isinstance(p, Mapping)] if isinstance(rows, list) else []

    def arrivals(self, pose: str) -> tuple[list[int], Array]:
        """Cycles (n) and offsets (n, 3) m from the barycentre of one pose, in the base."""
        rows = dig(self.result, "residuals", "per_sample")
        mine = [r for r in rows or [] if dig(r, "pose") == pose]
        off = np.array([r["off"] for r in mine], dtype=float).reshape(-1, 3)
        return [int(r["cycle"]) for r in mine], off
