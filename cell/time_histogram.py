"""A distribution of times in constant memory, for what is measured hundreds of times a second."""

import math

SHORTEST_S = 1e-5
PER_DECADE = 40  # a quantile is right to 6 %
DECADES = 7


class TimeHistogram:
    """Counts of times in bins of equal ratio, from 10 us to 100 s, and the longest of them."""

    def __init__(self) -> None:
        self.count = 0
        self.longest_s = 0.0
        self._bins = [0] * (PER_DECADE * DECADES + 1)

    def add(self, seconds: float) -> None:
        """Count one time; what is shorter than 10 us, or negative, counts as 10 us."""
        self.count += 1
        self.longest_s = max(self.longest_s, seconds)
        ratio = max(seconds, SHORTEST_S) / SHORTEST_S
        self._bins[min(math.ceil(PER_DECADE * math.log10(ratio)), len(self._bins) - 1)] += 1

    def quantile(self, fraction: float) -> float:
        """A time that ``fraction`` of those counted do not exceed, s; 0.0 when none was counted."""
        wanted, seen = fraction * self.count, 0
        for k, count in enumerate(self._bins):
            seen += count
            if count and seen >= wanted:
                return min(SHORTEST_S * math.pow(10.0, k / PER_DECADE), self.longest_s)
        return 0.0

    def summary(self) -> dict[str, float]:
        """``n``, ``p50_s``, ``p99_s``, ``p999_s`` and ``max_s``."""
        p50, p99, p999 = (round(self.quantile(f), 6) for f in (0.5, 0.99, 0.999))
        return {
            "n": self.count,
            "p50_s": p50,
            "p99_s": p99,
            "p999_s": p999,
            "max_s": round(self.longest_s, 6),
        }
