"""The result of a touch test, field by field."""

from typing import Literal

from pydantic import Field

from cell.formats.main_figure import MainFigure
from cell.formats.result import (
    Covariance,
    Empty,
    Envelope,
    Explained,
    Inputs,
    Metres,
    Part,
    Pose,
    Radians,
    Turn,
    Vector,
)


class CornerOff(Part):
    """One corner."""

    corner: int = Field(description="Number of the target's point.")
    off: Vector = Field(
        description="In the target's frame: where camera, arm and tool have the tool's point, less where it "
        "stood."
    )
    off_m: Metres = Field(description="Its length.")


class TouchAnswer(Part):
    """By how much tool, camera and arm together are off at the board."""

    T_base_target: Pose = Field(description="The board as the camera had it.")
    shift: Vector = Field(description="Of all corners together, in the target's frame, at their middle.")
    shift_m: Metres = Field(description="Its length.")
    turn: Turn = Field(description="Rotation vector of all corners together, in the target's frame.")
    turn_rad: Radians = Field(description="Its angle.")
    chance: float = Field(
        description="How often a cell in which nothing is off shows as much as that, by what is known of it "
        "(1)."
    )
    corners: list[CornerOff] = Field(description="Each corner.")


class CauseOff(Part):
    """What one cause leaves open."""

    source: str = Field(description="The cause.")
    sigma_m: Metres = Field(description="Standard deviation that it gives the shift along an axis.")


class TouchUncertainty(Explained):
    """Of shift and turn."""

    cov: Covariance = Field(description="Of shift (m) and turn (rad).")
    shift_95_m: Metres = Field(description="95 % of the errors of the shift are shorter than this.")
    turn_95_rad: Radians = Field(description="95 % of the errors of the turn are smaller than this.")
    by_source: list[CauseOff] = Field(description="By cause, largest first.")


class TouchResiduals(Explained):
    """What a common shift and turn leave at the corners."""

    rms_m: Metres = Field(description="RMS along an axis, by the degrees of freedom.")
    expected_m: Metres = Field(description="What is expected by how well the point is brought to a corner.")


class TouchObservability(Part):
    """What the test does not tell."""

    undetermined: list[str] = Field(description="In words.")


class TouchInputs(Inputs):
    """What was measured."""

    path: str = Field(description="The data set.")
    corners: int = Field(description="Corners that count.")
    skipped: list[int] = Field(description="Corners that were left out.")
    arm_rms_m: Metres | None = Field(
        description="RMS error of the arm by the model in use, as its calibration or the hand-eye's has it."
    )


class TouchResult(Envelope):
    """The tool's point over corners of a board that the camera has located."""

    kind: Literal["touch-test"] = "touch-test"
    result: TouchAnswer
    uncertainty: TouchUncertainty
    residuals: TouchResiduals
    heldout: Empty = Field(default_factory=Empty, description="Empty: every corner is in the answer.")
    observability: TouchObservability
    inputs: TouchInputs

    def main_figure(self) -> MainFigure:
        name = "tool's point off at the board"
        return MainFigure("shift_m", name, self.result.shift_m, "m", self.uncertainty.shift_95_m)
