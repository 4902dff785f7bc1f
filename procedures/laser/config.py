"""What an integrator can set for the crossed-beam jobs, and the geometry that a reference keeps."""

from collections.abc import Mapping
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, ValidationError, model_validator

from calibration.odds import FALSE_ALARM
from calibration.tool_frame.geometry import MIN_CROSSING_RAD
from cell.errors import error
from cell.formats.bounds import Direction
from cell.formats.reading import Strict
from cell.formats.robot import SixAngles
from cell.poses import Array

BEAMS = ("xs", "ys")
MIN_ALONG_M = 0.04
MAX_SLOPE = 0.02  # of the way across a beam, which is level


class BeamSection(Strict):
    """How one beam is crossed."""

    input: str = Field(description="name of its input")
    aux: str = Field(
        description="name of a [poses] entry: the tool beside the beam and above it, in the attitude of the "
        "measurement; it belongs to the tool and the fixture"
    )
    across: Direction = Field(description="direction of the way out across the beam, in base; level")
    distance_m: float = Field(gt=0.005, le=0.5, description="length of the way across")
    along_m: float = Field(
        default=0.05,
        ge=-0.5,
        le=0.5,
        description="to the second place along the beam, 0.04 or more; positive is to the left of 'across' "
        "seen from above",
    )

    @model_validator(mode="after")
    def _usable(self) -> Self:
        length = float(np.linalg.norm(self.across))
        if length < 1e-6 or abs(self.across[2]) > MAX_SLOPE * length:
            raise ValueError("across must be a level direction: two beams lie in a plane parallel to x-y")
        if abs(self.along_m) < MIN_ALONG_M:
            raise ValueError(f"along_m must be {MIN_ALONG_M:g} m or more to either side")
        return self

    @property
    def across_unit(self) -> Array:
        """(3,) unit vector of the way out."""
        unit: Array = np.array(self.across) / np.linalg.norm(self.across)
        return unit

    @property
    def along_unit(self) -> Array:
        """(3,) unit vector along the beam: the way out turned by 90 degrees about base z."""
        x, y, _ = self.across_unit
        unit: Array = np.array([-y, x, 0.0]) / np.hypot(x, y)
        return unit


class SearchSection(Strict):
    """The search and the measurement; a reference keeps them, so that every check repeats them exactly."""

    descend_step_m: float = Field(default=0.005, gt=0, le=0.05, description="down when nothing triggered")
    max_descents: int = Field(default=10, ge=1, le=200, description="steps down before the search gives up")
    floor_m: float = Field(
        ge=-5.0,
        le=5.0,
        description="lowest height in base that the tool's point may reach, with the configured tool",
    )
    search_speed_m_s: float = Field(
        default=0.05, gt=0, le=0.5, description="of the tool's point while it searches"
    )
    measure_speed_m_s: float = Field(
        default=0.02, gt=0, le=0.5, description="of the tool's point while it crosses a beam"
    )
    passes: int = Field(default=8, ge=1, le=64, description="there and back, for each beam, place and height")
    measure_depth_m: float = Field(
        default=0.006,
        gt=0,
        le=0.1,
        description="measured this far below the height at which the tool's point meets the beam",
    )
    tilt_height_m: float = Field(
        default=0.025, ge=0, le=0.1, description="second height, that much lower; 0: no tilt"
    )
    z_resolution_m: float = Field(
        default=0.00002,
        gt=0,
        le=0.05,
        description="the search in height ends when the height is known as well as from an interval so long, "
        "and as well as max_U_m asks for; or after as many ways there and back as it would take to halve "
        "descend_step_m down to this",
    )
    edges: int = Field(default=2, ge=2, le=16, description="changes of a beam on one way; 4 with two fingers")
    lead_m: float = Field(
        default=0.004, gt=0, le=0.1, description="at constant speed before and after a crossing"
    )
    tool_margin_m: float = Field(
        default=0.01, ge=0, le=0.2, description="the plan is checked with a tool that is longer by this"
    )
    max_speed_deviation: float = Field(default=0.05, gt=0, le=0.5, description="share, between the edges")
    max_out_back_m: float = Field(
        default=0.001, gt=0, le=0.02, description="between the way out and the way back, half chords"
    )
    max_poll_gap_s: float = Field(
        default=0.06, gt=0, le=1.0, description="longest time without a poll on the way"
    )
    retries: int = Field(default=3, ge=0, le=20, description="of a pass that cannot be used")
    settle_s: float = Field(default=0.05, ge=0, le=5.0, description="wait at rest between two moves")

    @property
    def heights(self) -> tuple[float, ...]:
        """How far below the height at which the point meets a beam it is measured, m; one or two."""
        deeper = (self.measure_depth_m + self.tilt_height_m,) if self.tilt_height_m > 0.0 else ()
        return (self.measure_depth_m, *deeper)

    @property
    def most_height_pairs(self) -> int:
        """How many ways there and back the height of one place may take."""
        return int(np.ceil(np.log2(max(self.descend_step_m / self.z_resolution_m, 1.0))))

    @model_validator(mode="after")
    def _edges_come_in_pairs(self) -> Self:
        if self.edges % 2:
            raise ValueError("edges must be an even number: what breaks a beam clears it again")
        return self


class Policy(Strict):
    """Who accepts a result that passed."""

    auto: bool = Field(default=False, description="accept a passing result without asking")


class LaserReferenceConfig(SearchSection):
    """``[job.laser-reference]``: the fixture, and how it is measured.

    A run that was interrupted cannot be adopted: its passes and those of another day do not belong together.
    """

    xs: BeamSection = Field(description="the first beam")
    ys: BeamSection = Field(description="the second beam")
    pin_radius_m: float | None = Field(
        default=None, gt=0, le=0.5, description="of the tool where it crosses; else [robot] tool.radius_m"
    )
    max_plane_gap_m: float = Field(
        default=0.002, gt=0, le=0.1, description="height between the two beams where they cross"
    )
    max_slope_rad: float = Field(default=0.02, gt=0, le=0.2, description="of a beam against base x-y")
    max_U_m: float = Field(default=0.0002, gt=0, le=0.01, description="95 % uncertainty of the point")
    retract_pose: str | None = Field(default=None, description="name of a [poses] entry to end at")
    ask_for_tool: bool = Field(
        default=True, description="a person confirms that the tool in place is the good one, before it moves"
    )
    max_duration_s: float = Field(
        default=3600.0, gt=0, description="the run is ended when it takes longer, s"
    )
    accept: Policy = Field(default_factory=lambda: Policy(), description="who accepts the result")

    @model_validator(mode="after")
    def _two_beams(self) -> Self:
        if self.xs.input == self.ys.input:
            raise ValueError(f"xs and ys have the same input '{self.xs.input}'; each beam needs its own")
        ways = np.array([self.xs.across_unit[:2], self.ys.across_unit[:2]])
        if abs(float(np.linalg.det(ways))) < np.sin(MIN_CROSSING_RAD):
            raise ValueError(
                f"xs.across and ys.across run nearly along each other; the beams must cross at "
                f"{np.degrees(MIN_CROSSING_RAD):.0f} deg or more"
            )
        return self


class BentLimits(Strict):
    """Beyond these the tool counts as bent: nothing is corrected."""

    max_shift_m: float = Field(
        default=0.003, gt=0, le=0.1, description="of the tool's point; further off the tool counts as bent"
    )
    max_tilt_rad: float = Field(
        default=0.03, gt=0, le=0.5, description="of the tool's axis; turned by more the tool counts as bent"
    )


Floor = Annotated[
    float | None,
    Field(
        ge=-5.0,
        le=5.0,
        description="lowest height in base that the tool's point may reach, m; by default that of "
        "[job.laser-reference]. Where the reference was made with a higher one, that one holds",
    ),
]


class _Measured(Strict):
    """What a check and an update share. How the beams are crossed is what the reference keeps."""

    against_reference: BentLimits = Field(
        default_factory=lambda: BentLimits(), description="limits of shift and tilt since the reference"
    )
    against_last: BentLimits = Field(
        default_factory=lambda: BentLimits(max_shift_m=0.002, max_tilt_rad=0.02),
        description="limits of shift and tilt since the last measurement",
    )
    max_U_m: float = Field(default=0.0002, gt=0, le=0.01, description="95 % uncertainty of the tool's point")
    false_alarm: float = Field(
        default=FALSE_ALARM,
        gt=0,
        le=0.1,
        description="chance, at most, that a check calls a tool moved that has not moved, and that the "
        "second scan of an update turns down a right frame. With a smaller one only larger errors are found; "
        "cellward check prints their sizes",
    )
    max_latency_s: float = Field(
        default=0.02, gt=0, le=1.0, description="a latency further from the configured one is warned of"
    )
    retract_pose: str | None = Field(default=None, description="name of a [poses] entry to end at")
    floor_m: Floor = None
    max_duration_s: float = Field(
        default=3600.0, gt=0, description="the run is ended when it takes longer, s"
    )


class LaserCheckConfig(_Measured):
    """``[job.laser-check]``. How the beams are crossed is what the reference keeps."""

    tolerance_m: float | None = Field(
        default=None,
        gt=0,
        le=0.1,
        description="a tool whose point is further off the frame in effect has moved: verdict fail, run "
        "laser-update; by default 0.0001. Where the measurement is too uncertain for that, the tolerance is "
        "larger: what a tool that has not moved exceeds in false_alarm of all checks",
    )
    tolerance_rad: float | None = Field(
        default=None,
        gt=0,
        le=0.5,
        description="the same for the tool's axis; by default 0.002",
    )

    @model_validator(mode="after")
    def _moved_before_bent(self) -> Self:
        bent = self.against_last
        if self.tolerance_m is not None and self.tolerance_m > bent.max_shift_m:
            raise ValueError(
                f"tolerance_m, {self.tolerance_m:g} m, is above against_last.max_shift_m, "
                f"{bent.max_shift_m:g} m; lower the one or raise the other"
            )
        if self.tolerance_rad is not None and self.tolerance_rad > bent.max_tilt_rad:
            raise ValueError(
                f"tolerance_rad, {self.tolerance_rad:g} rad, is above against_last.max_tilt_rad, "
                f"{bent.max_tilt_rad:g} rad; lower the one or raise the other"
            )
        return self


class LaserUpdateConfig(_Measured):
    """``[job.laser-update]``. How the beams are crossed is what the reference keeps."""

    accept: Policy = Field(default_factory=lambda: Policy(), description="who accepts the result")


class StoredBeam(BeamSection):
    """One beam in a reference: the auxiliary point as the joints it had then."""

    q: SixAngles


class Search(SearchSection):
    """What a reference keeps of the search, and what every later measurement repeats."""

    device: str = Field(description="name of the input device")
    xs: StoredBeam
    ys: StoredBeam

    @classmethod
    def from_config(cls, config: LaserReferenceConfig, poses: Mapping[str, Any], device: str) -> "Search":
        """The geometry of today's config, with the joints of its auxiliary points."""
        common = {name: getattr(config, name) for name in SearchSection.model_fields}
        beams = {
            name: {**getattr(config, name).model_dump(), "q": list(poses[getattr(config, name).aux])}
            for name in BEAMS
        }
        return cls.model_validate({**common, **beams, "device": device})

    @classmethod
    def from_reference(cls, reference: Mapping[str, Any], floor_m: float | None) -> "Search":
        """The geometry that a reference was made with; ``DATA_INVALID`` when it cannot be read.

        ``floor_m`` is the floor of today's configuration, if it has one; of two floors the higher one holds.
        """
        try:
            search = cls.model_validate(reference["search"])
            higher = max(search.floor_m, search.floor_m if floor_m is None else floor_m)
            return search.model_copy(update={"floor_m": higher})
        except (KeyError, ValidationError) as exc:
            raise error("DATA_INVALID", f"the stored reference has no usable 'search': {exc}") from exc

    def beam(self, name: str) -> StoredBeam:
        return self.xs if name == "xs" else self.ys
