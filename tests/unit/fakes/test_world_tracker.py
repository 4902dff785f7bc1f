"""The world's laser tracker: Euclidean truth, noise, what hides a reflector, what it follows and loses."""

from typing import Any

import numpy as np
import pytest

from calibration.kinematics import UrArmModel
from cell.errors import CellError
from cell.poses import from_pose6
from fakes.world.arm.kinematics import chain
from fakes.world.arm.shape import ur_shape
from fakes.world.scenario import Scenario
from fakes.world.tracker.tracker import MULTIPLE, NO_TARGET, NOT_AIMED, Tracker, direction, polar
from fakes.world.tracker.visibility import BROKEN, OUT_OF_RANGE, TURNED_AWAY
from fakes.world.world import World

T0 = 100.0
STAND = [2.0, -2.0, 0.9, 0.02, -0.01, 2.3]
UPRIGHT = [0.0, -np.pi / 2, 0.0, -np.pi / 2, 0.0, 0.0]


def scenario(tracker: str = "", reflectors: str | None = None) -> Scenario:
    default = """
[world.reflectors.smr1]
on = "arm"
point = [0.05, 0.02, 0.06]
[world.reflectors.m1]
on = "base"
point = [0.6, -0.5, 0.02]
"""
    return Scenario.parse(f"""
schema = "cellward.scenario/1"
[world.arm]
model = "ur10e"
q_start = [0.3, -1.8, 1.8, -1.57, -1.57, 0.0]
repeatability_t_m = 0.00002
[world.arm.error]
delta_theta = [0.0, 0.002, -0.001, 0.001, 0.0, 0.0]
[world.tracker]
T_base_tracker = {STAND}
{tracker}
{default if reflectors is None else reflectors}
""")


def world(tracker: str = "", reflectors: str | None = None) -> tuple[World, Tracker]:
    subject = World.from_scenario(scenario(tracker, reflectors), T0)
    assert subject.tracker is not None
    return subject, subject.tracker


def aim_at(subject: Tracker, name: str, t: float, half: float = 0.01) -> str:
    subject.turn_to(t, *polar(subject.visibility.local(name, t)))
    return subject.search(t, half, half)


# -- readings


def test_without_noise_a_reading_is_the_reflectors_place_in_the_trackers_frame() -> None:
    subject, tracker = world("sigma0_m = 0.0\nsigma_per_m = 0.0")
    for name, carrier in (("smr1", subject.true_flange(T0 + 1.0)), ("m1", None)):
        point = subject.config.reflectors[name].point
        in_base = carrier.apply(point) if carrier is not None else np.array(point)
        assert aim_at(tracker, name, T0 + 1.0) == ""
        reading = tracker.read(T0 + 1.0)
        assert reading.point == pytest.approx(from_pose6(STAND).inv().apply(in_base), abs=1e-12)
        assert reading.slope == pytest.approx(np.linalg.norm(in_base - STAND[:3]), abs=1e-12)
        assert reading.point == pytest.approx(reading.slope * direction(reading.hz, reading.v), abs=1e-12)


def test_the_true_flange_carries_the_reflector_not_the_one_the_controller_believes_in() -> None:
    subject, _ = world()
    believed = subject.believed_flange(T0).apply(subject.config.reflectors["smr1"].point)
    gap = np.linalg.norm(subject.tracker.visibility.position("smr1", T0) - believed)
    assert 0.0002 < gap < 0.01


def test_angles_count_clockwise_from_y_and_down_from_z() -> None:
    assert polar(np.array([0.0, 2.0, 0.0])) == pytest.approx((0.0, np.pi / 2))
    assert polar(np.array([2.0, 0.0, 0.0])) == pytest.approx((np.pi / 2, np.pi / 2))
    assert polar(np.array([-1.0, 0.0, 1.0])) == pytest.approx((1.5 * np.pi, np.pi / 4))


def test_noise_grows_with_the_range_and_is_the_same_along_each_axis() -> None:
    sigma = {}
    for distance in (1.0, 20.0):
        reflectors = f'[world.reflectors.far]\non = "base"\npoint = [2.0, {distance - 2.0}, 0.9]'
        subject, tracker = world("", reflectors)
        assert aim_at(tracker, "far", T0) == ""
        true = tracker.visibility.local("far", T0)
        assert np.linalg.norm(true) == pytest.approx(distance)
        errors = np.array([tracker.read(T0 + 0.02 * k).point - true for k in range(4000)])
        sigma[distance] = errors.std(axis=0)
        assert np.abs(errors.mean(axis=0)).max() < 5 * sigma[distance].max() / np.sqrt(4000)
        assert np.abs(np.corrcoef(errors.T) - np.eye(3)).max() < 0.08
        assert abs(np.corrcoef(errors[:-1, 0], errors[1:, 0])[0, 1]) < 0.08
        del subject
    # The standard deviation of 4000 readings is known within 1.1 %; five times that is allowed.
    assert sigma[1.0] == pytest.approx(np.full(3, 21e-6), rel=0.056)
    assert sigma[20.0] == pytest.approx(np.full(3, 135e-6), rel=0.056)


def test_a_reading_is_a_function_of_seed_and_time() -> None:
    readings = []
    for _ in range(2):
        _, tracker = world()
        aim_at(tracker, "smr1", T0)
        readings.append([tracker.read(T0 + t).point for t in (0.5, 1.0, 1.02)])
    assert np.array_equal(readings[0], readings[1])
    assert np.abs(np.diff(readings[0], axis=0)).min() > 0.0


def test_a_wrong_constant_makes_every_distance_wrong_by_the_same() -> None:
    reflectors = '[world.reflectors.p]\non = "base"\npoint = [0.0, 1.0, 0.4]\nconstant_m = -0.0169'
    _, tracker = world("sigma0_m = 0.0\nsigma_per_m = 0.0\nconstant_m = -0.0169", reflectors)
    aim_at(tracker, "p", T0)
    true = np.linalg.norm(tracker.visibility.local("p", T0))
    assert tracker.read(T0).slope == pytest.approx(true, abs=1e-12)
    tracker.constant_m = 0.0
    assert tracker.read(T0).slope == pytest.approx(true + 0.0169, abs=1e-12)


# -- the stand


def test_the_stand_creeps_and_jumps_when_it_is_pushed() -> None:
    subject, tracker = world("drift_m_h = [0.0, 0.0, 0.00036]\ndrift_rad_h = [0.0, 0.0, 0.0036]")
    after_an_hour = tracker.stand.at(T0 + 3600.0)
    moved = after_an_hour * tracker.stand.at(T0).inv()
    assert after_an_hour.translation - STAND[:3] == pytest.approx([0.0, 0.0, 0.00036], abs=1e-9)
    assert moved.rotation.as_rotvec() == pytest.approx([0.0, 0.0, 0.0036], abs=1e-9)
    tracker.stand.move(T0 + 10.0, [0.001, 0.0, 0.0], [0.0, 0.0, 0.0002])
    step = tracker.stand.at(T0 + 10.0).translation - tracker.stand.at(T0 + 10.0 - 1e-6).translation
    assert step == pytest.approx([0.001, 0.0, 0.0], abs=1e-9)
    assert subject.truth(T0 + 10.0)["tracker"]["T_base_tracker"][0] == pytest.approx(2.001)


# -- what hides a reflector


def test_a_beam_broken_for_a_moment_is_lost_until_it_is_searched_again() -> None:
    _, tracker = world()
    aim_at(tracker, "smr1", T0)
    tracker.visibility.hinder(BROKEN, T0 + 1.0)
    tracker.visibility.free(T0 + 1.01)
    assert tracker.read(T0 + 0.99).status == ""
    lost = tracker.read(T0 + 5.0)
    assert lost.point is None
    assert lost.status == BROKEN
    assert tracker.read(T0 + 6.0).point is None, "clear again, but nobody has searched"
    assert tracker.search(T0 + 6.0, 0.01, 0.01) == ""
    assert tracker.read(T0 + 6.0).point is not None


def test_while_the_beam_is_broken_a_search_finds_nothing() -> None:
    _, tracker = world()
    aim_at(tracker, "m1", T0)
    tracker.visibility.hinder(BROKEN, T0 + 1.0, "m1")
    assert tracker.search(T0 + 1.5, 0.01, 0.01) == NO_TARGET
    assert aim_at(tracker, "smr1", T0 + 1.5) == "", "only the monument is hidden"


def test_a_reflector_is_seen_within_its_cone_and_not_beyond() -> None:
    for angle, seen in ((0.5, ""), (0.54, TURNED_AWAY)):
        # The tracker stands at this angle from the normal, 3 m away.
        to_tracker = np.array([np.sin(angle), 0.0, np.cos(angle)]) * 3.0
        point = (np.array(STAND[:3]) - to_tracker).tolist()
        reflectors = f'[world.reflectors.s]\non = "base"\npoint = {point}\nnormal = [0.0, 0.0, 2.0]'
        _, tracker = world("elevation_rad = [-1.5, 1.5]", reflectors)
        assert tracker.visibility.hindrance("s", T0) == seen


def test_the_field_of_view_ends_above_below_and_far_away() -> None:
    for offset, seen in (
        ([3.0, 0.0, 0.0], ""),
        ([0.1, 0.0, 0.0], OUT_OF_RANGE),
        ([50.0, 0.0, 0.0], OUT_OF_RANGE),
        ([0.2, 0.0, 2.0], OUT_OF_RANGE),
        ([0.5, 0.0, -2.0], OUT_OF_RANGE),
    ):
        point = [float(a + b) for a, b in zip(STAND[:3], offset, strict=True)]
        _, tracker = world("", f'[world.reflectors.s]\non = "base"\npoint = {point}')
        assert tracker.visibility.hindrance("s", T0) == seen


def test_a_box_hides_what_is_behind_it_and_nothing_before_or_beside_it() -> None:
    box = "opaque = [{ min = [-0.2, -2.1, 0.0], max = [0.2, -1.9, 2.0] }]"
    for x, y, seen in ((-1.0, -2.0, BROKEN), (1.0, -2.0, ""), (-1.0, -1.0, ""), (0.2, -2.0, BROKEN)):
        _, tracker = world(box, f'[world.reflectors.s]\non = "base"\npoint = [{x}, {y}, 0.9]')
        assert tracker.visibility.hindrance("s", T0) == seen


@pytest.mark.parametrize(("model", "within_m"), [("ur10e", 0.005), ("ur5e", 0.02), ("ur20", 0.06)])
def test_the_twins_links_lie_where_the_drawings_have_them(model: str, within_m: float) -> None:
    shape, drawn = ur_shape(model, chain(model)), UrArmModel(model)
    for q in np.random.default_rng(3).uniform(-3.0, 3.0, (20, 6)):
        theirs = drawn.link_ends(q)[0][[0, 2, 4, 5, 6]]
        assert np.linalg.norm(shape.lines(q) - theirs, axis=-1).max() < within_m


def behind_the_arm(keys: str) -> tuple[World, Tracker]:
    """The upper arm stands between the tracker at +x and a mark at -x, 0.5 m above the base."""
    subject, tracker = world(keys, '[world.reflectors.m]\non = "base"\npoint = [-3.0, -0.17, 0.5]')
    tracker.stand.move(T0, np.array([3.0, -0.17, 0.5]) - STAND[:3])
    subject.track.hold(T0, UPRIGHT)
    return subject, tracker


def test_the_arm_hides_what_is_behind_its_links_when_the_scenario_says_so() -> None:
    for radius, seen in ((0.0, ""), (0.05, BROKEN)):
        subject, tracker = behind_the_arm(f"arm_radius_m = {radius}")
        assert tracker.visibility.hindrance("m", T0 + 1.0) == seen
        subject.track.hold(T0 + 2.0, [np.pi / 2, *UPRIGHT[1:]])
        assert tracker.visibility.hindrance("m", T0 + 2.0) == "", "beside the arm"


def test_what_hides_a_reflector_hides_it_however_often_it_was_looked_at_before() -> None:
    def goes_on(cell: tuple[World, Tracker], since: float, t: float) -> str:
        if since < 2.0 <= t:
            cell[0].track.start_joint_move(T0 + 2.0, [np.pi / 2, *UPRIGHT[1:]], 1.0, 2.0)
        if since < 6.0 <= t:
            cell[1].stand.move(T0 + 6.0, [50.0, 0.0, 0.0])
        return cell[1].visibility.hindrance("m", T0 + t)

    often, before, found = behind_the_arm("arm_radius_m = 0.05"), 0.0, set()
    for t in np.arange(0.5, 8.0, 0.1).tolist():
        why = goes_on(often, before, t)
        assert why == goes_on(behind_the_arm("arm_radius_m = 0.05"), 0.0, t)
        before = t
        found.add(why)
    assert found == {"", BROKEN, OUT_OF_RANGE}


def test_a_creeping_tracker_comes_to_see_what_an_arm_at_rest_hid() -> None:
    _, tracker = behind_the_arm("arm_radius_m = 0.05\ndrift_m_h = [0.0, 360.0, 0.0]")
    assert [tracker.visibility.hindrance("m", T0 + t) for t in (0.1, 5.0)] == [BROKEN, ""]


# -- following


def test_it_follows_a_moving_arm_only_when_told_to() -> None:
    for follows, status in ((True, ""), (False, NOT_AIMED)):
        subject, tracker = world()
        tracker.follow(T0, follows)
        assert aim_at(tracker, "smr1", T0) == ""
        end = subject.track.start_joint_move(T0 + 1.0, [0.6, -1.6, 1.7, -1.4, -1.5, 0.3], 0.5, 1.0)
        reading = tracker.read(end + 0.1)
        assert reading.status == status
        if follows:
            there = from_pose6(STAND).inv().apply(subject.tracker.visibility.position("smr1", end + 0.1))
            assert reading.point == pytest.approx(there, abs=3e-4)


def narrow() -> tuple[World, Tracker]:
    """A reflector that faces the tracker, with a cone so narrow that a turn of the last joint hides it."""
    smr = '[world.reflectors.s]\non = "arm"\npoint = [0.1, 0.0, 0.05]\nnormal = {}\nhalf_angle_rad = 0.3'
    probe, _ = world("", smr.format([1.0, 0.0, 0.0]))
    to_tracker = np.array(STAND[:3]) - probe.tracker.visibility.position("s", T0)
    way = probe.true_flange(T0).rotation.inv().apply(to_tracker)
    subject, tracker = world("", smr.format((way / np.linalg.norm(way)).tolist()))
    tracker.follow(T0, True)
    assert aim_at(tracker, "s", T0) == ""
    return subject, tracker


def turn_away_and_back(subject: World) -> float:
    """Returns when the arm is back."""
    q = np.array(subject.config.arm.q_start)
    there = subject.track.start_joint_move(T0 + 1.0, q + 1.2 * np.eye(6)[5], 1.0, 2.0)
    return subject.track.start_joint_move(there, q, 1.0, 2.0)


def test_it_loses_a_reflector_that_turned_away_during_the_move_even_if_it_faces_it_at_the_end() -> None:
    subject, tracker = narrow()
    back = turn_away_and_back(subject)
    assert tracker.read(back + 1.0).status == TURNED_AWAY
    assert tracker.visibility.hindrance("s", back + 1.0) == ""


def test_nobody_has_to_ask_while_the_arm_still_remembers_what_it_did() -> None:
    subject, tracker = narrow()
    back, q = turn_away_and_back(subject), np.array(subject.config.arm.q_start)
    for k in range(1, 8):  # long after that the track has forgotten
        subject.track.start_joint_move(back + 5.0 * k, q + 0.001 * k, 1.0, 2.0)
    assert subject.track.snapshot()[0].t0 > back
    assert tracker.read(back + 60.0).status == TURNED_AWAY


def test_a_search_takes_the_nearest_within_its_window_and_refuses_two_that_it_cannot_tell_apart() -> None:
    reflectors = """
[world.reflectors.a]
on = "base"
point = [0.0, 0.0, 0.9]
[world.reflectors.b]
on = "base"
point = [0.0, 0.1, 0.9]
[world.reflectors.c]
on = "base"
point = [-0.02, 0.1, 0.9]
"""
    _, tracker = world("", reflectors)
    hz, v = polar(tracker.visibility.local("a", T0))
    tracker.turn_to(T0, hz - 0.01, v)
    assert tracker.search(T0, 0.005, 0.005) == NO_TARGET
    assert tracker.search(T0, 0.2, 0.2) == ""
    assert tracker.target == "a"
    assert aim_at(tracker, "b", T0, half=0.2) == ""
    assert tracker.target == "b"
    wide = world("separable_rad = 0.01", reflectors)[1]
    assert aim_at(wide, "b", T0, half=0.2) == MULTIPLE
    assert wide.read(T0).point is None


def test_how_often_it_is_asked_changes_nothing() -> None:
    outcomes = []
    for step in (0.013, 0.4, 20.0):
        subject, tracker = world("elevation_rad = [-0.9, 0.05]")
        tracker.follow(T0, True)
        assert aim_at(tracker, "smr1", T0) == ""
        end = subject.track.start_joint_move(T0 + 1.0, [0.3, -1.5, 0.1, -1.57, -1.57, 0.0], 0.4, 1.0)
        for t in np.arange(T0, end, step):
            tracker.read(float(t))
        outcomes.append(tracker.read(end).status)
    assert outcomes == [OUT_OF_RANGE] * 3


# -- scenario


@pytest.mark.parametrize(
    ("tracker", "reflectors", "said"),
    [
        ("range_m = [5.0, 1.0]", None, "range_m is"),
        ("serial = '1234'", None, "serial"),
        ("sigma = 1.0", None, "sigma is not a known key, did you mean sigma"),
        (
            "",
            '[world.reflectors.s]\non = "base"\npoint = [0, 0, 0]\nnormal = [0, 0, 0]',
            "normal has no length",
        ),
        ("opaque = [{ min = [0, 0, 0], max = [1, 0, 1] }]", None, "min is not below max"),
    ],
)
def test_a_scenario_that_makes_no_sense_is_refused_by_name(
    tracker: str, reflectors: str | None, said: str
) -> None:
    with pytest.raises(CellError, match=said):
        scenario(tracker, reflectors)


def test_reflectors_without_a_tracker_are_refused() -> None:
    text = """
schema = "cellward.scenario/1"
[world.arm]
model = "ur10e"
q_start = [0.0, -1.8, 1.8, -1.57, -1.57, 0.0]
[world.reflectors.s]
on = "base"
point = [0.0, 0.0, 0.0]
"""
    with pytest.raises(CellError, match=r"give \[world.tracker\] too"):
        Scenario.parse(text)


def test_the_truth_names_every_reflector_and_its_place() -> None:
    subject, _ = world()
    told: dict[str, Any] = subject.truth()["tracker"]
    assert told["T_base_tracker"] == pytest.approx(STAND)
    assert set(told["reflectors"]) == {"smr1", "m1"}
    assert told["reflectors"]["m1"]["p_base"] == pytest.approx([0.6, -0.5, 0.02])
