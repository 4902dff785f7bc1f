"""Intervals of a belt's scale when sightings share errors: of a frame, or of a place in the picture."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.adjustment.lens_terms import LensPrior
from calibration.belt.placing import POSE, off_by_camera
from calibration.belt.scale import BeltScale, fit_scale
from cell.formats.capture import Camera
from cell.formats.intercept import ItemsCamera
from cell.poses import to_pose6
from procedures.belt.calibrating.delay import with_delay
from procedures.belt.calibrating.rows import SightingRows, counts_at, rounding_variance
from procedures.belt.calibrating.slip import find_slip, part_at_slips
from procedures.belt.calibrating.spread import (
    lens_slopes,
    spread,
    with_camera,
    with_doubt,
    with_lens,
)
from tests.kit.belt_sightings import (
    BESIDE,
    FEW,
    MANY,
    NOISE,
    SCALE,
    SEEN,
    USUAL,
    WAY,
    Coverage,
    Error,
    Feed,
    coverage,
    nothing,
    of_frames,
    of_items,
    of_the_picture,
    seen,
)  # fmt: skip

RUNS = 150
HELD = (0.90, 0.987)  # 95 % of so many runs, three standard deviations about it, and a little for the sure


def assert_held(found: Coverage, most: float = HELD[1]) -> None:
    assert HELD[0] <= found.scale <= most, found
    assert found.angle >= HELD[0], found


@pytest.mark.parametrize("feed", [USUAL, MANY, FEW], ids=["usual", "many", "few"])
def test_independent_sightings_are_held_by_an_interval_close_to_what_their_noise_asks_for(feed: Feed) -> None:
    found = coverage(RUNS, feed=feed)
    assert_held(found)
    assert found.width < 1.5


def test_noise_that_is_larger_along_the_belt_is_not_averaged_with_that_across_it() -> None:
    found = coverage(RUNS, along=3.0 * NOISE)
    assert found.plain < 0.85
    assert_held(found)


@pytest.mark.parametrize("feed", [USUAL, MANY], ids=["usual", "many"])
def test_an_error_that_a_whole_frame_shares_is_in_the_interval(feed: Feed) -> None:
    found = coverage(RUNS, of_frames, feed)
    assert found.plain < 0.7
    assert_held(found)
    assert found.width < 1.2


@pytest.mark.parametrize("feed", [USUAL, MANY], ids=["usual", "many"])
def test_what_the_camera_gets_wrong_about_an_item_is_in_the_interval(feed: Feed) -> None:
    found = coverage(RUNS, of_items, feed)
    assert found.plain < 0.7
    assert_held(found)


@pytest.mark.parametrize("feed", [USUAL, MANY], ids=["usual", "many"])
def test_what_the_camera_gets_wrong_over_the_picture_is_in_the_interval(feed: Feed) -> None:
    found = coverage(RUNS, of_the_picture, feed)
    assert found.plain < 0.5
    assert_held(found)


def test_a_camera_that_is_turned_and_too_far_away_is_inside_the_interval_that_asks_for_it() -> None:
    turn_95, share_95, inside = 5e-4, 6e-4, []
    for seed in range(RUNS):
        rng = np.random.default_rng(seed)
        rows = seen(rng, feed=MANY)
        turned = Rotation.from_rotvec(rng.normal(0.0, turn_95 / 1.96, 3)).apply(rows.points)
        off = replace(rows, points=turned * (1.0 + rng.normal(0.0, share_95 / 1.96)))
        answer = fit_scale(off.points, off.counts, off.items)
        assert isinstance(answer, BeltScale)
        alone = spread(answer, off)
        assert alone is not None
        sure = with_camera(alone, answer, turn_95, share_95)
        inside.append(
            [
                abs(answer.m_per_count - SCALE) <= half.half_scale
                and abs(answer.direction @ BESIDE) <= half.half_angle
                for half in (sure, alone)
            ]
        )
        d = answer.direction
        assert np.sqrt(d @ sure.cov @ d) >= np.sqrt(d @ alone.cov @ d)
    with_it, without = np.mean(inside, axis=0)
    assert with_it > 0.85  # of both at once; 0.9 is right
    assert without < 0.5


def test_steps_of_a_depth_camera_widen_the_direction_in_height_and_not_the_level_one() -> None:
    held = []
    for seed in range(40):
        rng = np.random.default_rng([seed, 9])
        rows = seen(rng, feed=MANY)
        steps = 5e-4 * np.sin(8.0 * (rows.points @ WAY) + rng.uniform(0.0, 6.0))
        rows = replace(rows, points=rows.points + steps[:, None] * np.cross(WAY, BESIDE))
        answer = fit_scale(rows.points, rows.counts, rows.items)
        assert isinstance(answer, BeltScale)
        sure = spread(answer, rows)
        assert sure is not None
        assert sure.half_level < 0.3 * sure.half_angle
        held.append(abs(answer.direction @ BESIDE) <= sure.half_level)
    assert np.mean(held) > 0.85


def test_a_lens_that_is_known_as_by_its_maker_is_inside_the_interval_that_has_it() -> None:
    """Its focal length and centre, which no pattern over the picture shows."""
    pose = RigidTransform.from_components([0.5 * SEEN, 0.05, 0.8], Rotation.from_rotvec([3.1, 0.05, 0.1]))
    told = Camera(width=1280, height=800, K=[802.4, 801.7, 644.2, 396.8], dist=[0.02, -0.04, 0.0, 0.0, 0.0])
    camera = ItemsCamera(T_base_camera=to_pose6(pose).tolist(), told=told)
    inside = []
    for seed in range(RUNS // 2):
        rng = np.random.default_rng(seed)
        rows = seen(rng, feed=USUAL)
        by_lens = off_by_camera(rows.points, pose, told.intrinsics())[:, :, POSE:]
        off = rows.points.copy()
        off[:, :2] += by_lens[:, :, :4] @ rng.normal(0.0, LensPrior().sigma()[:4])
        rows = replace(rows, points=off)
        answer = fit_scale(rows.points, rows.counts, rows.items)
        assert isinstance(answer, BeltScale)
        alone = spread(answer, rows)
        assert alone is not None
        sure = with_lens(alone, answer, lens_slopes(answer, rows, camera))
        d = answer.direction
        assert np.sqrt(d @ (sure.cov - alone.cov) @ d) > 0.003 * SCALE
        inside.append(
            [
                [abs(answer.m_per_count - SCALE) <= half.half_scale for half in (sure, alone)],
                [abs(answer.direction @ BESIDE) <= half.half_angle for half in (sure, alone)],
            ]
        )
    (scale, scale_alone), (angle, _) = np.mean(inside, axis=0)
    assert scale > HELD[0]
    assert angle > HELD[0]
    assert scale_alone < 0.5


def test_late_stamps_of_counts_are_smoothed_out() -> None:
    rng = np.random.default_rng(3)
    sent = np.arange(800) * 0.005
    late = np.where(rng.random(800) < 0.1, rng.uniform(0.0, 0.012, 800), rng.uniform(0.0, 5e-4, 800))
    stamps = np.maximum.accumulate(sent + late)
    encoder = np.stack([stamps, np.floor(1500.0 * sent)], axis=1)
    times = np.linspace(0.5, 3.5, 60)
    off = (
        np.array([c.count for c in counts_at(encoder, list(times), 0.005) if c is not None]) - 1500.0 * times
    )
    plain = np.interp(times, encoder[:, 0], encoder[:, 1]) - 1500.0 * times
    assert len(off) == 60
    assert np.std(off) < 0.4 * np.std(plain)


def test_what_rounding_leaves_of_coarse_counts_is_known_where_it_drifts_with_the_belt() -> None:
    times = 1.0 + 0.25 * np.arange(24)  # 37 counts and a little from look to look
    off, told = [], []
    for phase in np.linspace(0.0, 1.0, 12, endpoint=False):
        stamps = np.arange(0.0, 8.0, 0.005)
        encoder = np.stack([stamps, np.floor(148.075 * stamps + phase)], axis=1)
        found = [counted for counted in counts_at(encoder, list(times), 0.005) if counted is not None]
        counts, rounding = np.array([c.count for c in found]), np.array([c.rounding for c in found])
        weight = counts - counts.mean()
        weight /= weight @ weight
        off.append(weight @ (counts - 148.075 * times))
        told.append(rounding_variance(weight, rounding))
    assert 0.3 < np.sqrt(np.mean(told)) / np.std(off) < 2.0


@pytest.mark.parametrize("ahead_m", [0.0006, -0.003])
def test_a_slip_of_the_wheel_is_found_and_taken_out_of_the_scale(ahead_m: float) -> None:
    for seed in range(10):
        rows = seen(np.random.default_rng(seed))
        when = float(rows.t[len(rows.t) // 2]) - 0.01
        slipped = replace(rows, counts=rows.counts + np.where(rows.t > when, ahead_m / SCALE, 0.0))
        with_slip = fit_scale(slipped.points, slipped.counts, slipped.items)
        assert isinstance(with_slip, BeltScale)
        parted = part_at_slips(with_slip, slipped)
        sure = spread(parted.answer, parted.rows)
        assert sure is not None
        assert abs(parted.answer.m_per_count - SCALE) < 2.0 * sure.half_scale
        if with_slip.used.all():  # else the sightings of items that met the slip are left out
            (slip,) = parted.slips
            assert parted.left is None
            assert slip.ahead_m == pytest.approx(ahead_m, abs=1.5e-4)
            assert abs(slip.t - when) < 0.2


@pytest.mark.parametrize(("ahead_m", "sure"), [(0.00012, False), (0.003, True)])
def test_the_interval_holds_without_a_slip_that_may_be_chance(ahead_m: float, sure: bool) -> None:
    rows = seen(np.random.default_rng(2))
    when = float(rows.t[len(rows.t) // 2]) - 0.01
    slipped = replace(rows, counts=rows.counts + np.where(rows.t > when, ahead_m / SCALE, 0.0))
    without = fit_scale(slipped.points, slipped.counts, slipped.items)
    assert isinstance(without, BeltScale)
    parted = part_at_slips(without, slipped)
    assert [slip.sigmas > 6.0 for slip in parted.slips] == [sure]
    alone = spread(parted.answer, parted.rows)
    assert alone is not None
    stated = with_doubt(alone, parted.answer, parted.doubt)
    apart = 0.0 if sure else abs(parted.answer.m_per_count - without.m_per_count)
    assert stated.half_scale == pytest.approx(alone.half_scale + apart, rel=1e-9)
    along = parted.answer.direction
    assert along @ (stated.cov - alone.cov) @ along == pytest.approx((apart / 1.96) ** 2, rel=1e-6)


@pytest.mark.parametrize("error", [nothing, of_frames, of_the_picture])
def test_what_sightings_share_is_not_taken_for_a_slip(error: Error) -> None:
    for seed in range(60):
        rows = seen(np.random.default_rng([seed, 5]), error)
        answer = fit_scale(rows.points, rows.counts, rows.items)
        assert isinstance(answer, BeltScale)
        assert find_slip(answer, rows) is None


def fit(data: SightingRows) -> BeltScale:
    answer = fit_scale(data.points, data.counts, data.items)
    assert isinstance(answer, BeltScale)
    return answer


def braking(rng: np.random.Generator, feed: Feed, late_m: float) -> SightingRows:
    """The belt brakes to a fifth over four frames; counts are as late as ``late_m`` is of way before."""
    data = seen(rng, feed=feed)
    frame = np.round(data.t / 0.1).astype(int)
    at = rng.integers(2, feed.frames - 6)
    speed = np.interp(np.arange(feed.frames), [at, at + 4], [1.0, 0.2])  # of the speed before
    t = np.concatenate([[0.0], np.cumsum(0.2 / (speed[1:] + speed[:-1]))])
    return replace(data, t=t[frame], points=data.points - late_m * speed[frame][:, None] * WAY)


@pytest.mark.parametrize("feed", [USUAL, MANY, FEW], ids=["usual", "many", "few"])
@pytest.mark.parametrize("late_m", [0.0, 1e-4, 4e-4])
def test_counts_that_are_late_where_the_belt_brakes_are_in_the_interval(feed: Feed, late_m: float) -> None:
    held = []
    for seed in range(RUNS // 2):
        data = braking(np.random.default_rng([seed, 11]), feed, late_m)
        parted = part_at_slips(fit(data), data)
        sure = spread(parted.answer, parted.rows)
        assert sure is not None
        sure = with_delay(with_doubt(sure, parted.answer, parted.doubt), parted.answer, parted.rows)
        held.append(abs(parted.answer.m_per_count - SCALE) <= sure.half_scale)
    assert np.mean(held) >= HELD[0]


def test_a_delay_costs_nothing_at_an_even_speed() -> None:
    data = seen(np.random.default_rng(3))
    answer = fit(data)
    sure = spread(answer, data)
    assert sure is not None
    assert with_delay(sure, answer, data).half_scale == pytest.approx(sure.half_scale, rel=1e-6)
