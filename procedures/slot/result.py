"""The result of an insertion, field by field."""

from typing import Annotated, Any, Literal

from pydantic import Field

from cell.formats.main_figure import MainFigure
from cell.formats.result import (
    Covariance,
    Envelope,
    Explained,
    Figures,
    Inputs,
    Metres,
    Part,
    Pixels,
    Pose,
    Turn,
    Unit,
    Vector,
)

Newtons = Annotated[float, Unit("N")]


class BudgetRow(Part):
    """What one cause alone would give."""

    source: str = Field(description="The cause.")
    error95_m: Metres = Field(description="95 % of insertions would be less than this beside the middle.")


class SlotBudget(Part):
    """How far beside the middle of the slot the part's front will be, predicted before it goes in."""

    predicted_95_m: Metres = Field(description="95 % of insertions stay below this, wherever in the slot.")
    at_mouth_m: Metres = Field(description="The same at the opening.")
    at_end_m: Metres = Field(description="The same at the end of the travel.")
    clearance_m: Metres = Field(description="What it may be before the part touches.")
    by_source: list[BudgetRow] = Field(description="By cause, at the worse of the two, largest first.")


class Correction(Part):
    """The slot against where the rack's model has it: the fine correction that was applied."""

    t: Vector = Field(description="Shift in the slot's frame.")
    r: Turn = Field(description="Rotation vector in the slot's frame.")


class SlotAnswer(Part):
    """Where the slot was, and what became of the part."""

    action: Literal["insert", "pull", "replace"] = Field(description="What was asked for.")
    slot: int = Field(description="Number of the slot, from 1.")
    row: int = Field(description="Its row, from 1.")
    column: int = Field(description="Its column, from 1.")
    part: Literal["none", "gripped", "inserted", "jammed", "released", "lost"] = Field(
        description="State of the part at the end."
    )
    states: list[str] = Field(description="All states of the part, in order.")
    T_base_slot: Pose = Field(description="The middle of the opening, z into the slot, as it was measured.")
    correction: Correction = Field(description="Against the rack's model.")
    budget: SlotBudget | None = Field(default=None, description="Of an insertion.")
    travel_m: Metres | None = Field(default=None, description="Of the part's front in the slot.")
    force_n: Newtons | None = Field(default=None, description="That ended the guarded move.")


class SlotUncertainty(Explained):
    """Of the look."""

    cov: Covariance = Field(description="Of the slot in the camera, perturbation on the right.")


class SlotResiduals(Explained):
    """How well the edges agree with the known size."""

    edge_px: Pixels = Field(
        description="RMS distance of edge points from the rim of the opening or of the marker."
    )
    contrast: list[float] = Field(description="Of the four sides, grey levels.")
    moved_px: Pixels = Field(description="Distance from where the coarse look had it.")


class SlotObservability(Part):
    """What the look does not tell."""

    undetermined: list[str] = Field(description="In words.")


class SlotInputs(Inputs):
    """What was solved."""

    path: str = Field(description="The data set.")
    pictures: int = Field(description="Of the measuring look.")
    arm_rms_m: Metres | None = Field(
        description="RMS error of the arm by the model in use, as its calibration or the hand-eye's has it."
    )
    arm_expected_m: Metres = Field(description="Error of the arm that the budget goes by, RMS.")


class SlotResult(Envelope):
    """Of an insertion or a pull."""

    kind: Literal["slot"] = "slot"
    result: SlotAnswer
    uncertainty: SlotUncertainty
    residuals: SlotResiduals
    heldout: dict[str, Any] = Field(default_factory=dict, description="Empty: one look is all there is.")
    observability: SlotObservability
    inputs: SlotInputs

    def figures(self) -> Figures:
        budget = self.result.budget
        return Figures(predicted_95_m=0.0 if budget is None else budget.predicted_95_m)

    def main_figure(self) -> MainFigure | None:
        budget = self.result.budget
        if budget is None:
            return None
        return MainFigure("beside_95_m", "95 % beside the middle of the slot", budget.predicted_95_m, "m")
