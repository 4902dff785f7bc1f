"""What a controller tells that its joints may do: the limits of its safety configuration.

Source: a UR5e of URSim 5.8, whose first robot state Universal Robots recorded (its configuration data, in
``tests/data/recordings/ur5e_first_state.hex``): 363 degrees each way, and 0.2 rad/s more than the 180 deg/s
of its manual. That the limits of the other arms lie above their manuals by as much is an assumption.
"""

from typing import Annotated

import numpy as np
from pydantic import Field

from cell.formats.joint_limits import JointRanges
from cell.formats.reading import Strict
from cell.poses import Array
from fakes.world.arm.joint_speeds import fastest_joints

MARGIN_RAD_S = 0.2
RANGE_RAD = float(np.deg2rad(363.0))
Speeds = Annotated[list[Annotated[float, Field(gt=0, le=50)]], Field(min_length=6, max_length=6)]


class ControllerLimitsTruth(Strict):
    """``[world.arm.controller_limits]``: as somebody set them in the robot's safety configuration."""

    joint_ranges_rad: JointRanges | None = Field(
        default=None, description="lowest and highest angle of each joint; without it 363 deg each way"
    )
    joint_speeds_rad_s: Speeds | None = Field(
        default=None, description="highest speed of each joint; without it 0.2 rad/s above the manual's"
    )

    def ranges(self) -> Array:
        """(6, 2) rad."""
        return np.array(self.joint_ranges_rad or [[-RANGE_RAD, RANGE_RAD]] * 6)

    def speeds(self, model: str) -> Array:
        """(6,) rad/s that the controller of an arm of this model tells."""
        own = self.joint_speeds_rad_s
        return fastest_joints(model) + MARGIN_RAD_S if own is None else np.array(own)

    def reached(self, model: str) -> Array:
        """(6,) rad/s: how fast the joints of an arm of this model turn at most on set-points."""
        own = self.joint_speeds_rad_s
        return fastest_joints(model) if own is None else np.array(own)

    def told(self) -> dict[str, list[float] | list[list[float]]]:
        """What was set, as an arm without protocols tells it; the defaults are those of a UR controller."""
        return self.model_dump(exclude_none=True)
