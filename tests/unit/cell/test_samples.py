"""A reading is used only while it is true."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cell.clock import ClockModel
from cell.errors import CellError
from cell.samples import Mapped, Sample, Stream


@dataclass
class HandClock:
    t: float = 0.0

    def now(self) -> float:
        return self.t

    async def sleep(self, seconds: float) -> None:
        self.t += seconds


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.fixture
def subject(clock: HandClock) -> Stream[float]:
    return Stream("gauge", clock)


def linear(a: float, b: float, f: float) -> float:
    return a + f * (b - a)


def fill(stream: Stream[float], n: int = 11) -> None:
    for i in range(n):
        stream.push(Sample(float(i), 0.1 * i, 0.0, i))


def test_an_empty_stream_offers_nothing(subject: Stream[float]) -> None:
    with pytest.raises(CellError, match="no sample yet"):
        subject.latest(1.0)


def test_an_old_sample_is_refused_with_its_age(subject: Stream[float], clock: HandClock) -> None:
    fill(subject)
    clock.t = 1.05
    assert subject.latest(0.06).value == 10.0
    clock.t = 1.5
    with pytest.raises(CellError, match=r"gauge: newest sample is 0\.500 s old, limit 0\.100 s"):
        subject.latest(0.1)


@given(st.floats(0.0, 1.0))
def test_values_between_samples_are_interpolated(t: float) -> None:
    subject: Stream[float] = Stream("gauge", HandClock())
    fill(subject)
    assert subject.at(t, linear, max_bracket=0.2) == pytest.approx(10 * t, abs=1e-9)


@pytest.mark.parametrize("t", [-0.01, 1.01])
def test_nothing_is_extrapolated(subject: Stream[float], t: float) -> None:
    fill(subject)
    with pytest.raises(CellError, match="both sides"):
        subject.at(t, linear)


def test_a_gap_is_counted_and_not_bridged(subject: Stream[float]) -> None:
    subject.push(Sample(0.0, 0.0, 0.0, 0))
    subject.push(Sample(1.0, 0.5, 0.0, 5))
    assert subject.gaps == 4
    with pytest.raises(CellError, match=r"gap of 0\.500 s"):
        subject.at(0.2, linear)


def test_a_new_epoch_forgets_the_old_samples(subject: Stream[float]) -> None:
    fill(subject)
    subject.new_epoch()
    subject.push(Sample(7.0, 0.0, 0.0, 0))
    assert subject.epoch == 1
    with pytest.raises(CellError):
        subject.at(0.5, linear)


def test_a_sample_that_does_not_follow_is_a_defect(subject: Stream[float]) -> None:
    fill(subject)
    with pytest.raises(ValueError, match="does not follow"):
        subject.push(Sample(0.0, 0.5, 0.0, 11))


def test_a_mapped_stream_gives_the_same_samples_with_other_values(
    subject: Stream[float], clock: HandClock
) -> None:
    mapped = Mapped(subject, lambda value: -value)
    assert mapped.last() is None
    came: list[float] = []
    end = mapped.subscribe(lambda sample: came.append(sample.value))
    fill(subject, 3)
    end()
    subject.push(Sample(3.0, 0.3, 0.001, 3))
    clock.t = 0.35
    assert came == [0.0, -1.0, -2.0]
    assert mapped.latest(0.1) == Sample(-3.0, 0.3, 0.001, 3)
    assert [s.value for s in mapped.between(0.05, 0.25)] == [-1.0, -2.0]
    subject.new_epoch()
    assert (mapped.epoch, mapped.name, mapped.clock) == (1, "gauge", clock)
    with pytest.raises(CellError, match="no sample yet"):
        mapped.latest(1.0)


@settings(max_examples=8, deadline=None)
@given(
    st.floats(-200e-6, 200e-6),
    st.floats(-1e5, 1e5),
    st.integers(0, 2**32 - 1),
)
def test_the_clock_model_follows_drift_from_below_the_jitter(drift: float, origin: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    subject = ClockModel()
    errors = []
    for i in range(4000):
        source = 0.01 * i
        truth = origin + source * (1.0 + drift)
        estimate = subject.observe(source, truth + 1e-4 + rng.exponential(0.002))
        if i > 2000:
            errors.append(estimate - truth)
    # 0.1 ms of constant delay cannot be seen; the envelope sits on top of it.
    assert max(abs(e) for e in errors) < 1e-3


@pytest.mark.parametrize("late_bins", [1, 2, 3, 4, 8])
@pytest.mark.parametrize("late_s", [0.002, 0.05, 0.3, 0.45])
def test_a_time_in_which_everything_came_late_does_not_shift_the_stamps_after_it(
    late_bins: int, late_s: float
) -> None:
    """Seconds of load after a connection: the stamps of what comes in time afterwards are right."""
    subject, drift = ClockModel(), 2e-5
    for i in range(100 * (late_bins + 20)):
        source = 0.01 * i
        truth = 50.0 + source * (1.0 + drift)
        late = late_s if source < late_bins + 0.5 else 1e-4
        estimate = subject.observe(source, truth + late)
        if source > late_bins + 0.6:
            assert abs(estimate - truth) < 2.5e-3, source


def test_the_clock_model_starts_afresh_when_the_source_jumps() -> None:
    subject = ClockModel()
    for i in range(100):
        subject.observe(1000.0 + 0.002 * i, 5.0 + 0.002 * i)
    assert subject.observe(0.002, 6.0) == pytest.approx(6.0)
    assert subject.resets == 1
