"""What no cell reaches: the bounds of every number in a data set, one list for all formats.

They are wide: what is only in another unit passes, so that the loaders can say which unit it is. Beyond them
squares and products of the numbers overflow somewhere in a solver, and no answer would mean anything.
"""

from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import Field, GetCoreSchemaHandler
from pydantic_core import CoreSchema, core_schema

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
FORCE_N = 1e6
WHOLE = 2**53  # beyond it a number in JSON is not exact
OBSERVATIONS = 20_000
SAMPLES = 200_000
QUERIES = 20_000
COUNTS = 2_000_000


@dataclass(frozen=True)
class AtMost:
    """A check: no cell has more, so the number is in another unit or damaged."""

    most: float
    unit: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        # A function for each of a hundred thousand numbers would take longer than a solver.
        fix = f"give it in {self.unit}" if self.unit else "correct it"
        beyond = f"is beyond {self.most:g}{self.unit and ' '}{self.unit}, which no cell reaches; {fix}"
        bounded = core_schema.float_schema(ge=-self.most, le=self.most)
        checked = core_schema.custom_error_schema(bounded, "beyond", custom_error_message=beyond)
        return core_schema.chain_schema([handler(source), checked])


Length = Annotated[float, AtMost(LENGTH_M, "m")]
Size = Annotated[float, Field(ge=SMALLEST_M), AtMost(LENGTH_M, "m")]
Angle = Annotated[float, AtMost(ANGLE_RAD, "rad")]
LengthOrAngle = Annotated[float, AtMost(LENGTH_M, "m or rad")]
Pixels = Annotated[float, AtMost(PIXEL, "px")]
Coefficient = Annotated[float, AtMost(DISTORTION, "")]
Ratio = Annotated[float, AtMost(RATIO, "")]
Stamp = Annotated[float, AtMost(STAMP_S, "s")]
Whole = Annotated[int, Field(ge=-WHOLE, le=WHOLE)]
PixelCount = Annotated[int, Field(gt=0, le=int(PIXEL))]
SigmaPx = Annotated[float, Field(ge=0.0), AtMost(SIGMA_PX, "px")]
SigmaLength = Annotated[float, Field(ge=0.0), AtMost(SIGMA_M, "m")]
SigmaAngle = Annotated[float, Field(ge=0.0), AtMost(SIGMA_RAD, "rad")]
SigmaPerMetre = Annotated[float, Field(ge=0.0), AtMost(SIGMA_PER_M, "m/m")]
Force = Annotated[float, AtMost(FORCE_N, "N")]
Payload = Annotated[float, Field(ge=0.0), AtMost(PAYLOAD_KG, "kg")]
Point = Annotated[list[Length], Field(min_length=3, max_length=3)]
Rotation = Annotated[list[Angle], Field(min_length=3, max_length=3)]
Direction = Annotated[list[Ratio], Field(min_length=3, max_length=3)]
Pose = Annotated[list[LengthOrAngle], Field(min_length=6, max_length=6)]
Joints = Annotated[list[LengthOrAngle], Field(min_length=1, max_length=30)]
Pixel = Annotated[list[Pixels], Field(min_length=2, max_length=2)]
