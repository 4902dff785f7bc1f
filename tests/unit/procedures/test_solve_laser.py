"""From a laser data set on disk to a result: figures, limits, refusals, one clear sentence for bad input."""

import json
import pickle
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.errors import CellError
from cell.formats.laser import parse_laser
from cell.formats.result import Result
from procedures.laser.solve.data import unit_warnings
from tests.kit.cli_harness import CommandLine
from tests.kit.laser_scene import DOWN, Bench, data_set, write
from tests.kit.solved import solve_laser, solve_reference

SHIFT, TURN = (0.0012, -0.0007, 0.0005), (0.006, -0.008, 0.0)
R = DOWN.as_matrix()


@pytest.fixture(scope="module")
def made() -> dict[str, Any]:
    return data_set(Bench(seed=1, shift=SHIFT, turn=TURN), depths=(0.006, 0.031), pairs=2, resolution=1e-4)


@pytest.fixture(scope="module")
def path(made: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("laser"), made)


@pytest.fixture(scope="module")
def result(path: Path) -> dict[str, Any]:
    return solve_laser(path)


def in_milliseconds(entry: dict[str, Any]) -> None:
    for key in ("pose_t", "poll_t"):
        entry[key] = [1e3 * t for t in entry[key]]


def without_times(result: dict[str, Any]) -> dict[str, Any]:
    return {**result, "inputs": {k: v for k, v in result["inputs"].items() if k != "solve_seconds"}}


def test_a_bent_tool_gives_a_result_in_the_format(result: dict[str, Any]) -> None:
    assert Result.model_validate(result).kind == "laser"
    assert result["verdict"] == "pass", result["warnings"]
    answer, uncertainty = result["result"], result["uncertainty"]
    error = np.array(answer["dp_flange"]) - SHIFT
    cov = np.array(answer["cov"])
    assert np.linalg.norm(error) < 60e-6
    assert error @ np.linalg.solve(cov[:3, :3], error) < 25.0
    assert np.linalg.norm(np.array(answer["drot_flange"]) - TURN) < 2.5e-3
    assert answer["flange_offset_base"] == pytest.approx(-R @ np.array(answer["dp_flange"]))
    assert answer["p_new"] == pytest.approx([0.0012, -0.0007, 0.1805], abs=6e-5)
    assert answer["tau"] == pytest.approx(0.004, abs=5e-4)
    assert 0.0 < uncertainty["U_xy_m"] < 1e-4
    assert 0.0 < uncertainty["U_z_m"] < 8e-5
    assert 0.0 < uncertainty["U_tilt_rad"] < 5e-3
    assert uncertainty["U_point_m"] >= uncertainty["U_xy_m"]
    rest = result["residuals"]
    assert rest["rms_m"] < 2.0 * rest["expected_m"]
    assert {entry["set"] for entry in rest["per_pass"]} == {"reference", "current"}
    used = [entry for entry in rest["per_pass"] if entry["used"]]
    assert all(entry["chord_m"] == pytest.approx(0.006, abs=3e-4) for entry in used)
    assert all(entry["speed_m_s"] == pytest.approx(0.02, rel=0.03) for entry in used)
    assert all(abs(entry["m"]) < 3e-4 for entry in rest["out_back"])
    assert result["heldout"]["edges"] > 20
    assert result["heldout"]["rms_m"] < 3.0 * result["heldout"]["expected_m"]
    assert result["observability"]["rank"] == 5
    assert any("spin" in words for words in result["observability"]["undetermined"])
    assert result["inputs"]["solve_seconds"] > 0.0
    json.dumps(result, allow_nan=False)


def test_replies_that_all_take_longer_leave_no_more_open(tmp_path: Path) -> None:
    """What every reply takes counts to the input's delay; what some take longer is what is not known."""
    data = data_set(Bench(seed=8, shift=SHIFT, counters=True), depths=(0.006, 0.031), pairs=2)
    quick = solve_laser(write(tmp_path, data))
    for entry in data["reference"]["passes"] + data["current"]["passes"]:
        entry["poll_dt"] = [2e-3 + 2e-3 * (k % 2) for k in range(len(entry["poll_dt"]))]
    uneven = solve_laser(write(tmp_path, data))
    for entry in data["reference"]["passes"] + data["current"]["passes"]:
        entry["poll_dt"] = [2e-3] * len(entry["poll_dt"])
    slow = solve_laser(write(tmp_path, data))
    assert slow["result"]["cov"] == quick["result"]["cov"]
    assert uneven["uncertainty"]["U_xy_m"] > 1.2 * slow["uncertainty"]["U_xy_m"]


def test_the_entries_can_be_sent_to_a_worker_process() -> None:
    for entry in (solve_laser, solve_reference):
        assert pickle.loads(pickle.dumps(entry)) is entry


def test_a_tool_that_is_bent_beyond_its_limits_fails_with_the_answer_and_the_limit(path: Path) -> None:
    found = solve_laser(path, limits={"max_shift_m": 0.001, "max_tilt_rad": 0.001})
    assert found["verdict"] == "fail"
    assert [r.split(":")[:2] for r in found["reasons"]] == [
        ["bent-tool", " max_shift_m"],
        ["bent-tool", " max_tilt_rad"],
    ]
    assert found["result"]["dp_flange"] is not None
    with pytest.raises(CellError, match="max_bend"):
        solve_laser(path, limits={"max_bend": 1.0})


def test_the_sources_method_has_its_offset_and_its_plain_rule_doubles_the_error(path: Path) -> None:
    found = solve_laser(path, method="classic")
    answer = found["result"]
    offset = np.array(answer["flange_offset_base"])
    assert offset == pytest.approx(-R @ np.array(answer["dp_flange"]))
    left = np.abs(np.array(SHIFT) - np.array(answer["source_rule_dp"]))
    assert left[0] > 1.5 * abs(SHIFT[0])
    assert answer["drot_flange"] is None
    assert answer["cov"] is None
    assert [w["code"] for w in found["warnings"]] == ["laser.classic"]


def test_another_method_is_refused_with_the_list_of_those_there_are(path: Path) -> None:
    with pytest.raises(CellError, match="interval, averaging, classic"):
        solve_laser(path, method="best")


def test_a_refusal_says_what_most_passes_were_left_out_for(made: dict[str, Any], tmp_path: Path) -> None:
    def current(change: Any) -> str:
        passes = [{**p, **change(p)} for p in made["current"]["passes"]]
        found = solve_laser(write(tmp_path, {**made, "current": {"passes": passes}}))
        return str(found["reasons"][0])

    inverted = current(lambda p: {"poll_v": [1 - v for v in p["poll_v"]]})
    assert inverted.startswith("no-edges: no current pass")
    assert inverted.endswith("left out because: the beam is broken at an end of the way")
    other_clock = current(lambda p: {"poll_t": [t + 1e6 for t in p["poll_t"]]})
    assert other_clock.startswith("too-few-passes: no current pass across beam xs")
    assert other_clock.endswith("because: the arm did not move across the beam at the times of the polls")


def test_data_that_cannot_tell_are_refused_by_name(made: dict[str, Any], tmp_path: Path) -> None:
    def only(keep: Any) -> dict[str, Any]:
        kept = [p for p in made["current"]["passes"] if keep(p)]
        return {**made, "current": {"passes": kept}}

    skew = {**made["beams"], "ys": {"point": [0.5, 0.1, 0.2], "dir": [1.0, 0.03, 0.0]}}
    along = {**made["beams"], "ys": {"point": [0.5, 0.1, 0.2], "dir": [0.0, 0.0, 1.0]}}
    for data, name in (
        (only(lambda p: not any(p["poll_v"])), "no-edges"),
        (only(lambda p: p["beam"] == "xs"), "one-beam-only"),
        ({**made, "beams": skew}, "beams-parallel"),
        ({**made, "beams": along}, "beam-along-tool"),
    ):
        found = solve_laser(write(tmp_path, data))
        assert found["verdict"] == "fail"
        assert found["result"] is None
        assert found["reasons"][0].startswith(f"{name}: ")
        assert found["observability"]["refused"] == name


def test_passes_of_one_way_only_give_an_answer_that_says_what_it_takes_for_granted(tmp_path: Path) -> None:
    data = data_set(Bench(seed=61, shift=SHIFT), pairs=2, resolution=5e-4)

    def only(**ways: int) -> dict[str, Any]:
        sets = {
            name: {"passes": [p for p in data[name]["passes"] if p["dir"] == w]} for name, w in ways.items()
        }
        return solve_laser(write(tmp_path, {**data, **sets}))

    for ways, tau in (({"current": 1}, 0.004), ({"reference": 1, "current": 1}, None)):
        found = only(**ways)
        assert found["verdict"] == "warn"
        assert [w["code"] for w in found["warnings"]] == ["laser.one-way"] * 2
        error = np.array(found["result"]["dp_flange"]) - SHIFT
        assert np.linalg.norm(error[:2]) < 80e-6
        assert found["result"]["tau"] == (None if tau is None else pytest.approx(tau, abs=5e-4))
    assert any("delay" in words for words in found["observability"]["undetermined"])
    opposite = only(reference=1, current=-1)
    assert opposite["result"] is None
    assert opposite["reasons"][0].startswith("no-return: the reference crosses beam")


def test_a_radius_that_is_not_that_of_the_chords_is_warned_of(made: dict[str, Any], tmp_path: Path) -> None:
    found = solve_laser(write(tmp_path, {**made, "tool": {**made["tool"], "radius": 0.006}}))
    assert [w["code"] for w in found["warnings"]] == ["laser.radius"] * 2
    assert "tool.radius is 6.00 mm" in found["warnings"][0]["text"]
    assert np.linalg.norm(np.array(found["result"]["dp_flange"]) - SHIFT) < 60e-6


def test_a_reference_run_gives_its_beams_and_does_not_look_at_current(tmp_path: Path) -> None:
    from tests.unit.calibration.test_tool_frame_beams import reference

    bench = Bench(seed=9)
    result = solve_reference(write(tmp_path, reference(bench, step=0.002)))
    assert Result.model_validate(result).kind == "laser-reference"
    assert result["verdict"] == "pass", result["warnings"]
    answer = result["result"]
    for name, beam in bench.beams.items():
        gap = np.array(answer["beams"][name]["point"]) - beam.point
        assert np.linalg.norm(gap - (gap @ beam.direction) * beam.direction) < 1e-4
        hit = np.array(answer["hits"][name]) + R @ bench.p_ref
        assert hit == pytest.approx(answer["beams"][name]["point"])
    assert abs(answer["plane"]["gap_m"]) < 1e-4
    assert np.array(answer["cov"]).shape == (6, 6)
    assert result["uncertainty"]["U_point_m"] < 1e-4
    assert result["residuals"]["out_back_rms_m"] < 2e-4
    one = deepcopy(reference(bench, places=(0.0,), step=0.002))
    refused = solve_reference(write(tmp_path, one))
    assert refused["reasons"][0].startswith("one-place-only")
    out = reference(bench, step=0.002)
    out["reference"]["passes"] = [p for p in out["reference"]["passes"] if p["dir"] == 1]
    assert solve_reference(write(tmp_path, out))["reasons"][0].startswith("no-return")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda d: d["current"].update(passes=[]), "current.passes is empty"),
        (lambda d: d.update(tools={}), "tools is an unknown key; did you mean 'tool'"),
        (lambda d: d["beams"]["ys"].update(dir=[0, 0, 0]), "beams.ys.dir must be a direction"),
        (lambda d: d["tool"].pop("p_ref"), "tool.p_ref is missing"),
        (lambda d: d["current"]["passes"][1].update(dir=2), r"current.passes\[1\].dir"),
        (lambda d: d["current"]["passes"][1]["poll_v"].pop(), r"passes\[1\] has \d+ entries in poll_v"),
        (lambda d: d["current"]["passes"][1]["poll_t"].__setitem__(3, 0.0), "must grow from poll to poll"),
        (lambda d: d["current"]["passes"][1].update(poll_n=[1, 2]), "entries in poll_n"),
        (
            lambda d: d["current"]["passes"][1].update(z=0.2),
            r"passes\[1\] has z 0.2 m, and its pose_xyz is at",
        ),
        (
            lambda d: in_milliseconds(d["current"]["passes"][1]),
            r"passes\[1\] .* give pose_t and poll_t in seconds",
        ),
        (lambda d: d.update(schema="cellward.laser/2"), "this command reads 'cellward.laser/1'"),
    ],
)
def test_bad_input_is_one_sentence_with_file_field_and_fix(
    made: dict[str, Any], change: Any, sentence: str
) -> None:
    data = deepcopy(made)
    change(data)
    with pytest.raises(CellError, match=sentence) as caught:
        parse_laser(data, "laser.json")
    assert "laser.json" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_millimetres_and_degrees_are_warned_of(made: dict[str, Any]) -> None:
    assert unit_warnings(parse_laser(made, "made")) == []
    data = deepcopy(made)
    data["tool"]["p_ref"], data["R_base_flange"] = [0.0, 0.0, 180.0], [180.0, 0.0, 0.0]
    data["current"]["passes"][2]["pose_xyz"][0][0] = 500.0
    found = [code for code, _ in unit_warnings(parse_laser(data, "made"))]
    assert found == ["units.translation", "units.translation", "units.rotation"]


def test_the_command_line_gives_the_same_answer_and_prints_it_with_units(
    path: Path,
    result: dict[str, Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "result.json"
    command = CommandLine(monkeypatch, capsys, tmp_path / "cell.toml")
    done = command("solve", "laser", path, "-o", out)
    assert done.code == 0, done.err
    assert " mm" in done.out
    assert " deg" in done.out
    written = json.loads(out.read_text("utf-8"))
    assert written.pop("software").startswith("cellward ")
    assert without_times(written) == without_times(result)
    refused = command("solve", "lasers", path)
    assert refused.code == 2
    assert "did you mean laser?" in refused.err
