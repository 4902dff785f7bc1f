"""Light beams in the twin: when the tool breaks them, and what the sensor makes of it."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from fakes.world.world import World
from tests.kit.beam_scene import (
    ARM,
    BEAM,
    OVER,
    PIN,
    Q0,
    TOOL,
    assert_crossings,
    beam,
    gaps,
    looked_up,
    shift,
    world,
)


def test_a_pin_that_crosses_straight_at_constant_speed_breaks_the_beam_when_geometry_says() -> None:
    subject = world(xs=beam([0.0, 0.02, 0.01], [1, 0, 0]))
    v, a = 0.05, 2.0
    start = 1.0
    shift(subject, start, [0.0, 0.04, 0.0], v, a)
    on, off = subject.beams.edges("xs", 0.0, 10.0)
    # The arm has its speed after v/a seconds and v^2/2a metres.
    middle = start + v / a + (0.02 - 0.5 * v * v / a) / v
    half = (PIN + BEAM) / v
    # The arm's path is a spline through exact points, good to a tenth of a micrometre.
    assert on == (pytest.approx(middle - half, abs=5e-6), True)
    assert off == (pytest.approx(middle + half, abs=5e-6), False)
    assert_crossings(subject, "xs", [on, off])


def test_an_oblique_beam_is_met_later_by_the_slope_and_for_longer_by_the_angle() -> None:
    angle = np.deg2rad(88.5) - np.pi / 2
    way = [np.cos(angle), np.sin(angle), 0.0]
    subject = world(xs=beam([0.04, 0.02, 0.01], way))
    v = 0.05
    shift(subject, 0.0, [0.0, 0.04, 0.0], v, 2.0)
    (on, _), (off, _) = subject.beams.edges("xs", 0.0, 10.0)
    # On the tool's line the beam is at y = 0.02 - 0.04 tan(angle), and its chord is wider by 1/cos.
    assert off - on == pytest.approx(2 * (PIN + BEAM) / np.cos(angle) / v, abs=5e-6)
    where = 0.5 * v * v / 2.0 + v * (0.5 * (on + off) - v / 2.0)
    assert where == pytest.approx(0.02 - 0.04 * np.tan(angle), abs=5e-7)


def test_a_look_every_20_microseconds_at_a_wild_motion_sees_the_same_edges() -> None:
    rng = np.random.default_rng(5)
    subject = world(
        xs=beam([0.0, 0.005, 0.004], [1, 0.1, 0.1], hysteresis_m=1e-4),
        ys=beam([0.004, 0.0, 0.002], [0.2, 1.0, -0.3]),
    )
    q, t = Q0, 0.0
    for k in range(28):
        near = RigidTransform.from_translation(rng.uniform(-0.015, 0.015, 3))
        aim = ARM.inverse(near * OVER * TOOL.inv(), Q0)
        match k % 7:
            case 3:
                subject.track.stop_joint(t, 8.0)
            case 4:
                subject.track.speed_joints(t, (aim - q) * 10.0, 10.0)
            case 5 | 6:
                subject.track.servo(t, aim, 0.02)
            case _:
                subject.track.start_joint_move(t, aim, 1.0, 20.0)
        t += rng.uniform(0.02, 0.05)
        q = subject.track.at(t)[0]
    times = np.arange(0.0, t, 2e-5)
    flanges = subject.true.matrix(np.array([subject.track.at(when)[0] for when in times]))
    for name in ("xs", "ys"):
        edges = subject.beams.edges(name, 0.0, t)
        looks = looked_up(subject, name, times, gaps(subject, name, flanges @ TOOL.as_matrix()))
        assert len(looks) >= 6
        assert [level for _, level in looks] == [level for _, level in edges]
        assert all(0.0 <= look - edge <= 2.1e-5 for (look, _), (edge, _) in zip(looks, edges, strict=True))
        assert_crossings(subject, name, edges)


def test_fine_bending_of_the_arm_at_standstill_is_seen_by_the_beams() -> None:
    subject = world(2e-5, xs=beam([0.0, 0.005, 0.004], [1, 0.1, 0.1], hysteresis_m=2e-5))
    t = 0.0
    for k in range(6):
        t = shift(subject, t, [0.0, 0.01 if k % 2 == 0 else -0.01, 0.0], 0.03) + 0.05
    edges = subject.beams.edges("xs", 0.0, t)
    assert [level for _, level in edges] == [True, False] * 6
    assert_crossings(subject, "xs", edges)
    assert len({round(gap_believed(subject, when) * 1e7) for when, _ in edges}) > 3


def gap_believed(subject: World, t: float) -> float:
    """How far the pin would be from the beam if the arm were where its controller believes."""
    tool = (subject.believed_flange(t) * TOOL).as_matrix()[None]
    return float(gaps(subject, "xs", tool)[0])


@pytest.mark.parametrize(("depth", "edges"), [(1e-7, 2), (-1e-7, 0), (2e-6, 2), (-2e-6, 0)])
def test_the_shortest_graze_is_not_missed_and_a_near_miss_is_none(depth: float, edges: int) -> None:
    """The pin turns round where it is just in the light, or just not."""
    reach = PIN + BEAM
    subject = world(xs=beam([0.0, 0.02 + reach, 0.01], [1, 0, 0]))
    there = shift(subject, 0.0, [0.0, 0.02 + depth, 0.0], 0.05, 0.5)
    shift(subject, there, [0.0, -0.02, 0.0], 0.05, 0.5)
    # The arm's line is good to some nanometres; that is what the beams have to see.
    found = subject.beams.edges("xs", 0.0, 5.0)
    assert len(found) == edges
    assert_crossings(subject, "xs", found)


def test_a_pin_that_passes_over_a_beam_grazes_it_when_it_is_a_micrometre_too_low() -> None:
    for depth, edges in ((1e-6, 2), (-1e-6, 0)):
        # The round end of the pin meets the light when the tool's point is a beam's radius above its middle.
        subject = world(xs=beam([0.0, 0.02, -BEAM + depth], [1, 0, 0]))
        shift(subject, 0.0, [0.0, 0.04, 0.0], 0.25, 5.0)
        found = subject.beams.edges("xs", 0.0, 5.0)
        assert len(found) == edges
        assert_crossings(subject, "xs", found)


def test_a_beam_ends_where_it_ends() -> None:
    for x, edges in ((0.049, 2), (0.0536, 0)):
        subject = world(xs=beam([x, 0.02, 0.01], [1, 0, 0], length_m=0.1))
        shift(subject, 0.0, [0.0, 0.04, 0.0], 0.1, 2.0)
        assert len(subject.beams.edges("xs", 0.0, 5.0)) == edges


def test_the_sensor_answers_late_by_its_latency() -> None:
    quick = world(xs=beam([0.0, 0.02, 0.01], [1, 0, 0]))
    slow = world(xs=beam([0.0, 0.02, 0.01], [1, 0, 0], latency_s=0.002))
    for subject in (quick, slow):
        shift(subject, 0.0, [0.0, 0.04, 0.0], 0.05)
    (early, _), _ = quick.beams.edges("xs", 0.0, 5.0)
    (late, _), _ = slow.beams.edges("xs", 0.0, 5.0)
    assert late - early == pytest.approx(0.002, abs=1e-9)
    assert not slow.beams.level("xs", late - 1e-7)
    assert slow.beams.level("xs", late + 1e-7)


def test_hysteresis_lets_the_beam_break_later_and_clear_later_by_half_of_it_each() -> None:
    plain = world(xs=beam([0.0, 0.02, 0.01], [1, 0, 0]))
    lazy = world(xs=beam([0.0, 0.02, 0.01], [1, 0, 0], hysteresis_m=1e-4))
    for subject in (plain, lazy):
        shift(subject, 0.0, [0.0, 0.04, 0.0], 0.05, 2.0)
    before, after = (subject.beams.edges("xs", 0.0, 5.0) for subject in (plain, lazy))
    late = [b[0] - a[0] for a, b in zip(before, after, strict=True)]
    assert late == pytest.approx([5e-5 / 0.05] * 2, abs=2e-7)


def test_rising_edges_are_counted_since_power_up() -> None:
    subject = world(xs=beam([0.0, 0.01, 0.01], [1, 0, 0]))
    t = 0.0
    for k in range(5):
        t = shift(subject, t, [0.0, 0.02 if k % 2 == 0 else -0.02, 0.0], 0.1) + 0.1
        assert subject.beams.count("xs", t) == k + 1
    (first, _), (second, _), *_ = subject.beams.edges("xs", 0.0, t)
    assert subject.beams.count("xs", first - 1e-6) == 0
    assert subject.beams.count("xs", second + 1e-6) == 1


def test_a_tool_that_stands_in_the_beam_at_first_is_no_edge() -> None:
    subject = world(xs=beam([0.0, 0.0, 0.01], [1, 0, 0]))
    assert subject.beams.level("xs", 0.0)
    end = shift(subject, 0.0, [0.0, 0.02, 0.0], 0.05)
    assert not subject.beams.level("xs", end)
    assert subject.beams.count("xs", end) == 0
    shift(subject, end, [0.0, -0.02, 0.0], 0.05)
    assert subject.beams.count("xs", end + 10.0) == 1
