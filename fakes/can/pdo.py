"""A transmit PDO: its settings as objects, with CiA 301's order of changing them, and its frame."""

from collections.abc import Callable

from fakes.can.objects import (
    NOT_MAPPABLE,
    OUT_OF_RANGE,
    PDO_TOO_LONG,
    WRONG_STATE,
    Dictionary,
    Entry,
    SdoRefusal,
    constant,
)

OFF, NO_REMOTE = 1 << 31, 1 << 30
_MOST_MAPPED, _MOST_BITS = 4, 64
_SYNCHRONOUS = range(1, 241)
_EVENTS = (254, 255)


class Tpdo:
    """``mappable``: entry of the mapping (index, sub-index, bits) and how to read it at a time.

    The identifier changes only while the PDO is off, the mapping only while it is off and has no entries.
    """

    def __init__(
        self, cob_id: int, kind: int, mapping: list[int], mappable: dict[int, Callable[[float], int]]
    ) -> None:
        self._cob_id, self.kind, self._mapping = cob_id | NO_REMOTE, kind, list(mapping)
        self._count, self._mappable = len(mapping), mappable
        self.inhibit, self.timer_ms = 0, 0
        self.changed: Callable[[], None] = lambda: None

    @property
    def id(self) -> int:
        return self._cob_id & 0x7FF

    @property
    def period_s(self) -> float:
        """Interval of sending by the timer; 0 when it does not send by itself."""
        by_timer = not self._cob_id & OFF and self.kind in _EVENTS
        return self.timer_ms / 1000.0 if by_timer else 0.0

    @property
    def inhibit_s(self) -> float:
        """The shortest time between two frames; a millisecond where none is set."""
        return max(1e-4 * self.inhibit, 1e-3)

    def answers_sync(self, counter: int) -> bool:
        """Whether the ``counter``-th SYNC makes it send."""
        return not self._cob_id & OFF and self.kind in _SYNCHRONOUS and counter % self.kind == 0

    def data(self, t: float) -> bytes:
        """The mapped values at ``t``, one after the other, low byte first."""
        value = bits = 0
        for entry in self._mapping[: self._count]:
            width = entry & 0xFF
            value |= (self._mappable[entry](t) % (1 << width)) << bits
            bits += width
        return value.to_bytes(bits // 8, "little")

    def publish(self, objects: Dictionary, number: int) -> None:
        """Add settings and mapping of TPDO ``number`` (from 1)."""
        objects.add_subs(
            0x1800 + number - 1,
            {
                0: constant(1, 5),
                1: Entry(4, lambda: self._cob_id, self._set_cob_id),
                2: Entry(1, lambda: self.kind, self._set_kind),
                3: Entry(2, lambda: self.inhibit, self._set_inhibit),
                5: Entry(2, lambda: self.timer_ms, self.set_timer),
            },
        )
        slots = {k: self._slot(k - 1) for k in range(1, _MOST_MAPPED + 1)}
        objects.add_subs(0x1A00 + number - 1, {0: Entry(1, lambda: self._count, self._set_count), **slots})

    def set_timer(self, milliseconds: int) -> None:
        """Send every so often; 0: not by itself."""
        self.timer_ms = milliseconds
        self.changed()

    def _set_cob_id(self, value: int) -> None:
        if not (self._cob_id | value) & OFF and value != self._cob_id:
            raise SdoRefusal(WRONG_STATE)
        if not 0x181 <= value & 0x1FFFFFFF <= 0x57F:
            raise SdoRefusal(OUT_OF_RANGE)
        self._cob_id = value
        self.changed()

    def _set_kind(self, kind: int) -> None:
        if kind not in _SYNCHRONOUS and kind not in _EVENTS:
            raise SdoRefusal(OUT_OF_RANGE)
        self.kind = kind
        self.changed()

    def _set_inhibit(self, value: int) -> None:
        if not self._cob_id & OFF:
            raise SdoRefusal(WRONG_STATE)
        self.inhibit = value

    def _set_count(self, count: int) -> None:
        if not self._cob_id & OFF:
            raise SdoRefusal(WRONG_STATE)
        entries = self._mapping[:count]
        if count > len(self._mapping) or any(entry not in self._mappable for entry in entries):
            raise SdoRefusal(NOT_MAPPABLE)
        if sum(entry & 0xFF for entry in entries) > _MOST_BITS:
            raise SdoRefusal(PDO_TOO_LONG)
        self._count = count

    def _slot(self, k: int) -> Entry:
        def write(entry: int) -> None:
            if self._count or not self._cob_id & OFF:
                raise SdoRefusal(WRONG_STATE)
            if entry not in self._mappable:
                raise SdoRefusal(NOT_MAPPABLE)
            self._mapping += [0] * (k + 1 - len(self._mapping))
            self._mapping[k] = entry

        return Entry(4, lambda: self._mapping[k] if k < len(self._mapping) else 0, write)
