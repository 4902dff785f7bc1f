"""Input modules as data: where each keeps levels and counters. A new module is an entry in ``MODELS``.

Addresses are 0-based protocol addresses of the makers' manuals.
"""

from dataclasses import dataclass

from drivers.modbus.registers import Table


@dataclass(frozen=True)
class LevelPlace:
    """Channel k is bit ``start + k`` of a table of bits; in registers, bit k % 16 of ``start + k // 16``."""

    table: Table
    start: int


@dataclass(frozen=True)
class CounterPlace:
    """Counters of rising edges of the electrical level, of ``width`` bits, one after the other."""

    table: Table
    start: int
    width: int = 32
    low_word_first: bool = False

    @property
    def registers(self) -> int:
        return self.width // 16


@dataclass(frozen=True)
class ModuleModel:
    """What the driver has to know about one make of module.

    ``highest_hz`` is what its counters can follow: a count that grew faster was set back or cleared.
    """

    channels: int
    levels: LevelPlace
    counters: CounterPlace | None = None
    highest_hz: float = 5000.0


GENERIC = ModuleModel(channels=65536, levels=LevelPlace(Table.DISCRETE, 0))

MODELS: dict[str, ModuleModel] = {
    "generic": GENERIC,
    # Counters and the word of all levels lie within 33 registers, so that one read is one snapshot.
    "ioLogik-E1210": ModuleModel(16, LevelPlace(Table.INPUT, 0x30), CounterPlace(Table.INPUT, 0x10)),
    # Levels as coils: only newer firmware has them as discrete inputs too.
    "ADAM-6050": ModuleModel(
        12, LevelPlace(Table.COILS, 0), CounterPlace(Table.HOLDING, 0, low_word_first=True)
    ),
    "WAGO-750": ModuleModel(256, LevelPlace(Table.DISCRETE, 0)),
}
