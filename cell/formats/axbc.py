"""``cellward.axbc/1``: a fixed camera sees a target whose place on the flange is known.

A run adds ``frames`` and ``index`` to its observations, as in a capture.
"""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from cell.formats.bounds import (
    OBSERVATIONS,
    QUERIES,
    Joints,
    Pixel,
    Pose,
    SigmaAngle,
    SigmaLength,
    Stamp,
    Whole,
)
from cell.formats.capture import Camera, FrameEntry, GivenNoise, TargetTable
from cell.formats.reading import Strict

SCHEMA = "cellward.axbc/1"
PlaceFrom = Literal["drawing", "hand-eye"]
TARGETS_SCHEMA = "cellward.axbc-targets/1"


class SigmaPose(Strict):
    """How well a pose is known: standard deviations along and about one axis."""

    t: SigmaLength = Field(description="of the place, m")
    r: SigmaAngle = Field(description="of the rotation, rad")


class Limits(Strict):
    """Largest error of the given hand-eye that is good enough, at the base."""

    t: SigmaLength = Field(description="of the place, m")
    r: SigmaAngle = Field(description="of the rotation, rad")


class AxbcObservation(Strict):
    """One pose of the arm and what the camera saw of the target."""

    index: Whole | None = None
    q: Joints | None = None
    T_base_flange: Pose
    T_camera_marker: Pose | None = None
    image: str | None = None
    corners: list[Pixel | None] | None = None
    frames: list[FrameEntry] = Field(default_factory=list)
    t: Stamp | None = None
    notes: Any = None

    @model_validator(mode="after")
    def _has_a_measurement(self) -> "AxbcObservation":
        if not (self.image or self.corners or self.frames or self.T_camera_marker):
            raise ValueError("has none of image, corners, frames and T_camera_marker; give one")
        return self


How = Literal["given", "corrected"]


class AxbcTarget(Strict):
    """The flange as wanted in the camera, and the ``T_base_flange`` that are commanded for it.

    ``corrected`` is null where no way is better than none, or out of reach."""

    T_camera_flange: Pose
    given: Pose
    corrected: Pose | None = None


class AxbcArrival(Strict):
    """One rest at a target, which counts from 0, and what the camera saw there."""

    target: Annotated[int, Field(ge=0, le=QUERIES)]
    how: How
    seen: AxbcObservation


class AxbcDriven(Strict):
    """Targets that the arm was driven to after the answer; nothing is solved from them.

    ``way``: by what ``corrected`` was made; ``lost`` says in words what was not measured, ``stands`` where
    the arm was left when it did not go back. Each target is seen once in each way.
    """

    way: Literal["none", "constant", "model"]
    targets: Annotated[list[AxbcTarget], Field(max_length=QUERIES)]
    arrivals: Annotated[list[AxbcArrival], Field(max_length=OBSERVATIONS)]
    lost: list[str] = Field(default_factory=list)
    stands: str | None = None

    @model_validator(mode="after")
    def _arrivals_have_a_target(self) -> "AxbcDriven":
        first: dict[tuple[int, How], int] = {}
        for k, arrival in enumerate(self.arrivals):
            if (before := first.setdefault((arrival.target, arrival.how), k)) != k:
                raise ValueError(
                    f"(arrivals[{k}]) is of target {arrival.target}, '{arrival.how}', as arrivals[{before}] "
                    "is; leave out one of the two"
                )
            if arrival.target >= len(self.targets):
                raise ValueError(
                    f"(arrivals[{k}].target) is {arrival.target}; the last one is {len(self.targets) - 1}"
                )
        return self


class AxbcSet(Strict):
    """The whole data set."""

    schema_: Annotated[str, Field(alias="schema")]
    robot: dict[str, Any] | None = None
    camera: Camera | None = None
    marker: TargetTable | None = None
    noise: GivenNoise | None = None
    T_marker_flange: Pose
    sigma_C: SigmaPose | None = None
    C_from: PlaceFrom = "drawing"
    X_measured_T_camera_base: Pose
    sigma_X: SigmaPose | None = None
    limits: Limits | None = None
    observations: Annotated[list[AxbcObservation], Field(max_length=OBSERVATIONS)]
    driven: AxbcDriven | None = None
    notes: Any = None

    @model_validator(mode="after")
    def _images_have_a_target(self) -> "AxbcSet":
        bare = all(o.T_camera_marker for o in self.observations)
        if self.marker is None and not bare:
            raise ValueError("has images or corners; give 'marker', the target that they show")
        return self


class AxbcTargets(Strict):
    """Where the flange is wanted, as the camera sees it; ``q_near`` picks the arm's branch."""

    schema_: Annotated[str, Field(alias="schema")]
    targets: Annotated[list[Pose], Field(max_length=QUERIES)]
    q_near: Annotated[list[Joints], Field(max_length=QUERIES)] | None = None

    @model_validator(mode="after")
    def _as_many(self) -> "AxbcTargets":
        if self.q_near is not None and len(self.q_near) != len(self.targets):
            raise ValueError(
                f"has {len(self.targets)} targets and {len(self.q_near)} q_near; give one q_near for each"
            )
        return self
