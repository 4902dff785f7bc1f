"""The gripper's registers, as a Modbus device of the twin shows them: 03E8h to 03EAh in, 07D0h to 07D2h out.

From the register tables of the maker's manual; the answers to its worked examples are tested byte for byte.
"""

from collections.abc import Mapping

from fakes.modbus_io.module import Action, Identity
from fakes.modbus_io.pdu import ILLEGAL_ADDRESS, ILLEGAL_FUNCTION, Refused
from fakes.robotiq.hand import Hand

_IN, _OUT = 0x03E8, 0x07D0
# Bits of the action request, which is the high byte of the first register.
_BITS = {"ACT": 0x01, "GTO": 0x08, "ATR": 0x10, "ADR": 0x20}


class RobotiqTables:
    """``fakes.modbus_io.module.UnitTables`` of a :class:`Hand`; it has no coils and tells no identity."""

    def __init__(self, hand: Hand) -> None:
        self._hand = hand
        self._written = [0, 0, 0]
        self._request: dict[int, int] = {}

    @property
    def identity(self) -> Identity:
        raise Refused(ILLEGAL_FUNCTION)

    def coils(self) -> Mapping[int, bool]:
        raise Refused(ILLEGAL_FUNCTION)

    def discrete(self) -> Mapping[int, bool]:
        raise Refused(ILLEGAL_FUNCTION)

    def holding(self) -> Mapping[int, int]:
        """Older manuals read the status as holding registers."""
        return self.input() | dict(enumerate(self._written, _IN))

    def input(self) -> dict[int, int]:
        hand = self._hand
        names = ("ACT", "GTO", "STA", "OBJ", "FLT", "PRE", "POS", "COU")
        values = {name: hand.read(name) or 0 for name in names}
        status = values["OBJ"] << 6 | values["STA"] << 4 | values["GTO"] << 3 | values["ACT"]
        return {
            _OUT: status << 8,
            _OUT + 1: values["FLT"] << 8 | values["PRE"],
            _OUT + 2: values["POS"] << 8 | values["COU"],
        }

    def coil(self, address: int, on: bool) -> Action:
        raise Refused(ILLEGAL_FUNCTION)

    def register(self, address: int, value: int) -> Action:
        """All registers of a request act at once, however many there are."""
        if not _IN <= address <= _IN + 2:
            self._request.clear()
            raise Refused(ILLEGAL_ADDRESS)
        self._request[address - _IN] = value
        return self._write

    def _write(self) -> None:
        """The first action of a request does all of it."""
        if not self._request:
            return
        for index, value in self._request.items():
            self._written[index] = value
        self._request.clear()
        action, position, rest = self._written
        values = {name: int(bool(action >> 8 & bit)) for name, bit in _BITS.items()}
        self._hand.write(values | {"POS": position & 0xFF, "SPE": rest >> 8, "FOR": rest & 0xFF})

    def restart(self, serial: str | None = None) -> None:
        self._written = [0, 0, 0]
        self._hand.write({"ACT": 0, "GTO": 0})
