"""Where a tool's end first meets a beam: the likelihood of hits, misses and lengths."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr

from calibration.tool_frame import height
from calibration.tool_frame.glimpse import LOST, glimpse
from calibration.tool_frame.height import first_contact, log_likelihood, weights
from calibration.tool_frame.height_search import HeightSearch, sought
from calibration.tool_frame.repeatability import scatter_of
from calibration.tool_frame.solution import solve
from calibration.tool_frame.standstills import SHARED
from calibration.tool_frame.tip import ENDS, TipShape, ToolInBeam
from cell.formats.laser import parse_laser
from cell.poses import Array
from procedures.laser.solve.data import scene_of
from tests.kit.height_scene import (
    CHORD_M,
    FAST,
    FLAT_END,
    PERIOD_S,
    RIMMED_END,
    ROUND_END,
    SLOW,
    VIEW,
    End,
    crossed,
    pairs_at,
    searched,
    stepped,
)
from tests.kit.laser_scene import BALL, Bench, Part, data_set

SIGMA = 1e-5


def known(seed: int, end: End, heights: list[float], sigma: float = SIGMA) -> tuple[float, float]:
    """Error and standard deviation of a first contact at height 0, from ways at ``heights`` (m)."""
    rng = np.random.default_rng(seed)
    scatter = scatter_of(sigma * np.sqrt(2.0), sigma)
    found = first_contact(pairs_at(rng, end, 0.0, heights, sigma), VIEW, ENDS, scatter, -3e-4, 3e-4)
    w = weights(found.evidence, ENDS, scatter)
    mean = float(np.sum(w * found.mean))
    return mean, float(np.sqrt(np.sum(w * (found.var + (found.mean - mean) ** 2))))


NEAR = [-1e-4, -4e-5, 1e-5, -1e-5, 2e-5, -2e-5, 0.0]


@pytest.mark.parametrize(
    "end", [ROUND_END, FLAT_END, RIMMED_END, stepped], ids=["round", "flat", "rimmed", "stepped"]
)
@pytest.mark.parametrize("sigma", [1e-5, 2.1e-5])
def test_the_height_is_as_true_as_it_is_said_to_be(end: End, sigma: float) -> None:
    found = np.array([known(seed, end, NEAR, sigma) for seed in range(16)])
    squared = (found[:, 0] / found[:, 1]) ** 2
    assert 0.3 < np.mean(squared) < 2.0
    assert np.mean(squared < 1.96**2) >= 0.8


def test_lengths_of_breaks_tell_the_height_of_a_round_end() -> None:
    deep = [-1.2e-4, -8e-5, -1e-4, -6e-5]
    (_, by_length), (_, by_hits) = known(1, ROUND_END, [*deep, 5e-5]), known(1, FLAT_END, [*deep, 5e-5])
    assert by_length < 0.7 * by_hits


def test_a_way_whose_polls_left_out_the_crossing_tells_nothing_by_missing() -> None:
    places = np.concatenate([np.arange(-0.01, -1e-3, 1e-4), np.arange(1e-3, 0.01, 1e-4)])
    blind = glimpse(0.0, 1, places, np.zeros(len(places), dtype=bool), 0.0, 2e-4)
    seeing = glimpse(0.0, 1, np.arange(-0.01, 0.01, 1e-4), np.zeros(200, dtype=bool), 0.0, 2e-4)
    short = np.array([0.0, 3e-4, 7e-4])
    assert blind.at(short) == pytest.approx(1.0, abs=0.05)
    assert seeing.at(short)[0] > 0.99
    assert seeing.at(short)[1:] == pytest.approx(LOST)


def test_polls_whose_times_may_be_off_say_less_by_missing() -> None:
    places, clear, half = np.arange(-0.01, 0.01, 1e-4), np.zeros(200, dtype=bool), np.array([5e-5])
    sharp, soft = (glimpse(0.0, 1, places, clear, 0.0, 2e-4, off) for off in (0.0, 2.5e-5))
    assert sharp.at(half)[0] == pytest.approx(0.5, abs=0.01)
    assert soft.at(half)[0] == pytest.approx(1.0, abs=0.01)
    assert soft.at(np.array([1.6e-4]))[0] == pytest.approx(LOST)


def test_a_hit_leaves_the_lengths_that_its_polls_enclose() -> None:
    places = np.arange(-0.01, 0.01, 1e-4)
    dark = np.abs(places) < 5.5e-4  # eleven polls
    found = glimpse(0.0, 1, places, dark, 0.0, 2e-4)
    assert found.at(np.array([1.1e-3]))[0] == pytest.approx(1.0, abs=0.05)
    assert found.at(np.array([0.0, 9.5e-4, 1.25e-3])) == pytest.approx(LOST)


def test_one_pass_that_is_not_what_it_seems_does_not_move_the_height() -> None:
    rng = np.random.default_rng(3)
    seen = pairs_at(rng, ROUND_END, 0.0, NEAR, SIGMA)
    places = np.arange(-0.01, 0.01, 1e-4)
    lost = [glimpse(-2e-4, 99, places, np.zeros(len(places), dtype=bool), 0.0, 2e-4)]
    scatter = scatter_of(None, SIGMA)
    good, bad = (first_contact(g, VIEW, ENDS, scatter, -3e-4, 3e-4) for g in (seen, seen + lost))
    k = np.unravel_index(int(np.argmax(good.evidence)), good.evidence.shape)
    assert bad.mean[k] == pytest.approx(good.mean[k], abs=2e-6)


def test_what_is_the_same_for_many_ends_is_folded_once_and_each_says_what_it_says_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scatter, folded = scatter_of(None), []
    blurred = height._blurred

    def counted(rows: Array, points: float) -> Array:
        folded.append(len(rows))
        return blurred(rows, points)

    seen = pairs_at(np.random.default_rng(5), ROUND_END, 0.0, NEAR, SIGMA)
    grid = np.linspace(-3e-4, 3e-4, 101)
    monkeypatch.setattr(height, "_blurred", counted)
    together = log_likelihood(seen, VIEW, ENDS, scatter, grid)
    assert max(folded) < 0.5 * len(seen) * len(ENDS)
    for k in (0, 1, len(ENDS) - 1):
        alone = log_likelihood(seen, VIEW, ENDS[k : k + 1], scatter, grid)
        assert together[k] == pytest.approx(alone[0], rel=1e-9)


def test_the_log_likelihood_adds_up_pairs_of_ways_folded_with_what_is_theirs_and_what_they_share() -> None:
    scatter, ends, grid = scatter_of(None), ENDS[::12], np.linspace(-3e-4, 3e-4, 51)
    seen = pairs_at(np.random.default_rng(6), ROUND_END, 0.0, NEAR[:5], SIGMA)
    seen = [*seen, replace(seen[0], pair=99)]  # one way without its way back
    chances = dict(zip(map(id, seen), height._chances(seen, VIEW, ends, grid, None), strict=True))
    expected = np.zeros((len(ends), len(scatter.sigmas), len(grid)))
    for k, points in enumerate(scatter.sigmas / (grid[1] - grid[0])):
        for pair in {g.pair for g in seen}:
            ways = [chances[id(g)] for g in seen if g.pair == pair]
            if len(ways) == 1:
                expected[:, k] += np.log(height._blurred(ways[0], points))
            else:
                own = [height._blurred(way, np.sqrt(1.0 - SHARED) * points) for way in ways]
                expected[:, k] += np.log(height._blurred(np.prod(own, axis=0), np.sqrt(SHARED) * points))
    assert log_likelihood(seen, VIEW, ends, scatter, grid) == pytest.approx(expected, rel=1e-9)


def test_a_way_out_and_one_back_are_each_judged_by_the_breaks_of_their_own_direction() -> None:
    """A flat end that is tilted leaves the beam late on ways in one direction, and not in the other."""
    rng, scatter, grid = np.random.default_rng(9), scatter_of(2e-5), np.linspace(-2e-4, 2e-4, 81)
    normal = np.array([0.0, np.cos(0.02), np.sin(0.02)])
    view = replace(VIEW, axis=np.array([0.0, np.sin(0.02), -np.cos(0.02)]), n=normal)
    ends = [TipShape("flat", 0.5, band=8e-5, rim=2e-4), TipShape("edge", 0.5, band=8e-5), ROUND_END]
    ways = [
        replace(crossed(rng, ROUND_END, 1e-4 - h, h, k), sense=1.0 - 2.0 * (k % 2))
        for k, h in enumerate([0.0, 0.0, 5e-5, 3e-5])
    ]
    alone = [log_likelihood([way], view, ends, scatter, grid) for way in ways]
    found = log_likelihood(ways, view, ends, scatter, grid)
    assert found == pytest.approx(np.sum(alone, axis=0), abs=1e-9)
    other = log_likelihood([replace(ways[0], sense=-1.0)], view, ends, scatter, grid)
    assert np.max(np.abs(other - alone[0])[:2]) > 0.1


@pytest.mark.parametrize("points", [0.01, 0.4, 3.0, 60.0])
def test_a_fold_takes_from_each_point_what_its_cell_has_of_the_normal_and_goes_on_beyond_the_ends(
    points: float,
) -> None:
    n, far = 2 * height._STRETCH + 30, 800
    values = np.random.default_rng(2).uniform(LOST, 1.0, (2, n))
    at = np.arange(-far, n + far)
    longer = values[:, np.clip(at, 0, n - 1)]
    sigma = max(points**2 - 1.0 / 12.0, height._NARROW**2) ** 0.5
    share = [ndtr((at - k + 0.5) / sigma) - ndtr((at - k - 0.5) / sigma) for k in range(n)]
    assert height._blurred(values, points) == pytest.approx(longer @ np.array(share).T, rel=1e-9)


@pytest.mark.parametrize("end", [ROUND_END, FLAT_END], ids=["round", "flat"])
def test_a_search_in_height_gets_near_the_end_from_any_first_hit(end: TipShape) -> None:
    rng = np.random.default_rng(8)
    found = [searched(rng, end, SIGMA) for _ in range(3)]
    assert all(abs(s.mean - truth) < 4.0 * s.sigma for s, truth in found)
    assert all(s.sigma < 1.5e-4 for s, _ in found)


def test_near_the_end_of_a_round_tool_the_search_goes_slowly() -> None:
    rng = np.random.default_rng(9)
    found, _ = searched(rng, ROUND_END, SIGMA, most=6)
    assert found.next.speed == SLOW


@pytest.mark.parametrize(("period_s", "slowest"), [(0.01, 0.5 * SLOW), (0.02, 0.25 * SLOW)])
def test_where_polls_are_slow_the_search_goes_more_slowly_still(period_s: float, slowest: float) -> None:
    """A ball's break of 0.49 mm, 10 um below its first contact, is to last four polls."""
    search = HeightSearch(0.0, 5e-3, CHORD_M, False, scatter_of(1.4e-5), FAST, SLOW, period_s)
    rng = np.random.default_rng(3)
    near = (1.5e-3, 1.9e-3, 2.01e-3, 1.95e-3, 1.98e-3, 1.99e-3, 2.005e-3)
    seen = [crossed(rng, ROUND_END, 2e-3 - h, h, k, 0.1 * SLOW) for k, h in enumerate(near)]
    assert sought(search, seen).next.speed == slowest


def test_a_search_goes_on_from_what_it_believed() -> None:
    rng = np.random.default_rng(12)
    search = HeightSearch(0.0, 5e-3, CHORD_M, False, scatter_of(1.4e-5), FAST, SLOW, PERIOD_S)
    seen = [crossed(rng, ROUND_END, 2e-3 - h, h, k) for k, h in enumerate((1.5e-3, 1.9e-3, 2.01e-3, 1.95e-3))]
    anew, then = sought(search, seen), sought(search, [])
    for each in seen:
        then = sought(search, [each], then.belief)
    assert then.mean == pytest.approx(anew.mean, abs=0.02 * anew.sigma)
    assert then.sigma == pytest.approx(anew.sigma, rel=0.02)


def test_an_arm_that_comes_back_exactly_is_searched_with_as_well() -> None:
    found, truth = searched(np.random.default_rng(4), FLAT_END, 1e-8, most=20)
    assert abs(found.mean - truth) < 5.0 * found.sigma


def test_a_search_is_not_misled_by_a_chord_that_is_not_known() -> None:
    """Breaks shorter than the chord are those of an end, and the search would creep up to it from below."""
    found = [
        searched(np.random.default_rng(k), FLAT_END, SIGMA, 10, longer=6e-4, unsure=7e-4) for k in range(4)
    ]
    assert max(abs(f.mean - truth) for f, truth in found) < 2.5e-5
    assert max(f.sigma for f, _ in found) < 1e-5


def test_one_pass_a_height_leaves_the_height_less_sure_with_an_arm_that_repeats_badly() -> None:
    data = data_set(Bench(seed=5, parts=BALL), pairs=2)
    good, bad = (
        solve(scene_of(parse_laser({**data, "repeatability_m": r}, "made")), points=128) for r in (3e-6, 3e-5)
    )
    assert good.z_sigma is not None
    assert bad.z_sigma is not None
    assert bad.z_sigma > good.z_sigma


def test_the_height_goes_with_what_is_not_known_across() -> None:
    found = solve(
        scene_of(parse_laser(data_set(Bench(seed=6, turn=(0.01, 0.0, 0.0)), depths=(0.006, 0.031)), "m"))
    )
    assert np.any(np.abs(found.cov[2, [0, 1, 3, 4]]) > 0.0)
    assert np.all(np.linalg.eigvalsh(found.cov) > -1e-18)


def test_an_end_of_no_known_shape_leaves_open_how_much_lower_it_reaches_tilted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A ball of the tool's radius reaches no lower, a flat end by the tilt times the radius."""
    other = (TipShape("other", 1.0, 0.15),)
    monkeypatch.setattr("calibration.tool_frame.rise.ENDS", other)
    most = 0.003 * 0.01
    found = {}
    for turn in (0.0, 0.01):
        bench = Bench(seed=6, turn=(turn, 0.0, 0.0), parts=(Part(0.003),))
        found[turn] = solve(scene_of(parse_laser(data_set(bench, depths=(0.006, 0.031)), "m")))
    tilted, straight = found[0.01].z_sigma, found[0.0].z_sigma
    assert tilted is not None
    assert straight is not None
    assert tilted**2 > straight**2 + 0.7 * most**2 / 12.0
    assert abs(found[0.01].dp[2]) < 2.6 * tilted
    across, beam, up = np.eye(3)
    view = ToolInBeam.of(np.array([np.sin(0.01), 0.0, -np.cos(0.01)]), across, beam, up, 0.003, 0.007)
    assert view.bulge(other[0]) == pytest.approx(0.5 * most, rel=0.01)
