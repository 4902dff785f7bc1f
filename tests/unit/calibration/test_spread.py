"""The distribution of times that a run keeps of its own lateness."""

import numpy as np
import pytest

from cell.time_histogram import TimeHistogram


def test_quantiles_are_right_to_six_percent() -> None:
    times = np.random.default_rng(3).lognormal(np.log(2e-3), 1.0, 20_000)
    subject = TimeHistogram()
    for t in times:
        subject.add(float(t))
    summary = subject.summary()
    for key, fraction in (("p50_s", 0.5), ("p99_s", 0.99), ("p999_s", 0.999)):
        assert summary[key] == pytest.approx(np.quantile(times, fraction, method="higher"), rel=0.06)
    assert summary["max_s"] == pytest.approx(times.max(), abs=1e-6)
    assert summary["n"] == len(times)


@pytest.mark.parametrize("seconds", [-1.0, 0.0, 1e-9, 1e3, 1e9])
def test_times_outside_the_bins_are_counted(seconds: float) -> None:
    subject = TimeHistogram()
    subject.add(seconds)
    assert subject.count == 1
    assert subject.quantile(0.5) <= max(seconds, 0.0)


def test_nothing_counted_is_all_zero() -> None:
    assert set(TimeHistogram().summary().values()) == {0}
