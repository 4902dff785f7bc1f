"""The data set of a touch test, ``touch-test.json``: what was known, the look, and where the tool stood."""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from calibration.hand_eye.pnp import Poses, solve_pnp
from calibration.hand_eye.views import CornerSet
from calibration.targets import make_target
from cell.devices import Intrinsics
from cell.formats.bounds import (
    RATIO,
    AtMost,
    Joints,
    Pixel,
    Point,
    Pose,
    Ratio,
    SigmaLength,
)
from cell.formats.capture import Camera, TargetTable
from cell.formats.reading import Strict, parse, read_json
from cell.formats.robot import Robot, parse_robot
from cell.poses import Array
from procedures.touch_test.config import TouchTestConfig

DATA_FILE, SCHEMA = "touch-test.json", "cellward.touch-test/1"
Covariance = Annotated[
    list[Annotated[list[Ratio], Field(min_length=6, max_length=6)]], Field(min_length=6, max_length=6)
]


Larger = Annotated[float, Field(gt=-1.0), AtMost(RATIO, "")]
Sigma = Annotated[float, Field(ge=0.0), AtMost(RATIO, "")]


class PrintedSize(Strict):
    """How much larger a board is than configured along its axes, as shares, with standard deviations."""

    x: Larger
    y: Larger
    sigma_x: Sigma
    sigma_y: Sigma

    @property
    def factors(self) -> Array:
        """(3,) of the target's points."""
        return np.array([1.0 + self.x, 1.0 + self.y, 1.0])


class LookTaken(Strict):
    """The board at the look: point ``ids[i]`` of the target at ``corners[i]``, mean of ``frames`` frames.
    ``camera`` is as it tells itself; ``lens`` as the hand-eye was solved with, None without one; ``printed``
    as the hand-eye found this board, None where it found another one or none."""

    q: Joints
    T_base_flange: Pose
    ids: list[int] = Field(min_length=4)
    corners: list[Pixel] = Field(min_length=4)
    frames: int = Field(ge=1)
    camera: Camera
    lens: Camera | None = None
    printed: PrintedSize | None = None

    def lens_in_use(self) -> Intrinsics:
        """That of the hand-eye, else as the camera tells it."""
        return (self.lens or self.camera).intrinsics()


class PointStood(Strict):
    """The arm at rest with the tool's point over the target's point ``corner``, as a person confirmed it."""

    corner: int = Field(ge=0)
    q: Joints
    T_base_flange: Pose


class TouchData(Strict):
    """``job`` as configured; ``tool`` is the tool's point on the flange by the frame in effect, and
    ``tool_reference`` as its accepted laser reference has it, None without one. ``hand_eye_cov`` is of
    ``T_flange_camera``, perturbation on the right; ``arm_rms_m`` of the arm's model in use, None where
    unknown."""

    schema_: Annotated[Literal["cellward.touch-test/1"], Field(alias="schema")] = "cellward.touch-test/1"
    job: TouchTestConfig
    robot: dict[str, Any]
    arm_rms_m: SigmaLength | None
    target: TargetTable
    T_flange_camera: Pose
    hand_eye_cov: Covariance
    tool: Point
    tool_reference: Point | None
    look: LookTaken | None = None
    stood: list[PointStood] = Field(default_factory=list)
    skipped: list[int] = Field(default_factory=list, description="points that were left out")

    @model_validator(mode="after")
    def _of_the_target(self) -> Self:
        count = len(make_target(self.spec).points)
        seen = [] if self.look is None else self.look.ids
        for where, ids in (("look.ids", seen), ("stood", [at.corner for at in self.stood])):
            if beyond := [k for k in ids if not 0 <= k < count]:
                raise ValueError(f"{where} has point {beyond[0]}, and the target's are 0 to {count - 1}")
        if self.look is not None and not len(set(seen)) == len(seen) == len(self.look.corners):
            raise ValueError("look has another number of ids than of corners, or an id twice")
        return self

    @property
    def spec(self) -> dict[str, Any]:
        """The target's table."""
        return self.target.model_dump(exclude_none=True)

    def arm(self) -> Robot:
        return parse_robot(self.robot, "robot")


def view_of(look: LookTaken, points: Array) -> CornerSet:
    """The corners of the look with the target's ``points`` (n, 3) m."""
    seen = points[np.array(look.ids)]
    return CornerSet(seen, np.array(look.corners), np.full(len(look.ids), float(look.frames)))


def printed_points(target: dict[str, Any], look: LookTaken) -> Array:
    """(n, 3) m of the target, of the size that the hand-eye found, else as configured."""
    points = make_target(target).points
    return points if look.printed is None else points * look.printed.factors


def located(look: LookTaken, points: Array) -> Poses:
    """Where the camera saw the target with ``points``, by the lens of the hand-eye; the first pose is the
    best."""
    poses = solve_pnp([view_of(look, points)], look.lens_in_use())[0]
    if not np.isfinite(poses.C).all():
        raise ArithmeticError("the look's corners and the target's points give no pose")
    return poses


def read_data_set(path: Path) -> tuple[TouchData, Path]:
    """A run's data set and its file, from its folder or the file; raises an ``InputError``."""
    file = path / DATA_FILE if path.is_dir() else path
    return parse(TouchData, read_json(file), SCHEMA, str(file)), file
