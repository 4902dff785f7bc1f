"""The tables of a scenario that describe a palletizer which nobody but its own program moves."""

from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from cell.formats.reading import Strict
from fakes.world.arm.truth import JointErrorsTruth

Four = Annotated[list[float], Field(min_length=4, max_length=4)]
Range = Annotated[list[float], Field(min_length=2, max_length=2)]
Length = Annotated[float, Field(ge=-5, le=5)]
Angle = Annotated[float, Field(ge=-7, le=7)]
Ratio = Annotated[float, Field(ge=-10, le=10)]


class PalletizerTable(Strict):
    """What the controller believes, m, rad and link per motor; ``tx, ty, tz``: nominal place of smr1."""

    a1: Length
    a2: Length
    a3: Length
    a4: Length
    a5: Length = 0.0
    d1: Length
    d5: Length
    k1: Ratio = 1.0
    k2: Ratio = 1.0
    k3: Ratio = 1.0
    k5: Ratio = 1.0
    t1: Angle = 0.0
    t2: Angle = 0.0
    t3: Angle = 0.0
    t5: Angle = 0.0
    tx: Length = 0.0
    ty: Length = 0.0
    tz: Length = 0.0


class PalletizerErrors(Strict):
    """What the true arm has more than its controller believes; same letters and units."""

    a1: Length = 0.0
    a2: Length = 0.0
    a3: Length = 0.0
    a4: Length = 0.0
    a5: Length = 0.0
    d1: Length = 0.0
    d5: Length = 0.0
    k1: Ratio = 0.0
    k2: Ratio = 0.0
    k3: Ratio = 0.0
    k5: Ratio = 0.0
    t1: Angle = 0.0
    t2: Angle = 0.0
    t3: Angle = 0.0
    t5: Angle = 0.0


class ObservedTruth(Strict):
    """``[world.observed]``: a palletizer, its controller's registers, and the program that moves it."""

    serial: str = Field(
        default="99995500001", pattern=r"^9999\d+$", description="twin serials begin with 9999"
    )
    model: str = Field(default="Twin palletizer", min_length=1, max_length=40)
    version: str = "3.1"
    parameters: PalletizerTable
    error: PalletizerErrors = PalletizerErrors()
    joint_errors: JointErrorsTruth = JointErrorsTruth()
    q_start: Four
    limits: Annotated[list[Range], Field(min_length=4, max_length=4)]
    speed_rad_s: float = Field(default=0.8, gt=0, le=10, description="of the joint with the longest way")
    accel_rad_s2: float = Field(default=1.5, gt=0, le=100)
    reaction_s: float = Field(default=1.0, ge=0, le=600, description="from a request until the arm sets out")
    repeatability_t_m: float = Field(
        default=0.0, ge=0, le=0.01, description="sigma per axis, new at each standstill"
    )
    repeatability_r_rad: float = Field(default=0.0, ge=0, le=0.01)
    number: Literal["float32", "int32"] = Field(default="float32", description="how registers hold a joint")
    unit: Literal["rad", "deg"] = "deg"
    scale: float = Field(default=1.0, gt=0, le=1000, description="of the unit, for one step of an int32")
    word_order: Literal["high-first", "low-first"] = "high-first"

    @model_validator(mode="after")
    def _starts_within_its_limits(self) -> Self:
        for i, ((low, high), q) in enumerate(zip(self.limits, self.q_start, strict=True)):
            if not low < high:
                raise ValueError(f"limits[{i}] is [low, high]; {low:g} is not below {high:g}")
            if not low <= q <= high:
                raise ValueError(f"q_start[{i}] = {q:g} is not within its limits {low:g} .. {high:g}")
        return self

    @property
    def robot(self) -> dict[str, Any]:
        """The ROBOT of the data formats that the controller believes in."""
        return {"family": "palletizer4", "parameters": self.parameters.model_dump()}

    @property
    def true_parameters(self) -> dict[str, float]:
        """The same letters as they truly are, without the reflector's place."""
        believed = self.parameters.model_dump()
        return {name: believed[name] + off for name, off in self.error.model_dump().items()}
