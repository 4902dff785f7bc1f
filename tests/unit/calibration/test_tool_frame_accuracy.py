"""The tool's displacement from made passes with known truth: how far off it is, and how far it says it is."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calibration.tool_frame.lateral import AVERAGING
from calibration.tool_frame.scene import Refused
from calibration.tool_frame.solution import Solution, solve
from cell.formats.laser import parse_laser
from procedures.laser.solve.data import scene_of
from tests.kit.laser_scene import APEX, BALL, GRIPPER, IDEAL, PIN, Bench, beams, data_set

TWO_HEIGHTS = {"depths": (0.006, 0.031)}
TURN = (0.012, -0.016, 0.0)  # 20 mrad
SHIFT = (0.0007, -0.0004, 0.0005)


def solved(bench: Bench, points: int = 256, method: str = "interval", **scan: Any) -> Solution:
    return solve(scene_of(parse_laser(data_set(bench, **scan), "made")), method, points)


def error_of(found: Solution, bench: Bench) -> np.ndarray:
    """(6,) m and rad; turns about the axis are not compared, as nothing shows them."""
    turn = np.zeros(3)
    if found.drot is not None:
        turn = found.drot - np.array(bench.turn)
        turn -= bench.axis_ref * (turn @ bench.axis_ref)
    return np.concatenate([found.dp - np.array(bench.shift), turn])


def many(count: int, bench: Bench, **scan: Any) -> np.ndarray:
    errors = []
    for seed in range(count):
        shift = tuple(np.random.default_rng(seed).uniform(-1e-3, 1e-3, 3))
        one = replace(bench, seed=seed, shift=shift)
        errors.append(error_of(solved(one, **scan), one))
    return np.array(errors)


def rms(errors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def test_at_20_mm_s_and_5_ms_the_point_is_found_to_28_um_and_its_height_to_12() -> None:
    errors = many(3, Bench())
    assert rms(errors[:, :2]) <= 28e-6
    assert rms(errors[:, 2:3]) <= 12e-6


def test_at_5_mm_s_and_2_ms_the_point_is_found_to_4_um() -> None:
    errors = many(1, Bench(speed=0.005, poll=0.002, reach=0.006), step=0.001, resolution=1e-4)
    assert rms(errors[:, :2]) <= 4e-6


def test_with_two_heights_a_tilted_tool_is_found_to_30_um_and_its_tilt_to_1_2_mrad() -> None:
    errors = many(8, Bench(turn=TURN), **TWO_HEIGHTS)
    assert rms(errors[:, :3]) <= 30e-6
    assert rms(errors[:, 3:]) <= 1.2e-3


@pytest.mark.parametrize(
    "bench",
    [
        Bench(seed=21, parts=BALL),
        Bench(seed=22, parts=APEX),
        Bench(seed=23, parts=IDEAL),
        Bench(
            seed=25,
            beams=beams(0.15, 0.01, 0.0005),
            R=Rotation.from_euler("xyz", [175.0, 4.0, 37.0], degrees=True),
            axis_ref=np.array([0.05, -0.1, 0.99373]) / np.linalg.norm([0.05, -0.1, 0.99373]),
            reach=0.012,
        ),
        Bench(seed=27, parts=GRIPPER, reach=0.02),
        Bench(seed=28, counters=True, pose_noise=2e-5, tau=0.012),
        Bench(seed=29, lag=0.004, hysteresis=1e-4),
    ],
    ids=["ball", "apex", "ideal", "skew beams, attitude, axis", "gripper", "noise", "switching"],
)
def test_tools_beams_attitudes_and_inputs_of_all_kinds_are_within_what_is_said(bench: Bench) -> None:
    bench = replace(bench, shift=SHIFT, turn=TURN)
    found = solved(bench, pairs=2, **TWO_HEIGHTS)
    e = error_of(found, bench)
    sigma = np.sqrt(np.diag(found.cov))
    assert found.drot is not None
    assert np.all(np.abs(e) <= 4.0 * sigma + 1e-7)
    assert np.linalg.norm(e[:2]) <= 60e-6
    assert np.linalg.norm(e[3:]) <= 2.5e-3
    limit = 300e-6 if bench.parts is GRIPPER else 30e-6
    assert abs(e[2]) <= limit


def test_the_delay_is_found_and_with_two_speeds_the_hysteresis_too() -> None:
    one = solved(Bench(seed=31, tau=0.012, hysteresis=2e-4), pairs=4)
    # 0.1 mm along the way at 20 mm/s is 5 ms that cannot be told from the delay.
    assert one.lateral.value("tau") == pytest.approx(0.017, abs=4e-4)
    assert one.lateral.value("hysteresis") is None
    late = Bench(seed=32, tau=0.012, hysteresis=2e-4, lag=0.003)
    two = solved(late, pairs=4, search_speed=0.06)
    deeper = solved(late, pairs=4, search_speed=0.06, step=0.012)
    for found, names in ((two, ("tau", "hysteresis")), (deeper, ("tau", "hysteresis", "lag"))):
        for name in names:
            sigma = found.lateral.deviation(name)
            assert sigma is not None
            assert abs(found.lateral.value(name) - getattr(late, name)) < 4.0 * sigma
    assert two.lateral.deviation("tau") < 1.5e-3
    # Near the tool's end a short chord is the tool's, not the input's.
    assert two.lateral.value("lag") is None


def test_a_search_that_meets_a_round_end_does_not_make_the_input_clear_early() -> None:
    """At 0.1 m/s and polls every 5 ms a chord that is 0.1 mm short is not seen to be."""
    bench = Bench(seed=35, parts=BALL, tau=0.002)
    found = solved(bench, pairs=3, search_speed=0.1, **TWO_HEIGHTS)
    near = found.lateral.narrower
    sigma = max(found.lateral.deviation(f"narrower {name}") or 0.0 for name in found.lateral.model.near_ends)
    assert sigma < 1.5e-4
    assert len(near) >= 4
    for place, narrower in near.items():
        height = float(np.mean(found.seen.crossings[place].above))  # of the ball's middle over the beam
        assert narrower == pytest.approx(0.003 - np.sqrt(0.003**2 - height**2), abs=4.0 * sigma)
    assert max(near.values()) > 2.0 * sigma
    assert found.lateral.value("lag") is None


def test_a_reference_that_leans_a_little_is_not_taken_for_straight() -> None:
    """The passes show the lean to about its own size; trusted to 0.1 mrad it would be 0.7 mrad off."""
    squares, towards = [], []
    for seed in range(12):
        way = np.random.default_rng(seed).choice((-1.0, 1.0), 2)
        before = Bench(seed=seed, turn=(*(1.2e-3 * way).tolist(), 0.0))
        now = replace(before, seed=seed + 100)
        data = data_set(now, before, pairs=1, **TWO_HEIGHTS)
        found = solve(scene_of(parse_laser(data, "made")), points=256)
        assert found.drot is not None
        off = found.drot[:2]  # the tool is as it was
        squares.append(off @ np.linalg.solve(found.cov[3:5, 3:5], off))
        towards.append(off * way)
    assert 0.8 < np.mean(squares) < 3.2
    assert abs(np.mean(towards)) < 4.5e-4


def test_one_height_shows_no_tilt_and_says_so() -> None:
    found = solved(Bench(seed=33))
    assert found.drot is None
    assert np.all(found.cov[3:] == 0.0)
    assert any("tilt" in words for words in found.undetermined)
    assert any("spin" in words for words in found.undetermined)
    assert all(0.0 < lever < 0.007 for lever in found.lever.values())


def test_a_reference_whose_axis_is_not_as_stated_is_compared_as_it_is() -> None:
    before = Bench(seed=35, turn=(0.004, 0.006, 0.0))
    now = Bench(seed=36, shift=SHIFT, turn=(0.012, -0.004, 0.0))
    data = data_set(now, before, pairs=4, **TWO_HEIGHTS)
    found = solve(scene_of(parse_laser(data, "made")), points=256)
    assert np.linalg.norm(found.drot - np.array([0.008, -0.010, 0.0])) < 1.5e-3
    assert np.linalg.norm((found.dp - np.array(SHIFT))[:2]) < 30e-6


def test_beams_whose_stated_height_is_wrong_are_taken_from_the_reference() -> None:
    bench = Bench(seed=37, shift=SHIFT, turn=TURN)
    data = data_set(bench, pairs=2, **TWO_HEIGHTS)
    for beam in data["beams"].values():
        beam["point"][2] += 0.02
    found = solve(scene_of(parse_laser(data, "made")), points=256)
    assert [code for code, _ in found.warnings] == ["laser.beam-height"] * 2
    assert np.linalg.norm(error_of(found, bench)[:3]) < 45e-6


def test_a_pass_that_disagrees_is_left_out_and_named() -> None:
    bench = Bench(seed=38, shift=SHIFT)
    data = data_set(bench, pairs=4)
    entry = data["current"]["passes"][-1]
    entry["poll_t"] = [t + 0.02 for t in entry["poll_t"]]
    found = solve(scene_of(parse_laser(data, "made")), points=256)
    last = len(data["reference"]["passes"]) + len(data["current"]["passes"]) - 1
    assert set(found.rejected) == {last}
    assert "disagrees" in found.rejected[last]
    assert np.linalg.norm(error_of(found, bench)[:2]) < 20e-6


def test_a_trigger_that_was_lost_deep_down_does_not_move_the_height() -> None:
    bench = Bench(seed=39, shift=SHIFT)
    data = data_set(bench, pairs=4)
    for entry in data["current"]["passes"][-2:]:
        entry["poll_v"] = [0] * len(entry["poll_v"])
    found = solve(scene_of(parse_laser(data, "made")), points=256)
    assert abs(error_of(found, bench)[2]) < 30e-6


def test_without_a_pass_above_the_tool_the_height_is_not_claimed() -> None:
    bench = Bench(seed=40, shift=SHIFT)
    data = data_set(bench)
    for name in ("reference", "current"):
        passes = data[name]["passes"]
        data[name]["passes"] = [p for p in passes if any(p["poll_v"])][-2:] + passes[:0]
        data[name]["passes"] += [p for p in passes if p["beam"] == "xs" and any(p["poll_v"])][-2:]
    found = solve(scene_of(parse_laser(data, "made")), points=256)
    assert found.z_sigma is None
    assert found.dp[2] == pytest.approx(0.0, abs=1e-12)
    assert [code for code, _ in found.warnings] == ["laser.no-height"]
    assert np.linalg.norm(error_of(found, bench)[:2]) < 90e-6


def test_averaging_is_what_the_middles_of_the_intervals_say() -> None:
    bench = Bench(seed=41, shift=SHIFT)
    plain, ours = solved(bench, method=AVERAGING, pairs=4), solved(bench, pairs=4)
    assert 0.0 < np.linalg.norm((plain.dp - ours.dp)[:2]) < 60e-6
    assert plain.lateral.effective is None


def test_passes_that_cannot_tell_are_refused_by_name() -> None:
    bench = Bench(seed=42)
    data = data_set(bench)
    for strip, name in (
        (lambda p: False, "no-edges"),
        (lambda p: p["beam"] == "xs", "one-beam-only"),
    ):
        passes = [p for p in data["current"]["passes"] if strip(p) or not any(p["poll_v"])]
        scene = scene_of(parse_laser({**data, "current": {"passes": passes}}, "made"))
        with pytest.raises(Refused, match=name):
            solve(scene)
    skew = {**data, "beams": {**data["beams"], "ys": {"point": [0, 0, 0], "dir": [1.0, 0.05, 0.0]}}}
    with pytest.raises(Refused, match="beams-parallel"):
        solve(scene_of(parse_laser(skew, "made")))


def test_a_tool_that_is_wider_now_is_compared_by_its_middle() -> None:
    before = Bench(seed=43)
    now = Bench(seed=44, shift=SHIFT, turn=TURN, parts=(replace(PIN[0], radius=0.0032),))
    data = data_set(now, before, pairs=2, **TWO_HEIGHTS)
    found = solve(scene_of(parse_laser(data, "made")), points=256)
    assert [code for code, _ in found.warnings] == ["laser.width"] * 2
    assert found.rejected == {} or all("met the tip" in r for r in found.rejected.values())
    e = error_of(found, now)
    assert np.linalg.norm(e[:2]) < 40e-6
    assert np.linalg.norm(e[3:]) < 2e-3


def test_a_reference_without_a_pass_above_it_is_taken_from_the_stated_beams() -> None:
    bench = Bench(seed=45, shift=SHIFT)
    data = data_set(bench)
    data["reference"]["passes"] = [p for p in data["reference"]["passes"] if any(p["poll_v"])]
    for beam in ("xs", "ys"):
        own = [p for p in data["reference"]["passes"] if p["beam"] == beam]
        data["reference"]["passes"] = [
            p for p in data["reference"]["passes"] if p["beam"] != beam or p in own[-2:]
        ]
    found = solve(scene_of(parse_laser(data, "made")), points=256)
    assert [code for code, _ in found.warnings] == ["laser.reference-height"] * 2
    assert abs(error_of(found, bench)[2]) < 40e-6


def test_an_input_that_is_not_as_late_as_in_the_reference_is_told_and_does_no_harm() -> None:
    bench = Bench(seed=46, shift=SHIFT, tau=0.004)
    before = replace(bench, seed=47, shift=(0.0, 0.0, 0.0), tau=0.010)
    found = solve(scene_of(parse_laser(data_set(bench, before, pairs=2), "made")), points=256)
    assert [code for code, _ in found.warnings] == ["laser.delay"]
    assert found.lateral.value("tau") == pytest.approx(0.010, abs=5e-4)
    assert found.lateral.value("tau_current") == pytest.approx(0.004, abs=5e-4)
    assert np.linalg.norm(error_of(found, bench)[:2]) < 28e-6
