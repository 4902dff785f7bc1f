"""What a scenario says about the items on a belt, and about the gripper that takes them."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from cell.formats.reading import Strict

Three = Annotated[list[float], Field(min_length=3, max_length=3)]
Delay = Annotated[float, Field(ge=0, le=1)]


class ItemsTruth(Strict):
    """``[world.items]``: boxes that come down the belt one after the other, for ever or ``count`` of them.

    An item is placed by the belt's own travel, so a belt that stops brings none.
    """

    size_m: Three = Field(default=[0.06, 0.04, 0.03], description="length, width, height")
    height_m: tuple[float, float] | None = Field(
        default=None, description="heights drawn between two, item by item, instead of size_m's"
    )
    colour: Three = Field(default=[40.0, 120.0, 230.0], description="blue, green, red; of 255")
    spacing_m: float = Field(default=0.25, gt=0, le=10, description="between middles, along the belt")
    jitter_m: float = Field(default=0.0, ge=0, le=5, description="of the spacing, at most, either way")
    lateral_m: float = Field(default=0.0, ge=0, le=1, description="off the belt's middle at most")
    yaw_rad: float = Field(default=0.0, ge=0, le=1.6, description="turned at most, either way")
    first_m: float = Field(default=0.3, ge=-10, le=10, description="of the first, upstream of the origin")
    count: int = Field(default=0, ge=0, description="0: without end")
    gone_m: float = Field(default=1.5, gt=0, le=50, description="downstream of the origin it falls off")

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.height_m is not None and not 0.0 < self.height_m[0] <= self.height_m[1] <= 1.0:
            low, high = self.height_m
            raise ValueError(f"height_m = [{low:g}, {high:g}] should be two numbers in order, 1 m at most")
        return self


class PlaceTruth(Strict):
    """``[world.place]``: an input that is on while nothing lies where the gripper puts items down."""

    input: str = Field(default="clear", min_length=1, description="its name")
    carried_off_s: float = Field(
        default=1.0, ge=0, le=1e6, description="so long after it was put down an item is carried off"
    )
    beam: Three | None = Field(
        default=None,
        description="x, y, z in the base, m, of a light barrier: the tool's point breaks it, too, below z "
        "and within 0.02 m of x, y; absent: only what lies there is seen",
    )
    scan_s: Delay = Field(default=0.0, description="its module looks once in this time; 0: always")
    filter_s: Delay = Field(default=0.0, description="a level counts once it has lasted so long")


class GripperTruth(Strict):
    """``[world.gripper]``: two fingers, or a cup, on the arm, moved by one or two of its digital outputs.

    It takes an item only when, at the moment its fingers have closed, the tool's point is close enough to
    the middle of the item's upper face and hardly moves against it.
    """

    output: int = Field(default=0, ge=0, le=17, description="of the arm: on closes")
    open_output: int | None = Field(
        default=None,
        ge=0,
        le=17,
        description="of a valve that stays: on opens, or blows off; while both are off, or on, nothing moves",
    )
    confirm: int | None = Field(
        default=None,
        ge=0,
        le=17,
        description="input of the arm, on while something is held; absent: none",
    )
    close_s: float = Field(default=0.04, ge=0, le=5)
    open_s: float = Field(default=0.04, ge=0, le=5)
    within_m: float = Field(default=0.003, gt=0, le=0.1)
    below_m_s: float = Field(default=0.02, gt=0, le=1)
