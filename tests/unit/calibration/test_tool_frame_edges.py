"""From polls to edges: the interval of each, pulses between polls, bounce, and which passes are used."""

from typing import Any

import numpy as np

from calibration.tool_frame.crossings import see
from calibration.tool_frame.edges import merged
from calibration.tool_frame.geometry import frames
from calibration.tool_frame.scene import Pass, ToolFrameScene
from calibration.tool_frame.selection import select
from cell.formats.laser import parse_laser
from procedures.laser.solve.data import scene_of
from tests.kit.laser_scene import Bench, Part, without_passes


def polled(levels: list[int], counts: list[int] | None = None, dt: float = 0.0) -> Pass:
    n = len(levels)
    return Pass(
        index=0,
        current=False,
        beam="xs",
        direction=1,
        pose_t=np.array([0.0, n * 0.01]),
        pose_xyz=np.zeros((2, 3)),
        poll_t=np.arange(n) * 0.01,
        poll_v=np.array(levels) != 0,
        poll_n=None if counts is None else np.array(counts),
        poll_dt=None if dt == 0.0 else np.full(n, dt),
    )


def scene(passes: list[dict[str, Any]], bench: Bench) -> ToolFrameScene:
    data = without_passes(bench)
    data["reference"]["passes"] = passes
    return scene_of(parse_laser(data, "made", current=False))


def selected(passes: list[dict[str, Any]], bench: Bench) -> tuple[Any, Any]:
    made = scene(passes, bench)
    seen = see(made, frames(made.beams, made.R, made.tool))
    return seen, select(made, seen)


def test_an_edge_lies_between_the_poll_before_it_and_the_one_that_shows_it() -> None:
    found = polled([0, 0, 1, 1, 0], dt=0.001).edges
    assert [(round(e.low, 6), round(e.high, 6), e.rising) for e in found] == [
        (0.01, 0.02, True),
        (0.03, 0.04, False),
    ]
    assert found[0].soft == 0.001


def test_a_pulse_between_two_polls_is_two_edges_in_one_interval() -> None:
    found = polled([0, 0, 0], [3, 3, 5]).edges
    assert [(e.low, e.high, e.rising) for e in found] == [(0.01, 0.02, True), (0.01, 0.02, False)]


def test_a_counter_that_contradicts_the_levels_is_left_aside() -> None:
    for counts in ([7, 7, 0, 0, 1], [0, 0, 2, 2, 4]):
        assert len(polled([0, 0, 1, 1, 0], counts).edges) == 2


def test_bounce_is_one_edge_whose_interval_covers_it() -> None:
    levels = [0] * 5 + [1, 0, 1] + [1] * 100 + [0] * 5
    found = merged(polled(levels).edges)
    assert [e.rising for e in found] == [True, False]
    assert (round(found[0].low, 6), round(found[0].high, 6)) == (0.04, 0.07)


def test_intervals_along_the_way_hold_the_true_edges() -> None:
    bench = Bench(seed=3, tau=0.0)
    seen, _ = selected(bench.there_and_back("xs", -0.005), bench)
    for crossing in seen.crossings.values():
        assert np.all(np.abs(crossing.low) < 0.0031)
        for low, high, edge in zip(crossing.low, crossing.high, (-0.003, 0.003), strict=True):
            assert low <= edge <= high
            assert high - low < 1.3e-4


def test_a_way_without_its_return_tells_nothing_and_says_so() -> None:
    bench = Bench(seed=4)
    passes = bench.there_and_back("xs", -0.005)
    passes[1]["poll_v"] = [0] * len(passes[1]["poll_v"])
    _, selection = selected(passes + bench.there_and_back("xs", -0.005), bench)
    assert list(selection.across) == [2, 3]
    assert "do not both show" in selection.reasons[0]
    assert 1 not in selection.missed


def test_one_way_of_two_at_the_tools_end_is_no_fault_where_the_search_began_two_millimetres_above() -> None:
    bench = Bench(seed=4)
    at_the_end = bench.there_and_back("xs", -0.0006)
    at_the_end[1]["poll_v"] = [0] * len(at_the_end[1]["poll_v"])
    above, inside = bench.there_and_back("xs", 0.0012), bench.there_and_back("xs", -0.0008)
    _, selection = selected(above + inside + at_the_end + bench.there_and_back("xs", -0.005), bench)
    assert selection.reasons[4] == "met the tip alone: one way of two"
    assert 4 in selection.grazing


def test_near_the_end_a_pass_with_late_polls_tells_the_height_alone() -> None:
    bench = Bench(seed=4, parts=(Part(round=True),))
    passes = bench.there_and_back("xs", 0.0) + bench.there_and_back("xs", -0.006)
    _, as_usual = selected(passes, bench)
    for late in (passes[0], passes[2]):
        rise = late["poll_v"].index(1)
        for key in ("poll_t", "poll_v"):
            del late[key][rise - 2 : rise + 3]
    _, selection = selected(passes, bench)
    assert list(as_usual.across) == [0, 1, 2, 3]
    assert list(selection.across) == [1, 2, 3]  # further up the tool is as wide at one height as at another
    assert list(selection.grazing) == [0]
    assert 0 in selection.hits
    assert "polls came too late" in selection.reasons[0]


def test_a_pass_whose_speed_changes_while_it_crosses_is_flagged() -> None:
    bench = Bench(seed=5)
    passes = bench.there_and_back("xs", -0.005) + bench.there_and_back("xs", -0.005)
    entry = passes[0]
    t = np.array(entry["pose_t"])
    slow = t[0] + (t - t[0]) ** 1.35 / (t[-1] - t[0]) ** 0.35
    entry["pose_xyz"] = np.column_stack(
        [np.interp(slow, t, x) for x in np.array(entry["pose_xyz"]).T]
    ).tolist()
    _, selection = selected(passes, bench)
    assert list(selection.across) == [1, 2, 3]
    assert "the speed changed by" in selection.reasons[0]


def test_noise_of_the_poses_is_not_taken_for_a_change_of_speed() -> None:
    bench = Bench(seed=6, pose_noise=3e-5)
    _, selection = selected([w for _ in range(5) for w in bench.there_and_back("xs", -0.005)], bench)
    assert len(selection.across) == 10


def test_a_ball_that_is_just_met_tells_the_height_and_not_the_place_across() -> None:
    bench = Bench(seed=7, parts=(Part(round=True),))
    passes = bench.there_and_back("xs", 0.0025) + bench.there_and_back("xs", -0.006)
    _, selection = selected(passes, bench)
    assert list(selection.across) == [2, 3]
    assert list(selection.grazing) == [0, 1]
    assert set(selection.hits) == {0, 1, 2, 3}


def test_a_finger_that_is_met_alone_tells_the_height() -> None:
    fingers = (Part(0.004, offset=(0.0, 0.012, 0.0)), Part(0.004, offset=(0.0, -0.012, -0.001)))
    bench = Bench(seed=8, parts=fingers, reach=0.02)
    passes = bench.there_and_back("xs", -0.0005) + [
        w for _ in range(2) for w in bench.there_and_back("xs", -0.006)
    ]
    seen, selection = selected(passes, bench)
    assert list(seen.partial) == [0, 1]
    assert set(selection.hits) == set(range(6))
    assert all(seen.crossings[k].edges == 4 for k in selection.across)
