"""What a scenario says about a rack and its parts."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from cell.formats.reading import Strict
from fakes.world.arm.truth import Six
from fakes.world.beams.truth import Three

Two = Annotated[list[float], Field(min_length=2, max_length=2)]


class PartTruth(Strict):
    """A part: in the slot with this number, or somewhere in the base. Its front is what goes in first."""

    slot: int | None = Field(default=None, ge=1, description="it is in there, at the end of its travel")
    T_base_part: Six | None = Field(default=None, description="of the middle of its front, z out of it")

    @model_validator(mode="after")
    def _at_one_place(self) -> Self:
        if (self.slot is None) == (self.T_base_part is None):
            raise ValueError("a part is in a slot or at T_base_part: give one of the two")
        return self


class SlotMarkerTruth(Strict):
    """A printed marker beside each slot: ``id`` at slot 1, one more at each next one."""

    dictionary: str = "DICT_4X4_50"
    id: int = Field(default=0, ge=0)
    size_m: float = Field(default=0.014, gt=0.001, le=0.5)
    T_slot_marker: Six = Field(description="its middle; y to its upper side, z out of it")


class RackTruth(Strict):
    """``[world.rack]``: slots in rows and columns; the rack's z leads into them.

    Slots are counted from 1 along x in the first row. A part is ``part_m`` wide, high and long, and is taken
    by a point ``grasp_m`` behind its front.
    """

    T_base_rack: Six
    rows: int = Field(default=1, ge=1, le=100)
    columns: int = Field(default=1, ge=1, le=100)
    row_pitch_m: float = Field(default=0.05, gt=0, le=1)
    column_pitch_m: float = Field(default=0.06, gt=0, le=1)
    opening_m: Two = Field(default=[0.041, 0.021], description="width and height")
    depth_m: float = Field(default=0.06, gt=0, le=1, description="travel of a part's front to the end")
    chamfer_m: float = Field(default=0.0, ge=0, le=0.05, description="at 45 degrees around the opening")
    part_m: Three = Field(default=[0.040, 0.020, 0.1])
    grasp_m: float = Field(default=0.08, gt=0, le=1)
    parts: list[PartTruth] = Field(default=[])
    handed: Six | None = Field(
        default=None,
        description="one more part, which a person puts into the gripper: its front in the flange",
    )
    blocked: dict[str, float] = Field(
        default={}, description="by number of a slot: how deep something is in it that nobody sees, m"
    )
    marker: SlotMarkerTruth | None = Field(default=None, description="beside each slot")
    friction: float = Field(default=0.2, ge=0, lt=1)
    stiffness_n_m: float = Field(default=30000.0, gt=0, description="of arm and part along the slot")
    side_stiffness_n_m: float = Field(default=20000.0, gt=0, description="across it")
    plate_colour: Three = Field(default=[150.0, 150.0, 150.0], description="blue, green, red; of 255")
    inside_colour: Three = Field(default=[35.0, 35.0, 35.0])
    part_colour: Three = Field(default=[60.0, 150.0, 60.0])
    depth_off_m: float = Field(
        default=0.003, ge=-0.05, le=0.05, description="by which the camera's depth is wrong here"
    )

    @model_validator(mode="after")
    def _parts_are_in_slots(self) -> Self:
        numbers = [part.slot for part in self.parts if part.slot is not None]
        if len(set(numbers)) < len(numbers) or max(numbers, default=1) > self.rows * self.columns:
            raise ValueError(f"parts are in slots {numbers}: one in each of those that there are")
        return self
