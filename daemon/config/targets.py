"""``[target.NAME]``: what a camera looks at; the same keys as in a capture set."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from daemon.config.models import Point, Section

# Markers of each of OpenCV's dictionaries; ``cv2`` itself takes long to import.
DICTIONARY_SIZES = {
    **{f"DICT_{n}X{n}_{size}": size for n in (4, 5, 6, 7) for size in (50, 100, 250, 1000)},
    "DICT_ARUCO_ORIGINAL": 1024,
    **{f"DICT_ARUCO_MIP_36{h}12": 250 for h in "hH"},
    **{f"DICT_APRILTAG_16{h}5": 30 for h in "hH"},
    **{f"DICT_APRILTAG_25{h}9": 35 for h in "hH"},
    **{f"DICT_APRILTAG_36{h}10": 2320 for h in "hH"},
    **{f"DICT_APRILTAG_36{h}11": 587 for h in "hH"},
}


class Charuco(Section):
    """A ChArUco board as OpenCV has it."""

    type: Literal["charuco"] = Field(description="kind of target")
    squares_x: int = Field(ge=3, le=100, description="squares along x")
    squares_y: int = Field(ge=3, le=100, description="squares along y")
    square_m: float = Field(gt=0, le=1.0, description="side of a square, as measured")
    marker_m: float = Field(ge=1e-4, le=1.0, description="side of a marker, smaller than the square")
    dictionary: str = Field(pattern=r"^DICT_\w+$", description="OpenCV's name, as in DICT_5X5_100")
    legacy: bool = Field(default=False, description="pattern of OpenCV before 4.6")

    @model_validator(mode="after")
    def _marker_fits(self) -> Self:
        if self.marker_m >= self.square_m:
            raise ValueError("'marker_m' must be smaller than 'square_m'")
        return self


class Chessboard(Section):
    """A chessboard, counted in inner corners."""

    type: Literal["chessboard"] = Field(description="kind of target")
    columns: int = Field(ge=2, le=100, description="inner corners along x")
    rows: int = Field(ge=2, le=100, description="inner corners along y")
    square_m: float = Field(gt=0, le=1.0, description="side of a square, as measured")


class CircleGrid(Section):
    """A grid of circles."""

    type: Literal["circle-grid"] = Field(description="kind of target")
    columns: int = Field(ge=2, le=100, description="circles along x")
    rows: int = Field(ge=2, le=100, description="circles along y")
    spacing_m: float = Field(gt=0, le=1.0, description="distance of neighbouring centres, as measured")
    large_dot_corner: bool = Field(default=False, description="one corner has a larger circle")


class ArucoMarker(Section):
    """A single marker."""

    type: Literal["aruco-marker"] = Field(description="kind of target")
    dictionary: str = Field(pattern=r"^DICT_\w+$", description="OpenCV's name, as in DICT_5X5_100")
    id: int = Field(ge=0, le=1023, description="number of the marker in its dictionary")
    size_m: float = Field(gt=0, le=1.0, description="side of the marker, as measured")


class Points(Section):
    """Points in the target's own frame, m."""

    type: Literal["points"] = Field(description="kind of target")
    points: Annotated[list[Point], Field(min_length=3, max_length=10000)] = Field(
        description="x, y, z of each point in the target's frame, m"
    )


TARGETS: dict[str, type[Section]] = {
    "charuco": Charuco,
    "chessboard": Chessboard,
    "circle-grid": CircleGrid,
    "aruco-marker": ArucoMarker,
    "points": Points,
}
