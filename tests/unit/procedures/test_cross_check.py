"""``cellward cross-check``: what two captures on disk and a measured tool say of the cell."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.adjustment.cross_check import CrossChecked
from calibration.adjustment.touch import Touches
from calibration.hand_eye.problem import Setup
from cell.errors import InputError
from cell.poses import Array
from cell.run_values import RunValues
from procedures.cross_check import solver
from procedures.cross_check.result import CrossCheckInputs, CrossCheckResiduals
from procedures.cross_check.solver import (
    _by_joints,
    _Capture,
    _result,
    check_cell,
    solve_cross_check,
    tool_of,
    touch_of,
)
from procedures.cross_check.words import cross_check_lines
from procedures.report.write import write_report
from procedures.touch_test.judging import solve_touch_test
from tests.kit.cli_harness import CellOnDisk, CommandLine
from tests.kit.cross_check_scene import (
    HALF_TURN,
    Q_BEAMS,
    REFERENCE_M,
    STAND_M,
    STAND_OFF_M,
    TIP,
    Change,
    change,
    in_tracker,
    tool_in_beams,
    touched,
    views,
)
from tests.kit.eye_to_hand_scene import POINTS, joints, make_scene, off, pose6
from tests.kit.imperfect_cell import ARM, CAMERA
from tests.unit.procedures.test_latency_job import made_by_hand

SETUP: Setup = "eye-to-hand"
SETUPS: tuple[Setup, Setup] = ("eye-to-hand", "eye-in-hand")
STORED = Path(__file__).parents[2] / "kit" / "stored_results"
POSES = 40
LENS = {"width": CAMERA.width, "height": CAMERA.height, "K": list(CAMERA.K), "dist": list(CAMERA.dist)}
TARGET = {"type": "points", "points": POINTS.tolist()}


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Runs of one cell: when all was well, and with each part changed, with the tool in the beams."""
    rng, root = np.random.default_rng(12), tmp_path_factory.mktemp("cells")
    scene = make_scene(rng, POSES)
    found = {}
    for part in ("then", "none", "camera", "joint"):
        what = Change() if part == "then" else change(rng, part, 2)
        folder = found[part] = root / part
        folder.mkdir()
        W = scene.W @ off(rng, 0.003, 0.02)
        measured, Q = views(rng, scene.cell, SETUP, scene.X, W, joints(rng, scene.X, W, POSES), what)
        (folder / "capture.json").write_text(json.dumps(capture(measured, Q)), "utf-8")
        seen = tool_in_beams(rng, scene.cell, what)
        (root / f"{part}-beams").mkdir()
        write_beams(root / f"{part}-beams", seen.moved, seen.cov)
        found[f"{part}-beams"] = root / f"{part}-beams"
    return found


def capture(measured: Any, Q: Array, setup: Setup = SETUP) -> dict[str, Any]:
    return {
        "schema": "cellward.capture/1",
        "setup": setup,
        "robot": {"model": "ur10e"},
        "camera": LENS,
        "target": {**TARGET, "scale_sigma": 1e-4, "flatness_m": 2e-5},
        "observations": [
            {
                "index": k,
                "group": 0,
                "q": q.tolist(),
                "T_base_flange": pose6(F),
                "corners": view.corners.tolist(),
            }
            for k, (q, F, view) in enumerate(zip(Q, measured.F, measured.views, strict=True))
        ],
    }


def write_beams(folder: Path, moved: Array, cov: Array) -> None:
    """A run of laser-check that found this, in the fixture of the scene."""
    result = json.loads((STORED / "laser-01.json").read_text("utf-8"))
    whole = np.zeros((6, 6))
    whole[:3, :3] = cov
    result["result"] |= {"dp_flange": moved.tolist(), "cov": whole.tolist()}
    (folder / "result.json").write_text(json.dumps(result), "utf-8")
    (folder / "run.json").write_text(json.dumps({"values": values()}), "utf-8")


def values() -> dict[str, Any]:
    reference = made_by_hand()
    reference["tool"]["p_ref"] = TIP.tolist()
    for name in ("xs", "ys"):
        reference["search"][name]["q"] = Q_BEAMS.tolist()
    poses = {reference["search"][name]["aux"]: Q_BEAMS.tolist() for name in ("xs", "ys")}
    tool = {
        "name": reference["tool"]["id"],
        "T_flange_tool": [*TIP.tolist(), 0.0, 0.0, 0.0],
        "radius_m": 0.01,
    }
    return {"robot": {"model": "ur10e"}, "tool": tool, "laser_reference": reference, "poses": poses}


@pytest.mark.parametrize(("part", "named"), [("none", "none"), ("camera", "camera"), ("joint", "joint zero")])
def test_the_part_that_has_changed_is_named(captures: dict[str, Path], part: str, named: str) -> None:
    found = check_cell(captures["then"], captures[part], captures[f"{part}-beams"])
    answer = found.as_json()["result"]
    assert answer["part"] == named
    assert answer.get("joint") == ("elbow" if part == "joint" else None)
    assert found.verdict == ("pass" if part == "none" else "fail")
    if part != "none":
        assert found.reasons[0].startswith(named.replace(" ", "-"))


def test_captures_of_different_lenses_have_no_lens_in_common(
    captures: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[int] = []
    true = solver.cross_check
    monkeypatch.setattr(solver, "cross_check", lambda *a: seen.append(a[0].lens) or true(*a))
    other = json.loads((captures["none"] / "capture.json").read_text("utf-8"))
    other["camera"]["K"][0] *= 1.0 + 1e-5
    (tmp_path / "capture.json").write_text(json.dumps(other), "utf-8")
    check_cell(captures["then"], captures["none"])
    check_cell(captures["then"], tmp_path)
    assert seen == [8, 0]


def test_the_data_set_names_folders_from_its_own_and_the_report_says_the_same(
    captures: dict[str, Path], tmp_path: Path
) -> None:
    folder = captures["then"].parent
    asked = {"schema": "cellward.cross-check/1", "then": "then", "now": "joint", "beams": "joint-beams"}
    (folder / "cross-check.json").write_text(json.dumps(asked), "utf-8")
    found = solve_cross_check(folder)
    report = write_report(found.signed().as_json(), tmp_path / "report.html")
    assert "zero of joint" in report.read_text("utf-8")
    lines = "\n".join(cross_check_lines(found))  # type: ignore[arg-type]
    assert "the zero of joint 'elbow' is off by" in lines
    assert "the zero of joint 'wrist 3': it shows in nothing that was measured" in lines


def test_how_a_joint_moves_the_point_is_what_the_model_does(captures: dict[str, Path]) -> None:
    subject = _by_joints(RunValues.of(values()))
    start = ARM.forward(Q_BEAMS)
    for k in range(6):
        moved = ARM.forward(Q_BEAMS + 1e-6 * np.eye(6)[k]).apply(TIP)
        expected = start.rotation.inv().apply(moved - start.apply(TIP)) / 1e-6
        assert subject[:, k] == pytest.approx(expected, abs=1e-5)
    assert tool_of(captures["joint-beams"]).by_joints == pytest.approx(subject)


def test_what_is_no_measured_tool_and_captures_without_joints_are_refused(
    captures: dict[str, Path], tmp_path: Path
) -> None:
    data = json.loads((captures["then"] / "capture.json").read_text("utf-8"))
    del data["robot"]
    (tmp_path / "capture.json").write_text(json.dumps(data), "utf-8")
    with pytest.raises(InputError, match=r"has no robot; a cross check needs the arm's joints"):
        check_cell(tmp_path, captures["none"], None)


def test_one_capture_as_then_and_now_is_refused(captures: dict[str, Path], tmp_path: Path) -> None:
    then = captures["then"]
    data = json.loads((then / "capture.json").read_text("utf-8"))
    (tmp_path / "capture.json").write_text(json.dumps(data, indent=1), "utf-8")
    for now in (then, tmp_path):
        with pytest.raises(InputError, match="hold one and the same capture"):
            check_cell(then, now)


def test_a_data_set_that_is_no_object_is_refused_with_its_file(tmp_path: Path) -> None:
    file = tmp_path / "cross-check.json"
    file.write_text("[]", "utf-8")
    with pytest.raises(InputError, match=r"cross-check\.json holds a list") as caught:
        solve_cross_check(file)
    assert caught.value.name == "DATA_INVALID"


def test_the_command_says_the_part_and_ends_with_one(
    captures: dict[str, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    cell = CellOnDisk(tmp_path)
    for run_id, part in ((1, "then"), (2, "joint"), (3, "joint-beams")):
        folder = cell.add_run(run_id, outcome="complete").path
        for file in captures[part].iterdir():
            own = json.loads(file.read_text("utf-8"))
            if file.name == "run.json":  # beside what the run says of itself
                own = json.loads((folder / "run.json").read_text("utf-8")) | own
            (folder / file.name).write_text(json.dumps(own), "utf-8")
    subject = CommandLine(monkeypatch, capsys, cell.config)
    done = subject("cross-check", 1, 2, "--beams", 3, "--report", tmp_path / "report.html")
    assert done.code == 1
    assert "the zero of joint 'elbow' is off by" in done.out
    assert (tmp_path / "report.html").exists()
    assert subject("cross-check", 1, 9).code == 2


def test_a_tracker_is_asked_of_the_arm_of_now(captures: dict[str, Path], tmp_path: Path) -> None:
    rng = np.random.default_rng(12)
    cell = make_scene(rng, POSES).cell  # the one of the captures
    Q, places = in_tracker(rng, cell, change(np.random.default_rng(1), "joint", 2), 40)
    data = {
        "schema": "cellward.kincal/1",
        "robot": {"model": "ur10e"},
        "noise": {"sigma0": 2e-5, "sigma_per_m": 0.0},
        "samples": [{"q": q.tolist(), "p_tracker": p.tolist()} for q, p in zip(Q, places, strict=True)],
    }
    (tmp_path / "kincal.json").write_text(json.dumps(data), "utf-8")
    found = check_cell(captures["then"], captures["none"], tracker=tmp_path).as_json()
    # The tracker saw a zero off which the board of now did not: nothing that one part explains.
    assert found["result"]["part"] not in ("none", "tool")
    assert found["inputs"]["tracker"] == str(tmp_path)
    data["samples"] = data["samples"][:5]  # type: ignore[index]
    (tmp_path / "kincal.json").write_text(json.dumps(data), "utf-8")
    with pytest.raises(InputError, match=r"has 5 places, 10 are needed"):
        check_cell(captures["then"], captures["none"], tracker=tmp_path)


def write_touch(folder: Path, of: Touches, target: dict[str, Any] = TARGET) -> Path:
    """A run of touch-test that saw this."""
    folder.mkdir(exist_ok=True)
    corners = [int(np.argmin(np.linalg.norm(POINTS - point, axis=1))) for point in of.points]
    data = {
        "schema": "cellward.touch-test/1",
        "job": {
            "target": "board",
            "look_pose": "look",
            "stand_off_m": STAND_OFF_M,
            "stand_sigma_m": STAND_M,
            "tool_sigma_m": REFERENCE_M,
        },
        "robot": {"model": "ur10e"},
        "arm_rms_m": None,
        "target": target,
        "T_flange_camera": [0.0] * 6,
        "hand_eye_cov": np.eye(6).tolist(),
        "tool": [0.1, 0.1, 0.1],  # corrected since, so the reference counts
        "tool_reference": of.tool.tolist(),
        "look": {
            "q": of.q_look.tolist(),
            "T_base_flange": pose6(ARM.forward(of.q_look).as_matrix()),
            "ids": list(range(len(POINTS))),
            "corners": of.view.corners.tolist(),
            "frames": 1,
            "camera": LENS,
        },
        "stood": [
            {"corner": corner, "q": q.tolist(), "T_base_flange": pose6(ARM.forward(q).as_matrix())}
            for corner, q in zip(corners, of.Q, strict=True)
        ],
    }
    (folder / "touch-test.json").write_text(json.dumps(data), "utf-8")
    return folder


def test_a_touch_test_names_a_bent_tool_that_no_beams_saw(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    scene = make_scene(rng, POSES)
    what = Change(tool=np.array([1.5e-3, -1.5e-3, 1e-3]))
    for name in ("then", "now"):
        Q = joints(rng, scene.X, scene.W, POSES)
        measured, Q = views(rng, scene.cell, "eye-in-hand", scene.X, scene.W, Q, Change())
        (tmp_path / name).mkdir()
        (tmp_path / name / "capture.json").write_text(
            json.dumps(capture(measured, Q, "eye-in-hand")), "utf-8"
        )
    of = touched(rng, scene.cell, scene.W @ HALF_TURN, what)
    write_touch(tmp_path / "touch", of)
    asked = {"schema": "cellward.cross-check/1", "then": "then", "now": "now", "touch": "touch"}
    (tmp_path / "cross-check.json").write_text(json.dumps(asked), "utf-8")
    found = solve_cross_check(tmp_path).as_json()
    assert found["result"]["part"] == "tool"
    assert found["result"]["t"] == pytest.approx(float(np.linalg.norm(what.tool)), rel=0.3)
    assert found["inputs"]["touch"] == str(tmp_path / "touch")
    assert not [open_ for open_ in found["observability"]["undetermined"] if open_.startswith("the tool:")]


@pytest.mark.parametrize("by", ["the beams", "the touch test"])
def test_what_shows_a_zero_is_named_as_it_was_given(by: str) -> None:
    found = CrossChecked("none", None, {"none": 1.0}, np.zeros(3), np.ones(3), (), by_beams_alone=(0,))
    inputs = CrossCheckInputs(then="then", now="now", setup="eye-in-hand")
    result = _result(found, inputs, CrossCheckResiduals(then_px=None, now_px=None), by, [])
    (open_,) = result.observability.undetermined
    assert open_.endswith(f"from a bent tool: it shows in {by} alone")


def test_a_touch_test_goes_with_a_camera_on_the_flange_and_its_own_target(tmp_path: Path) -> None:
    rng = np.random.default_rng(12)
    scene = make_scene(rng, 4)
    of = touched(rng, scene.cell, scene.W @ HALF_TURN, Change())
    folder = write_touch(tmp_path, of)
    nothing: Any = None
    fixed, other = (
        _Capture(setup, {**TARGET, "points": (1.1 * POINTS).tolist()}, *[nothing] * 5) for setup in SETUPS
    )
    with pytest.raises(InputError, match="leave it out"):
        touch_of(folder, fixed)
    with pytest.raises(InputError, match="another target than the capture of now"):
        touch_of(folder, other)


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        (("target", "points", 0, 0), 1e308, "points[0][0] is beyond"),
        (("target", "points"), [], "points has 0 entries"),
        (("look", "ids", 0), 10**12, "look.ids has point 1000000000000"),
        (("look", "ids", 0), 1, "an id twice"),
        (("stood", 0, "corner"), 48, "stood has point 48"),
        (("job", "clear_m"), 0.001, "job.clear_m"),
        (("hand_eye_cov",), [], "hand_eye_cov has 0 entries"),
        (("tool", 2), -1e12, "tool[2] is beyond"),
    ],
)
def test_a_damaged_touch_test_is_refused_with_file_and_field(
    tmp_path: Path, path: tuple[Any, ...], value: object, says: str
) -> None:
    rng = np.random.default_rng(3)
    scene = make_scene(rng, 2)
    folder = write_touch(tmp_path / "touch", touched(rng, scene.cell, scene.W @ HALF_TURN, Change()))
    file = folder / "touch-test.json"
    data = json.loads(file.read_text("utf-8"))
    *above, key = path
    table = data
    for step in above:
        table = table[step]
    table[key] = value
    file.write_text(json.dumps(data), "utf-8")
    with pytest.raises(InputError) as caught:
        solve_touch_test(file)
    assert str(file) in str(caught.value)
    assert says in str(caught.value)
