"""The register table: what stands where, and how values become registers."""

import math
import re
import struct
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from typing import Any

from daemon.warning_bits import WARNING_BITS

WORDS = {"uint16": 1, "uint32": 2, "float32": 2}


@dataclass(frozen=True)
class Register:
    """One line of the table."""

    address: int
    name: str
    type: str
    meaning: str
    unit: str = ""
    limit: int | None = None
    values: Mapping[int, str] = field(default_factory=dict)
    bits: Sequence[str] = ()
    reserved: Sequence[int] = ()

    @property
    def words(self) -> int:
        return WORDS[self.type]

    def bit(self, name: str) -> int:
        """The mask of a bit: ``name`` is what the table says of it, up to a colon or a bracket.

        ``KeyError`` for a name that is none, or not of one bit alone.
        """
        found = [i for i, text in enumerate(self.bits) if re.split(r"[:(]", text)[0].strip() == name]
        if len(found) != 1:
            raise KeyError(f"'{name}' is not the name of one bit of {self.name}")
        return 1 << found[0]

    def number(self, name: str) -> int:
        """The value that the table gives to ``name``, which is its meaning up to a colon; else *other*."""
        numbers = {text.partition(":")[0]: number for number, text in self.values.items()}
        return numbers.get(name, numbers["other"])

    def encode(self, value: float | None, low_first: bool) -> list[int]:
        """The registers of ``value``: None and numbers that are not finite become 0, others saturate."""
        number = 0.0 if value is None or not math.isfinite(value) else value
        if self.type == "uint16":
            return [min(max(int(number), 0), 0xFFFF)]
        if self.type == "uint32":
            packed = struct.pack(">I", min(max(int(number), 0), 0xFFFFFFFF))
        else:
            packed = struct.pack(">f", min(max(number, -3.4e38), 3.4e38))
        high, low = struct.unpack(">HH", packed)
        return [low, high] if low_first else [high, low]

    def decode(self, words: Sequence[int], low_first: bool) -> float:
        """The value of this register's words."""
        if self.type == "uint16":
            return words[0]
        high, low = (words[1], words[0]) if low_first else (words[0], words[1])
        number: float = struct.unpack(">I" if self.type == "uint32" else ">f", struct.pack(">HH", high, low))[
            0
        ]
        return number


@dataclass(frozen=True)
class RegisterTable:
    """The command block, and behind each other the status block and that of what was committed."""

    command: tuple[Register, ...]
    status: tuple[Register, ...]
    committed: tuple[Register, ...]
    command_size: int
    status_size: int
    committed_size: int
    mirror: int

    @property
    def readable(self) -> tuple[Register, ...]:
        """What a PLC reads, in the order of its addresses."""
        return (*self.status, *self.committed)

    @property
    def readable_size(self) -> int:
        return self.status_size + self.committed_size

    def readable_words(self, values: Mapping[str, Any], low_first: bool) -> list[int]:
        """Both blocks that are read; names the table does not know are a defect (``KeyError``)."""
        if unknown := values.keys() - {r.name for r in self.readable}:
            raise KeyError(f"not among the registers: {', '.join(sorted(unknown))}")
        words = [0] * self.readable_size
        for register in self.readable:
            encoded = register.encode(values.get(register.name), low_first)
            words[register.address : register.address + register.words] = encoded
        return words

    def bit(self, register: str, name: str) -> int:
        """The mask of the bit ``name`` in ``register``; ``KeyError`` when there is none."""
        return self.register(register).bit(name)

    def register(self, name: str) -> Register:
        """The register called ``name``; ``KeyError`` when there is none."""
        for found in (*self.readable, *self.command):
            if found.name == name:
                return found
        raise KeyError(f"there is no register '{name}'")

    def value_allowed(self, address: int, value: int) -> bool:
        """Whether the PLC may write ``value`` to ``address`` of the command block.

        An unknown job number is refused with a result code, not here: a PLC would take an exception
        for a broken link.
        """
        register = next((r for r in self.command if r.address == address), None)
        if register is None:
            return True
        if register.limit is not None and value > register.limit:
            return False
        return register.name != "command" or value in register.values


@cache
def register_table() -> RegisterTable:
    """The table of this program."""
    raw = tomllib.loads(files("daemon.modbus").joinpath("registers.toml").read_text("utf-8"))
    blocks = raw["blocks"]
    warnings = next(entry for entry in raw["status"] if entry["name"] == "warning_bits")
    warnings["bits"] = [bit.meaning for bit in WARNING_BITS]

    def registers(key: str) -> tuple[Register, ...]:
        return tuple(
            Register(**{**entry, "values": {int(k): v for k, v in entry.get("values", {}).items()}})
            for entry in raw[key]
        )

    return RegisterTable(
        registers("command"),
        registers("status"),
        registers("committed"),
        blocks["command_size"],
        blocks["status_size"],
        blocks["committed_size"],
        blocks["mirror"],
    )
