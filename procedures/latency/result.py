"""The result of a latency calibration, field by field."""

from typing import Annotated, Literal

from pydantic import Field

from cell.formats.result import Envelope, Inputs, Interval, Metres, Part, Seconds, Unit


class LatencyAnswer(Part):
    """How late a source is."""

    source: str = Field(description="Device.")
    time_offset_s: Seconds = Field(description="What is to be subtracted from its own stamps, in all.")
    interval95_s: Annotated[Interval, Unit("s")] = Field(description="95 % interval of that.")
    tau: Seconds = Field(description="Delay that is left in the data.")
    applied_s: Seconds = Field(description="What the driver has subtracted already.")
    hysteresis_m: Metres | None = Field(description="Shift of the edges along the way; null with one speed.")


class LatencyUncertainty(Part):
    """Of the answer."""

    sigma_s: Seconds = Field(description="Standard deviation of the delay.")
    sigma_hysteresis_m: Metres | None = Field(description="Of the hysteresis.")


class LatencyResiduals(Part):
    """How the edges agree."""

    rms_m: Metres = Field(description="Of the edges.")
    over_bracket: float = Field(description="The same in units of what polling leaves open (1).")
    edges: int = Field(description="How many there are.")


class LatencyHeldOut(Part):
    """Edges judged by solutions that did not see them."""

    rms_m: Metres | None = Field(description="Of the edges.")


class LatencyObservability(Part):
    """What is open."""

    undetermined: list[str] = Field(description="In words.")


class LatencyInputs(Inputs):
    """What was solved."""

    path: str = Field(description="The data set.")
    passes: int = Field(description="Passes in it.")
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
