"""How a configuration writes the limits of joints."""

from typing import Annotated, Any

from pydantic import AfterValidator, Discriminator, Field, Tag

from cell.formats.bounds import Angle


def _form(speeds: Any) -> str:
    return "each" if isinstance(speeds, list) else "all"


def _rising(bounds: list[float]) -> list[float]:
    low, high = bounds
    if low >= high:
        raise ValueError(f"{low:g} is not below {high:g}; write [low, high]")
    return bounds


_Speed = Annotated[float, Field(ge=0.001, le=10.0)]
JointSpeeds = Annotated[
    Annotated[_Speed, Tag("all")] | Annotated[list[_Speed], Field(min_length=6, max_length=6), Tag("each")],
    Discriminator(_form),
]
"""One number for all joints, or six from the base to the flange, rad/s."""

_Range = Annotated[list[Angle], Field(min_length=2, max_length=2), AfterValidator(_rising)]
JointRanges = Annotated[list[_Range], Field(min_length=6, max_length=6)]
"""Lowest and highest angle of each of six joints, rad."""
