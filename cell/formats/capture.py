"""``cellward.capture/1``: images or corners of a target with the flange pose beside each.

Two extensions of the format that runs use: ``frames`` holds several exposures of one pose, each with its
corners as the vision child measured them; and ``corners`` may be given for every type of target, as a full
list in the order of the target's points with null where a point was not seen. Corners that are present are
used as they are; an image is searched only where there are none.
"""

from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from cell.devices import Intrinsics
from cell.formats.bounds import (
    OBSERVATIONS,
    Coefficient,
    Joints,
    PixelCount,
    Pixels,
    Point,
    Pose,
    SigmaAngle,
    SigmaLength,
    SigmaPx,
    Size,
    Stamp,
    Whole,
)
from cell.formats.pixel_list import Corners
from cell.formats.reading import Strict

SCHEMA = "cellward.capture/1"
QUERY_SCHEMA = "cellward.capture-query/1"
_SHORTEST_FOCAL_PX = 1.0
SMALLEST_CHESSBOARD = 3
Share = Annotated[float, Field(gt=0, le=0.5)]
_DIST_LENGTHS = (0, 4, 5, 8, 12, 14)


class CameraSigma(Strict):
    """How well the intrinsics are known: the focal length as a share, the principal point in pixels."""

    f: Share | None = Field(None, description="standard deviation of the focal length, as a share of it")
    c_px: float | None = Field(
        None, gt=0, le=1000.0, description="standard deviation of the principal point (px)"
    )


class Camera(Strict):
    """Intrinsics: K is fx, fy, cx, cy in pixels; dist in OpenCV's order."""

    width: PixelCount
    height: PixelCount
    K: Annotated[list[Pixels], Field(min_length=4, max_length=4)]
    dist: list[Coefficient] = Field(default_factory=list)
    sigma: CameraSigma | None = None

    @field_validator("K")
    @classmethod
    def _focal_lengths_are_positive(cls, K: list[float]) -> list[float]:
        if min(K[:2]) < _SHORTEST_FOCAL_PX:
            raise ValueError(
                "must be [fx, fy, cx, cy] in pixels with positive focal lengths of a pixel or more"
            )
        return K

    @classmethod
    def of(cls, lens: Intrinsics) -> Self:
        return cls(width=lens.width, height=lens.height, K=list(lens.K), dist=list(lens.dist))

    def intrinsics(self) -> Intrinsics:
        fx, fy, cx, cy = self.K
        return Intrinsics(self.width, self.height, (fx, fy, cx, cy), tuple(self.dist))

    @field_validator("dist")
    @classmethod
    def _dist_has_a_known_length(cls, dist: list[float]) -> list[float]:
        if len(dist) not in _DIST_LENGTHS:
            raise ValueError(f"has {len(dist)} entries, must have one of {_DIST_LENGTHS}")
        return dist


class Printed(Strict):
    """How well a target's points are known: standard deviations, with a default where they are left out."""

    scale_sigma: Share | None = Field(
        default=None, description="of the printed size, as a share; 1e-4 is a board measured over its length"
    )
    flatness_m: Annotated[float, Field(gt=0, le=0.1)] | None = Field(
        default=None, description="of the height of its edge over its middle, m"
    )


class Charuco(Printed):
    """A ChArUco board as OpenCV has it."""

    type: Literal["charuco"] = Field(description="kind of target")
    squares_x: int = Field(ge=2, le=200, description="squares along x")
    squares_y: int = Field(ge=2, le=200, description="squares along y")
    square_m: Size = Field(description="side of a square, as measured")
    marker_m: Size = Field(description="side of a marker, smaller than the square")
    dictionary: str = Field(description="OpenCV's name, as in DICT_5X5_100")
    legacy: bool = Field(default=False, description="pattern of OpenCV before 4.6")

    @model_validator(mode="after")
    def _marker_fits(self) -> Self:
        if self.marker_m >= self.square_m:
            raise ValueError("'marker_m' must be smaller than 'square_m'")
        return self


class Chessboard(Printed):
    """A chessboard, counted in inner corners."""

    type: Literal["chessboard"] = Field(description="kind of target")
    columns: int = Field(ge=SMALLEST_CHESSBOARD, le=200, description="inner corners along x")
    rows: int = Field(ge=SMALLEST_CHESSBOARD, le=200, description="inner corners along y")
    square_m: Size = Field(description="side of a square, as measured")

    @field_validator("columns", "rows", mode="before")
    @classmethod
    def _opencv_finds_it(cls, corners: object) -> object:
        if isinstance(corners, int) and corners < SMALLEST_CHESSBOARD:
            raise ValueError(
                f"is {corners}, and a chessboard needs {SMALLEST_CHESSBOARD} inner corners or more in either "
                "direction: OpenCV's search knows the grid by corners that have neighbours on both sides; "
                "use a larger board, a ChArUco board or a circle grid"
            )
        return corners


class CircleGrid(Printed):
    """A symmetric grid of circles."""

    type: Literal["circle-grid"] = Field(description="kind of target")
    columns: int = Field(ge=2, le=200, description="circles along x")
    rows: int = Field(ge=2, le=200, description="circles along y")
    spacing_m: Size = Field(description="distance of neighbouring centres, as measured")
    large_dot_corner: bool = Field(default=False, description="one corner has a larger circle")


class ArucoMarker(Printed):
    """A single marker."""

    type: Literal["aruco-marker"] = Field(description="kind of target")
    dictionary: str = Field(description="OpenCV's name, as in DICT_5X5_100")
    id: int = Field(ge=0, le=2**31 - 1, description="number of the marker in its dictionary")
    size_m: Size = Field(description="side of the marker, as measured")


class Points(Printed):
    """Points in the target's own frame; the corners come with the observations."""

    type: Literal["points"] = Field(description="kind of target")
    points: list[Point] = Field(
        min_length=1, max_length=100_000, description="x, y, z of each point in the target's frame, m"
    )


TARGETS: dict[str, type[Printed]] = {
    "charuco": Charuco,
    "chessboard": Chessboard,
    "circle-grid": CircleGrid,
    "aruco-marker": ArucoMarker,
    "points": Points,
}
TargetTable = Annotated[Charuco | Chessboard | CircleGrid | ArucoMarker | Points, Field(discriminator="type")]


class GivenNoise(Strict):
    """Known noise levels: pixels of one frame, metres, radians."""

    sigma_px: SigmaPx | None = None
    sigma_flange_t: SigmaLength | None = None
    sigma_flange_r: SigmaAngle | None = None


class Task(Strict):
    """Where the result is to be used: what the arm's joints are there, and how far the camera looks."""

    q: Joints
    distance_m: Annotated[float, Field(gt=0, le=100)]


class FrameEntry(Strict):
    """One exposure of a pose; ``corners`` as measured by the vision child, null where unseen."""

    image: str | None = None
    depth: str | None = None
    corners: Corners | None = None
    t: Stamp | None = None
    notes: Any = None


class Observation(Strict):
    """One pose of the arm and what the camera saw there."""

    index: Whole
    group: Whole = 0
    base: Whole | None = Field(
        None, description="place of the target's stand, which several groups may share"
    )
    planned: Whole | None = Field(None, description="place on the cone round the target, counted from 0")
    image: str | None = None
    corners: Corners | None = None
    frames: list[FrameEntry] = Field(default_factory=list)
    T_base_flange: Pose
    q: Joints | None = None
    T_camera_target: Pose | None = None
    t: Stamp | None = None
    notes: Any = None

    @model_validator(mode="after")
    def _has_a_measurement(self) -> "Observation":
        if not (self.image or self.corners or self.frames or self.T_camera_target):
            raise ValueError(
                f"(index {self.index}) has none of image, corners, frames and T_camera_target; give one"
            )
        return self


class Capture(Strict):
    """The whole data set."""

    schema_: Annotated[str, Field(alias="schema")]
    setup: Literal["eye-in-hand", "eye-to-hand"]
    camera: Camera | None
    target: TargetTable
    noise: GivenNoise | None = None
    robot: dict[str, Any] | None = None
    task: Task | None = None
    observations: Annotated[list[Observation], Field(max_length=OBSERVATIONS)]
    notes: Any = None

    @field_validator("observations")
    @classmethod
    def _indices_differ(cls, observations: list[Observation]) -> list[Observation]:
        seen: set[int] = set()
        for observation in observations:
            if observation.index in seen:
                raise ValueError(f"holds index {observation.index} twice; number the observations")
            seen.add(observation.index)
        return observations


class CaptureQuery(Strict):
    """Joints whose flange poses are wanted."""

    schema_: Annotated[str, Field(alias="schema")]
    q: Annotated[list[Joints], Field(min_length=1, max_length=OBSERVATIONS)]
