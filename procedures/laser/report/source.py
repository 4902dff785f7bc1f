"""What the sections of a crossed-beam report ask for: the tool before and now, beams, hits, second scan."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from calibration.lengths import length95
from calibration.tool_frame.geometry import BEAMS
from calibration.tool_frame.scene import Line, ReferenceTool, Refused, ToolFrameScene
from cell.errors import CellError
from cell.formats.laser import LaserData
from cell.poses import Array
from procedures.laser.report.near_end import NearEnd, near_end
from procedures.laser.report.passes import EdgeEstimate, ShownPasses, estimate, shown
from procedures.laser.result import LaserResult, ReferenceResult, RejectedPass, RejectedReferencePass
from procedures.laser.solve.data import load_laser, scene_of
from procedures.report.numbers import covariance, dig
from procedures.report.source import Source


def vector(value: Sequence[float] | None) -> Array | None:
    """(3,), None of nothing."""
    return None if value is None else np.array(value, dtype=float)


@dataclass
class LaserSource(Source[LaserResult | ReferenceResult]):
    """A result of ``laser`` or ``laser-reference``; its data set is ``cellward.laser/1``."""

    @property
    def is_reference(self) -> bool:
        """Whether the run made a reference rather than measuring against one."""
        return self.result.kind == "laser-reference"

    @property
    def measured(self) -> LaserResult | None:
        """What a check or an update found; None of others and without an answer."""
        return self.found if isinstance(self.found, LaserResult) else None

    @property
    def made(self) -> ReferenceResult | None:
        """The reference that a run made; None of others and without an answer."""
        return self.found if isinstance(self.found, ReferenceResult) else None

    @property
    def rejected(self) -> Sequence[RejectedPass | RejectedReferencePass]:
        """The passes that were not used across the beams."""
        if self.made is not None:
            return self.made.residuals.rejected
        return [] if self.measured is None else self.measured.result.rejected

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
    def shown(self) -> ShownPasses | None:
        """The passes; None, with a line in ``missing``, when they do not make a measurement."""
        if self.scene is None:
            return None
        tau = None if self.found is None else self.found.result.tau
        try:
            return shown(self.scene, tau or 0.0, () if self.measured is None else self.rejected)
        except Refused as exc:
            self.missing.append(f"The passes of the data set cannot be drawn: {exc.refusal.words}.")
            return None

    @cached_property
    def near_end(self) -> NearEnd | None:
        """The ways near the tool's end; None where passes do not make a measurement, or none is near it."""
        if self.scene is None or self.shown is None:
            return None
        rejected = () if self.measured is None else self.rejected
        tau = None if self.found is None else self.found.result.tau
        return near_end(self.scene, tau or 0.0, rejected, self.measured)

    @cached_property
    def estimate(self) -> EdgeEstimate | None:
        """Where the solution has the edges; None for a reference, without an answer or without passes."""
        if self.scene is None or self.shown is None or self.measured is None:
            return None
        return estimate(self.scene, self.measured)

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
        return None if self.measured is None else np.array(self.measured.result.dp_flange)

    @property
    def drot(self) -> Array | None:
        """(3,) rad: rotation vector from the axis then to the axis now; None when it was not measured."""
        return None if self.measured is None else vector(self.measured.result.drot_flange)

    @property
    def cov(self) -> Array | None:
        """(6, 6) of the answer; the rows of the rotation are zero when it was not measured."""
        return None if self.found is None else covariance(self.found.result.cov)

    @property
    def U(self) -> float | None:
        """The length (m) that 95 % of the errors of the point stay below."""
        stated = None if self.found is None else self.found.uncertainty.U_point_m
        if stated is not None or self.cov is None:
            return stated
        return length95(self.cov[:3, :3])

    @property
    def plane_gap(self) -> float | None:
        """How much higher one beam is than the other where they cross, m; of a reference."""
        return None if self.made is None else abs(self.made.result.plane.gap_m)

    @property
    def slopes(self) -> dict[str, float]:
        """Angle (rad) of each beam to base x-y; of a reference."""
        found = {} if self.made is None else self.made.result.plane.slope_rad
        return {name: abs(slope) for name, slope in found.items()}

    @property
    def delay(self) -> float | None:
        """What the signals are late by, s; without a run what is left in the stamps of the data."""
        if self.measured is not None and self.measured.result.latency_s is not None:
            return self.measured.result.latency_s
        return None if self.found is None else self.found.result.tau

    @property
    def beams(self) -> dict[str, Line]:
        """The beams that can be drawn: as found by a reference, else as the data set has them."""
        return self._found_beams() if self.scene is None else dict(self.scene.beams)

    def _found_beams(self) -> dict[str, Line]:
        found = {} if self.made is None else self.made.result.beams
        return {name: Line.of(beam.point, beam.dir) for name, beam in found.items() if any(beam.dir)}

    @property
    def hits(self) -> dict[str, Array]:
        """Where in the base (3,) m the tool's point meets each beam, as the reference has it."""
        if self.scene is None:
            return {}
        stored = dig(self.run, "values", "laser_reference", "hits") or {}
        hits = stored if self.made is None else self.made.result.hits
        flange = {name: vector(hits.get(name)) for name in BEAMS}
        point = self.scene.R @ self.scene.tool.p
        return {name: at + point for name, at in flange.items() if at is not None}
