"""Joints as numbers in registers or in a file, and back: type, word order, unit, scale and zero."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite, pi
from typing import Literal

NumberType = Literal["float32", "int32", "int16"]
Unit = Literal["rad", "deg", "counts", "m", "mm"]

WORDS: dict[NumberType, int] = {"float32": 2, "int32": 2, "int16": 1}
_FORMATS: dict[NumberType, str] = {"float32": ">f", "int32": ">i", "int16": ">h"}
_SI: dict[str, float] = {"rad": 1.0, "deg": pi / 180.0, "m": 1.0, "mm": 1e-3}


@dataclass(frozen=True)
class Encoding:
    """``joint = (number - zero) * scale * unit``; a joint is in rad, or in m if it slides."""

    type: NumberType
    low_word_first: bool
    unit: Unit
    scale: float
    counts_per_turn: float | None
    zero: float

    @property
    def words(self) -> int:
        """Registers that the number takes."""
        return WORDS[self.type]

    @property
    def step(self) -> float:
        """rad or m for one of the number."""
        if self.counts_per_turn is not None:
            return self.scale * 2.0 * pi / self.counts_per_turn
        return self.scale * _SI[self.unit]

    def joint(self, number: float) -> float:
        """rad or m."""
        return (number - self.zero) * self.step

    def decode(self, words: Sequence[int]) -> float:
        """The joint in registers, rad or m; not finite when a float in them is not."""
        ordered = words[::-1] if self.low_word_first else words
        raw = b"".join(word.to_bytes(2, "big") for word in ordered)
        return self.joint(struct.unpack(_FORMATS[self.type], raw)[0])

    def encode(self, joint: float) -> list[int]:
        """Registers for a joint; ``ValueError`` when the type cannot hold it."""
        number = joint / self.step + self.zero
        if not isfinite(number):
            raise ValueError(f"{joint} is no number")
        try:
            raw = struct.pack(_FORMATS[self.type], number if self.type == "float32" else round(number))
        except (struct.error, OverflowError):
            raise ValueError(f"{joint:g} does not fit into {self.type} as {number:g}") from None
        words = [int.from_bytes(raw[i : i + 2], "big") for i in range(0, len(raw), 2)]
        return words[::-1] if self.low_word_first else words
