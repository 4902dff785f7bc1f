"""What an integrator can set for picking from a belt."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from cell.formats.capture import CameraSigma
from cell.formats.joint_limits import JointSpeeds
from cell.formats.reading import Strict

MOST_PLACES = 400
Length = Annotated[float, Field(gt=0, le=2.0)]


class ItemLook(Strict):
    """What an item is for the camera: heights above the belt, and its longer side.

    What is higher or longer is no item, and nobody goes round it.
    """

    min_height_m: Length = Field(default=0.005, description="lower things above the belt are no items")
    max_height_m: Length = Field(default=0.05, description="higher things above the belt are no items")
    min_size_m: Length = Field(default=0.01, description="smaller things are no items")
    max_size_m: Length = Field(default=0.3, description="larger things are no items")
    height_m: Length | None = Field(
        default=None,
        description="known height of all items above the belt: a camera without depth needs it, and finds "
        "them by their colour; one with depth measures it",
    )
    height_sigma_m: float = Field(
        default=0.0005, ge=0, le=0.1, description="standard deviation of height_m from item to item"
    )

    camera_sigma: CameraSigma | None = Field(
        default=None,
        description="how well the intrinsics are known that the camera tells, where the calibration of its "
        "pose has no lens of its own; else as a maker's own calibration",
    )

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.min_height_m >= self.max_height_m or self.min_size_m >= self.max_size_m:
            raise ValueError("min_height_m and min_size_m must be smaller than max_height_m and max_size_m")
        if self.height_m is not None and not self.min_height_m <= self.height_m <= self.max_height_m:
            raise ValueError(
                f"height_m = {self.height_m:g} should be between min_height_m = {self.min_height_m:g} and "
                f"max_height_m = {self.max_height_m:g}"
            )
        return self


class Zone(Strict):
    """Where the arm may touch items: between two places along the belt, dot(p, dir) in the base."""

    min_m: float = Field(ge=-20, le=20, description="where it begins, along the belt's direction in the base")
    max_m: float = Field(ge=-20, le=20, description="where it ends")

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        if self.min_m >= self.max_m:
            raise ValueError("min_m must be smaller than max_m")
        return self


Along = Literal["x", "-x", "y", "-y"]


class PlaceGrid(Strict):
    """A level grid of places, filled column by column, row by row and layer by layer from below; place_pose
    is the first of them.

    Directions are those of the tool's axes at place_pose, where the tool points down.
    """

    rows: int = Field(ge=1, le=50, description="how many rows")
    columns: int = Field(ge=1, le=50, description="places in a row")
    column_pitch_m: Length = Field(description="from one column to the next")
    row_pitch_m: Length = Field(description="from one row to the next")
    layers: int = Field(default=1, ge=1, le=50, description="grids on each other, the lowest filled first")
    layer_m: Length | None = Field(
        default=None,
        description="from one layer to the next above it: of an item, and of what lies between two layers",
    )
    columns_along: Along = Field(default="x", description="axis of the tool along which columns follow")
    rows_along: Along = Field(default="y", description="axis of the tool along which rows follow")
    ask_empty: bool = Field(
        default=True, description="ask before a run whether the places from first_place on are empty"
    )
    when_full: Literal["end", "hold"] = Field(
        default="end",
        description="end the job when the last place is filled, or hold it at rest until somebody confirms "
        "that all places are empty again",
    )

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if self.columns_along[-1] == self.rows_along[-1]:
            raise ValueError(
                f"columns_along = '{self.columns_along}' and rows_along = '{self.rows_along}' are one line; "
                "give x for one and y for the other"
            )
        if self.places > MOST_PLACES:
            raise ValueError(
                f"{self.places} places are more than {MOST_PLACES}; make rows, columns or layers fewer"
            )
        if (self.layers > 1) != (self.layer_m is not None):
            raise ValueError(
                f"layers = {self.layers} and layer_m belong together: give both, with 2 layers or more"
            )
        return self

    @property
    def places(self) -> int:
        """How many there are, in all layers."""
        return self.rows * self.columns * self.layers

    @property
    def top_m(self) -> float:
        """The uppermost layer above the lowest, m."""
        return 0.0 if self.layer_m is None else (self.layers - 1) * self.layer_m


class JobLimits(Strict):
    """Of the motion in this job. Above [limits] only where allow_job_override permits it."""

    speed_m_s: float = Field(default=1.0, gt=0, le=5, description="highest speed of the tool")
    accel_m_s2: float = Field(default=6.0, gt=0, le=50, description="highest acceleration of the tool")
    jerk_m_s3: float = Field(default=80.0, gt=0, le=2000, description="highest jerk of the tool")
    joint_speed_rad_s: JointSpeeds = Field(
        default=2.0, description="highest speed of each joint: one number, or six from the base to the flange"
    )


class BeltTrackingConfig(Strict):
    """``[job.belt-tracking]``."""

    wait_pose: str = Field(description="of [poses]: the tool points down, above the belt")
    place_pose: str = Field(description="of [poses]: the tool's point is where an item is put down")
    place_clear: str | None = Field(
        default=None,
        min_length=1,
        description="input of [robot] place_inputs that is on while the place is clear; an item is put down "
        "only then, and no reading is as off. Without it the place is always clear",
    )
    place_look_above_m: float | None = Field(
        default=None,
        ge=0,
        le=2.0,
        description="place_clear is looked at until the tool is lower than this above the place, where the "
        "sensor may see tool and item, and the last look counts; 0: to the end, for one that never sees "
        "them. Without it items.max_height_m, below which the sensor has to look to see what lies there",
    )
    zone: Zone = Field(description="where along the belt items may be touched")
    place_grid: PlaceGrid | None = Field(
        default=None, description="places from place_pose on, filled one after the other; without it one"
    )
    first_place: int = Field(
        default=1,
        ge=1,
        le=MOST_PLACES,
        description="of place_grid: a run begins here, counted from 1; those before are filled already",
    )
    belt_z_m: float = Field(ge=-5, le=5, description="height of the belt's surface in the base")
    items: ItemLook = Field(default_factory=ItemLook, description="how items look from the camera")
    above_m: Length = Field(
        default=0.05, description="height of the level ways above an item's upper face and above the place"
    )
    straight_m: Length | None = Field(
        default=None,
        description="of above_m, next to an item's face and the place, that is straight, to 3 mm at its "
        "upper end; without it 0.02 m at most, and classic begins and ends each of its moves at rest",
    )
    grip_m: float = Field(
        default=0.0,
        ge=-0.1,
        le=0.1,
        description="height of the tool's point above an item's upper face at the grip",
    )
    dwell_s: float = Field(default=0.05, ge=0, le=5, description="least time in contact")
    grip_timeout_s: float = Field(
        default=1.0,
        gt=0,
        le=5,
        description="longest wait for the gripper to close or to open; grippers take 0.2 to 0.6 s",
    )
    grip_tries: int = Field(
        default=2,
        ge=1,
        le=10,
        description="closings on an item that is followed; it may slide under the first",
    )
    failed_grips: int = Field(
        default=5, ge=0, le=100, description="so many in a row are an alarm, GRIPS_FAILED; 0: never"
    )
    on_failed_grips: Literal["end", "hold"] = Field(
        default="end", description="end the job at that alarm, or hold it at rest until somebody confirms"
    )
    following_limit_m: float = Field(
        default=0.003,
        gt=0,
        le=0.1,
        description="the tool may be so far from its set-points during a grip: farther for a moment gives a "
        "warning, for some 0.2 s ends the job. An item farther from them at contact gives a warning",
    )
    align: bool = Field(default=True, description="turn the tool to the item")
    follow: bool = Field(default=True, description="move with the item during the grip")
    choice: Literal["leaving first", "soonest"] = Field(
        default="leaving first",
        description="of several items in reach: who leaves the zone first, or is met first",
    )
    method: Literal["ml", "classic"] = Field(
        default="ml",
        description="how a contact is chosen: ml, the earliest in the zone, aimed anew; classic, once",
    )
    T1_s: float = Field(default=0.4, gt=0, le=5, description="classic: fixed time of the way above the item")
    picks: int = Field(default=0, ge=0, le=65535, description="end after so many; 0: until finished")
    min_sightings: int = Field(
        default=2, ge=1, le=50, description="what is seen less often is not taken for an item"
    )
    spacing_m: Length = Field(
        default=0.03, description="closer on the belt is the same item, unless one picture shows both"
    )
    queue_limit: int = Field(
        default=500, ge=1, le=10000, description="so many items on their way; more are let pass and counted"
    )
    camera_stall_s: float = Field(
        default=0.5, gt=0, le=10, description="without a picture for so long, and the result warns"
    )
    standing_m_s: float = Field(default=0.005, gt=0, le=0.5, description="a slower belt stands")
    standing_s: float = Field(
        default=1.0, gt=0, le=60, description="a belt that stands for so long suspends the job"
    )
    limits: JobLimits = Field(default_factory=JobLimits, description="of this job's motion")
    max_duration_s: float = Field(
        default=86400.0, gt=0, description="the run is ended when it takes longer, s"
    )

    @model_validator(mode="after")
    def _makes_sense(self) -> Self:
        if self.grip_m >= self.above_m:
            raise ValueError("grip_m must be smaller than above_m")
        shortest = min(self.above_m, self.down_m)
        if self.straight_m is not None and self.straight_m > shortest:
            raise ValueError(
                f"straight_m = {self.straight_m:g} m is longer than the way down, {shortest:g} m "
                "(above_m, less a grip_m above 0); lower straight_m, or raise above_m"
            )
        if self.place_look_above_m is not None and self.place_look_above_m > self.above_m:
            raise ValueError(
                f"place_look_above_m = {self.place_look_above_m:g} is above above_m = {self.above_m:g} m, "
                "where the tool waits for a clear place; lower it, or raise above_m"
            )
        grid, first = self.place_grid, self.first_place
        if grid is None and first > 1:
            raise ValueError(f"first_place = {first}, but there is no place_grid; give one, or leave it out")
        if grid is not None and first > (places := grid.places):
            raise ValueError(f"first_place = {first} is beyond the last of {places} places of place_grid")
        low, high = self.items.min_height_m, self.items.max_height_m
        if grid is not None and grid.layer_m is not None and grid.layer_m < high:
            raise ValueError(
                f"place_grid.layer_m = {grid.layer_m:g} is lower than items.max_height_m = {high:g}: items "
                "would be pressed on those below; make max_height_m as small as the items are"
            )
        if low + self.grip_m <= 0.0:
            raise ValueError(
                f"grip_m = {self.grip_m:g} would take the tool's point into the belt at an item of "
                f"items.min_height_m = {low:g} m; raise one of the two"
            )
        if high > self.above_m:
            raise ValueError(
                f"above_m = {self.above_m:g} is too low to go, or to carry an item, over others of "
                f"items.max_height_m = {high:g} m; raise above_m, or lower items.max_height_m"
            )
        return self

    def roles(self) -> tuple[str, ...]:
        """Roles of ``[robot]`` that the job needs."""
        return ("arm", "fixed_camera", "belt", "gripper", *(["place_inputs"] if self.place_clear else ()))

    @property
    def look_above_m(self) -> float:
        """Down to this height of the tool above the place the input for a clear place is looked at, m."""
        above = self.place_look_above_m
        return self.items.max_height_m if above is None else above

    @property
    def down_m(self) -> float:
        """From a level way above an item down to the grip, m."""
        return self.above_m - self.grip_m

    @property
    def sunk_m(self) -> float:
        """How far below an item's upper face the tool's point is in the grip, m."""
        return max(-self.grip_m, 0.0)
