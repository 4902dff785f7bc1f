"""The result of a cross check, field by field."""

from typing import Literal

from pydantic import Field

from cell.formats.result import Envelope, Inputs, Metres, Part, Pixels, Radians


class CrossCheckAnswer(Part):
    """Which part of the cell has changed."""

    part: Literal["none", "tool", "camera", "joint zero", "cannot-tell"] = Field(
        description="`none`: nothing has; `cannot-tell`: no part alone explains what is seen well enough."
    )
    joint: str | None = Field(default=None, description="Whose zero it is, where it is one.")
    t: Metres | None = Field(default=None, description="By how much it moved, of a tool or a camera.")
    t_sigma: Metres | None = Field(default=None, description="Standard deviation of that, along each axis.")
    r: Radians | None = Field(default=None, description="By how much it turned, of a camera or a joint.")
    r_sigma: Radians | None = Field(default=None, description="Standard deviation of that, about each axis.")
    probable: dict[str, float] = Field(
        description="How probable each explanation is: none, tool, camera, joint, several (1)."
    )


class CrossCheckUncertainty(Part):
    """What the probabilities rest on."""

    meaning: str = Field(description="In words.")


class CrossCheckResiduals(Part):
    """How well the captures fit the adjustment."""

    then_px: Pixels | None = Field(description="Noise of a corner of the first capture.")
    now_px: Pixels | None = Field(description="Of the second one.")


class CrossCheckHeldOut(Part):
    """What was set aside."""

    meaning: str = Field(description="In words.")


class CrossCheckObservability(Part):
    """What is open."""

    undetermined: list[str] = Field(description="In words.")


class CrossCheckInputs(Inputs):
    """What was judged."""

    then: str = Field(description="The capture of when all was well.")
    now: str = Field(description="The capture of now.")
    beams: str | None = Field(default=None, description="The run that measured the tool in the beams.")
    tracker: str | None = Field(default=None, description="The run in which a tracker saw the arm.")
    touch: str | None = Field(
        default=None, description="The run in which the tool's point stood over a board."
    )
    setup: str = Field(description="Where the camera is.")


class CrossCheckResult(Envelope):
    """What in the cell has changed since a capture."""

    kind: Literal["cross-check"] = "cross-check"
    result: CrossCheckAnswer
    uncertainty: CrossCheckUncertainty
    residuals: CrossCheckResiduals
    heldout: CrossCheckHeldOut
    observability: CrossCheckObservability
    inputs: CrossCheckInputs
