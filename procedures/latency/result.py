"""The result of a latency calibration, field by field."""

from typing import Annotated, Literal

from pydantic import Field

from cell.formats.main_figure import MainFigure
from cell.formats.result import Envelope, Inputs, Interval, Metres, Part, Seconds, Unit


class LatencyAnswer(Part):
    """How late a source is."""

    source: str = Field(description="Device.")
    time_offset_s: Seconds = Field(description="What is to be subtracted from its own stamps, in all.")
    interval95_s: Annotated[Interval, Unit("s")] = Field(description="95 % interval of that.")
    tau: Seconds = Field(description="Delay that is left in the data.")
    applied_s: Seconds = Field(description="What the driver has subtracted already.")
    hysteresis_m: Metres | None = Field(
        description="Shift of the edges, or of the arm's play, along the way; null with one speed or a belt."
    )


class LatencyUncertainty(Part):
    """Of the answer."""

    sigma_s: Seconds = Field(description="Standard deviation of the delay.")
    sigma_hysteresis_m: Metres | None = Field(description="Of the hysteresis.")
    camera_sigma_s: Seconds | None = Field(
        default=None, description="Part of sigma_s that the camera brings by which a belt was seen."
    )
    look_s: Seconds | None = Field(
        default=None,
        description="The most that all edges of a beam may be off alike, by where between a request and its "
        "reply the module looks. The interval has it in full, sigma_s as scatter only.",
    )


class LatencyResiduals(Part):
    """How the readings agree: edges in a beam, pictures of a target, or sightings of items."""

    rms_m: Metres = Field(description="Of the readings, along the way.")
    over_bracket: float | None = Field(
        description="The same in units of what polling leaves open (1); null without polls."
    )
    edges: int = Field(description="How many readings there are.")


class LatencyHeldOut(Part):
    """Readings judged by solutions that did not see them."""

    rms_m: Metres | None = Field(description="Of the readings.")


class LatencyObservability(Part):
    """What is open."""

    undetermined: list[str] = Field(description="In words.")


class LatencyInputs(Inputs):
    """What was solved."""

    path: str = Field(description="The data set.")
    passes: int = Field(description="Ways in it; 0 for a belt.")
    camera_version: int | None = Field(
        default=None,
        description="Version of the camera's delay by which a belt was seen; null where none was in effect.",
    )
    camera_calibration: str | None = Field(
        default=None,
        description="Name in the ledger of which camera_version is one, time_offset_s.DEVICE; without it, in "
        "results of before, nobody knows whose delay that was.",
    )
    source: str = Field(description="Device.")


class LatencyResult(Envelope):
    """How late the stamps of a source are."""

    kind: Literal["latency"] = "latency"
    result: LatencyAnswer
    uncertainty: LatencyUncertainty
    residuals: LatencyResiduals
    heldout: LatencyHeldOut
    observability: LatencyObservability
    inputs: LatencyInputs

    def main_figure(self) -> MainFigure:
        low, high = self.result.interval95_s
        found, half = self.result.time_offset_s, (high - low) / 2
        return MainFigure("time_offset_s", "delay of the stamps", found, "s", half)
