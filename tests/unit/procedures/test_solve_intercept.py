"""``cellward.intercept/1`` to a result: figures, causality, bad input, refusals and warnings."""

import copy
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench.intercept import HORIZONS, M_PER_COUNT, SimulatedSet, make, squares
from calibration.belt.arm_time import MotionLimits, rest_to_rest
from cell.errors import InputError
from daemon.words.result_text import result_text
from tests.kit.solved import solve_intercept


@pytest.fixture
def solve(tmp_path: Path) -> Any:
    def call(data: dict[str, Any], method: str | None = None) -> dict[str, Any]:
        path = tmp_path / "intercept.json"
        path.write_text(json.dumps(data))
        result = solve_intercept(path, method=method)
        json.dumps(result, allow_nan=False)
        return result

    return call


@pytest.fixture(scope="module")
def steady() -> SimulatedSet:
    return make("wrap", 3, seconds=9.0, queries=30)


def codes(result: dict[str, Any]) -> list[str]:
    return [w["code"] for w in result["warnings"]]


def rms(scene: SimulatedSet, result: dict[str, Any]) -> np.ndarray:
    return np.sqrt(np.mean(squares(scene, result), axis=0))


def test_predictions_across_a_wrap_are_near_the_bound(solve: Any, steady: SimulatedSet) -> None:
    result = solve(steady.data)
    assert steady.bound is not None
    # 30 queries scatter by 10 % about what many would show; the benchmark holds the mean to 1.05.
    assert np.all(rms(steady, result) < 1.3 * np.sqrt(steady.bound))
    assert result["verdict"] == "pass"
    assert [a["id"] for a in result["result"]["answers"]] == [q["id"] for q in steady.data["queries"]]


def test_the_belts_own_part_is_small_beside_the_camera(solve: Any) -> None:
    scene = make("ripple", 5, seconds=9.0, queries=12, camera=0.0, unknown=0.0)
    assert np.all(rms(scene, solve(scene.data)) < 1e-4)


def test_covariances_are_those_of_the_errors(solve: Any, steady: SimulatedSet) -> None:
    result = solve(steady.data)
    squared = []
    for a, u in zip(result["result"]["answers"], result["uncertainty"]["answers"], strict=True):
        e = np.array(a["pred"]) - steady.truth.xy(a["id"], a["t"] + np.array(HORIZONS))
        squared.append(np.einsum("hi,hij,hj->h", e, np.linalg.inv(np.array(u["cov"])), e))
    assert np.all((np.mean(squared, axis=0) > 1.0) & (np.mean(squared, axis=0) < 3.4))  # 2, 99.9 % of 30


@pytest.mark.parametrize("kind", ["ripple", "stop-start"])
def test_the_future_changes_nothing_bit_by_bit(solve: Any, kind: str) -> None:
    data = make(kind, 1, seconds=7.5, queries=8).data
    whole = solve(data)
    pairs = zip(whole["result"]["answers"], whole["uncertainty"]["answers"], data["queries"], strict=True)
    for answer, uncertainty, query in list(pairs)[::4]:
        cut = copy.deepcopy(data)
        cut["encoder"] = [row for row in data["encoder"] if row[0] <= query["t"]]
        cut["detections"] = [d for d in data["detections"] if d["t_recv"] <= query["t"]]
        cut["queries"] = [query]
        alone = solve(cut)
        assert alone["result"]["answers"] == [answer]
        assert alone["uncertainty"]["answers"] == [uncertainty]


def test_the_classic_method_is_causal_too_and_far_behind(solve: Any, steady: SimulatedSet) -> None:
    whole = solve(steady.data, "classic")
    assert whole["inputs"]["method"] == "classic"
    assert np.all(rms(steady, whole) > 2.0 * rms(steady, solve(steady.data)))
    query = steady.data["queries"][4]
    cut = copy.deepcopy(steady.data)
    cut["encoder"] = [row for row in cut["encoder"] if row[0] <= query["t"]]
    cut["detections"] = [d for d in cut["detections"] if d["t_recv"] <= query["t"]]
    cut["queries"] = [query]
    assert solve(cut, "classic")["result"]["answers"] == [whole["result"]["answers"][4]]


def plain(v: float = 0.2, **changes: Any) -> dict[str, Any]:
    """A belt along x without noise: item a at x = v (t - 1) - 0.4, asked at t = 1."""
    stamps = 0.005 * np.arange(400)
    data: dict[str, Any] = {
        "schema": "cellward.intercept/1",
        "belt": {"m_per_count": M_PER_COUNT, "dir": [1.0, 0.0, 0.0], "modulus": 65536, "period": 0.005},
        "robot": {"limits": {"v": 1.0, "a": 6.0, "j": 80.0}, "wait_point": [0.0, 0.1, 0.3], "above": 0.08},
        "encoder": [[float(t), int(np.floor(v * t / M_PER_COUNT + 0.5)) % 65536] for t in stamps],
        "detections": [{"id": "a", "t_recv": 0.9, "t_exp": 0.8, "xy": [-0.4 - 0.2 * v, 0.1], "z": 0.02}],
        "latency_mean": 0.1,
        "queries": [{"id": "a", "t": 1.0, "horizons": [0.0, 0.6]}],
    }
    return {**data, **changes}


def only(result: dict[str, Any]) -> dict[str, Any]:
    [answer] = result["result"]["answers"]
    return dict(answer)


def test_the_contact_is_the_first_root_of_arm_and_belt(solve: Any) -> None:
    answer = only(solve(plain()))
    assert answer["pred"] == [pytest.approx([-0.4, 0.1], abs=1e-4), pytest.approx([-0.28, 0.1], abs=1e-4)]
    limits = MotionLimits(1.0, 6.0, 80.0)
    way = float(rest_to_rest(np.array(answer["p_pick"][0]), limits))
    assert answer["t_pick"] == pytest.approx(
        1.0 + way + float(rest_to_rest(np.array(0.08), limits)), abs=1e-5
    )
    assert answer["p_pick"] == pytest.approx([-0.4 + 0.2 * (answer["t_pick"] - 1.0), 0.1], abs=1e-4)


def test_what_the_camera_leaves_open_is_in_each_answer(solve: Any) -> None:
    looks_down = [-0.5, 0.1, 0.82, float(np.pi), 0.0, 0.0]  # from 0.8 m above the item
    cov = np.zeros((14, 14))
    cov[3, 3] = 1e-6  # a turn of 1 mrad about x, which moves what lies below along y
    told = {"width": 1280, "height": 800, "K": [800.0, 800.0, 640.0, 400.0]}
    camera = {"T_base_camera": looks_down, "told": told, "cov": cov.tolist()}
    alone, subject = solve(plain()), solve(plain(camera=camera))
    covs = [np.array(found["uncertainty"]["answers"][0]["cov"]) for found in (alone, subject)]
    assert covs[1][:, 1, 1] - covs[0][:, 1, 1] == pytest.approx([0.64e-6] * 2, rel=0.01)
    assert covs[1][:, 0, 0] == pytest.approx(covs[0][:, 0, 0], rel=1e-6)
    assert subject["uncertainty"]["camera_95_m"] == pytest.approx(1.96 * 0.8e-3, rel=0.01)
    assert alone["uncertainty"]["camera_95_m"] is None
    assert solve(plain(camera={**camera, "cov": None}))["uncertainty"] == alone["uncertainty"]


def test_the_zone_holds_on_both_edges_with_the_dwell(solve: Any) -> None:
    waited = only(solve(plain(zone={"min": -0.1, "max": 0.2}, dwell_s=0.05)))
    assert waited["t_pick"] == pytest.approx(2.5, abs=2e-3)
    free = only(solve(plain()))
    edge = free["p_pick"][0]
    assert only(solve(plain(zone={"min": -1.0, "max": edge + 0.004}, dwell_s=0.05)))["t_pick"] is None
    assert only(solve(plain(zone={"min": -1.0, "max": edge + 0.012}, dwell_s=0.05)))["t_pick"] is not None
    assert only(solve(plain(v=0.0, zone={"min": -0.1, "max": 0.2})))["p_pick"] is None


def test_the_classic_contact_is_t1_and_t2_after_the_last_computation(solve: Any) -> None:
    near = plain(classic={"T1_s": 0.8, "t2_s": 0.15})
    answer = only(solve(near, "classic"))
    assert answer["t_pick"] == pytest.approx(1.0 + 0.8 + 0.15, abs=0.006)
    assert only(solve(plain(classic={"T1_s": 0.2, "t2_s": 0.15}), "classic"))["t_pick"] is None


def test_an_exposure_that_is_not_known_is_taken_from_the_mean_latency(solve: Any) -> None:
    data = plain()
    data["detections"][0]["t_exp"] = None
    assert only(solve(data))["pred"][0] == pytest.approx([-0.4, 0.1], abs=2e-4)


def test_several_sightings_of_an_item_are_weighed_and_a_false_one_is_left_out(solve: Any) -> None:
    data = plain()
    for t, off in ((0.5, 0.0), (0.6, 0.0), (0.7, 0.03)):
        xy = [-0.4 + 0.2 * (t - 1.0) + off, 0.1]
        data["detections"].append({"id": "a", "t_recv": t + 0.1, "t_exp": t, "xy": xy, "z": 0.02})
    result = solve(data)
    assert only(result)["pred"][0] == pytest.approx([-0.4, 0.1], abs=2e-4)
    assert codes(result) == ["detections.stray"]


def test_an_item_not_seen_yet_is_answered_with_null(solve: Any) -> None:
    data = plain()
    data["queries"].append({"id": "a", "t": 0.85, "horizons": [0.1, 0.2]})
    result = solve(data)
    late = result["result"]["answers"][1]
    assert late == {"id": "a", "t": 0.85, "pred": [[None, None]] * 2, "t_pick": None, "p_pick": None}
    assert codes(result) == ["queries.unseen"]


def test_the_scale_may_come_from_wheel_and_resolution(solve: Any) -> None:
    data = plain()
    del data["belt"]["m_per_count"]
    data["belt"] |= {"wheel_circumference_m": 0.2, "counts_per_revolution": 2000}
    assert only(solve(data))["pred"] == only(solve(plain()))["pred"]


def test_a_wrong_scale_and_direction_are_told_from_the_sightings(solve: Any) -> None:
    data = make("constant", 9, seconds=8.0, queries=20, sightings=(3, 4), unknown=0.0).data
    data["belt"]["m_per_count"] *= 1.05
    d = np.array(data["belt"]["dir"])
    data["belt"]["dir"] = (d + 0.08 * np.array([-d[1], d[0], 0.0])).tolist()
    assert {"belt.scale", "belt.direction"} <= set(codes(solve(data)))


def test_later_data_judge_the_predictions(solve: Any) -> None:
    scene = make("constant", 2, seconds=9.0, queries=20, sightings=(4, 4), camera=1e-4, unknown=0.0)
    early = copy.deepcopy(scene.data)
    for q in early["queries"]:
        q["t"] = min(d["t_recv"] for d in early["detections"] if d["id"] == q["id"]) + 1e-3
    heldout = solve(early)["heldout"]
    assert [row["horizon"] for row in heldout["travel"]] == list(HORIZONS)
    assert all(row["rms_m"] < 1e-4 for row in heldout["travel"])
    assert heldout["later_sightings"]["count"] > 20
    assert 1e-4 < heldout["later_sightings"]["rms_m"] < 4e-4


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"belt": {"m_per_count": 1e-4, "dir": [2.0, 0.0], "modulus": 65536, "period": 0.005}}, "belt.dir"),
        ({"belt": {"m_per_count": 1e-4, "dir": [1, 0], "modulus": 65536, "period": 0.02}}, "encoder.period"),
        ({"encoder": plain()["encoder"][:100] + plain()["encoder"][180:]}, "encoder.gap"),
        ({"encoder": plain()["encoder"][::-1]}, "encoder.order"),
    ],
)
def test_odd_data_are_used_and_told(solve: Any, change: dict[str, Any], code: str) -> None:
    result = solve(plain(**change))
    assert codes(result) == [code]
    assert result["verdict"] == "warn"
    assert only(result)["pred"][0] == pytest.approx([-0.4, 0.1], abs=3e-4)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"encoder": [[0.0, 5]]}, "too-few-counts"),
        ({"encoder": [[0.0, 5], [0.0, 6]]}, "no-time"),
        ({"detections": []}, "no-detections"),
    ],
)
def test_data_that_cannot_tell_are_refused(solve: Any, change: dict[str, Any], name: str) -> None:
    result = solve(plain(**change))
    assert (result["verdict"], result["result"]) == ("fail", None)
    assert result["reasons"][0].startswith(f"{name}: ")


@pytest.mark.parametrize(
    ("path", "value", "said"),
    [
        (("belt", "dir"), [0.0, 0.0, 1.0], "belt.dir must be a direction in base with a horizontal part"),
        (("belt", "m_per_count"), 0.0, "m_per_count 0"),
        (("belt", "modulus"), 100, "lie outside of modulus 100; correct belt.modulus"),
        (("zone",), {"min": 0.3, "max": 0.1}, "swap or correct them"),
        (("robot", "limits"), {"v": 1.0, "a": 6.0}, "robot.limits.j is missing; add it"),
        (("robto",), {}, "robto is an unknown key; did you mean 'robot'?"),
        (("belt", "m_per_count"), 0.1, "moves 0.1 m with one count, which no belt does; give it in metres"),
        (("belt", "m_per_count"), 1e-300, "which no belt does"),
        (("belt", "period"), 20, "belt.period is beyond 10 s"),
        (("belt", "period"), 1e-300, "belt.period should be greater than or equal to"),
        (("robot", "limits"), {"v": 1000, "a": 6.0, "j": 80.0}, "robot.limits.v is beyond 100 m/s"),
        (("robot", "above"), 80, "robot.above is beyond 10 m"),
        (("latency_mean",), 80, "latency_mean is beyond 10 s"),
        (("dwell_s",), 50, "dwell_s is beyond 10 s"),
        (("encoder",), [[0.0, 1], [1e308, 2]], "encoder[1][0] is beyond 1e+11 s"),
    ],
)
def test_bad_input_is_one_sentence_with_the_fix(
    solve: Any, path: tuple[str, ...], value: object, said: str
) -> None:
    data = plain()
    table = data
    for key in path[:-1]:
        table = table[key]
    table[path[-1]] = value
    with pytest.raises(InputError) as caught:
        solve(data)
    assert said in str(caught.value)
    assert "intercept.json" in str(caught.value)


def test_stamps_since_1970_give_the_same_contact(solve: Any) -> None:
    data, since = plain(), 1.7e9
    data["encoder"] = [[t + since, n] for t, n in data["encoder"]]
    data["detections"] = [{**d, "t_recv": since + 0.9, "t_exp": since + 0.8} for d in data["detections"]]
    data["queries"] = [{**q, "t": since + 1.0} for q in data["queries"]]
    later = only(solve(data))
    assert later["t_pick"] - since == pytest.approx(only(solve(plain()))["t_pick"], abs=1e-5)


def test_counts_by_another_clock_leave_no_answer_and_fail(solve: Any) -> None:
    result = solve(plain(encoder=[[1e3 * (t + 2.0), n] for t, n in plain()["encoder"]]))
    assert result["verdict"] == "fail"
    assert result["reasons"][0].startswith("no-answers: ")
    assert "one clock" in result["reasons"][0]


def test_a_belt_given_backwards_is_told_as_such(solve: Any) -> None:
    data = make("constant", 9, seconds=8.0, queries=20, sightings=(3, 4), unknown=0.0).data
    data["belt"]["dir"] = [-v for v in data["belt"]["dir"]]
    result = solve(data)
    assert "the items move against belt.dir" in " ".join(result["reasons"])


@pytest.mark.parametrize("text", ["", " \n"])
def test_an_empty_file_is_called_empty(tmp_path: Path, text: str) -> None:
    (tmp_path / "intercept.json").write_text(text)
    with pytest.raises(InputError, match=r"intercept\.json is empty; replace it"):
        solve_intercept(tmp_path)


def test_a_mark_before_the_text_does_no_harm(tmp_path: Path) -> None:
    (tmp_path / "intercept.json").write_text(json.dumps(plain()), "utf-8-sig")
    assert solve_intercept(tmp_path)["verdict"] == "pass"


def test_an_unknown_exposure_needs_a_latency(solve: Any) -> None:
    data = plain()
    data["detections"][0]["t_exp"] = None
    del data["latency_mean"]
    with pytest.raises(InputError, match="add latency_mean in seconds"):
        solve(data)


def test_an_unknown_method_is_named(solve: Any) -> None:
    with pytest.raises(InputError, match="it must be adaptive or classic"):
        solve(plain(), "kalman")


def test_the_shorter_of_two_calls_is_the_time_and_progress_is_told(tmp_path: Path) -> None:
    path = tmp_path / "intercept.json"
    path.write_text(json.dumps(plain()))
    told: list[tuple[str, int, int]] = []
    result = solve_intercept(tmp_path, progress=lambda *step: told.append(step), calls=2)
    assert result["inputs"]["solve_seconds"] > 0.0
    assert told == 2 * [("solve", 1, 1)]


def test_the_result_in_words_names_contacts_and_what_came_true(solve: Any) -> None:
    data = plain(zone={"min": -1.0, "max": 2.0})
    data["queries"].append({"id": "b", "t": 1.0, "horizons": [0.1]})
    text = result_text(solve(data))
    assert "method adaptive: 2 queries, 1 predicted, 1 within reach" in text
    assert "belt over 0.6 s: 0.0" in text
    assert "b asked at 1.000 s: no answer" in text
    assert "warning queries.unseen" in text
