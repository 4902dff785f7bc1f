"""Where the beams are, whether a new frame meets them, and what is expected before anything moves."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calibration.tool_frame.beams import FoundBeams, find_beams
from calibration.tool_frame.contacts import stated
from calibration.tool_frame.height import Density
from calibration.tool_frame.meeting import tool_point_meets
from calibration.tool_frame.prediction import predict
from calibration.tool_frame.rise import Rise
from calibration.tool_frame.scene import Refused
from calibration.tool_frame.solution import solve
from cell.formats.laser import parse_laser
from procedures.laser.solve.data import scene_of
from tests.kit.laser_scene import DOWN, POINT, Beam, Bench, beams, without_passes

R = DOWN.as_matrix()


def reference(bench: Bench, places: tuple[float, ...] = (0.0, 0.05), **scan: Any) -> dict[str, Any]:
    """A reference run: both beams at several places, with the beams known roughly."""
    passes: list[dict[str, Any]] = []
    for along in places:
        passes += replace(bench, seed=bench.seed + round(1e3 * along), along=along).scan(**scan)
    for k, p in enumerate(passes):
        start = 100.0 * k - p["pose_t"][0]
        for key in ("pose_t", "poll_t"):
            p[key] = [t + start for t in p[key]]
    return {
        "schema": "cellward.laser/1",
        "R_base_flange": bench.R.as_rotvec().tolist(),
        "beams": {
            "xs": {"point": (POINT + np.array([0.02, 0.0015, 0.004])).tolist(), "dir": [1.0, 0.0, 0.0]},
            "ys": {"point": (POINT + np.array([-0.002, 0.01, -0.003])).tolist(), "dir": [0.0, 1.0, 0.0]},
        },
        "tool": {"p_ref": bench.p_ref.tolist(), "axis_ref": bench.axis_ref.tolist(), "radius": 0.003},
        "reference": {"passes": passes},
        "current": {"passes": []},
    }


def found_in(data: dict[str, Any]) -> FoundBeams:
    return find_beams(scene_of(parse_laser(data, "made", current=False)), points=256)


def off_line(point: np.ndarray, beam: Beam) -> float:
    gap = point - beam.point
    return float(np.linalg.norm(gap - (gap @ beam.direction) * beam.direction))


def test_beams_are_found_where_they_are() -> None:
    bench = Bench(seed=1, beams=beams(angle=0.06, slope=0.004))
    found = found_in(reference(bench, pairs=3, depths=(0.006, 0.031)))
    assert found.warnings == []
    for name, beam in found.beams.items():
        true = bench.beams[name]
        across, height = np.sqrt(beam.cov_point[:2, :2].trace()), np.sqrt(beam.cov_point[2, 2])
        assert off_line(beam.line.point, true) < 4.0 * np.hypot(across, height)
        angle = float(np.linalg.norm(np.cross(beam.line.direction, true.direction)))
        assert angle < 4.0 * np.sqrt(beam.cov_direction.trace())
        assert beam.line.direction @ true.direction > 0.99
        assert beam.apart == pytest.approx(0.05, abs=1e-3)
        assert beam.slope == pytest.approx(0.004, abs=1.5e-3)
        # The point of the tool meets the beam there.
        assert beam.hit + R @ bench.p_ref == pytest.approx(beam.line.point, abs=1e-12)
    assert abs(found.plane_gap) < max(found.U_plane_gap, 1e-4)
    assert found.tau == pytest.approx(bench.tau, abs=4.0 * found.sigma_tau)
    assert np.sqrt(np.mean(np.square(list(found.out_back.values())))) < 1e-4
    assert all(chord == pytest.approx(0.006, abs=1e-4) for chord in found.chords.values())
    assert np.linalg.norm(found.axis_turn) < 2e-3


def test_a_gap_between_the_planes_of_the_beams_is_measured() -> None:
    low = beams()
    low["ys"] = replace(low["ys"], point=low["ys"].point - [0.0, 0.0, 0.001])
    found = found_in(reference(Bench(seed=2, beams=low), pairs=1))
    assert found.plane_gap == pytest.approx(0.001, abs=1e-4)


def test_an_update_against_found_beams_gives_the_displacement_of_the_tool() -> None:
    bench = Bench(seed=3, beams=beams(angle=0.06))
    data = reference(bench, pairs=2, depths=(0.006, 0.031))
    found = found_in(data)
    data["beams"] = {
        b: {"point": f.line.point.tolist(), "dir": f.line.direction.tolist()} for b, f in found.beams.items()
    }
    shift, turn = (0.0006, -0.0005, 0.0003), (0.004, 0.003, 0.0)
    now = replace(bench, seed=4, shift=shift, turn=turn)
    data["current"]["passes"] = now.scan(pairs=2, depths=(0.006, 0.031))
    answer = solve(scene_of(parse_laser(data, "made")), points=256)
    assert np.linalg.norm(answer.dp - shift) < 40e-6
    assert np.linalg.norm(answer.drot - np.array(turn)) < 2e-3


def test_one_place_of_each_beam_does_not_give_its_direction() -> None:
    with pytest.raises(Refused, match="one-place-only"):
        found_in(reference(Bench(seed=5), places=(0.0, 0.02)))


def test_beams_without_a_pass_above_the_tool_have_no_height() -> None:
    data = reference(Bench(seed=6))
    data["reference"]["passes"] = [p for p in data["reference"]["passes"] if any(p["poll_v"])][-10:] + [
        p for p in data["reference"]["passes"] if any(p["poll_v"]) and p["beam"] == "xs"
    ]
    with pytest.raises(Refused):
        found_in(data)


def test_a_right_candidate_meets_the_reference_and_the_plain_rule_does_not() -> None:
    true = np.array([0.0012, -0.0007, 0.0005])
    cov = np.diag([5e-6, 5e-6, 6e-6]) ** 2
    t_ref = np.array([0.0, 0.0, 0.18])
    measured = true + np.array([4e-6, -3e-6, 5e-6])
    second = true + np.array([-5e-6, 2e-6, -4e-6])
    between = second - measured
    right = tool_point_meets(t_ref + measured, t_ref, measured, between, cov, R)
    assert right.meets
    assert right.distance == pytest.approx(np.linalg.norm(measured - second))
    assert right.apart == pytest.approx(R @ (measured - second))
    offset = -R @ measured  # of the flange; the plain rule adds it to the frame as it stands
    plain = tool_point_meets(t_ref + offset, t_ref, measured, between, cov, R)
    assert not plain.meets
    assert plain.apart[0] == pytest.approx(-2.0 * true[0], abs=2e-5)
    old = tool_point_meets(t_ref, t_ref, true, np.zeros(3), cov, R)
    assert old.distance == pytest.approx(np.linalg.norm(true))


@pytest.mark.parametrize("chance", [1.0 / 300.0, 0.05])
def test_a_right_frame_misses_as_seldom_as_is_said_and_a_wrong_one_is_found(chance: float) -> None:
    cov = np.diag([8e-6, 5e-6, 1e-5]) ** 2
    draws = np.random.default_rng(7).multivariate_normal(np.zeros(3), cov, 60_000)
    gate = tool_point_meets(np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), cov, R, chance)
    assert np.mean(np.linalg.norm(draws, axis=1) > gate.U) == pytest.approx(chance, rel=0.25)
    for way in np.eye(3):
        found = np.linalg.norm(draws + gate.detectable * way, axis=1) > gate.U
        assert np.mean(found) >= 0.99
    assert np.mean(np.linalg.norm(draws + gate.detectable * np.eye(3)[2], axis=1) > gate.U) < 0.998


@pytest.mark.parametrize(
    ("pairs", "depths", "count"), [(2, (0.006,), 20), (2, (0.006, 0.031), 12)], ids=["point", "tilt"]
)
def test_what_is_predicted_is_what_comes_out(
    monkeypatch: pytest.MonkeyPatch, pairs: int, depths: tuple[float, ...], count: int
) -> None:
    def as_bracketed(self: Rise, beam: str, current: bool) -> Density:
        shape = len(self.ends), len(self.scatter.sigmas)
        return stated(self.vertical.brackets[beam, current].middle, 2e-5, shape)

    # It is of what comes out across the beams. Heights take most of the time, and have tests of their own.
    monkeypatch.setattr(Rise, "_density", as_bracketed)
    expected = predict(0.02, 0.005, pairs, 4e-11, depths, staggered=False)
    assert expected.slide_m == pytest.approx(1e-4)
    shifts, tilts = [], []
    for seed in range(count):
        bench = Bench(seed=seed, jitter=8e-4)
        bench.parts = (replace(bench.parts[0], radius=0.003 + 1e-4 * np.random.default_rng(seed).random()),)
        data = without_passes(bench)
        for name, one in (("reference", replace(bench, seed=seed + 900)), ("current", bench)):
            # Only what measures: the search has hits of its own, which a prediction does not count on.
            data[name]["passes"] = [
                w
                for beam in bench.beams
                for depth in depths
                for _ in range(pairs)
                for w in one.there_and_back(beam, -depth)
            ] + [w for beam in bench.beams for w in one.there_and_back(beam, 0.001)]
        answer = solve(scene_of(parse_laser(data, "made")), points=256)
        shifts.append(answer.dp[:2])
        tilts.append(answer.drot if answer.drot is not None else np.zeros(3))
    rms = float(np.sqrt(np.mean(np.sum(np.square(shifts), axis=1))))
    assert rms == pytest.approx(expected.sigma_xy_m, rel=0.25)
    if len(depths) > 1:
        tilt = float(np.sqrt(np.mean(np.sum(np.square(tilts), axis=1))))
        assert tilt == pytest.approx(float(np.sqrt(np.trace(expected.cov[3:, 3:]))), rel=0.25)
    else:
        assert expected.U_tilt_rad is None
