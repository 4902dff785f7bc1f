"""One input of a module: from the edges of its sensor to the level and the count that the module has.

What the sensor shows bounces at the contact, may be covered by a stuck contact, passes the module's filter
and is looked at by its scan. Each step makes a list of changes from a list of changes.
"""

from bisect import bisect_right
from collections.abc import Sequence
from math import ceil, inf

from fakes.world.beams.beams import Beams

Change = tuple[float, bool]  # when, and the level from then on

_BOUNCES = 4
_REVISABLE_S = 1.0  # what is older than this is not computed again
_MOST_CHANGES = 4096


class InputChannel:
    """An input as a function of time; ``beam`` may be None for one that nothing is wired to."""

    def __init__(
        self, beams: Beams, beam: str | None, inverted: bool, filter_s: float, scan_s: float, t0: float
    ) -> None:
        self._beams, self._beam, self._inverted = beams, beam, inverted
        self._filter_s, self._scan_s, self._t0 = filter_s, scan_s, t0
        self._bounce_s: list[tuple[float, float]] = [(-inf, 0.0)]
        self._stuck: list[tuple[float, bool | None]] = [(-inf, None)]
        self._revision = 0
        # Changes up to the settled time are for good, those after it are made anew when there is reason to.
        self._settled, self._settled_changes = -inf, 0
        self._at_first = self._raw_level(-inf)
        self._dropped = 0
        self._changes: list[float] = []
        self._key: object = None

    def level(self, t: float) -> bool:
        """The electrical level that the module has at ``t``."""
        return self._level(self._index(t))

    def count(self, t: float) -> int:
        """How many rising edges the module has seen by ``t``."""
        return self.image(t)[1]

    def image(self, t: float) -> tuple[bool, int]:
        """What :meth:`level` and :meth:`count` say at ``t``."""
        changes = self._index(t)
        return self._level(changes), (changes + (not self._at_first)) // 2

    def quiet_until(self, t: float) -> float:
        """Until when the image at ``t`` is the same, as far as has been looked ahead."""
        following = bisect_right(self._changes, t)
        own = self._changes[following] if following < len(self._changes) else inf
        return own if self._beam is None else min(own, self._beams.quiet_until(self._beam, t))

    def bounce(self, t: float, duration_s: float) -> None:
        """From ``t`` on the contact bounces for so long at every edge."""
        self._bounce_s.append((t, duration_s))
        self._revision += 1

    def stick(self, t: float, level: bool | None) -> None:
        """From ``t`` on the contact has this level whatever the sensor does; None sets it free."""
        self._stuck.append((t, level))
        self._revision += 1

    # -- how it comes about

    def _index(self, t: float) -> int:
        if self._beam is not None and t > self._settled:
            key = self._beams.index(self._beam, t), self._beams.version, self._revision
            if key != self._key:
                self._key = key
                self._work_out(self._beam, t)
        return self._dropped + bisect_right(self._changes, t)

    def _level(self, changes: int) -> bool:
        return self._at_first != bool(changes % 2)

    def _raw_level(self, t: float) -> bool:
        return self._beam is not None and self._beams.level(self._beam, t) != self._inverted

    def _work_out(self, beam: str, t: float) -> None:
        del self._changes[self._settled_changes :]
        sensor = [
            (when, level != self._inverted) for when, level in self._beams.edges(beam, self._settled, t)
        ]
        contact = self._cover(self._bounced(sensor), self._raw_level(self._settled))
        before = self._level(self._dropped + len(self._changes))
        self._changes += [when for when, _ in self._scanned(self._filtered(contact, before), before)]
        self._settle([when for when, _ in contact], t)

    def _settle(self, contact: Sequence[float], t: float) -> None:
        """Move the settled time to the last quiet moment that is old enough."""
        if not contact:
            return
        quiet_s = self._filter_s + 2.0 * self._scan_s + max(b for _, b in self._bounce_s) + 1e-6
        moments = [when + quiet_s for when in contact]
        quiet = [
            moment
            for moment, following in zip(moments, [*contact[1:], inf], strict=True)
            if moment < min(following, t - _REVISABLE_S)
        ]
        if not quiet:
            return
        self._settled = quiet[-1]
        self._settled_changes = bisect_right(self._changes, self._settled)
        if self._settled_changes > _MOST_CHANGES:
            old = self._settled_changes // 4 * 2
            del self._changes[:old]
            self._dropped, self._settled_changes = self._dropped + old, self._settled_changes - old

    def _bounced(self, edges: Sequence[Change]) -> list[Change]:
        out: list[Change] = []
        for k, (when, level) in enumerate(edges):
            following = edges[k + 1][0] if k + 1 < len(edges) else inf
            duration = self._bounce_s[bisect_right(self._bounce_s, (when, inf)) - 1][1]
            times = [when + duration * j / _BOUNCES for j in range(_BOUNCES + 1 if duration else 1)]
            out += [(t, level != bool(j % 2)) for j, t in enumerate(times) if t < following]
        return out

    def _cover(self, edges: Sequence[Change], before: bool) -> list[Change]:
        """The contact's changes, whose level without a stuck contact was ``before`` at the settled time."""
        if len(self._stuck) == 1:
            return list(edges)
        free, out = before, []
        stuck = self._stuck[bisect_right(self._stuck, self._settled, key=_when) - 1][1]
        events = [(when, 0, level) for when, level in edges]
        events += [(when, 1, level) for when, level in self._stuck if when > self._settled]  # type: ignore[misc]
        last = free if stuck is None else stuck
        for when, is_stuck, level in sorted(events, key=lambda e: e[:2]):
            if is_stuck:
                stuck = level
            else:
                free = level
            now = free if stuck is None else stuck
            if now != last:
                out.append((when, now))
            last = now
        return out

    def _filtered(self, changes: Sequence[Change], before: bool) -> list[Change]:
        """A level is taken over once it has lasted for the filter's time."""
        if not self._filter_s:
            return list(changes)
        out: list[Change] = []
        for k, (when, level) in enumerate(changes):
            following = changes[k + 1][0] if k + 1 < len(changes) else inf
            if following - when >= self._filter_s and level != before:
                out.append((when + self._filter_s, level))
                before = level
        return out

    def _scanned(self, changes: Sequence[Change], before: bool) -> list[Change]:
        """What a look every scan time sees."""
        if not self._scan_s:
            return list(changes)
        seen: dict[int, bool] = {}
        for when, level in changes:
            seen[ceil((when - self._t0) / self._scan_s - 1e-9)] = level
        out: list[Change] = []
        for look, level in seen.items():
            if level != before:
                out.append((self._t0 + look * self._scan_s, level))
                before = level
        return out


def _when(event: tuple[float, object]) -> float:
    return event[0]
