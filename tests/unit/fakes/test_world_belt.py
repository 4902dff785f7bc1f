"""The belt of the world: travel as an exact function of time, and what its encoder shows of it."""

from itertools import pairwise

import numpy as np
import pytest
from pydantic import ValidationError

from cell.errors import CellError
from fakes.world.belt.belt import Belt
from fakes.world.belt.encoder import BeltEncoder
from fakes.world.belt.truth import BeltTruth
from fakes.world.scenario import Scenario
from fakes.world.world import World

T0 = 1000.0
RIPPLE = [{"amplitude": 0.03, "hz": 0.7, "phase_rad": 0.4}, {"amplitude": 0.01, "hz": 3.1}]
COURSES = {
    "constant": {"profile": [{"speed_m_s": 0.2}]},
    "creep": {"profile": [{"speed_m_s": 0.2, "creep_per_s": 0.004, "for_s": 30.0}]},
    "ripple": {"profile": [{"speed_m_s": 0.2}], "ripple": RIPPLE},
    "stop-start": {"profile": [{"speed_m_s": 0.2}], "stops": {}, "ripple": RIPPLE},
    "reversal": {
        "profile": [{"speed_m_s": 0.2, "for_s": 3.0}, {"speed_m_s": -0.15, "for_s": 2.0}],
        "repeat": True,
        "ripple": RIPPLE,
    },
}


def belt(**truth: object) -> Belt:
    return Belt(BeltTruth.model_validate(truth), 7, T0)


def encoder(subject: Belt) -> BeltEncoder:
    return BeltEncoder(subject.truth, subject, T0)


@pytest.mark.parametrize("course", COURSES)
def test_travel_is_the_integral_of_speed(course: str) -> None:
    subject = belt(**COURSES[course])
    t = T0 + np.arange(0.0, 20.0, 5e-4)
    speed = np.array([subject.speed_at(x) for x in t])
    travel = np.array([subject.travel_at(x) for x in t])
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * 5e-4)])
    assert travel[0] == 0.0
    # The trapezoidal rule errs by a ramp's corner at most.
    assert np.max(np.abs(travel - summed)) < 2e-6
    assert np.max(np.abs(np.diff(speed))) < 1e-3, "speed does not jump"


@pytest.mark.parametrize("course", COURSES)
def test_where_the_belt_is_does_not_depend_on_who_looked_before(course: str) -> None:
    seldom, often = belt(**COURSES[course]), belt(**COURSES[course])
    last = seldom.travel_at(T0 + 40.0)
    for t in T0 + np.arange(0.0, 40.0, 0.05):
        often.travel_at(float(t))
    assert often.travel_at(T0 + 40.0) == last
    assert seldom.travel_at(T0 + 3.0) == often.travel_at(T0 + 3.0)


def test_a_belt_that_stops_at_random_stands_as_long_as_it_should_and_runs_between() -> None:
    subject = belt(**{**COURSES["stop-start"], "ripple": []})
    speed = np.array([subject.speed_at(T0 + x) for x in np.arange(0.0, 120.0, 0.01)])
    stands = np.concatenate([[False], speed == 0.0, [False]])
    begins = np.flatnonzero(~stands[:-1] & stands[1:])
    held = 0.01 * (np.flatnonzero(stands[:-1] & ~stands[1:]) - begins)
    assert len(held) > 20
    assert np.all((held > 0.18) & (held < 1.02))
    assert np.max(np.abs(np.diff(speed))) <= 1.2 * 0.01 + 1e-9
    assert speed.max() == pytest.approx(0.2)


def test_an_operator_stops_reverses_and_resumes_and_the_past_stays() -> None:
    subject = belt(**COURSES["ripple"])
    before = subject.travel_at(T0 + 5.0)
    subject.run(T0 + 5.0, 0.0, 0.5)
    assert subject.travel_at(T0 + 5.0) == pytest.approx(before, abs=1e-12)
    assert subject.speed_at(T0 + 5.5) == 0.0
    stood = subject.travel_at(T0 + 6.0)
    assert subject.travel_at(T0 + 9.0) == pytest.approx(stood, abs=1e-12)
    subject.run(T0 + 10.0, -0.1)
    assert subject.speed_at(T0 + 12.0) < -0.09
    subject.resume(T0 + 13.0)
    assert subject.speed_at(T0 + 15.0) == pytest.approx(0.2, rel=0.05)
    assert subject.travel_at(T0 + 5.0) == pytest.approx(before, abs=1e-12)


def test_another_belt_with_the_same_orders_runs_alike() -> None:
    subject = belt(**COURSES["stop-start"])
    subject.run(T0 + 3.0, -0.1)
    subject.resume(T0 + 4.0)
    other = Belt(subject.truth, 7, T0 + 0.6)  # a process that was started later
    other.load(subject.begin, subject.orders())
    for t in (1.0, 3.5, 4.5, 20.0):
        assert other.travel_at(T0 + t) == subject.travel_at(T0 + t)


def test_the_belts_frame_has_x_along_the_travel_and_z_up() -> None:
    frame = belt(origin=[0.1, 0.2, 0.3], dir=[0.0, 2.0, 0.0]).T_base_belt
    assert frame.translation.tolist() == [0.1, 0.2, 0.3]
    assert frame.rotation.as_matrix()[:, 0] == pytest.approx([0.0, 1.0, 0.0])
    assert frame.rotation.as_matrix()[:, 2] == pytest.approx([0.0, 0.0, 1.0])


# -- the encoder


def test_counts_are_whole_and_wrap_at_the_encoders_own_range() -> None:
    subject = encoder(belt(modulus=1000, count_at_start=990, profile=[{"speed_m_s": 0.1}]))
    raw = [subject.raw(T0 + 0.001 * k) for k in range(40)]
    assert raw[0] == 990
    assert [b - a for a, b in pairwise(raw)].count(-999) == 1
    assert raw[-1] == (990 + 39) % 1000


def test_a_negative_scale_counts_down() -> None:
    subject = encoder(belt(m_per_count=-1e-4, count_at_start=5, profile=[{"speed_m_s": 0.1}]))
    assert [subject.raw(T0 + 0.001 * k) for k in (0, 5, 6)] == [5, 0, 65535]
    assert subject.speed(T0) == pytest.approx(-1000.0)


def test_slip_moves_the_wheel_and_not_the_belt() -> None:
    subject = encoder(belt(profile=[{"speed_m_s": 0.1}]))
    subject.slip(T0 + 1.0, 0.005, 0.05)
    assert subject.raw(T0 + 0.999) == 1000 + 999
    assert subject.raw(T0 + 1.5) == 1000 + 1500 + 50
    assert subject.belt.travel_at(T0 + 1.5) == pytest.approx(0.15)
    assert subject.speed(T0 + 1.01) == pytest.approx(1000.0 + 1000.0)


def test_a_wheel_that_stands_goes_on_from_where_it_stood() -> None:
    subject = encoder(belt(profile=[{"speed_m_s": 0.1}]))
    subject.stick(T0 + 1.0, True)
    assert subject.raw(T0 + 3.0) == 2000
    assert subject.speed(T0 + 3.0) == 0.0
    subject.stick(T0 + 3.0, False)
    assert subject.raw(T0 + 4.0) == pytest.approx(3000, abs=1)


def test_a_frozen_encoder_shows_one_position_and_then_the_true_one() -> None:
    subject = encoder(belt(profile=[{"speed_m_s": 0.1}]))
    subject.freeze(T0 + 1.0, True)
    assert subject.raw(T0 + 3.0) == 2000
    subject.freeze(T0 + 3.0, False)
    assert subject.raw(T0 + 3.0) == 4000


@pytest.mark.parametrize("speed", [0.1, -0.1])
def test_a_wrap_that_is_asked_for_comes_after_so_many_counts(speed: float) -> None:
    subject = encoder(belt(profile=[{"speed_m_s": speed}]))
    subject.wrap(T0 + 1.0, 20)
    raw = [subject.raw(T0 + 1.0 + 0.001 * k) for k in range(25)]
    jumps = [k for k, (a, b) in enumerate(pairwise(raw), 1) if abs(b - a) > 1000]
    assert jumps == [pytest.approx(20, abs=1)]


@pytest.mark.parametrize(("keeps", "expected"), [(True, 2000), (False, 0)])
def test_an_incremental_encoder_begins_at_zero_after_a_restart(keeps: bool, expected: int) -> None:
    subject = encoder(belt(keeps_position=keeps, profile=[{"speed_m_s": 0.1}]))
    subject.restart(T0 + 1.0)
    assert subject.raw(T0 + 1.0) == pytest.approx(expected, abs=1)


# -- scenario and world


@pytest.mark.parametrize(
    ("truth", "said"),
    [
        ({"serial": "99996600001"}, "32 bits"),
        ({"serial": "4711"}, "serial"),
        ({"m_per_count": 0.0}, "m_per_count"),
        ({"dir": [0.0, 0.0, 0.0]}, "dir"),
        ({"profile": [{"speed_m_s": 0.1}, {"speed_m_s": 0.2}]}, "for_s"),
        ({"profile": [{"speed_m_s": 0.1, "creep_per_s": 0.01}]}, "creep_per_s"),
        ({"stops": {"held_s": [1.0, 0.2]}}, "held_s"),
    ],
)
def test_a_belt_that_cannot_be_is_refused(truth: dict[str, object], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        BeltTruth.model_validate(truth)


def test_a_misspelt_key_of_the_belt_gets_a_suggestion() -> None:
    text = 'schema = "cellward.scenario/1"\n[world.arm]\nmodel = "ur10e"\nq_start = [0, 0, 0, 0, 0, 0]\n'
    with pytest.raises(CellError, match="did you mean m_per_count"):
        Scenario.parse(text + "[world.belt]\nm_per_counts = 0.1\n")


def test_the_shipped_belt_moves_and_a_mirrored_world_follows_its_orders() -> None:
    scenario = Scenario.load("belt:ideal")
    ours, theirs = World.from_scenario(scenario, T0), World.from_scenario(scenario, T0)
    assert ours.belt is not None
    assert theirs.belt is not None
    ours.belt.run(T0 + 1.0, 0.05)
    ours.mirror_to(theirs.apply)
    ours.belt.run(T0 + 2.0, 0.0)
    assert theirs.belt.travel_at(T0 + 9.0) == ours.belt.travel_at(T0 + 9.0)
    told = ours.truth(T0 + 9.0)["belt"]
    assert told["travel_m"] == ours.belt.travel_at(T0 + 9.0)
    assert told["m_per_count"] == 0.0001
    assert np.linalg.norm(told["dir"]) == pytest.approx(1.0)
