"""What an integrator can set for an insertion."""

from typing import Any, Literal, Self

from pydantic import Field, model_validator

from calibration.slot.rack import Rack
from cell.formats.bounds import Pose
from cell.formats.reading import Strict

_ROOM_M = 0.005  # between a part that is carried and those that stand out of the rack


class RackConfig(Strict):
    """The rack and how well its place is known. Slots are counted from 1 along x, then row by row along y."""

    T_base_rack: Pose = Field(
        description="the middle of the first slot's opening, z into the slots: m, and rotation vector (rad)"
    )
    rows: int = Field(default=1, ge=1, le=100, description="along y")
    columns: int = Field(default=1, ge=1, le=100, description="along x")
    row_pitch_m: float = Field(default=0.05, gt=0, le=1.0, description="between two rows")
    column_pitch_m: float = Field(default=0.05, gt=0, le=1.0, description="between two columns")
    sigma_m: float = Field(
        default=0.003, gt=0, le=0.05, description="how well a slot's place is known before it is seen"
    )
    sigma_rad: float = Field(
        default=0.002,
        gt=0,
        le=0.1,
        description="how well the rack's direction is known; no look at one slot betters that",
    )

    def model(self) -> Rack:
        return Rack(self.rows, self.columns, self.row_pitch_m, self.column_pitch_m)


class OpeningConfig(Strict):
    """The opening of a slot, chamfer included, as its edges show it."""

    width_m: float = Field(gt=0.002, le=1.0, description="along the rack's x")
    height_m: float = Field(gt=0.002, le=1.0, description="along its y")
    chamfer_m: float = Field(
        default=0.0, ge=0, le=0.05, description="of the edge, on each side; it leads a part in"
    )
    depth_m: float = Field(gt=0.002, le=1.0, description="travel of the part's front to the end of the slot")


class PartConfig(Strict):
    """The part. Its frame: the middle of its front, which goes in first; z out of it, as the slot's."""

    width_m: float = Field(gt=0.001, le=1.0, description="along the slot's x")
    height_m: float = Field(gt=0.001, le=1.0, description="along its y")
    length_m: float = Field(gt=0.002, le=1.0, description="from front to back")
    T_tool_part: Pose = Field(description="the part's front in the tool while it is gripped")
    sigma_m: float = Field(
        default=1e-4,
        ge=0,
        le=0.01,
        description="how well that place is known, the tool's own included, per axis",
    )
    sigma_rad: float = Field(
        default=1e-3, ge=0, le=0.1, description="the same of its direction, about each axis"
    )


class MarkerConfig(Strict):
    """A marker beside each slot, which tells the slot's place instead of the opening's edges."""

    dictionary: str = Field(description="OpenCV's name, such as DICT_4X4_50 or DICT_APRILTAG_36h11")
    id: int = Field(ge=0, le=10000, description="of the marker at slot 1; that of slot n is id + n - 1")
    size_m: float = Field(gt=0.001, le=0.5, description="outer side of its black square")
    T_slot_marker: Pose = Field(
        description="its middle in the slot's frame, y to its upper side, z out of it: m, and rotation "
        "vector (rad); a half turn about x for one that is upright where the slot's y points down"
    )
    sigma_m: float = Field(ge=0, le=0.01, description="how well that place is known, per axis")
    sigma_rad: float = Field(
        default=0.005, ge=0, le=0.2, description="the same of its direction, about each axis"
    )

    def target(self, slot: int) -> dict[str, Any]:
        """The ``target`` table of the marker at a slot."""
        return {
            "type": "aruco-marker",
            "dictionary": self.dictionary,
            "id": self.id + slot - 1,
            "size_m": self.size_m,
        }


class LookConfig(Strict):
    """From where a slot is looked at, and how."""

    T_slot_camera: Pose = Field(
        default=[0.0, 0.0, -0.3, 0.0, 0.0, 0.0],
        description="the camera at the measuring look, in the slot's frame",
    )
    reach_m: float = Field(
        default=0.01, gt=0, le=0.1, description="how far beside its place a slot is looked for"
    )
    frames: int = Field(default=3, ge=1, le=20, description="pictures of a look, which are averaged")
    settle_s: float = Field(default=0.3, ge=0.0, le=10.0, description="wait at rest before they are taken")


class InsertConfig(Strict):
    """How a part goes in and out."""

    clear_m: float = Field(
        default=0.06, gt=0.005, le=0.5, description="of the part's front from the rack, in free moves"
    )
    near_m: float = Field(
        default=0.005, gt=0.0005, le=0.05, description="the same where the guarded move begins"
    )
    speed_m_s: float = Field(default=0.01, gt=0, le=0.1, description="of the guarded move")
    max_force_n: float = Field(default=30.0, gt=0, le=500.0, description="force that ends it")
    tolerance_m: float = Field(
        default=0.003,
        gt=0,
        le=0.02,
        description="of the travel at which the end of the slot is felt: by what is known of its depth, and "
        "by what arm and part yield to max_force_n",
    )
    grip_timeout_s: float = Field(default=2.0, gt=0, le=30.0, description="longest wait for the gripper")


class SlotInsertionConfig(Strict):
    """``[job.slot-insertion]``: opening and part as they are, their difference is what is free."""

    action: Literal["insert", "pull", "replace"] = Field(
        default="insert", description="replace: pull, put down, fetch another part and insert it"
    )
    slot: int = Field(default=1, ge=1, le=10000, description="number of the slot, from 1")
    rack: RackConfig = Field(description="where the slots are")
    opening: OpeningConfig = Field(description="of each slot")
    part: PartConfig = Field(description="what goes in")
    marker: MarkerConfig | None = Field(
        default=None, description="beside each slot; without it the opening's edges tell where a slot is"
    )
    look: LookConfig = Field(default_factory=lambda: LookConfig(), description="at a slot")
    insertion: InsertConfig = Field(default_factory=lambda: InsertConfig(), description="travel and force")
    start_pose: str = Field(
        default="home", description="name of a [poses] entry near which joints are sought"
    )
    fetch_pose: str | None = Field(
        default=None,
        description="name of a [poses] entry where a part is gripped; else the gripper holds it already",
    )
    put_down_pose: str | None = Field(
        default=None,
        description="name of a [poses] entry where a pulled part is let go; else the gripper keeps it",
    )
    arm_repeatability_m: float = Field(
        default=1.5e-5, ge=0, le=0.001, description="of the flange along one axis, new at each standstill"
    )
    max_duration_s: float = Field(
        default=1800.0, gt=0, description="the run is ended when it takes longer, s"
    )

    @property
    def clearance_m(self) -> float:
        """How far a part may be beside the middle before it touches, on its narrower side."""
        opening, part = self.opening, self.part
        inner = 2.0 * opening.chamfer_m
        room = (opening.width_m - inner - part.width_m, opening.height_m - inner - part.height_m)
        return 0.5 * min(room)

    @model_validator(mode="after")
    def _the_part_fits(self) -> Self:
        if self.clearance_m <= 0.0:
            raise ValueError("the part is as large as the opening within its chamfer, or larger")
        if self.action == "replace" and None in (self.fetch_pose, self.put_down_pose):
            raise ValueError(
                "action 'replace' puts a part down and fetches another: give fetch_pose and put_down_pose"
            )
        if self.slot > self.rack.rows * self.rack.columns:
            raise ValueError(f"slot {self.slot} is none of the rack's {self.rack.rows * self.rack.columns}")
        stands_out = self.part.length_m - self.opening.depth_m
        if self.insertion.clear_m < stands_out + _ROOM_M:
            raise ValueError(
                f"insertion.clear_m is {self.insertion.clear_m:g} m, and parts in the rack stand out by "
                f"{stands_out:g} m: give at least {stands_out + _ROOM_M:g} m"
            )
        return self
