"""The data set of an insertion, ``slot.json``: what was known, the measuring look, and how it ended."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from cell.formats.bounds import Force, Length, LengthOrAngle, Pose, SigmaAngle, SigmaLength
from cell.formats.capture import Camera
from cell.formats.reading import Strict, parse, parse_part, read_json
from cell.formats.robot import Robot, SixAngles, parse_robot
from procedures.slot.config import SlotInsertionConfig
from procedures.slot.seeing import Look
from procedures.slot.states import PartState

DATA_FILE, SCHEMA = "slot.json", "cellward.slot/1"

Sigmas = Annotated[  # of a pose: three lengths and three angles
    list[Annotated[LengthOrAngle, Field(ge=0.0)]], Field(min_length=6, max_length=6)
]


class BudgetShare(Strict):
    """One cause (``block``) of a hand-eye's uncertainty: of its place, m, and its direction, rad."""

    block: str
    t: SigmaLength
    r: SigmaAngle


class HandEyeKnown(Strict):
    """The camera on the flange, its covariance, and the standard uncertainties by cause of its result."""

    T_flange_camera: Pose
    cov: Annotated[list[Pose], Field(min_length=6, max_length=6)]
    budget: list[BudgetShare] = Field(default_factory=list)


class LookTaken(Strict):
    """The measuring look; pictures by their names in the run folder.

    ``camera`` is as it tells itself; ``lens`` as the hand-eye was solved with, None without one. ``looks`` at
    the slot so far, this one included.
    """

    what: Literal["opening", "part"]
    q: SixAngles
    T_base_camera: Pose
    T_base_slot: Pose
    sigma: Sigmas
    colour: list[str]
    depth: list[str]
    camera: Camera
    lens: Camera | None = None
    reach_m: Length
    looks: int = Field(default=1, ge=1)

    def look(self, folder: Path) -> Look:
        return Look(
            [folder / name for name in self.colour],
            [folder / name for name in self.depth],
            (self.lens or self.camera).model_dump(),
            self.T_base_camera,
            self.T_base_slot,
            self.sigma,
            self.reach_m,
            self.looks,
        )


class InsertionOutcome(Strict):
    """What became of it. ``travel_m`` of the part's front in the slot; ``reasons``: why it ended badly;
    ``confirmed``: whether anything told what the gripper held, None in data sets of before."""

    states: list[PartState] = Field(default_factory=lambda: [PartState.NONE])
    travel_m: Length | None = None
    force_n: Force | None = None
    reasons: list[str] = Field(default_factory=list)
    confirmed: bool | None = None


class SlotData(Strict):
    """``job`` as configured; ``arm_rms_m``: of the arm's model in use, None where unknown."""

    schema_: Annotated[Literal["cellward.slot/1"], Field(alias="schema")] = "cellward.slot/1"
    job: dict[str, Any]
    robot: dict[str, Any]
    arm_rms_m: SigmaLength | None
    hand_eye: HandEyeKnown
    T_flange_part: Pose
    look: LookTaken | None = None
    insert_q: SixAngles | None = None
    outcome: InsertionOutcome = Field(default_factory=lambda: InsertionOutcome())

    def config(self) -> SlotInsertionConfig:
        return SlotInsertionConfig.model_validate(self.job)

    def arm(self) -> Robot:
        return parse_robot(self.robot, "robot")


def read_data_set(path: Path) -> tuple[SlotData, Path]:
    """A run's data set and its folder, from either; raises an ``InputError``."""
    file = path / DATA_FILE if path.is_dir() else path
    data = parse(SlotData, read_json(file), SCHEMA, str(file))
    parse_part(SlotInsertionConfig, data.job, f"{file}: job")
    parse_robot(data.robot, f"{file}: robot")
    return data, file.parent
