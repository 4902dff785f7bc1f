"""What no cell reaches: the bounds of every number in a data set, one list for all formats.

They are wide: what is only in another unit passes, so that the loaders can say which unit it is. Beyond them
squares and products of the numbers overflow somewhere in a solver, and no answer would mean anything.
"""

from collections.abc import Callable
from typing import Annotated

from pydantic import AfterValidator, Field

LENGTH_M = 1e6  # links in pure DH form are hundreds of metres long, and a million in millimetres
SMALLEST_M = 1e-6  # of what has a size: a square, a marker, a radius
ANGLE_RAD = 1e6  # motors behind gears turn hundreds of times
PIXEL = 1e6
STAMP_S = 1e11  # since 1970 it is under 2e9
RATIO = 1e6
DISTORTION = 1e6
SIGMA_PX = 1e4
SIGMA_M = 100.0
SIGMA_RAD = 10.0
SIGMA_PER_M = 1.0
PAYLOAD_KG = 1e5
WHOLE = 2**53  # beyond it a number in JSON is not exact
OBSERVATIONS = 20_000
SAMPLES = 200_000
QUERIES = 20_000
COUNTS = 2_000_000


def at_most(most: float, unit: str) -> Callable[[float], float]:
    """A check: no cell has more, so the number is in another unit or damaged."""

    def check(v: float) -> float:
        if abs(v) > most:
            beyond = f"is beyond {most:g}{unit and ' '}{unit}, which no cell reaches"
            raise ValueError(f"{beyond}; give it in {unit}" if unit else f"{beyond}; correct it")
        return v

    return check


Length = Annotated[float, AfterValidator(at_most(LENGTH_M, "m"))]
Size = Annotated[float, Field(ge=SMALLEST_M), AfterValidator(at_most(LENGTH_M, "m"))]
Angle = Annotated[float, AfterValidator(at_most(ANGLE_RAD, "rad"))]
LengthOrAngle = Annotated[float, AfterValidator(at_most(LENGTH_M, "m or rad"))]
Pixels = Annotated[float, AfterValidator(at_most(PIXEL, "px"))]
Coefficient = Annotated[float, AfterValidator(at_most(DISTORTION, ""))]
Ratio = Annotated[float, AfterValidator(at_most(RATIO, ""))]
Stamp = Annotated[float, AfterValidator(at_most(STAMP_S, "s"))]
Whole = Annotated[int, Field(ge=-WHOLE, le=WHOLE)]
PixelCount = Annotated[int, Field(gt=0, le=int(PIXEL))]
SigmaPx = Annotated[float, Field(ge=0.0), AfterValidator(at_most(SIGMA_PX, "px"))]
SigmaLength = Annotated[float, Field(ge=0.0), AfterValidator(at_most(SIGMA_M, "m"))]
SigmaAngle = Annotated[float, Field(ge=0.0), AfterValidator(at_most(SIGMA_RAD, "rad"))]
SigmaPerMetre = Annotated[float, Field(ge=0.0), AfterValidator(at_most(SIGMA_PER_M, "m/m"))]
Payload = Annotated[float, Field(ge=0.0), AfterValidator(at_most(PAYLOAD_KG, "kg"))]
Point = Annotated[list[Length], Field(min_length=3, max_length=3)]
Rotation = Annotated[list[Angle], Field(min_length=3, max_length=3)]
Direction = Annotated[list[Ratio], Field(min_length=3, max_length=3)]
Pose = Annotated[list[LengthOrAngle], Field(min_length=6, max_length=6)]
Joints = Annotated[list[LengthOrAngle], Field(min_length=1, max_length=30)]
Pixel = Annotated[list[Pixels], Field(min_length=2, max_length=2)]
