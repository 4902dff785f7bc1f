"""ROBOT: an arm by name, by the parameters of a palletizer, or link by link."""

from abc import abstractmethod
from collections.abc import Mapping
from difflib import get_close_matches
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from cell.errors import error
from cell.formats.bounds import ANGLE_RAD, LENGTH_M, RATIO, Angle, Length, Point, Ratio
from cell.formats.reading import Strict, parse_part

_SMALLEST = 1e-12  # of a prior: what is held so firmly is as good as fixed
SixLengths = Annotated[list[Length], Field(min_length=6, max_length=6)]
SixAngles = Annotated[list[Angle], Field(min_length=6, max_length=6)]


class Prior(Strict):
    """Standard deviations of the parameters about their nominal values; m, rad and, for ratios, relative.

    ``gear_rad`` and ``sag_rad``: of errors of the gears and of the loaded joints' giving way.
    """

    length_m: Annotated[float, Field(ge=_SMALLEST, le=LENGTH_M)] | None = None
    angle_rad: Annotated[float, Field(ge=_SMALLEST, le=ANGLE_RAD)] | None = None
    ratio: Annotated[float, Field(ge=_SMALLEST, le=RATIO)] | None = None
    gear_rad: Annotated[float, Field(ge=_SMALLEST, le=ANGLE_RAD)] | None = None
    sag_rad: Annotated[float, Field(ge=_SMALLEST, le=ANGLE_RAD)] | None = None


class Deltas(Strict):
    """What a factory calibration of Universal Robots adds to the published DH table."""

    delta_theta: SixAngles | None = None
    delta_d: SixLengths | None = None
    delta_a: SixLengths | None = None
    delta_alpha: SixAngles | None = None


class JointError(Strict):
    """``joint`` (from 1) turns ``sin`` times the sine and ``cos`` times the cosine of the angle ``of @ q``
    further than it reads. ``name`` says what it is, such as ``gear2.1`` or ``sag2.fore``."""

    name: str = Field(min_length=1, max_length=40)
    joint: int = Field(ge=1, le=30)
    of: list[Ratio] = Field(min_length=1, max_length=30)
    sin: Annotated[float, Field(ge=-0.1, le=0.1)]
    cos: Annotated[float, Field(ge=-0.1, le=0.1)]


class _Robot(Strict):
    tool: dict[str, Point] = Field(default_factory=dict)
    prior: Prior | None = None
    notes: Any = None


class NamedRobot(_Robot):
    """An arm of Universal Robots."""

    model: str
    calibration: Deltas | None = None

    @property
    def joints(self) -> int:
        """How many numbers a joint vector has."""
        return 6


class PalletizerParameters(Strict):
    """Four motors and a parallelogram. Lengths m, offsets rad, ratios link per motor."""

    a1: Length
    a2: Length
    a3: Length
    a4: Length
    a5: Length
    d1: Length
    d5: Length
    k1: Ratio
    k2: Ratio
    k3: Ratio
    k5: Ratio
    t1: Angle
    t2: Angle
    t3: Angle
    t5: Angle
    tx: Length
    ty: Length
    tz: Length


class _WithErrors(_Robot):
    joint_errors: list[JointError] = Field(default_factory=list, max_length=200)

    @property
    @abstractmethod
    def joints(self) -> int: ...

    @model_validator(mode="after")
    def _errors_fit_the_joints(self) -> Self:
        for k, one in enumerate(self.joint_errors):
            if one.joint > self.joints or len(one.of) != self.joints:
                raise ValueError(
                    f"(joint_errors.{k}) is of joint {one.joint} and has {len(one.of)} numbers in 'of'; "
                    f"the robot has {self.joints} joints"
                )
        return self


class PalletizerRobot(_WithErrors):
    """``tx``, ``ty``, ``tz`` of the parameters are the place of target "smr1" on the flange."""

    family: Literal["palletizer4"]
    parameters: PalletizerParameters

    @property
    def joints(self) -> int:
        """How many numbers a joint vector has."""
        return 4

    @model_validator(mode="after")
    def _one_place_for_smr1(self) -> "PalletizerRobot":
        own = [self.parameters.tx, self.parameters.ty, self.parameters.tz]
        if self.tool.get("smr1", own) != own:
            raise ValueError("(tool smr1) differs from tx, ty, tz of the parameters; leave it out of 'tool'")
        return self


class Link(Strict):
    """``Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta)``; ``beta`` only where two axes are near parallel."""

    theta: Angle = 0.0
    d: Length = 0.0
    a: Length = 0.0
    alpha: Angle = 0.0
    beta: Angle | None = None
    joint: Literal["revolute", "prismatic", "fixed"] = "revolute"


class SerialRobot(_WithErrors):
    """Any chain. ``coupling`` has a row for each moving link (or each link) and a column for each joint."""

    family: Literal["serial"]
    links: Annotated[list[Link], Field(min_length=1, max_length=30)]
    coupling: list[list[Ratio]] | None = None

    @property
    def joints(self) -> int:
        """How many numbers a joint vector has."""
        if self.coupling is not None:
            return len(self.coupling[0])
        return sum(link.joint != "fixed" for link in self.links)

    @model_validator(mode="after")
    def _coupling_fits_the_links(self) -> "SerialRobot":
        moving = sum(link.joint != "fixed" for link in self.links)
        if not moving:
            raise ValueError("(links) has no link that moves; give 'joint' of the moving ones")
        if self.coupling is None:
            return self
        rows, widths = len(self.coupling), {len(row) for row in self.coupling}
        if rows not in (moving, len(self.links)) or len(widths) != 1 or widths == {0}:
            raise ValueError(
                f"(coupling) must have {moving} rows, one for each moving link, of equal length; it has "
                f"{rows} rows of {', '.join(map(str, sorted(widths))) or 'no'} entries"
            )
        if rows == len(self.links):
            for k, (link, row) in enumerate(zip(self.links, self.coupling, strict=True)):
                if link.joint == "fixed" and any(row):
                    raise ValueError(f"(coupling) row {k} moves a fixed link; write zeros there")
        return self


class DhLink(Strict):
    """``Rz(q + theta) Tz(d) Tx(a) Rx(alpha)``: the joint turns about z of the frame before."""

    theta: Angle = 0.0
    d: Length = 0.0
    a: Length = 0.0
    alpha: Angle = 0.0


class LinkCapsule(Strict):
    """All points within ``radius_m`` of the line from ``p0`` to ``p1``, in the frame after some joints."""

    name: Annotated[str, Field(min_length=1, max_length=40)]
    joints: Annotated[int, Field(ge=0, le=6)]
    p0: Point
    p1: Point
    radius_m: Annotated[float, Field(gt=0.0, le=1.0)]


JointRange = Annotated[list[Angle], Field(min_length=2, max_length=2)]


class Serial6Robot(_Robot):
    """A six-axis arm that can be moved: chain, joint ranges, top speeds and the shape of its links."""

    family: Literal["serial6"]
    name: Annotated[str, Field(min_length=1, max_length=40)]
    links: Annotated[list[DhLink], Field(min_length=6, max_length=6)]
    joint_limits: Annotated[list[JointRange], Field(min_length=6, max_length=6)]
    joint_speeds_rad_s: Annotated[
        list[Annotated[float, Field(gt=0.0, le=50.0)]], Field(min_length=6, max_length=6)
    ]
    capsules: Annotated[list[LinkCapsule], Field(min_length=1, max_length=20)]

    @property
    def joints(self) -> int:
        """How many numbers a joint vector has."""
        return 6

    @model_validator(mode="after")
    def _limits_leave_room(self) -> "Serial6Robot":
        for k, (low, high) in enumerate(self.joint_limits):
            if low >= high:
                raise ValueError(
                    f"(joint_limits) joint {k + 1}: {low:g} is not below {high:g}; write [low, high]"
                )
        if [c.joints for c in self.capsules] != sorted(c.joints for c in self.capsules):
            raise ValueError("(capsules) must stand from the base to the flange, 'joints' rising")
        return self


Robot = NamedRobot | PalletizerRobot | SerialRobot | Serial6Robot
_FAMILIES: dict[str, type[PalletizerRobot] | type[SerialRobot] | type[Serial6Robot]] = {
    "palletizer4": PalletizerRobot,
    "serial": SerialRobot,
    "serial6": Serial6Robot,
}


def parse_robot(raw: object, where: str) -> Robot:
    """``raw`` as a ROBOT; ``where`` names file and key in errors (``DATA_INVALID``)."""
    if not isinstance(raw, Mapping):
        raise error("DATA_INVALID", f"{where} must be a table with 'model' or 'family'; see ROBOT")
    family = raw.get("family")
    if family is None:
        if "model" not in raw:
            raise error("DATA_INVALID", f"{where} has neither 'model' nor 'family'; add one of them")
        return parse_part(NamedRobot, raw, where)
    if not isinstance(family, str) or family not in _FAMILIES:
        near = get_close_matches(str(family), list(_FAMILIES), 1)
        fix = f"did you mean {near[0]!r}?" if near else f"there is {', '.join(_FAMILIES)}"
        raise error("DATA_INVALID", f"{where}.family {family!r} is not known; {fix}")
    return parse_part(_FAMILIES[family], raw, where)
