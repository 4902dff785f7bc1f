"""Light beams in the twin: when the tool breaks them, judged by other means than the twin's own."""

import pickle
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import RigidTransform, Rotation

from cell.poses import from_pose6, log_xi, to_pose6
from fakes._profile import Trapezoid
from fakes.beams import Beams
from fakes.distance import to_segments
from fakes.kinematics import chain
from fakes.scenario import Scenario
from fakes.segments import Hold, JointMove, JointSpeed, JointStop, Polynomial, Segment
from fakes.sweep import fastest, joints
from fakes.track import Track
from fakes.world import Message, World

ARM = chain("ur10e")
HOME = np.array([0.0, -1.8, 1.8, -1.57, -1.57, 0.0])
# The tool's point is here, and the tool points straight down.
OVER = RigidTransform.from_components([-0.65, -0.15, 0.35], Rotation.from_rotvec([np.pi, 0.0, 0.0]))
TOOL = from_pose6([0.0, 0.0, 0.18, 0.0, 0.0, 0.0])
Q0 = ARM.inverse(OVER * TOOL.inv(), HOME)

PIN, BEAM = 0.003, 0.0005
Beam = dict[str, Any]
Edges = list[tuple[float, bool]]


def beam(point: Any, way: Any, **more: Any) -> Beam:
    """A beam at ``point`` relative to where the tool's point is at first."""
    middle = (OVER.translation + np.asarray(point)).tolist()
    return {"point": middle, "dir": list(way), "latency_s": 0.0, "radius_m": BEAM, **more}


def world(repeatability_m: float = 0.0, shape: Any = None, **beams: Beam) -> World:
    raw: dict[str, Any] = {
        "seed": 3,
        "arm": {"model": "ur10e", "q_start": Q0.tolist(), "repeatability_t_m": repeatability_m},
        "beams": beams,
    }
    if repeatability_m:
        raw["arm"]["repeatability_r_rad"] = 1e-4
    if shape is not None:
        raw["tool"] = {"shape": shape}
    return World.from_scenario(Scenario.model_validate({"schema": "cellward.scenario/1", "world": raw}))


def shift(subject: World, t: float, way: Any, v: float, a: float = 1.0) -> float:
    """Move the tool straight by ``way`` in the base; returns when it rests."""
    goal = RigidTransform.from_translation(way) * subject.believed_flange(subject.track.end_time) * TOOL
    return subject.track.start_linear_move(t, subject.believed, goal, TOOL, v, a)


def gap(subject: World, name: str, t: float) -> float:
    """Least distance (m) of the tool's surface from the light, where both truly are."""
    flange = subject.true_flange(t).as_matrix()[None]
    return float(gaps(subject, name, flange @ subject.T_flange_tool_at(t).as_matrix())[0])


def gaps(subject: World, name: str, tools: np.ndarray) -> np.ndarray:
    """The same for many poses of the tool (n, 4, 4)."""
    truth = subject.config.beams[name]
    way = np.array(truth.dir) / np.linalg.norm(truth.dir)
    c, d = (np.array(truth.point) + s * 0.5 * truth.length_m * way for s in (-1, 1))
    found = []
    for capsule in subject.config.tool.shape:
        a, b = (tools[:, :3, :3] @ np.array(end) + tools[:, :3, 3] for end in (capsule.from_, capsule.to))
        found.append(segments_apart(a, b, c, d) - capsule.radius_m)
    return np.min(found, axis=0) - truth.radius_m


def segments_apart(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """The least of all candidates: each end against the other segment, and line against line."""

    def to_segment(p: np.ndarray, s: np.ndarray, e: np.ndarray) -> np.ndarray:
        u = e - s
        f = np.clip(np.sum((p - s) * u, axis=-1) / np.maximum(np.sum(u * u, axis=-1), 1e-30), 0.0, 1.0)
        return np.linalg.norm(p - s - f[..., None] * u, axis=-1)

    least = np.min(
        [to_segment(a, c, d), to_segment(b, c, d), to_segment(c, a, b), to_segment(d, a, b)], axis=0
    )
    normal = np.cross(b - a, d - c)
    size = np.linalg.norm(normal, axis=-1)
    skew = size > 1e-12
    size = np.where(skew, size, 1.0)
    # The lines' nearest points lie inside when either segment's ends are on both sides of the plane that
    # holds the other line and the common normal.
    inside = skew
    for start, end, other, along in ((a, b, c, d - c), (c, d, a, b - a)):
        plane = np.cross(along, normal)
        before = np.sum((start - other) * plane, axis=-1)
        inside = inside & (before * np.sum((end - other) * plane, axis=-1) < 0.0)
    lines = np.abs(np.sum((c - a) * normal, axis=-1)) / size
    return np.where(inside, np.minimum(least, lines), least)


def assert_crossings(subject: World, name: str, edges: Edges) -> None:
    """At every edge the gap passes its threshold within a microsecond, and in the direction that it says."""
    half = 0.5 * subject.config.beams[name].hysteresis_m
    for t, broken in edges:
        threshold = -half if broken else half
        before, after = gap(subject, name, t - 1e-6) - threshold, gap(subject, name, t + 1e-6) - threshold
        assert before * after < 0.0
        assert (after < 0.0) == broken


def looked_up(subject: World, name: str, times: np.ndarray, values: np.ndarray) -> Edges:
    """The edges that looks at ``times`` see, each at the time of the look that sees it first."""
    half = 0.5 * subject.config.beams[name].hysteresis_m
    broken, out = bool(values[0] < 0.0), []
    for t, g in zip(times.tolist(), values.tolist(), strict=True):
        if (g > half) if broken else (g < -half):
            broken = not broken
            out.append((t, broken))
    return out


# -- when


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


# -- what the sensor makes of it


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


# -- the tool


def test_a_gripper_with_two_fingers_makes_four_edges_on_each_way() -> None:
    fingers = [{"from": [0.0, y, -0.003], "to": [0.0, y, -0.05], "radius_m": 0.003} for y in (-0.012, 0.012)]
    subject = world(shape=fingers, xs=beam([0.0, 0.03, 0.01], [1, 0, 0]))
    v = 0.05
    end = shift(subject, 0.0, [0.0, 0.06, 0.0], v, 2.0)
    edges = subject.beams.edges("xs", 0.0, end)
    assert [level for _, level in edges] == [True, False, True, False]
    assert edges[2][0] - edges[0][0] == pytest.approx(0.024 / v, abs=5e-6)
    assert_crossings(subject, "xs", edges)
    assert subject.beams.count("xs", end) == 2


def test_a_bend_moves_the_tools_point_and_turns_it_in_the_flange() -> None:
    subject = world()
    subject.tool.bend(5.0, [1.2e-3, -0.7e-3, 0.5e-3], [0.01, -0.005, 0.0])
    assert np.allclose(to_pose6(subject.T_flange_tool_at(4.999)), to_pose6(TOOL))
    bent = subject.T_flange_tool_at(5.0)
    assert bent.translation == pytest.approx([1.2e-3, -0.7e-3, 0.1805])
    axis = Rotation.from_rotvec([0.01, -0.005, 0.0]).apply([0.0, 0.0, 1.0])
    assert bent.rotation.apply([0.0, 0.0, 1.0]) == pytest.approx(axis)
    subject.tool.straighten(6.0)
    assert np.allclose(to_pose6(subject.T_flange_tool_at(6.0)), to_pose6(TOOL))
    truth = subject.truth(5.5)
    assert truth["T_flange_tool"] == pytest.approx(to_pose6(bent).tolist())
    assert truth["T_flange_tool_nominal"] == pytest.approx([0, 0, 0.18, 0, 0, 0])


def test_a_bend_at_rest_can_break_a_beam_at_that_very_time() -> None:
    subject = world(xs=beam([0.0, 0.0055, 0.01], [1, 0, 0]))
    assert not subject.beams.level("xs", 20.0)
    # Flange y points against base y.
    subject.tool.bend(10.0, [0.0, -0.004, 0.0])
    subject.tool.straighten(12.0)
    assert subject.beams.edges("xs", 0.0, 20.0) == [(10.0, True), (12.0, False)]


def test_a_bent_tool_crosses_where_it_truly_is() -> None:
    subject = world(xs=beam([0.0, 0.02, 0.01], [1, 0, 0]))
    v = 0.05
    subject.tool.bend(0.0, [0.0, -0.001, 0.0], [0.02, 0.0, 0.0])
    shift(subject, 0.0, [0.0, 0.04, 0.0], v, 2.0)
    edges = subject.beams.edges("xs", 0.0, 5.0)
    assert_crossings(subject, "xs", edges)
    straight = world(xs=beam([0.0, 0.02, 0.01], [1, 0, 0]))
    shift(straight, 0.0, [0.0, 0.04, 0.0], v, 2.0)
    (a, _), (b, _) = straight.beams.edges("xs", 0.0, 5.0)
    sooner = 0.5 * (a + b) - 0.5 * (edges[0][0] + edges[1][0])
    # One millimetre further on, and the axis 10 mm up is back by the tilt: the turn about flange x by
    # +0.02 takes the pin's upper end to flange +y, base -y.
    assert sooner * v == pytest.approx(0.001 - 0.010 * 0.02, abs=2e-6)


def test_an_obstacle_feels_the_true_tool() -> None:
    wall = {
        "point": (OVER.translation + np.array([0.0, 0.0, 0.001])).tolist(),
        "normal": [0, 0, 1],
        "stiffness_n_m": 1e4,
    }
    raw = {"arm": {"model": "ur10e", "q_start": Q0.tolist()}, "obstacle": [wall]}
    subject = World.from_scenario(Scenario.model_validate({"schema": "cellward.scenario/1", "world": raw}))
    subject.tool.bend(1.0, [0.002, 0.0, 0.001])  # along flange z: down
    assert subject.contact_force(0.0, TOOL) == pytest.approx([0, 0, 10.0, 0, 0, 0], abs=1e-6)
    # The tip is 2 mm beside the TCP in flange x, which is base x.
    assert subject.contact_force(1.0, TOOL) == pytest.approx([0, 0, 20.0, 0, -0.04, 0], abs=1e-6)


# -- however and whenever it is asked


def test_a_reader_that_polls_through_changing_plans_sees_what_one_who_comes_later_sees() -> None:
    def scene(poll_s: float) -> tuple[World, list[int]]:
        rng = np.random.default_rng(1)
        subject = world(
            1e-5,
            xs=beam([0.0, 0.004, 0.004], [1, 0.1, 0.1], latency_s=0.002, hysteresis_m=5e-5),
            ys=beam([0.002, 0.0, 0.002], [0.2, 1.0, -0.3], latency_s=0.001),
        )
        seen = []
        for k in range(150):
            t = 0.002 * k
            if k < 125:
                goal = OVER.translation + 0.008 * np.array(
                    [np.sin(40 * t), np.sin(52 * t), 0.3 * rng.normal()]
                )
                aim = RigidTransform.from_components(goal, OVER.rotation) * TOOL.inv()
                subject.track.servo(t, ARM.inverse(aim, subject.track.at(t)[0]), 0.002)
            if poll_s and k % round(poll_s / 0.002) == 0:
                seen.append(subject.beams.index("xs", t + 0.0015))
        return subject, seen

    never, _ = scene(0.0)
    for poll_s in (0.002, 0.02):
        polled, seen = scene(poll_s)
        assert seen == sorted(seen)
        for name in ("xs", "ys"):
            expected = never.beams.edges(name, -1.0, 1.0)
            found = polled.beams.edges(name, -1.0, 1.0)
            assert len(expected) > 4
            assert [b for _, b in found] == [b for _, b in expected]
            assert [t for t, _ in found] == pytest.approx([t for t, _ in expected], abs=1e-8)


def test_what_was_foreseen_is_forgotten_when_the_arm_is_stopped_before() -> None:
    subject = world(xs=beam([0.0, 0.02, 0.01], [1, 0, 0]))
    shift(subject, 0.0, [0.0, 0.04, 0.0], 0.05)
    (on, _), _ = subject.beams.edges("xs", 0.0, 5.0)
    version = subject.beams.version
    subject.track.stop_joint(on - 0.2, 5.0)
    assert subject.beams.edges("xs", 0.0, 5.0) == []
    assert subject.beams.version > version


def test_counters_are_right_though_nobody_has_asked_for_long() -> None:
    """The track forgets after ten seconds; 400 moves and an hour later every crossing is counted."""
    subject = world(xs=beam([0.0, 0.004, 0.01], [1, 0, 0], hysteresis_m=1e-5))
    there = ARM.inverse(RigidTransform.from_translation([0.0, 0.008, 0.0]) * OVER * TOOL.inv(), Q0)
    t = 0.0
    for k in range(400):
        t = subject.track.start_joint_move(t, there if k % 2 == 0 else Q0, 1.0, 20.0) + 0.1
    assert subject.beams.count("xs", t + 3600.0) == 400


def test_a_reader_of_a_tool_far_away_costs_nearly_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    subject = world(xs=beam([0.0, 0.3, 0.0], [1, 0, 0]), ys=beam([0.4, 0.0, 0.0], [0, 1, 0]))
    looks: list[int] = []
    judge = Beams._gaps

    def counted(self: Beams, piece: Any, times: np.ndarray) -> np.ndarray:
        looks.append(len(times))
        return judge(self, piece, times)

    monkeypatch.setattr(Beams, "_gaps", counted)
    for k in range(1000):
        t = 0.002 * k
        subject.track.servo(t, Q0 + 0.02 * np.sin(5.0 * t), 0.002)
        subject.beams.level("xs", t)
    assert sum(looks) < 20
    looks.clear()
    for k in range(1000):  # at rest
        subject.beams.level("ys", 10.0 + 0.005 * k)
    assert len(looks) <= 3


def test_a_mirror_sees_the_same_edges_whenever_it_begins() -> None:
    subject = world(1e-5, xs=beam([0.0, 0.01, 0.01], [1, 0, 0], hysteresis_m=5e-5, latency_s=0.001))
    early, late = (
        world(1e-5, xs=beam([0.0, 0.01, 0.01], [1, 0, 0], hysteresis_m=5e-5, latency_s=0.001))
        for _ in range(2)
    )

    def follow(mirror: World) -> None:
        def send(message: Message) -> None:
            mirror.apply(pickle.loads(pickle.dumps(message)))

        subject.mirror_to(send)

    follow(early)
    t = 0.0
    for k in range(8):
        if k == 4:
            follow(late)
        t = shift(subject, t, [0.0, 0.02 if k % 2 == 0 else -0.02, 0.0], 0.05)
        if k == 5:
            subject.tool.bend(t, [1e-4, 2e-4, 0.0], [0.005, 0.0, 0.0])
        subject.track.hold(t)
    assert subject.beams.count("xs", t) == 8
    for mirror in (early, late):
        assert mirror.beams.count("xs", t) == 8
        ours, theirs = (w.beams.edges("xs", 0.0, t) for w in (subject, mirror))
        assert [b for _, b in theirs] == [b for _, b in ours]
        assert [e for e, _ in theirs] == pytest.approx([e for e, _ in ours], abs=1e-8)
        assert np.allclose(to_pose6(mirror.T_flange_tool_at(t)), to_pose6(subject.T_flange_tool_at(t)))


def test_the_flange_does_not_leap_when_a_stop_cuts_a_move_short() -> None:
    subject = world(2e-5)
    end = subject.track.start_joint_move(0.0, Q0 + 0.1, 0.5, 1.0)
    cut = 0.4 * end
    before = log_xi(subject.believed_flange(cut - 1e-9).inv() * subject.true_flange(cut - 1e-9))
    subject.track.stop_joint(cut, 8.0)
    after = log_xi(subject.believed_flange(cut).inv() * subject.true_flange(cut))
    assert np.allclose(before, after, atol=1e-12)
    assert np.linalg.norm(before[:3]) > 1e-7


# -- the parts


def test_the_distance_is_the_least_over_all_pairs_of_points() -> None:
    rng = np.random.default_rng(2)
    for _ in range(40):
        axis, middle = rng.uniform(-1, 1, (2, 3)), rng.uniform(-1, 1, 3)
        way, half = rng.normal(size=3), rng.uniform(0.05, 1.0)
        way /= np.linalg.norm(way)

        def squared(x: np.ndarray) -> float:
            gap = axis[0] + x[0] * (axis[1] - axis[0]) - middle - x[1] * half * way  # noqa: B023
            return float(gap @ gap)

        least = minimize(squared, [0.5, 0.0], bounds=[(0, 1), (-1, 1)], tol=1e-15)
        found = to_segments(axis[None, None], middle[None], way[None], np.array([half]))
        assert found.shape == (1, 1, 1)
        assert found[0, 0, 0] == pytest.approx(np.sqrt(least.fun), abs=1e-6)
        assert found[0, 0, 0] <= np.sqrt(least.fun) + 1e-12
        c, d = middle - half * way, middle + half * way
        assert found[0, 0, 0] == pytest.approx(segments_apart(axis[:1], axis[1:], c, d)[0], abs=1e-12)


def test_points_and_parallel_axes_have_a_distance_too() -> None:
    x = np.array([[1.0, 0.0, 0.0]])
    middle, half = np.zeros((1, 3)), np.array([0.5])
    for axis, least in (
        ([[0.0, 0.3, 0.0], [0.0, 0.3, 0.0]], 0.3),
        ([[-0.2, 0.0, 0.4], [0.2, 0.0, 0.4]], 0.4),
        ([[0.9, 0.3, 0.0], [2.0, 0.3, 0.0]], 0.5),
    ):
        assert to_segments(np.array([[axis]]), middle, x, half)[0, 0, 0] == pytest.approx(least, abs=1e-12)


def segments() -> list[Segment]:
    rng = np.random.default_rng(4)
    q1, qd = Q0 + rng.uniform(-0.5, 0.5, 6), rng.uniform(-1, 1, 6)
    lines = Track(0.0, Q0)
    goal = RigidTransform.from_translation([0.05, 0.1, -0.05]) * ARM.forward(Q0) * TOOL
    lines.start_linear_move(1.0, ARM, goal, TOOL, 0.25, 1.0)
    whole = lines.segment_at(1.1)
    lines.stop_linear(1.3, 2.0)
    return [
        Hold(1.0, Q0),
        JointMove(1.0, Q0, q1, Trapezoid(float(np.max(np.abs(q1 - Q0))), 0.7, 2.0)),
        JointMove(1.0, Q0, Q0, Trapezoid(0.0, 0.7, 2.0)),
        JointStop(1.0, Q0, qd, 3.0),
        JointSpeed(1.0, Q0, qd, -0.5 * qd, 4.0),
        Polynomial(1.0, 1.4, 0.9, np.array([Q0, 0.3 * qd, -qd, 2.0 * qd])),
        whole,
        lines.segment_at(1.31),
    ]


@pytest.mark.parametrize("kind", range(8))
def test_many_times_at_once_are_the_same_joints_and_no_joint_is_faster_than_said(kind: int) -> None:
    segment = segments()[kind]
    end = min(segment.t_end, segment.t0 + 3.0) + 0.1
    times = np.linspace(segment.t0, end, 501)
    single = [segment.at(float(t)) for t in times]
    assert np.allclose(joints(segment, times), [q for q, _ in single], rtol=0.0, atol=1e-12)
    speeds = np.max(np.abs([qd for _, qd in single]), axis=0)
    limit = fastest(segment)
    assert np.all(speeds <= limit + 1e-12)
    if isinstance(segment, Polynomial):
        assert np.allclose(
            joints(segment, inside := times[times <= segment.t1]),
            [segment.at(t)[0] for t in inside],
            atol=1e-12,
        )
    if not isinstance(segment, Polynomial):  # whose bound is a sum
        assert np.all(limit <= 1.3 * speeds + 1e-2)


def test_no_point_of_the_tool_is_faster_than_levers_and_joint_speeds_allow() -> None:
    rng = np.random.default_rng(6)
    levers = ARM.levers()
    for _ in range(200):
        q, qd, point = rng.uniform(-3, 3, 6), rng.uniform(-1, 1, 6), rng.uniform(-0.2, 0.2, 3)
        speed = np.linalg.norm((ARM.jacobian(q, point) @ qd)[:3])
        assert speed <= np.abs(qd) @ (levers + np.linalg.norm(point)) + 1e-12
    assert np.all(np.diff(levers) < 0)
    assert levers[0] < 1.8
