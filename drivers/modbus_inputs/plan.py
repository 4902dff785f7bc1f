"""Which spans one poll reads, and how levels and counts come out of the replies."""

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.modbus.registers import Span, words_to_int
from drivers.modbus_inputs.models import CounterPlace, LevelPlace, ModuleModel


@dataclass(frozen=True)
class Reading:
    """Electrical levels and counts by input; no counts from a module that does not count."""

    levels: tuple[bool, ...]
    counts: tuple[int, ...]


class ReadPlan:
    """The spans to read for ``channels``, counters first when one span cannot hold both.

    A level that is read after its counter can only be ahead of it, by at most one rising edge; the other
    way round a count could speak of an edge that the level does not show yet.
    """

    def __init__(self, model: ModuleModel, channels: Sequence[int]) -> None:
        self._levels, self._counters = model.levels, model.counters
        self._channels = tuple(channels)
        levels = _level_span(model.levels, self._channels)
        counters = None if model.counters is None else _counter_span(model.counters, self._channels)
        if counters is None:
            self.spans: tuple[Span, ...] = (levels,)
        else:
            self.spans = _joined(counters, levels) or (counters, levels)

    @property
    def width(self) -> int:
        """Bits of a counter; 0 without counters."""
        return 0 if self._counters is None else self._counters.width

    @property
    def bytes_per_poll(self) -> int:
        """Length of requests and replies on a serial line."""
        return sum(8 + 5 + ((s.count + 7) // 8 if s.table.has_bits else 2 * s.count) for s in self.spans)

    def decode(self, replies: Sequence[Sequence[int]]) -> Reading:
        """Levels and counts from the replies to ``spans``."""
        levels = _decode_levels(self._levels, self.spans[-1], replies[-1], self._channels)
        if self._counters is None:
            return Reading(levels, ())
        return Reading(levels, _decode_counts(self._counters, self.spans[0], replies[0], self._channels))


def _level_span(place: LevelPlace, channels: Sequence[int]) -> Span:
    first, last = min(channels), max(channels)
    if not place.table.has_bits:
        first, last = first // 16, last // 16
    return Span(place.table, place.start + first, last - first + 1)


def _counter_span(place: CounterPlace, channels: Sequence[int]) -> Span:
    first, last = min(channels), max(channels)
    count = (last - first + 1) * place.registers
    return Span(place.table, place.start + first * place.registers, count)


def _joined(a: Span, b: Span) -> tuple[Span] | None:
    start = min(a.start, b.start)
    count = max(a.start + a.count, b.start + b.count) - start
    if a.table is not b.table or count > a.table.most:
        return None
    return (Span(a.table, start, count),)


def _decode_levels(
    place: LevelPlace, span: Span, reply: Sequence[int], channels: Sequence[int]
) -> tuple[bool, ...]:
    at = place.start - span.start
    if place.table.has_bits:
        return tuple(bool(reply[at + k]) for k in channels)
    return tuple(bool(reply[at + k // 16] >> k % 16 & 1) for k in channels)


def _decode_counts(
    place: CounterPlace, span: Span, reply: Sequence[int], channels: Sequence[int]
) -> tuple[int, ...]:
    at, size = place.start - span.start, place.registers
    return tuple(
        words_to_int(reply[at + k * size : at + (k + 1) * size], place.low_word_first) for k in channels
    )
