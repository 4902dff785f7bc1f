"""The registers of a Modbus device: tables, spans of one request, and numbers that registers hold."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

from pydantic import Field

from cell.formats.reading import Strict

WordOrder = Literal["high-first", "low-first"]
RegisterTable = Literal["holding", "input"]


class Table(StrEnum):
    """The four tables of Modbus."""

    COILS = "coils"
    DISCRETE = "discrete"
    HOLDING = "holding"
    INPUT = "input"

    @property
    def function(self) -> int:
        """The function code that reads it."""
        return list(Table).index(self) + 1

    @property
    def has_bits(self) -> bool:
        return self.function <= 2

    @property
    def most(self) -> int:
        """What one request may ask for."""
        return 2000 if self.has_bits else 125


@dataclass(frozen=True)
class Span:
    """``count`` bits or registers of ``table`` from ``start`` on."""

    table: Table
    start: int
    count: int

    def __post_init__(self) -> None:
        if self.count > self.table.most or self.start + self.count > 65536:
            raise ValueError(
                f"{self.count} {'bits' if self.table.has_bits else 'registers'} from 0x{self.start:04X} on"
                f" are too many for one request, which takes {self.table.most} below 0x10000;"
                " make a second device for inputs that lie far apart"
            )

    def __str__(self) -> str:
        last = self.start + self.count - 1
        return f"function {self.table.function}, addresses 0x{self.start:04X} to 0x{last:04X}"


class NumberConfig(Strict):
    """Registers that hold one number."""

    table: RegisterTable = Field(default="holding", description="Modbus table of the number")
    address: int = Field(ge=0, le=65535, description="its first register")
    count: int = Field(default=1, ge=1, le=32, description="How many registers")
    word_order: WordOrder = Field(default="high-first", description="of numbers with more than one register")

    @property
    def span(self) -> Span:
        return Span(Table(self.table), self.address, self.count)


class SerialConfig(NumberConfig):
    """Registers that hold one number or one text."""

    kind: Literal["number", "text"] = Field(
        default="number", description="text: two characters a register, high byte first"
    )


def words_to_int(words: Sequence[int], low_word_first: bool) -> int:
    """The unsigned number in ``words``."""
    value = 0
    for word in reversed(words) if low_word_first else words:
        value = value << 16 | word
    return value
