"""What the belt does next: against motions that were integrated from a speed, and nothing else."""

import numpy as np
import pytest

from bench.intercept import FINE, HORIZONS, M_PER_COUNT, speed_course
from calibration.belt.estimator import BeltEstimator, EncoderScale
from calibration.belt.history import History
from calibration.belt.speeds import Speeds

PERIOD = 0.005


class Belt:
    """A belt whose counts are fed to an estimator up to any time."""

    def __init__(
        self, kind: str, seed: int, v: float = 0.2, modulus: int = 65536, late: float = 3e-4
    ) -> None:
        rng = np.random.default_rng(seed)
        course = speed_course(kind, rng, 12.0, v)
        self.grid = np.arange(len(course)) * FINE
        self.x = np.concatenate([[0.0], np.cumsum(0.5 * (course[1:] + course[:-1]) * FINE)])
        instants = np.arange(2800) * PERIOD + 0.001
        counts = np.floor(np.interp(instants, self.grid, self.x) / M_PER_COUNT + 0.4).astype(int)
        self.stamps = instants + rng.exponential(late, len(instants))
        self.counts = (counts + modulus - 3000) % modulus
        self.estimator = BeltEstimator(EncoderScale(M_PER_COUNT, modulus, PERIOD))
        self.fed = 0

    def until(self, t: float) -> None:
        while self.fed < len(self.stamps) and self.stamps[self.fed] <= t:
            self.estimator.add(float(self.stamps[self.fed]), int(self.counts[self.fed]))
            self.fed += 1

    def errors(self, times: np.ndarray, since: float = 0.15) -> tuple[np.ndarray, np.ndarray]:
        """Errors (k, h) of the travel from ``since`` before each time, and their own estimates."""
        found, sigma = [], []
        for t in times:
            self.until(t)
            forecast = self.estimator.forecast()
            assert forecast is not None
            ahead = t + np.array(HORIZONS)
            true = np.interp(ahead, self.grid, self.x) - np.interp(t - since, self.grid, self.x)
            found.append(forecast.travels(ahead) - forecast.travel(t - since) - true)
            sigma.append([forecast.sigma(t - since, float(a)) for a in ahead])
        return np.array(found), np.array(sigma)


def rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(values**2, axis=0))


def test_a_constant_belt_is_predicted_to_a_few_micrometres() -> None:
    errors, _ = Belt("constant", 1, v=0.1837).errors(np.linspace(3.0, 11.0, 25))
    assert rms(errors)[-1] < 8e-6


def test_a_belt_that_crawls_below_a_count_per_frame_is_predicted_within_a_count() -> None:
    errors, _ = Belt("constant", 2, v=0.0031).errors(np.linspace(3.0, 11.0, 25))
    assert np.abs(errors).max() < M_PER_COUNT


def test_a_slow_change_of_speed_is_followed() -> None:
    errors, _ = Belt("creep", 3).errors(np.linspace(4.0, 11.0, 25))
    assert rms(errors)[-1] < 3e-5


@pytest.mark.parametrize("seed", [4])
def test_ripple_is_predicted_after_four_seconds(seed: int) -> None:
    errors, sigma = Belt("ripple", seed).errors(np.linspace(4.0, 11.0, 20))
    assert rms(errors)[-1] < 8e-5
    assert np.all(np.isfinite(sigma))


def test_stops_and_starts_are_followed_at_thirty_milliseconds() -> None:
    errors, sigma = Belt("stop-start", 6).errors(np.linspace(3.0, 11.5, 90))
    assert rms(errors)[0] < 2.2e-4
    # What cannot be predicted is in the uncertainty as far as the belt has done it before.
    assert 0.3 * rms(errors)[0] < rms(sigma)[0] < 3.0 * rms(errors)[0]


def test_most_of_what_a_belt_that_stops_and_starts_does_is_within_the_stated_intervals() -> None:
    inside = []
    for seed in range(20, 25):
        errors, sigma = Belt("stop-start", seed).errors(np.linspace(5.0, 11.5, 26))
        inside.append(np.abs(errors) <= 1.96 * sigma)
    share = np.mean(np.concatenate(inside), axis=0)
    assert np.all(share >= 0.92), share


def test_stamps_that_are_often_late_make_no_stops_of_a_constant_belt() -> None:
    belt = Belt("constant", 9, v=0.3, late=2e-3)
    _, sigma = belt.errors(np.linspace(5.0, 11.5, 10))
    assert belt.estimator._speeds.changes(11.5, M_PER_COUNT).rate == 0.0
    assert np.all(sigma < 1e-3), sigma.max(axis=0)


def test_changes_count_each_stop_and_start_and_know_how_hard_they_are() -> None:
    subject, v = Speeds(), 0.0
    for k in range(300):
        phase = 0.08 * k % 6.0  # one second down, one second of rest, one second up, and three seconds run
        v = float(np.clip(np.interp(phase, [0, 1, 2, 3, 6], [2000, 0, 0, 2000, 2000]), 0, 2000))
        subject.add(0.08 * k, v)
    found = subject.changes(24.0, -M_PER_COUNT)
    assert found.rate == pytest.approx(4 / 6.0, rel=0.1)
    assert found.acceleration == pytest.approx(0.2, rel=0.05)
    assert found.span == pytest.approx(0.2)
    # 0.2 m/s ahead for 30 s, or a stop at once: 29.5 s of it are missing.
    assert 1.96 * found.variance(30.0) ** 0.5 == pytest.approx(0.2 * 29.5, rel=0.01)


def test_a_belt_that_rests_in_the_noise_of_its_counts_is_not_one_that_turns_round() -> None:
    subject = Speeds()
    for k in range(20):
        subject.add(0.08 * k, 2000.0)
    assert subject.range(1.6, -5.0) == (-5.0, 2000.0)
    assert subject.range(1.6, -200.0) == (-np.inf, 2000.0)
    assert subject.range(1.6, 2000.0) == (0.0, np.inf)


def test_a_reversing_belt_is_followed_through_zero() -> None:
    belt = Belt("reversal", 7)
    errors, _ = belt.errors(np.linspace(2.0, 11.5, 60))
    assert rms(errors)[0] < 2.5e-4
    low, high = belt.estimator._speeds.range(11.5, 0.0)
    assert low < -1000.0 < 1000.0 < high


@pytest.mark.parametrize("seed", range(8))
def test_a_belt_that_brakes_to_a_stop_is_not_forecast_to_turn_round(seed: int) -> None:
    """Its last parabola passes through rest before the counts show that it is over."""
    rng = np.random.default_rng(seed)
    v, a, begins = 0.2, rng.uniform(0.3, 1.5), 3.0 + rng.uniform(0.0, 0.1)
    rests = begins + v / a

    def travel(t: float) -> float:
        braked = min(max(t - begins, 0.0), v / a)
        return v * min(t, begins) + v * braked - 0.5 * a * braked**2

    belt, missed = BeltEstimator(EncoderScale(M_PER_COUNT, 65536, PERIOD)), []
    for t in np.arange(0.0, rests + 0.3, PERIOD):
        belt.add(float(t), int(travel(t) / M_PER_COUNT))
        if t > rests - 0.02:
            forecast = belt.forecast()
            assert forecast is not None
            missed.append(forecast.travel(t + 0.07) - forecast.travel(0.0) - travel(t + 0.07))
    assert np.abs(missed).max() < 6e-4


def test_a_standing_belt_stays_where_it_is() -> None:
    subject = BeltEstimator(EncoderScale(M_PER_COUNT, 65536, PERIOD))
    subject.extend((PERIOD * k, 17) for k in range(400))
    forecast = subject.forecast()
    assert forecast is not None
    assert forecast.speed(2.0) == 0.0
    assert forecast.travel(5.0) == 0.0
    assert forecast.sigma(1.5, 2.6) < 1e-4


def test_later_counts_change_nothing_in_a_forecast_that_was_made() -> None:
    belt = Belt("ripple", 8)
    belt.until(6.0)
    made = belt.estimator.forecast()
    assert made is not None
    alone = Belt("ripple", 8)
    alone.until(6.0)
    again = alone.estimator.forecast()
    assert again is not None
    belt.until(9.0)
    belt.estimator.forecast()
    times = np.linspace(6.0, 7.0, 5)
    assert np.array_equal(made.travels(times), again.travels(times))
    assert [made.travel(t) for t in (0.5, 3.0, 5.99)] == [again.travel(t) for t in (0.5, 3.0, 5.99)]
    assert made.sigma(5.9, 6.6) == again.sigma(5.9, 6.6)


def test_forgetting_the_oldest_counts_changes_no_forecast(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = Belt("ripple", 8)
    whole.until(11.0)
    subject = Belt("ripple", 8)
    subject.estimator._history = History(most=2 * 2500 // 5)
    monkeypatch.setattr("calibration.belt.estimator.LONG", 2.0)
    subject.until(11.0)
    short, kept = subject.estimator.forecast(), subject.estimator._history
    assert kept.first > 0
    assert len(subject.estimator) == len(whole.estimator)
    again = whole.estimator.forecast()
    assert short is not None
    assert again is not None
    times = np.linspace(11.0, 11.6, 4)
    assert np.array_equal(short.travels(times), again.travels(times))
    assert short.travel(9.5) == again.travel(9.5)
    assert subject.estimator.travel_at(0.5) is None
    assert whole.estimator.travel_at(0.5) is not None


def test_one_count_gives_no_forecast_and_two_give_one() -> None:
    subject = BeltEstimator(EncoderScale(M_PER_COUNT, None, PERIOD))
    assert subject.forecast() is None
    subject.add(0.0, 5)
    assert subject.forecast() is None
    subject.add(0.005, 15)
    forecast = subject.forecast()
    assert forecast is not None
    assert forecast.speed(0.005) == pytest.approx(0.2)


@pytest.mark.parametrize("held", [3, 9, 20])
def test_a_burst_of_frames_with_one_stamp_breaks_no_forecast(held: int) -> None:
    belt, last = Belt("constant", 4, v=0.15), -1.0
    for at in range(300, 2000, 171):
        belt.stamps[at - held : at + 1] = belt.stamps[at]
    bursts = belt.stamps[range(300, 2000, 171)]
    for t in np.arange(0.05, 7.0, 0.017):
        belt.until(float(t))
        forecast = belt.estimator.forecast()
        last = max([last, *bursts[bursts <= t]])
        if forecast is not None and t - last > 0.5:
            true = np.interp(t + 0.1, belt.grid, belt.x) - np.interp(t - 0.15, belt.grid, belt.x)
            assert t < 3.0 or abs(forecast.travel(t + 0.1) - forecast.travel(t - 0.15) - true) < 1e-3


@pytest.mark.parametrize("before", [0, 1, 12])
@pytest.mark.parametrize("held", [30, 60, 120])
@pytest.mark.parametrize("after", [0, 3, 60])
def test_a_stream_that_begins_with_frames_that_came_at_once_is_forecast(
    before: int, held: int, after: int
) -> None:
    """A PC stands still just when the encoder begins to send, and finds all frames with one stamp."""
    subject = BeltEstimator(EncoderScale(M_PER_COUNT, None, PERIOD))
    late = PERIOD * (before + held)
    for k in range(before + held + after):
        t = PERIOD * k if k < before else max(late, PERIOD * k)
        subject.add(t, 10 * k)
    forecast = subject.forecast()
    assert forecast is None if before + after == 0 else forecast is not None
    if forecast is not None and after == 60:
        assert forecast.speed(forecast.now) == pytest.approx(0.2, rel=0.02)
        assert forecast.sigma(forecast.now, forecast.now + 0.1) < 0.01


def test_a_count_from_the_past_is_dropped_and_counted() -> None:
    subject = BeltEstimator(EncoderScale(M_PER_COUNT, None, PERIOD))
    subject.extend([(0.0, 0), (0.005, 10), (0.002, 4), (0.010, 20)])
    assert (len(subject), subject.disordered) == (3, 1)


def test_who_keeps_up_decides_the_same_and_makes_no_past_forecast_then() -> None:
    subject, late = Belt("constant", 5), Belt("constant", 5)
    for t in np.arange(1.0, 9.0, 0.1):
        subject.until(t)
        subject.estimator.keep_up()
    late.until(subject.stamps[subject.fed - 1])
    made = len(subject.estimator._motions)
    now, then = subject.estimator.forecast(), late.estimator.forecast()
    assert now is not None
    assert then is not None
    assert now.sigma(now.now - 0.1, now.now + 0.5) == then.sigma(then.now - 0.1, then.now + 0.5)
    assert len(subject.estimator._motions) == made
    assert len(late.estimator._motions) >= 20, "which all had to be made at that moment"


@pytest.mark.parametrize(
    ("kind", "name"), [("constant", "line"), ("ripple", "ripple"), ("stop-start", "bend")]
)
def test_a_single_time_is_answered_as_one_of_many(kind: str, name: str) -> None:
    belt, motions = Belt(kind, 8), []
    for t in np.arange(4.0, 9.0, 0.5):
        belt.until(t)
        forecast = belt.estimator.forecast()
        assert forecast is not None
        motions.append(forecast.motion)
    motion = next(m for m in motions if m.name == name)
    times = motion.now + np.linspace(-0.05, 1.0, 22)
    positions = motion.position(times)
    assert [motion.position_at(t) for t in times.tolist()] == pytest.approx(positions, rel=1e-12)
    slopes = (motion.position(times + 1e-5) - motion.position(times - 1e-5)) / 2e-5
    assert [motion.speed_at(t) for t in times.tolist()] == pytest.approx(slopes, abs=1e-3 * abs(slopes).max())


def test_a_pc_that_stood_still_gets_a_forecast_from_what_came_at_once() -> None:
    """Half a second of counts, then those of a pause in one moment: one is left to look for ripple in."""
    subject = BeltEstimator(EncoderScale(1e-4, None, 0.001))
    subject.extend((0.001 * k, round(1.5 * k)) for k in range(502))
    for k in range(1, 1001):
        subject.add(2.0, 752 + round(2.25 * k))
        if k in (1, 2, 1000):
            subject.keep_up()
            assert subject.forecast() is not None
