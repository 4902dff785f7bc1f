"""An object dictionary and its SDO server: expedited transfers, and CiA 301's reasons to refuse."""

from collections.abc import Callable
from dataclasses import dataclass

UNKNOWN_COMMAND, READ_ONLY = 0x05040001, 0x06010002
NO_OBJECT, NOT_MAPPABLE, PDO_TOO_LONG = 0x06020000, 0x06040041, 0x06040042
WRONG_LENGTH, NO_SUB_INDEX, OUT_OF_RANGE, WRONG_STATE = 0x06070010, 0x06090011, 0x06090030, 0x08000022

_DOWNLOAD, _UPLOAD, _ABORT = 1, 2, 4  # command specifiers


class SdoRefusal(Exception):
    """A request is refused; the code goes to the client."""

    def __init__(self, code: int) -> None:
        super().__init__(f"{code:08X}h")
        self.code = code


@dataclass(frozen=True)
class Entry:
    """One value of ``size`` bytes; without ``write`` it can only be read."""

    size: int
    read: Callable[[], int]
    write: Callable[[int], None] | None = None


def constant(size: int, value: int) -> Entry:
    """A value that never changes."""
    return Entry(size, lambda: value)


class Dictionary:
    """Entries by index and sub-index."""

    def __init__(self) -> None:
        self._entries: dict[int, dict[int, Entry]] = {}

    def add(self, index: int, *entries: Entry) -> None:
        """A variable (one entry), or a record whose sub-index 0 is the first."""
        self._entries[index] = dict(enumerate(entries))

    def add_subs(self, index: int, entries: dict[int, Entry]) -> None:
        """A record with holes."""
        self._entries[index] = dict(entries)

    def find(self, index: int, sub: int) -> Entry:
        """The entry, or the refusal that says which of the two is not there."""
        if index not in self._entries:
            raise SdoRefusal(NO_OBJECT)
        if sub not in self._entries[index]:
            raise SdoRefusal(NO_SUB_INDEX)
        return self._entries[index][sub]

    def serve(self, request: bytes) -> bytes | None:
        """The server's reply to a request of 8 bytes; None for what needs none."""
        if len(request) != 8:
            return None
        command, place = request[0] >> 5, request[1:4]
        if command == _ABORT:
            return None
        try:
            if command == _UPLOAD:
                return self._upload(place)
            if command == _DOWNLOAD and request[0] & 0x02:
                return self._download(request[0], place, request[4:])
            raise SdoRefusal(UNKNOWN_COMMAND)
        except SdoRefusal as refusal:
            return bytes([_ABORT << 5]) + place + refusal.code.to_bytes(4, "little")

    def _upload(self, place: bytes) -> bytes:
        entry = self.find(*_split(place))
        value = entry.read() % (1 << 8 * entry.size)
        head = 0x43 | (4 - entry.size) << 2
        return bytes([head]) + place + value.to_bytes(entry.size, "little").ljust(4, b"\0")

    def _download(self, command: int, place: bytes, data: bytes) -> bytes:
        entry = self.find(*_split(place))
        if entry.write is None:
            raise SdoRefusal(READ_ONLY)
        size = 4 - (command >> 2 & 3) if command & 0x01 else entry.size
        if size != entry.size:
            raise SdoRefusal(WRONG_LENGTH)
        entry.write(int.from_bytes(data[:size], "little"))
        return bytes([0x60]) + place + bytes(4)


def _split(place: bytes) -> tuple[int, int]:
    return int.from_bytes(place[:2], "little"), place[2]
