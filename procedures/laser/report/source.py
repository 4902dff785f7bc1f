"""What the sections of a crossed-beam report ask for: the tool before and now, beams, hits, second scan."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.tool_frame.geometry import BEAMS
from calibration.tool_frame.scene import Line, ReferenceTool, Refusal, ToolFrameScene
from cell.errors import CellError
from cell.formats.laser import LaserData
from cell.poses import Array
from procedures.laser.report.passes import Estimate, Shown, estimate, shown
from procedures.laser.solve.data import load_laser, scene_of
from procedures.report.numbers import covariance, dig, number, radius95
from procedures.report.source import Source


def vector(value: Any) -> Array | None:
    """(3,) of three finite numbers, None for anything else."""
    if not isinstance(value, list | tuple) or len(value) != 3 or any(number(v) is None for v in value):
        return None
    return np.array(value, dtype=float)


@dataclass
class LaserSource(Source):
    """A result of ``laser`` or ``laser-reference``; its data set is ``cellward.laser/1``."""

    @property
    def is_reference(self) -> bool:
        """Whether the run made a reference rather than measuring against one."""
        return self.result.get("kind") == "laser-reference"

    @cached_property
    def loaded(self) -> LaserData | None:
        """The data set; None, with a line in ``missing``, when it cannot be read."""
        if self.data is None:
            self.missing.append("No data set is at hand, so tool and edges cannot be drawn.")
            return None
        try:
            return load_laser(self.data, current=not self.is_reference)[1]
        except CellError as exc:
            self.missing.append(f"The data set cannot be read: {exc}")
            return None

    @cached_property
    def scene(self) -> ToolFrameScene | None:
        """The data set as the estimator sees it; of a reference with the beams that it found."""
        if self.loaded is None:
            return None
        scene = scene_of(self.loaded)
        return ToolFrameScene(scene.R, {**scene.beams, **self._found_beams()}, scene.tool, scene.passes)

    @cached_property
    def shown(self) -> Shown | None:
        """The passes; None, with a line in ``missing``, when they do not make a measurement."""
        if self.scene is None:
            return None
        left = (number(dig(self.answer, key)) for key in ("tau", "tau_s"))
        try:
            tau = next((v for v in left if v is not None), 0.0)
            return shown(self.scene, tau, dig(self.answer, "rejected"))
        except Refusal as exc:
            self.missing.append(f"The passes of the data set cannot be drawn: {exc.words}.")
            return None

    @cached_property
    def estimate(self) -> Estimate | None:
        """Where the solution has the edges; None for a reference or without an answer."""
        if self.scene is None or self.answer is None:
            return None
        return estimate(self.scene, self.answer, self.result.get("observability") or {})

    @property
    def tool_id(self) -> str | None:
        found = dig(self.run, "values", "tool", "name")
        if found is None and self.loaded is not None:
            found = self.loaded.tool.id
        return None if found is None else str(found)

    @property
    def R(self) -> Rotation | None:
        """The attitude R_base_flange that the beams were crossed in."""
        return None if self.scene is None else Rotation.from_matrix(self.scene.R)

    @property
    def before(self) -> ReferenceTool | None:
        """The tool as the reference has it."""
        return None if self.scene is None else self.scene.tool

    @property
    def dp(self) -> Array | None:
        """(3,) m: displacement of the tool's point, in the flange."""
        return vector(dig(self.answer, "dp_flange"))

    @property
    def drot(self) -> Array | None:
        """(3,) rad: rotation vector from the axis then to the axis now; None when it was not measured."""
        return vector(dig(self.answer, "drot_flange"))

    @property
    def cov(self) -> Array | None:
        """(6, 6) of the answer; the rows of the rotation are zero when it was not measured."""
        return covariance(dig(self.answer, "cov"))

    @property
    def U(self) -> float | None:
        """The length (m) that 95 % of the errors of the point stay below."""
        stated = number(dig(self.result, "uncertainty", "U_point_m"))
        if stated is not None or self.cov is None:
            return stated
        return radius95(self.cov[:3, :3])

    @property
    def plane_gap(self) -> float | None:
        """How much higher one beam is than the other where they cross, m; of a reference."""
        gap = number(dig(self.answer, "plane", "gap_m"))
        return None if gap is None else abs(gap)

    @property
    def slopes(self) -> dict[str, float]:
        """Angle (rad) of each beam to base x-y; of a reference."""
        found = {name: number(dig(self.answer, "plane", "slope_rad", name)) for name in BEAMS}
        return {name: abs(slope) for name, slope in found.items() if slope is not None}

    @property
    def delay(self) -> float | None:
        """What the signals are late by, s; without a run what is left in the stamps of the data."""
        found = (number(dig(self.answer, key)) for key in ("latency_s", "tau", "tau_s"))
        return next((v for v in found if v is not None), None)

    @property
    def beams(self) -> dict[str, Line]:
        """The beams that can be drawn: as found by a reference, else as the data set has them."""
        return self._found_beams() if self.scene is None else dict(self.scene.beams)

    def _found_beams(self) -> dict[str, Line]:
        found = {}
        for name in BEAMS if self.is_reference else ():
            point, direction = (vector(dig(self.answer, "beams", name, key)) for key in ("point", "dir"))
            if point is not None and direction is not None and np.any(direction):
                found[name] = Line.of(point.tolist(), direction.tolist())
        return found

    @property
    def hits(self) -> dict[str, Array]:
        """Where in the base (3,) m the tool's point meets each beam, as the reference has it."""
        if self.scene is None:
            return {}
        document = self.answer if self.is_reference else dig(self.run, "values", "laser_reference")
        flange = {name: vector(dig(document, "hits", name)) for name in BEAMS}
        point = self.scene.R @ self.scene.tool.p
        return {name: at + point for name, at in flange.items() if at is not None}
