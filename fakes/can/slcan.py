"""A serial CAN adapter with the ASCII commands of Lawicel's, on a pseudo-terminal."""

from collections.abc import Callable
from pathlib import Path

from fakes.can.bus import CanBus, Frame
from fakes.faults.vocabulary import LinkFaults
from fakes.wire.terminal import PseudoTerminal

_OK, _ERROR = b"\r", b"\a"
_RATES = (10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)
_LONGEST = 64
_BUS_ERROR = 0x80
_HEADS = {"t": (3, False), "T": (8, True), "r": (3, False), "R": (8, True)}


class SlcanAdapter:
    """``path`` is the line that a client opens; the channel is closed until it sends O or L."""

    def __init__(self, bus: CanBus, path: Path, faults: LinkFaults, now: Callable[[], float]) -> None:
        self._bus, self._send = bus, bus.join(self._receive).send
        self._terminal = PseudoTerminal(path, faults, self._take)
        self._buffer = bytearray()
        self._channel = ""  # O, L or closed
        self._rate = 0
        self._now = now

    def plug_in(self) -> None:
        """Appear, with the channel closed."""
        self._buffer.clear()
        self._channel = ""
        self._terminal.open()

    def pull_out(self) -> None:
        """Disappear; harmless when not there."""
        self._terminal.close()
        self._channel = ""

    @property
    def path(self) -> Path:
        """The name of its line."""
        return self._terminal.path

    def junk(self) -> None:
        """Lines that are no frames: no hexadecimal digits, one cut off, one of noise."""
        self._terminal.send(b"tXYZ\rt1854A0\r\xff\x80q\r")

    @property
    def _hears(self) -> bool:
        return bool(self._channel) and self._rate == self._bus.bit_rate

    def _receive(self, frame: Frame, t: float) -> None:
        if self._hears:
            self._terminal.send(_line(frame).encode() + _OK)

    def _take(self, data: bytes) -> None:
        self._buffer += data
        *lines, rest = self._buffer.split(b"\r")
        self._buffer = bytearray(rest[-_LONGEST:])
        for line in lines:
            self._terminal.send(self._answer(line.decode("ascii", "replace")))

    def _answer(self, line: str) -> bytes:
        command, rest = line[:1], line[1:]
        match command:
            case "":
                return _OK
            case "C":
                self._channel = ""
                return _OK
            case "S" if not self._channel and rest.isdecimal() and int(rest) < len(_RATES):
                self._rate = _RATES[int(rest)]
                return _OK
            case "O" | "L" if not self._channel and self._rate and not rest:
                self._channel = command
                return _OK
            case "V":
                return b"V1013" + _OK
            case "N":
                return b"N9999" + _OK
            case "F" if self._channel:
                wrong = self._bus.faults.off or not self._hears
                return b"F%02X" % (_BUS_ERROR if wrong else 0) + _OK
            case "t" | "T" | "r" | "R" if self._channel == "O":
                return self._transmit(line)
        return _ERROR

    def _transmit(self, line: str) -> bytes:
        digits, extended = _HEADS[line[0]]
        try:
            identifier, length = int(line[1 : 1 + digits], 16), int(line[1 + digits], 16)
            data = bytes.fromhex(line[2 + digits :])
        except (ValueError, IndexError):
            return _ERROR
        remote = line[0] in "rR"
        if length > 8 or len(data) != (0 if remote else length):
            return _ERROR
        if self._hears:
            self._send(Frame(identifier, data, extended, remote), self._now())
        return b"z" + _OK


def _line(frame: Frame) -> str:
    """``t1854A0B0C0D0`` and the like."""
    head = ("R" if frame.extended else "r") if frame.remote else ("T" if frame.extended else "t")
    identifier = f"{frame.id:08X}" if frame.extended else f"{frame.id:03X}"
    return f"{head}{identifier}{len(frame.data)}{frame.data.hex().upper()}"
