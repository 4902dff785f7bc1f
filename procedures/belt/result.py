"""The results of calibrating a belt, of picking from it, and of queries about it, field by field."""

from typing import Annotated, Any, Literal

from pydantic import Field

from cell.formats.main_figure import MainFigure
from cell.formats.result import (
    Covariance,
    Empty,
    Envelope,
    Explained,
    Inputs,
    Interval,
    Metres,
    Part,
    Radians,
    Seconds,
    Unit,
)

Direction = Annotated[list[float], Field(min_length=2, max_length=3)]
ItemId = str | int
Place2 = Annotated[list[float], Field(min_length=2, max_length=2), Unit("m")]
BeltCovariance = list[list[float]]


class BeltAnswer(Part):
    """Scale and direction of a belt."""

    m_per_count: Metres = Field(description="Travel of one count.")
    dir: Direction = Field(description="Unit vector along which the belt runs, in the base (1).")
    m_per_count_95: Annotated[Interval, Unit("m")] | None = Field(description="95 % interval of the travel.")
    dir_95_rad: Radians | None = Field(
        description="Half of the 95 % interval of the direction, seen from above or in height, whichever is "
        "wider."
    )
    travel_m: Metres = Field(description="Longest way of one item.")
    sightings: int = Field(description="Sightings that were used.")
    items: int = Field(description="Items that they are of.")


class BeltUncertainty(Part):
    """Of the answer."""

    half_m_per_count: Metres | None = Field(description="Half of the 95 % interval of the travel.")
    half_dir_rad: Radians | None = Field(
        description="Half of that of the direction, the wider of the two that follow."
    )
    half_level_rad: Radians | None = Field(
        default=None,
        description="Half of that of the direction seen from above, by which picks go; `max_dir_rad` is its "
        "limit.",
    )
    half_rise_rad: Radians | None = Field(
        default=None,
        description="Half of that of how the direction rises, by which the tool is too high or too low at "
        "an item; `max_rise_rad` is its limit.",
    )
    cov: BeltCovariance | None = Field(description="3x3, of `m_per_count` times `dir` (m^2).")
    mostly_from: str | None = Field(
        description="What the scale's interval comes from mostly: `sightings`, `frames`, `items`, `picture`, "
        "`counts`, `slips`, `delay` or `lens`."
    )


class SightingResidual(Part):
    """One sighting."""

    t: Seconds = Field(description="Time of the exposure.")
    count: float = Field(description="Unwrapped count.")
    item: int = Field(description="Number of the item.")
    used: bool = Field(description="Whether the solution used it.")
    off_m: list[float] = Field(description="From the motion of its item (m).")


class BeltResiduals(Part):
    """How the sightings agree. That is no accuracy."""

    sigma_m: Metres | None = Field(description="Scatter of a sighting along one axis.")
    rejected: list[int] = Field(description="Sightings that were not used.")
    rms_m: Metres | None = Field(description="Of the sightings that were used.")
    per_sighting: list[SightingResidual] = Field(description="Every sighting.")


class BeltHeldOut(Part):
    """Sightings judged by solutions that did not see them."""

    rms_m: Metres | None = Field(description="Of their distances.")


class BeltObservability(Part):
    """What is open."""

    undetermined: list[str] = Field(description="In words.")


class BeltInputs(Inputs):
    """What was solved."""

    path: str = Field(description="The data set.")
    source: Literal["camera", "touch"] = Field(description="What located the items.")
    device: str = Field(description="Encoder.")
    sightings: int = Field(description="In the data set.")
    items: int = Field(description="In the data set.")
    counts: int = Field(description="Readings of the encoder.")


class BeltCalibrationResult(Envelope):
    """Travel of one count and direction of a belt."""

    kind: Literal["belt-calibration"] = "belt-calibration"
    result: BeltAnswer
    uncertainty: BeltUncertainty
    residuals: BeltResiduals
    heldout: BeltHeldOut
    observability: BeltObservability
    inputs: BeltInputs

    def direction_95_rad(self) -> tuple[float | None, float | None]:
        """Halves of the 95 % intervals of the direction seen from above and of how it rises; those of
        results of before these were stated are the wider of both."""
        wider, of = self.result.dir_95_rad, self.uncertainty
        level, rise = of.half_level_rad, of.half_rise_rad
        return wider if level is None else level, wider if rise is None else rise

    def main_figure(self) -> MainFigure:
        half = self.uncertainty.half_m_per_count
        return MainFigure("m_per_count", "travel of one count", self.result.m_per_count, "m", half)


class BeltFromSightings(Part):
    """The belt as sightings of items that were seen several times show it."""

    m_per_count: Metres = Field(description="Travel of one count.")
    dir: Direction = Field(description="Unit vector along which counts grow (1).")
    m_per_count_95: Annotated[Interval, Unit("m")] | None = Field(description="95 % interval of the travel.")
    dir_95_rad: Radians | None = Field(description="Half of the 95 % interval of the direction.")
    cov: BeltCovariance | None = Field(description="Of `m_per_count` times `dir` (m^2).")
    sigma_m: Metres | None = Field(description="Scatter of a sighting along one axis.")
    heldout_rms_m: Metres | None = Field(description="Of sightings held out.")
    travel_m: Metres = Field(description="Longest way of one item.")
    rejected: list[int] = Field(description="Sightings that were not used.")


class ForecastResiduals(Explained):
    """Levels that the forecasts work with."""

    counts_sigma: float | None = Field(description="Of a count (1).")
    stamp_share: float | None = Field(description="Share of an encoder's interval that stamps are late (1).")
    camera_sigma_m: Metres | None = Field(description="Of a sighting along one axis.")
    latency_sigma_s: Seconds | None = Field(description="Of exposure times.")
    along_rms_m: Metres | None = Field(description="Sightings of one item about its mean, along the belt.")
    across_rms_m: Metres | None = Field(description="The same across it.")
    belt_from_sightings: BeltFromSightings | None = Field(description="Null with too few sightings.")


class TravelCheck(Part):
    """Forecasts over one time."""

    horizon: Seconds = Field(description="That time.")
    rms_m: Metres | None = Field(description="Of the belt's travel against later counts.")
    count: int = Field(description="How many forecasts.")


class SightingCheck(Part):
    """Forecasts against later sightings of the same item."""

    rms_m: Metres | None = Field(description="Of the distances.")
    count: int = Field(description="How many sightings.")


class ForecastHeldOut(Explained):
    """Forecasts against what came after them."""

    travel: list[TravelCheck] = Field(description="Of the belt.")
    later_sightings: SightingCheck = Field(description="Of the items.")


class Slip(Part):
    """A slip of the encoder's wheel."""

    t: Seconds = Field(description="When.")
    along_m: Metres = Field(description="By how much, along the belt.")
    sigma_m: Metres = Field(description="Standard deviation of that.")


class CameraStalls(Part):
    """Times without pictures."""

    count: int = Field(description="How many.")
    longest_s: Seconds = Field(description="The longest.")


class PlaceWaitTimes(Part):
    """Times for which the arm waited, with an item, until the place was clear."""

    count: int = Field(description="How many.")
    longest_s: Seconds = Field(description="The longest.")
    total_s: Seconds = Field(description="All together.")


class GridFill(Part):
    """The places of a grid."""

    places: int = Field(description="How many there are.")
    filled: int = Field(description="Filled in this run; one at which the gripper opened counts.")
    next: int = Field(description="The next one when the run ended, from 1; 0: all were filled.")
    renewed: int = Field(description="How often somebody confirmed that all are empty again.")


class PickingAnswer(Part):
    """What a run of picking came to."""

    picks: int = Field(description="Items that were picked.")
    misses: dict[str, int] = Field(description="Items that were not, by cause.")
    seen: int = Field(description="Items that were seen.")
    success: float | None = Field(description="Share of those tried that were picked (1).")
    duration_s: Seconds = Field(description="Time of picking.")
    picks_per_minute: float | None = Field(description="Rate (1/min).")
    counters: dict[str, int] = Field(description="As the registers show them.")
    slips: list[Slip] = Field(description="Of the encoder's wheel.")
    jumps_m: Annotated[list[float], Unit("m")] = Field(description="Of the encoder's position.")
    camera_stalls: CameraStalls = Field(description="Times without pictures.")
    place_waits: PlaceWaitTimes | None = Field(
        default=None, description="Waits for a clear place; null in results of before these were counted."
    )
    grid: GridFill | None = Field(default=None, description="The grid of places; null without one.")
    arm_lag_s: Seconds | None = Field(
        default=None,
        description="How late the arm was on its set-points, made up for; null before the first grip.",
    )
    following_rms_m: Metres | None = Field(
        default=None, description="Tool beside its set-points during grips."
    )
    following_largest_m: Metres | None = Field(default=None, description="The largest of those.")
    contact_off_rms_m: Metres | None = Field(
        default=None,
        description="Item beside the tool's set-point at contact, level, as later counts and pictures show: "
        "mostly what the belt did meanwhile, without constant errors of camera, calibration and arm; "
        "null before the first.",
    )
    contact_off_largest_m: Metres | None = Field(default=None, description="The largest of those.")
    camera_delay_95_s: Seconds | None = Field(
        default=None,
        description="Half of the 95 % interval of the camera's delay: times the belt's speed, so far may all "
        "contacts be off along it; null where it was not measured.",
    )
    camera_95_m: Metres | None = Field(
        default=None,
        description="Half of the 95 % interval of where items lie by the camera's pose and lens, in the "
        "direction that is known worst: so far may all contacts be off; null where they are not known.",
    )
    contact_95_m: Metres | None = Field(
        default=None,
        description="So far off, level, are 95 of 100 contacts by all that is known to leave them open: "
        "sightings, motion of the belt, calibrations of belt and camera, delays, and how the arm follows; "
        "`contact_95_without` has what is not in it. Null before the first, by the classic method, and in "
        "results of before this was stated.",
    )
    contact_95_largest_m: Metres | None = Field(
        default=None, description="The same figure of the contact for which it is largest."
    )
    contact_95_shares: dict[str, float] | None = Field(
        default=None, description="Share of each source in the mean square of that figure (1)."
    )
    contact_95_assumed: list[str] | None = Field(
        default=None,
        description="In words, what that figure has by an assumption, as it was not measured: the delays of "
        "stamps, scale and direction of the belt. Null in results of before these were assumed.",
    )
    contact_95_without: list[str] | None = Field(
        default=None, description="In words, what may put a contact off and is not in that figure."
    )
    gripper_closing_s: Seconds | None = Field(
        default=None,
        description="From the command to the confirmation, the longest of the last; null before.",
    )
    gripper_opening_s: Seconds | None = Field(default=None, description="The same of opening.")
    follow: bool = Field(description="Whether the tool moved with the item while it gripped.")
    method: str = Field(description="How contacts were predicted.")


class PickingInputs(Inputs):
    """What it was picked with."""

    belt: dict[str, Any] | None = Field(description="The calibration of the belt.")
    versions: dict[str, int] = Field(description="Of the calibrations in use.")


class BeltTrackingResult(Envelope):
    """A run of picking from a belt."""

    kind: Literal["belt-tracking"] = "belt-tracking"
    result: PickingAnswer
    uncertainty: Empty = Field(description="Empty.")
    residuals: ForecastResiduals | Empty = Field(description="Empty when nothing could be checked.")
    heldout: ForecastHeldOut | Empty = Field(description="Empty when nothing could be checked.")
    observability: Empty = Field(description="Empty.")
    inputs: PickingInputs

    def main_figure(self) -> MainFigure:
        return MainFigure("picks", "items picked", self.result.picks, "")


class QueryAnswer(Part):
    """The answer to one query."""

    id: ItemId = Field(description="Of the item.")
    t: Seconds = Field(description="Time of the query.")
    pred: list[list[float | None]] = Field(description="x, y in the base at each horizon (m); null unknown.")
    t_pick: Seconds | None = Field(description="Time of contact; null out of reach.")
    p_pick: Place2 | None = Field(description="x, y of the contact in the base.")

    @property
    def known(self) -> bool:
        """Whether anything could be predicted."""
        return self.pred[:1] != [[None, None]]


class InterceptAnswer(Part):
    """Where items will be, and where the arm can meet them."""

    answers: list[QueryAnswer] = Field(description="Every query, in the order of the file.")
    method: str = Field(description="Solver.")


class QueryUncertainty(Part):
    """Of the answer to one query."""

    id: ItemId = Field(description="Of the item.")
    t: Seconds = Field(description="Time of the query.")
    cov: list[Covariance] | None = Field(description="2x2 of x, y at each horizon (m^2).")
    cov_pick: Covariance | None = Field(description="2x2 of the contact (m^2).")
    motion: str | None = Field(description="How the belt was taken to move.")


class InterceptUncertainty(Explained):
    """Of the answers."""

    answers: list[QueryUncertainty] = Field(description="Every query, in the order of the file.")
    camera_95_m: Metres | None = Field(
        default=None,
        description="What of it the camera's pose and lens leave open, for all items alike: half of a 95 % "
        "interval, in the direction that is known worst; null where they are not known.",
    )


class InterceptObservability(Part):
    """What is open."""

    unobservable: list[str] = Field(description="In words.")


class InterceptInputs(Inputs):
    """What was solved."""

    method: str = Field(description="Solver.")
    counts: int = Field(description="Readings of the encoder.")
    detections: int = Field(description="In the data set.")
    queries: int = Field(description="In the data set.")
    m_per_count: Metres = Field(description="Travel of one count.")
    dir: Direction = Field(description="Unit vector along the belt (1).")
    modulus: int | None = Field(description="Of the counter.")
    period_s: Seconds | None = Field(description="Interval of the encoder.")
    latency_mean_s: Seconds | None = Field(description="Of detections without an exposure.")
    limits: dict[str, float] = Field(description="Of the arm: `v` (m/s), `a` (m/s^2), `j` (m/s^3).")
    t2_s: Seconds = Field(description="Of the final descent.")
    dwell_s: Seconds = Field(description="At the item.")


class InterceptResult(Envelope):
    """Answers to queries about items on a belt."""

    kind: Literal["intercept"] = "intercept"
    result: InterceptAnswer
    uncertainty: InterceptUncertainty
    residuals: ForecastResiduals
    heldout: ForecastHeldOut
    observability: InterceptObservability
    inputs: InterceptInputs
