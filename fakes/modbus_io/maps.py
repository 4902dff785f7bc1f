"""Register maps of common input modules, after their public manuals; addresses are 0-based.

What a manual leaves to the device's web page (counter mode per channel, filters) is taken as configured.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from fakes.modbus_io.module import Module, RegisterMap, Snapshot
from fakes.modbus_io.pdu import ILLEGAL_ADDRESS, ILLEGAL_VALUE, Refused

Action = Callable[[], None]
T = TypeVar("T")


@dataclass(frozen=True)
class Generic:
    """Inputs at FC2 0.., 32-bit counters at FC4 0.., and what a plain module offers beside them.

    Coil *i* clears counter *i*; the counters are mirrored at FC3 0.., where writing sets them. A module
    without counters has neither these registers nor the coils.
    """

    low_word_first: bool = False
    channels: int = 16
    outputs: int = 0

    def coils(self, now: Snapshot) -> Mapping[int, bool]:
        return dict.fromkeys(range(self.channels if now.has_counters else 0), False)

    def discrete(self, now: Snapshot) -> Mapping[int, bool]:
        return _at(0, now.levels)

    def holding(self, now: Snapshot) -> Mapping[int, int]:
        return self.input(now)

    def input(self, now: Snapshot) -> Mapping[int, int]:
        return _at(0, _halves(now.counts, self.low_word_first)) if now.has_counters else {}

    def coil(self, module: Module, address: int, on: bool) -> Action:
        channel = _channel(address, self.channels if module.has_counters else 0)
        return lambda: module.set_count(channel, 0) if on else None

    def register(self, module: Module, address: int, value: int) -> Action:
        channel = _channel(address // 2, self.channels if module.has_counters else 0)
        high = (address % 2 == 1) == self.low_word_first

        def write() -> None:
            count = module.count(channel)
            kept = count & 0xFFFF if high else count & 0xFFFF0000
            module.set_count(channel, kept | (value << 16 if high else value))

        return write


@dataclass(frozen=True)
class IoLogikE1210:
    """Moxa ioLogik E1210: 16 inputs. FC4 0x10..0x30 is counters and levels in one read.

    Coils: 0x100.. start (1) and stop, 0x110.. clear (1 only), 0x120.. overflow, cleared by 0.
    """

    channels: int = 16
    outputs: int = 0

    def coils(self, now: Snapshot) -> Mapping[int, bool]:
        return {
            **_at(0x100, now.counting),
            **dict.fromkeys(range(0x110, 0x120), False),
            **_at(0x120, now.overflown),
        }

    def discrete(self, now: Snapshot) -> Mapping[int, bool]:
        return _at(0, now.levels)

    def holding(self, now: Snapshot) -> Mapping[int, int]:
        return {}

    def input(self, now: Snapshot) -> Mapping[int, int]:
        return {**_at(0x10, _halves(now.counts, low_first=False)), 0x30: _word(now.levels)}

    def coil(self, module: Module, address: int, on: bool) -> Action:
        group, channel = address & ~0xF, address & 0xF
        match group:
            case 0x100:
                return lambda: module.run_counter(channel, on)
            case 0x110 if on:
                return lambda: module.set_count(channel, 0)
            case 0x120 if not on:
                return lambda: module.clear_overflow(channel)
            case 0x110 | 0x120:
                raise Refused(ILLEGAL_VALUE)
        raise Refused(ILLEGAL_ADDRESS)

    def register(self, module: Module, address: int, value: int) -> Action:
        raise Refused(ILLEGAL_ADDRESS)


@dataclass(frozen=True)
class Adam6050:
    """Advantech ADAM-6050: 12 inputs at coils 0.. and FC2 0.., 6 outputs at coils 16..

    Counters are registers 0.., low word first; words of all inputs at 300 and of all outputs at 302. From
    coil 32 on each channel has four: start (1) and stop, clear, overflow, and a latch that stays off.
    """

    channels: int = 12
    outputs: int = 6

    def coils(self, now: Snapshot) -> Mapping[int, bool]:
        table = {**_at(0, now.levels), **_at(16, now.outputs)}
        for channel in range(self.channels):
            states = (now.counting[channel], False, now.overflown[channel], False)
            table.update(_at(32 + 4 * channel, states))
        return table

    def discrete(self, now: Snapshot) -> Mapping[int, bool]:
        return _at(0, now.levels)

    def holding(self, now: Snapshot) -> Mapping[int, int]:
        counters = _at(0, _halves(now.counts, low_first=True))
        return {**counters, 300: _word(now.levels), 302: _word(now.outputs)}

    def input(self, now: Snapshot) -> Mapping[int, int]:
        return self.holding(now)

    def coil(self, module: Module, address: int, on: bool) -> Action:
        if 16 <= address < 16 + self.outputs:
            return lambda: module.set_output(address - 16, on)
        channel, item = divmod(address - 32, 4)
        _channel(channel, self.channels)
        match item:
            case 0:
                return lambda: module.run_counter(channel, on)
            case 1:
                return lambda: module.set_count(channel, 0) if on else None
            case 2:
                return lambda: module.clear_overflow(channel)
        return lambda: None

    def register(self, module: Module, address: int, value: int) -> Action:
        if address != 302:
            raise Refused(ILLEGAL_ADDRESS)
        return lambda: _set_outputs(module, value, self.outputs)


@dataclass(frozen=True)
class Wago750:
    """WAGO 750 coupler with 16 digital inputs and 8 outputs: an image of bits and of words, no counters.

    Inputs at FC1/FC2 0.. and as word 0 of FC3/FC4; outputs read back from 0x200 and are written at 0.. or at
    0x200... Registers 0x1022..0x1025 tell the bits of the images: analogue out, in, digital out, in.
    """

    channels: int = 16
    outputs: int = 8

    def coils(self, now: Snapshot) -> Mapping[int, bool]:
        return {**_at(0, now.levels), **_at(0x200, now.outputs)}

    def discrete(self, now: Snapshot) -> Mapping[int, bool]:
        return self.coils(now)

    def holding(self, now: Snapshot) -> Mapping[int, int]:
        sizes = (0, 0, self.outputs, self.channels)
        return {0: _word(now.levels), 0x200: _word(now.outputs), **_at(0x1022, sizes)}

    def input(self, now: Snapshot) -> Mapping[int, int]:
        return self.holding(now)

    def coil(self, module: Module, address: int, on: bool) -> Action:
        channel = _channel(address & ~0x200, self.outputs)
        return lambda: module.set_output(channel, on)

    def register(self, module: Module, address: int, value: int) -> Action:
        if address not in (0, 0x200):
            raise Refused(ILLEGAL_ADDRESS)
        return lambda: _set_outputs(module, value, self.outputs)


MAPS: dict[str, Callable[[], RegisterMap]] = {
    "generic": Generic,
    "ioLogik-E1210": IoLogikE1210,
    "ADAM-6050": Adam6050,
    "WAGO-750": Wago750,
}


def register_map(module: str, low_word_first: bool = False) -> RegisterMap:
    """The map of ``module``; only the generic one has its word order to choose."""
    return Generic(low_word_first) if module == "generic" else MAPS[module]()


def _at(start: int, values: Sequence[T]) -> dict[int, T]:
    return dict(enumerate(values, start))


def _halves(counts: Sequence[int], low_first: bool) -> list[int]:
    def halves() -> Iterator[int]:
        for count in counts:
            high, low = count >> 16, count & 0xFFFF
            yield from (low, high) if low_first else (high, low)

    return list(halves())


def _word(bits: Sequence[bool]) -> int:
    return sum(bit << index for index, bit in enumerate(bits))


def _channel(channel: int, channels: int) -> int:
    if not 0 <= channel < channels:
        raise Refused(ILLEGAL_ADDRESS)
    return channel


def _set_outputs(module: Module, word: int, outputs: int) -> None:
    for channel in range(outputs):
        module.set_output(channel, bool(word >> channel & 1))
