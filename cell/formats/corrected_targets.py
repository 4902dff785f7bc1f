"""``cellward.corrected-targets/1``: where an arm went that was asked for targets as given and corrected.

``robot`` is the calibrated arm, ``T_base_tracker`` where the tracker stood when it was calibrated. ``given``
and ``corrected`` are the joints that were asked for.
"""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from cell.formats.bounds import (
    SAMPLES,
    Angle,
    Joints,
    Length,
    LengthOrAngle,
    Payload,
    Point,
    Pose,
    Stamp,
    Whole,
)
from cell.formats.kincal import TrackerNoiseTable
from cell.formats.reading import Strict

SCHEMA = "cellward.corrected-targets/1"
How = Literal["given", "corrected"]
LowHigh = Annotated[list[Angle], Field(min_length=2, max_length=2)]


class PlannedTarget(Strict):
    """The flange as wanted, the joints of both ways, and what to command for the second: x, y, z and yaw of
    a palletizer, else a pose, both as the controller's own model has them."""

    T_base_flange: Pose
    given: Joints
    corrected: Joints
    command: Annotated[list[LengthOrAngle], Field(min_length=4, max_length=6)]


class Arrival(Strict):
    """One rest. ``target`` counts from 0; ``q`` as read there, ``p_tracker`` where the reflector was seen."""

    target: Annotated[int, Field(ge=0, le=SAMPLES)]
    how: How
    q: Joints
    p_tracker: Point | None = None
    t: Stamp | None = None
    scatter_m: Length | None = None
    warnings: list[str] = Field(default_factory=list)


class CorrectedTargets(Strict):
    """The whole data set. ``reflector`` null: no tracker looked. ``predicted_95`` (m) of the calibration,
    which sampled each joint from the lowest to the highest of ``joints_sampled_rad``; null: not known."""

    schema_: Annotated[str, Field(alias="schema")]
    arm: str
    robot: dict[str, Any]
    kinematics_version: Whole | None = None
    predicted_95: Length | None = None
    joints_sampled_rad: Annotated[list[LowHigh], Field(max_length=SAMPLES)] | None = None
    payload_kg: Payload | None = None
    reflector: str | None = None
    T_base_tracker: Pose | None = None
    noise: TrackerNoiseTable | None = None
    as_given: bool
    pose_tolerance_rad: float
    targets: Annotated[list[PlannedTarget], Field(min_length=1, max_length=SAMPLES)]
    arrivals: Annotated[list[Arrival], Field(max_length=SAMPLES)]
    notes: Any = None

    @model_validator(mode="after")
    def _fits_together(self) -> "CorrectedTargets":
        if self.reflector is not None and (self.T_base_tracker is None or self.noise is None):
            raise ValueError("(reflector) is given, and T_base_tracker or noise is missing")
        for k, arrival in enumerate(self.arrivals):
            if arrival.target >= len(self.targets):
                raise ValueError(
                    f"(arrivals[{k}].target) is {arrival.target}; the last one is {len(self.targets) - 1}"
                )
            if self.reflector is not None and arrival.p_tracker is None:
                raise ValueError(f"(arrivals[{k}].p_tracker) is missing, and a reflector was looked at")
        return self
