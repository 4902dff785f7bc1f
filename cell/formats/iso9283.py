"""``cellward.iso9283/1``: where a tracker saw one reflector when an arm went to the same poses many times.

``poses`` P1 to P5 are judged; others (R1, ...) only tell where the tracker stands. ``T_base_flange`` is what
was wanted of the true flange, ``q`` the joints that were sent.
"""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from cell.formats.bounds import (
    SAMPLES,
    Joints,
    Length,
    Payload,
    Point,
    Pose,
    Rotation,
    Stamp,
    Whole,
)
from cell.formats.kincal import TrackerNoiseTable
from cell.formats.reading import Strict

SCHEMA = "cellward.iso9283/1"


class IsoPose(Strict):
    """One pose that was commanded."""

    name: str
    T_base_flange: Pose
    q: Joints


class IsoSample(Strict):
    """One arrival at rest; ``cycle`` counts from 1, 0 for a pose that only locates the tracker.

    ``warnings`` are what the instrument said of its readings. ``rotation``, of a six-degree target in the
    tracker frame, and beside angles in the axes of who sent it, is kept and not used.
    """

    pose: str
    cycle: Annotated[int, Field(ge=0, le=SAMPLES)]
    p_tracker: Point
    t: Stamp | None = None
    scatter_m: Length | None = None
    count: Whole | None = None
    warnings: list[str] = Field(default_factory=list)
    rotation: Rotation | None = None


class IsoKinematics(Strict):
    """The calibrated arm in use, and where its tracker stood (``T_base_tracker``)."""

    version: Whole | None = None
    T_base_tracker: Pose | None = None


class Iso9283(Strict):
    """The whole data set. ``point`` is the reflector in the flange, m."""

    schema_: Annotated[str, Field(alias="schema")]
    reflector: str
    point: Point
    noise: TrackerNoiseTable
    payload_kg: Payload
    speed_share: Annotated[float, Field(gt=0.0, le=1.0)]
    corrected: bool
    registration: Literal["fit", "kinematics"]
    kinematics: IsoKinematics | None = None
    cycles: Annotated[int, Field(ge=2, le=SAMPLES)]
    poses: Annotated[list[IsoPose], Field(max_length=1000)]
    samples: Annotated[list[IsoSample], Field(max_length=SAMPLES)]
    notes: Any = None

    @model_validator(mode="after")
    def _poses_are_known(self) -> "Iso9283":
        known = {pose.name for pose in self.poses}
        for k, sample in enumerate(self.samples):
            if sample.pose not in known:
                raise ValueError(f"(samples[{k}].pose) {sample.pose!r} is not among the poses")
        if self.registration == "kinematics" and (
            self.kinematics is None or self.kinematics.T_base_tracker is None
        ):
            raise ValueError("(registration) is 'kinematics' and T_base_tracker of the kinematics is missing")
        return self

    @property
    def T_base_tracker(self) -> Pose | None:
        """Where the tracker stands by the calibration; None where it is fitted to the arrivals."""
        return self.kinematics.T_base_tracker if self.kinematics and self.registration != "fit" else None
