"""Time-stamped readings and the history they live in."""

from bisect import bisect_left
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from itertools import islice
from typing import Any, Generic, Protocol, TypeVar

from cell.clock import Clock
from cell.errors import error
from cell.own_delay import busy_words
from cell.time_histogram import TimeHistogram

T = TypeVar("T")

GAP_S = 0.1


class Quality(StrEnum):
    """How far a reading can be trusted."""

    GOOD = "good"
    DEGRADED = "degraded"


@dataclass(frozen=True, slots=True)
class Sample(Generic[T]):
    """One reading: ``value`` was so at ``t`` (CLOCK_MONOTONIC seconds), give or take ``dt`` seconds."""

    value: T
    t: float
    dt: float
    seq: int
    quality: Quality = Quality.GOOD


class Readings(Protocol[T]):
    """What a reader sees of a :class:`Stream`; its methods are described there."""

    @property
    def name(self) -> str: ...
    @property
    def clock(self) -> Clock: ...
    @property
    def epoch(self) -> int: ...
    @property
    def gaps(self) -> int: ...
    @property
    def last_gap(self) -> tuple[float, float] | None: ...
    def subscribe(self, listener: Callable[[Sample[T]], None]) -> Callable[[], None]: ...
    def last(self) -> Sample[T] | None: ...
    def latest(self, max_age: float) -> Sample[T]: ...
    def between(self, t0: float, t1: float) -> list[Sample[T]]: ...


class Stream(Generic[T]):
    """Recent samples of one source, oldest first.

    A new ``epoch`` begins at every reconnect: interpolation and waiting never bridge two epochs.
    ``gaps`` counts the samples that the source numbered and we did not get; ``last_gap`` is the latest time
    of more than ``GAP_S`` without a sample, from stamp to stamp, an epoch's end included. ``ages``, when
    set, counts how old each sample was when its listeners saw it, and the newest one when it was asked for.
    """

    def __init__(self, name: str, clock: Clock, keep: int = 4096) -> None:
        self.name, self.clock = name, clock
        self.epoch = 0
        self.received = 0
        self.gaps = 0
        self.last_gap: tuple[float, float] | None = None
        self.ages: TimeHistogram | None = None
        self._newest_t: float | None = None  # of all epochs
        self._samples: deque[Sample[T]] = deque(maxlen=keep)
        self._listeners: list[Callable[[Sample[T]], None]] = []

    def new_epoch(self) -> None:
        """Forget the history: the source was reconnected or its meaning changed."""
        self.epoch += 1
        self._samples.clear()

    def push(self, sample: Sample[T]) -> None:
        """Append a sample; ``seq`` and ``t`` must grow within an epoch."""
        if self._samples:
            last = self._samples[-1]
            if sample.seq <= last.seq or sample.t < last.t:
                raise ValueError(f"{self.name}: sample {sample.seq} does not follow {last.seq}")
            self.gaps += sample.seq - last.seq - 1
        if self._newest_t is not None and sample.t - self._newest_t > GAP_S:
            self.last_gap = self._newest_t, sample.t
        self._newest_t = sample.t
        self._samples.append(sample)
        self.received += 1
        if self.ages is not None:
            self.ages.add(self.clock.now() - sample.t)
        for listener in tuple(self._listeners):
            listener(sample)

    def subscribe(self, listener: Callable[[Sample[T]], None]) -> Callable[[], None]:
        """Call ``listener`` on every new sample; the returned function ends that."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def last(self) -> Sample[T] | None:
        """The newest sample of any age; for display only, decisions use :meth:`latest`."""
        return self._samples[-1] if self._samples else None

    def latest(self, max_age: float) -> Sample[T]:
        """The newest sample, if it is at most ``max_age`` seconds old; else ``STALE_DATA``."""
        if not self._samples:
            raise error("STALE_DATA", f"{self.name} has given no sample yet")
        sample = self._samples[-1]
        age = self.clock.now() - sample.t
        if self.ages is not None:
            self.ages.add(age)
        if age > max_age:
            raise error(
                "STALE_DATA",
                f"{self.name}: newest sample is {age:.3f} s old, limit {max_age:.3f} s"
                f"{busy_words(self.clock.now())}",
            )
        return sample

    def between(self, t0: float, t1: float) -> list[Sample[T]]:
        """The samples with ``t0 <= t <= t1`` of this epoch."""
        first, last = (bisect_left(self._samples, t, key=_time) for t in (t0, t1 + 1e-12))
        return list(islice(self._samples, first, last))

    def at(self, t: float, interpolate: Callable[[T, T, float], T], max_bracket: float = 0.1) -> T:
        """The value at ``t`` by ``interpolate(before, after, fraction)``; never extrapolates."""
        samples = self._samples
        i = bisect_left(samples, t, key=_time)
        if i < len(samples) and samples[i].t == t:
            return samples[i].value
        if i == 0 or i == len(samples):
            raise error("STALE_DATA", f"{self.name} has no samples on both sides of t={t:.4f} s")
        a, b = samples[i - 1], samples[i]
        if b.t - a.t > max_bracket:
            raise error("STALE_DATA", f"{self.name} has a gap of {b.t - a.t:.3f} s around t={t:.4f} s")
        return interpolate(a.value, b.value, (t - a.t) / (b.t - a.t))


def _time(sample: Sample[Any]) -> float:
    return sample.t


class Mapped(Generic[T]):
    """The readings of ``source`` with ``see`` applied to every value, when somebody looks at it.

    Stamps are earlier by ``late_s``; :meth:`latest` judges the age by those of the source. All who look at
    the newest sample see one and the same.
    """

    def __init__(self, source: Readings[T], see: Callable[[T], T], late_s: float = 0.0) -> None:
        self._source, self._see, self._late_s = source, see, late_s
        self._newest: tuple[Sample[T], Sample[T]] | None = None  # as the source has it, and as it is seen

    @property
    def name(self) -> str:
        return self._source.name

    @property
    def clock(self) -> Clock:
        return self._source.clock

    @property
    def epoch(self) -> int:
        return self._source.epoch

    @property
    def gaps(self) -> int:
        return self._source.gaps

    @property
    def last_gap(self) -> tuple[float, float] | None:
        gap = self._source.last_gap
        return None if gap is None else (gap[0] - self._late_s, gap[1] - self._late_s)

    def subscribe(self, listener: Callable[[Sample[T]], None]) -> Callable[[], None]:
        return self._source.subscribe(lambda sample: listener(self._seen(sample)))

    def last(self) -> Sample[T] | None:
        sample = self._source.last()
        return None if sample is None else self._seen(sample)

    def latest(self, max_age: float) -> Sample[T]:
        return self._seen(self._source.latest(max_age))

    def between(self, t0: float, t1: float) -> list[Sample[T]]:
        return [self._seen(sample) for sample in self._source.between(t0 + self._late_s, t1 + self._late_s)]

    def _seen(self, sample: Sample[T]) -> Sample[T]:
        newest = self._newest
        if newest is None or newest[0] is not sample:
            t = sample.t - self._late_s
            seen = Sample(self._see(sample.value), t, sample.dt, sample.seq, sample.quality)
            newest = self._newest = sample, seen
        return newest[1]
