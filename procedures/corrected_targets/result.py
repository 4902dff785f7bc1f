"""The result of handing targets to an observed arm, field by field."""

from typing import Annotated, Literal

from pydantic import Field

from cell.formats.main_figure import MainFigure
from cell.formats.result import Empty, Envelope, Explained, Inputs, Metres, Part, Pose, Radians, Unit, Vector

Command = Annotated[list[float], Field(min_length=4, max_length=6), Unit("m, rad")]
JointsRead = Annotated[list[float], Unit("rad")]


class Reached(Part):
    """One rest at a target."""

    q: JointsRead = Field(description="Joints at which the arm rested.")
    off_rad: Radians = Field(description="Largest joint's distance from what was asked for.")
    error_m: Metres = Field(
        description="How far off the target: by the tracker, or without one by the joints and the calibrated "
        "arm."
    )
    error: Vector = Field(description="As a vector in the base: where it was less where it should be.")
    error_95_m: Metres | None = Field(
        description="95 % of the errors of `error` stay below this; null where nothing states it."
    )
    by_joints_m: Metres = Field(description="How far off it is by the joints and the calibrated arm alone.")


class TargetResult(Part):
    """One target, as given and corrected."""

    number: int = Field(description="From 1, in the order of the configuration.")
    T_base_flange: Pose = Field(description="The flange as wanted.")
    command: Command = Field(
        description="What to command the controller instead: x, y, z, yaw of a palletizer, else a pose."
    )
    q: JointsRead = Field(description="The joints of that command.")
    before: Reached | None = Field(description="As given; null where it was not asked for or not measured.")
    after: Reached | None = Field(description="Corrected; null where it was not measured.")


class Together(Part):
    """All targets that were measured in one way."""

    targets: int = Field(description="How many were measured.")
    rms_m: Metres = Field(description="RMS of what was off.")
    max_m: Metres = Field(description="Largest that was off.")


class TargetsAnswer(Part):
    """What remained off at each target, before and after the correction."""

    targets: list[TargetResult] = Field(description="Every target.")
    before: Together | None = Field(description="As given; null where none was measured.")
    after: Together = Field(description="Corrected.")
    seen_by: Literal["tracker", "joints"] = Field(description="What says where the arm went.")
    reflector: str | None = Field(description="The reflector that the tracker looked at.")
    arm: str = Field(description="Name of the observed arm.")
    kinematics_version: int | None = Field(description="Version of its kinematics.")


class TargetsUncertainty(Explained):
    """Of what remained off."""

    error_95_m: Metres | None = Field(description="The largest of all targets; null where nothing states it.")
    predicted_95_m: Metres | None = Field(description="95 % of the calibration's own prediction errors.")


class TargetsObservability(Part):
    """What is open."""

    undetermined: list[str] = Field(description="What was not measured, in words.")


class TargetsInputs(Inputs):
    """What was measured."""

    targets: int = Field(description="Targets of the configuration.")
    arrivals: int = Field(description="Arrivals in the data set.")


class TargetsResult(Envelope):
    """Targets that were handed to an arm one by one, as given and corrected."""

    kind: Literal["corrected-targets"] = "corrected-targets"
    result: TargetsAnswer
    uncertainty: TargetsUncertainty
    residuals: Empty = Field(default_factory=Empty, description="Empty.")
    heldout: Empty = Field(default_factory=Empty, description="Empty: nothing is solved from the arrivals.")
    observability: TargetsObservability
    inputs: TargetsInputs

    def main_figure(self) -> MainFigure:
        worst = max((t.after for t in self.result.targets if t.after), key=lambda found: found.error_m)
        name = "off at the worst target, corrected"
        return MainFigure("after_max_m", name, worst.error_m, "m", worst.error_95_m)
