"""From tracker points on disk to a result in the format: figures, answers, refusals and warnings."""

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform
from typer.testing import CliRunner

from calibration.kinematics.families import arm_spec
from cell.errors import InputError
from cell.formats.result import Result
from cell.formats.robot import parse_robot
from cell.poses import from_pose6, to_pose6
from daemon.cli.app import app
from tests.kit.kincal_scene import joints, make_scene
from tests.kit.solved import solve_kincal

KINDS = ("palletizer", "ur10e")
NAMES = {"palletizer": "tx", "ur10e": "smr1.x"}


def write(folder: Path, name: str, **content: Any) -> Path:
    path = folder / name
    path.write_text(json.dumps(content), "utf-8")
    return path


def codes(result: dict[str, Any]) -> list[str]:
    return [w["code"] for w in result["warnings"]]


def test_rotations_of_a_six_degree_target_are_counted_and_nothing_is_solved_with_them(tmp_path: Path) -> None:
    scene = make_scene("palletizer", 1, 60)
    samples = [{**sample, "rotation": [0.1, 0.2, 0.3]} for sample in scene.data["samples"][:2]]
    result: Any = solve_kincal(scene.changed(samples=samples).write(tmp_path))
    assert (result["inputs"]["samples"], result["inputs"]["rotations"]) == (2, 2)
    assert result["result"] is None


@pytest.mark.parametrize("kind", KINDS)
def test_a_data_set_gives_a_result_in_the_format(kind: str, tmp_path: Path) -> None:
    scene = make_scene(kind, 1, 60, blunders=2).changed(payload_kg=4.0)
    steps: list[tuple[str, int, int]] = []
    result: Any = solve_kincal(scene.write(tmp_path).parent, progress=lambda *step: steps.append(step))
    assert Result.model_validate(result).verdict == "pass"
    json.dumps(result, allow_nan=False)
    answer = result["result"]
    assert answer["rms_nominal"] > 1e-3
    assert answer["rms_registration_only"] > 1e-3
    assert answer["rms_calibrated"] < 1e-4
    assert [r["index"] for r in answer["rejected"]] == scene.blunders
    assert all("disagrees with the others by" in r["reason"] for r in answer["rejected"])
    assert (answer["rank"], answer["rank_without_registration"]) == {
        "palletizer": (11, 13),
        "ur10e": (21, 23),
    }[kind]
    assert set(answer["parameters"]) == set(answer["nominal"]) == set(answer["sigma"])
    geometry = [name for name in answer["parameters"] if not name.startswith(("gear", "sag"))]
    assert len(geometry) == {"palletizer": 18, "ur10e": 29}[kind]
    assert answer["sigma"][NAMES[kind]] is None, "an open combination has no uncertainty of its own"
    assert answer["payload_kg"] == 4.0
    assert not answer["noise"]["given"]
    assert result["inputs"]["solve_seconds"] > 0
    assert result["inputs"]["used"] == 58
    assert result["heldout"]["samples"] == 58
    assert result["heldout"]["rms"]["calibrated"] == answer["rms_calibrated"]
    off = [s["distance"] for s in result["residuals"]["per_sample"] if not s["used"]]
    squares = 58 * answer["rms_calibrated"] ** 2 + np.sum(np.square(off))
    assert result["heldout"]["rejected"] == 2
    assert result["heldout"]["rms_with_rejected"] == pytest.approx(np.sqrt(squares / 60))
    tracker = result["uncertainty"]["tracker"]
    assert tracker["sigma_3d"] == pytest.approx(np.sqrt(3) * (15e-6 + 6e-6 * tracker["range_m"]), rel=0.15)
    assert answer["rms_calibrated"] == pytest.approx(tracker["sigma_3d"], rel=0.4)
    assert np.shape(result["uncertainty"]["cov"]) == (len(result["uncertainty"]["names"]),) * 2
    predicted = result["uncertainty"]["predicted_95"]
    assert 0 < predicted["samples"]["median"] < predicted["workspace"]["max"] < 2e-4
    assert len(result["residuals"]["per_sample"]) == 60
    assert not result["observability"]["source_rule"]["kept"]
    assert {s[0] for s in steps} == {"solve"}


def test_solving_again_gives_the_same_answer_in_another_process_too(tmp_path: Path) -> None:
    assert pickle.loads(pickle.dumps(solve_kincal)) is solve_kincal
    path = make_scene("ur10e", 2, 40).write(tmp_path)
    first, second = solve_kincal(path), solve_kincal(path, calls=2)
    for result in (first, second):
        result["inputs"].pop("solve_seconds")  # type: ignore[attr-defined]
    assert first == second


@pytest.mark.parametrize("method", [None, "classic"])
@pytest.mark.parametrize("kind", KINDS)
def test_readings_are_predicted_at_joints_that_were_not_measured(
    kind: str, method: str | None, tmp_path: Path
) -> None:
    scene = make_scene(kind, 3, 80)
    Q = joints(kind, np.random.default_rng(50), 60)
    query = write(tmp_path, "query.json", schema="cellward.kincal-query/1", q=Q.tolist(), target="smr1")
    answer: Any = solve_kincal(scene.write(tmp_path), predict=query, method=method)["result"]
    off = np.linalg.norm(np.array(answer["p_tracker"]) - scene.truth.p_tracker(Q, ["smr1"] * 60), axis=1)
    assert np.sqrt(np.mean(off**2)) < 5e-5
    if method is None:
        assert np.mean(off < answer["p_tracker_95"]) > 0.7
        assert np.max(answer["p_tracker_95"]) < 1.5e-4
    else:
        assert answer["sigma"] is None
        assert "p_tracker_95" not in answer
        assert answer["classic"]["stopped"]


@pytest.mark.parametrize("hinted", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_corrected_joints_bring_the_reflector_to_where_the_wanted_poses_have_it(
    kind: str, hinted: bool, tmp_path: Path
) -> None:
    """Judged up to what tracker points leave open: the base as a whole, and the place on the flange."""
    scene = make_scene(kind, 4, 80)
    nominal = arm_spec(parse_robot(scene.data["robot"], "robot")).arm.base
    Q = joints(kind, np.random.default_rng(51), 25)
    T = nominal.flange(Q)
    if kind == "palletizer":
        targets = np.column_stack([T[:, :3, 3], np.arctan2(T[:, 1, 0], T[:, 0, 0])]).tolist()
    else:
        targets = to_pose6(RigidTransform.from_matrix(T)).tolist()
    near = {"q_near": (Q + 0.01).tolist()} if hinted else {}
    asked = write(tmp_path, "targets.json", schema="cellward.kincal-targets/1", targets=targets, **near)
    result: Any = solve_kincal(scene.write(tmp_path), targets=asked)
    q = np.array(result["result"]["q"], dtype=float)
    if hinted:
        assert np.max(np.abs(q - Q)) < 0.3
    before = _misfit(scene.truth, Q, T)
    after = _misfit(scene.truth, q, T)
    assert after < 1e-4
    assert before > 20 * after


def _misfit(truth: Any, q: np.ndarray, wanted: np.ndarray) -> float:
    """RMS distance of true reflector places from wanted ones after the best base motion and tool place."""
    p = truth.p_tracker(q, ["smr1"] * len(q)).T
    R, b = truth.T_tracker_base[:3, :3], truth.T_tracker_base[:3, 3]
    at = R.T @ (p - b[:, None])
    tool = truth.tools["smr1"].copy()
    for _ in range(20):
        f = np.einsum("nij,j->in", wanted[:, :3, :3], tool) + wanted[:, :3, 3].T
        y = np.concatenate([(at - f).T.ravel()])
        A = np.zeros((3 * len(q), 9))
        for k in range(len(q)):
            x, yy, z = f[:, k]
            A[3 * k : 3 * k + 3, :3] = wanted[k, :3, :3]
            A[3 * k : 3 * k + 3, 3:6] = -np.array([[0, z, -yy], [-z, 0, x], [yy, -x, 0]])
            A[3 * k : 3 * k + 3, 6:] = -np.eye(3)
        u = np.linalg.lstsq(A, y, rcond=1e-10)[0]
        tool = tool + u[:3]
        w = u[3:6]
        turned = np.eye(3) + np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        U, _, Vt = np.linalg.svd(turned)
        at = (U @ Vt) @ at + u[6:, None]
    f = np.einsum("nij,j->in", wanted[:, :3, :3], tool) + wanted[:, :3, 3].T
    return float(np.sqrt(np.mean(np.sum((at - f) ** 2, axis=0))))


def test_wanted_poses_out_of_reach_beyond_limits_or_tilted_are_named(tmp_path: Path) -> None:
    scene = make_scene("palletizer", 5, 40)
    path = scene.write(tmp_path)
    asked = write(
        tmp_path,
        "targets.json",
        schema="cellward.kincal-targets/1",
        targets=[[1.5, 0.2, 0.9, 0.1], [9.0, 0.0, 0.9, 0.0], [1.5, 0.2, 0.9, 0.02, 0.0, 0.1]],
    )
    result: Any = solve_kincal(path, targets=asked)
    assert [q is None for q in result["result"]["q"]] == [False, True, False]
    assert set(codes(result)) == {"targets.unreachable", "targets.tilt"}
    assert result["verdict"] == "warn"


def test_a_calibrated_robot_is_a_robot_for_the_next_set(tmp_path: Path) -> None:
    scene = make_scene("ur10e", 6, 120)
    first: Any = solve_kincal(scene.write(tmp_path))["result"]
    robot = write(tmp_path, "robot.json", **first["robot"])
    again: Any = solve_kincal(scene.write(tmp_path), robot=robot)
    assert again["result"]["rms_nominal"] < 1e-4
    assert codes(again) == ["calibration.no-gain"]
    assert again["result"]["rank"] == 21
    place, other = from_pose6(first["T_tracker_base"]), from_pose6(again["result"]["T_tracker_base"])
    assert np.max(np.abs((place.inv() * other).translation)) < 1e-5


def test_a_joint_that_rests_is_refused_by_name_unless_a_prior_fills_in(tmp_path: Path) -> None:
    scene = make_scene("ur10e", 7, 60)
    Q = scene.Q
    Q[:, 3] = 0.5
    p = scene.truth.p_tracker(Q, ["smr1"] * 60)
    samples = [{"q": q.tolist(), "p_tracker": t.tolist()} for q, t in zip(Q, p, strict=True)]
    still = scene.changed(samples=samples)
    result: Any = solve_kincal(still.write(tmp_path))
    assert (result["verdict"], result["result"]) == ("fail", None)
    assert result["reasons"][0].startswith("joint-still: joint 4 does not move")
    assert result["observability"]["refused"] == "joint-still"
    assert result["observability"]["lacking"]
    robot = {**scene.data["robot"], "prior": {"length_m": 1e-3, "angle_rad": 2e-3}}
    filled: Any = solve_kincal(still.changed(robot=robot).write(tmp_path))
    assert "observability.prior" in codes(filled)
    assert filled["result"]["rank"] < 21


@pytest.mark.parametrize(
    ("count", "name"), [(0, "too-few-poses"), (2, "too-few-poses"), (9, "too-few-poses")]
)
def test_too_few_samples_are_refused(count: int, name: str, tmp_path: Path) -> None:
    scene = make_scene("ur10e", 8, 20)
    result: Any = solve_kincal(scene.changed(samples=scene.data["samples"][:count]).write(tmp_path))
    assert result["result"] is None
    assert result["reasons"][0].startswith(name)


def test_few_samples_bad_noise_and_a_wrong_robot_are_warned_of(tmp_path: Path) -> None:
    scene = make_scene("ur10e", 9, 60)
    few: Any = solve_kincal(scene.changed(samples=scene.data["samples"][:15]).write(tmp_path))
    assert codes(few) == ["samples.few"]
    tight: Any = solve_kincal(scene.changed(noise={"sigma0": 3e-6, "sigma_per_m": 1e-6}).write(tmp_path))
    assert codes(tight) == ["noise.too-small"]
    other: Any = solve_kincal(scene.changed(robot={**scene.data["robot"], "model": "ur5e"}).write(tmp_path))
    assert "robot.far-off" in codes(other)
    bare: Any = solve_kincal(scene.changed(robot={"model": "ur10e"}).write(tmp_path))
    assert codes(bare) == ["tool.unknown"]
    assert bare["result"]["rms_calibrated"] < 1e-4


def test_samples_in_the_wrong_order_are_refused(tmp_path: Path) -> None:
    scene = make_scene("palletizer", 10, 60)
    samples = scene.data["samples"]
    moved = [{**s, "q": samples[k - 1]["q"]} for k, s in enumerate(samples)]
    with pytest.raises(InputError, match="check the order of the samples"):
        solve_kincal(scene.changed(samples=moved).write(tmp_path))


@pytest.mark.parametrize(
    ("option", "content", "needle"),
    [
        ("predict", {"schema": "cellward.kincal-query/1", "q": [[0.0] * 5]}, "q[0] has 5 joints"),
        ("predict", {"schema": "cellward.kincal-query/1", "q": [], "target": "ball"}, "'ball' is not known"),
        ("predict", {"schema": "cellward.kincal/1", "q": []}, "cellward.kincal-query/1"),
        (
            "targets",
            {"schema": "cellward.kincal-targets/1", "targets": [[0.0] * 4]},
            "targets[0] has 4 numbers",
        ),
        ("targets", {"schema": "cellward.kincal-targets/1", "targets": [[0.0] * 5]}, "5 numbers"),
        (
            "targets",
            {"schema": "cellward.kincal-targets/1", "targets": [[0.0] * 6], "q_near": []},
            "q_near) has 0 entries for 1 targets",
        ),
    ],
)
def test_a_wrong_question_is_one_sentence(
    option: str, content: dict[str, Any], needle: str, tmp_path: Path
) -> None:
    path = make_scene("ur10e", 11, 30).write(tmp_path)
    asked = write(tmp_path, "asked.json", **content)
    with pytest.raises(InputError) as caught:
        solve_kincal(path, **{option: asked})  # type: ignore[arg-type]
    assert needle in str(caught.value)
    assert "asked.json" in str(caught.value)


def test_the_command_line_prints_the_three_figures_and_writes_the_result(tmp_path: Path) -> None:
    scene = make_scene("palletizer", 12, 50, blunders=1)
    query = write(
        tmp_path, "query.json", schema="cellward.kincal-query/1", q=scene.Q[:3].tolist(), target="smr1"
    )
    out = tmp_path / "result.json"
    run = CliRunner().invoke(
        app, ["solve", "kincal", str(scene.write(tmp_path)), "--predict", str(query), "-o", str(out)]
    )
    assert run.exit_code == 0, run.output
    for words in (
        "with a region of the joints' space held out each time, calibrated ",
        "registration only",
        "rank 11",
        "a1 = a4",
        "3 readings are predicted",
        "1 samples were not",
    ):
        assert words in run.output
    assert len(json.loads(out.read_text("utf-8"))["result"]["p_tracker"]) == 3


def test_a_question_that_a_kind_cannot_answer_is_refused(tmp_path: Path) -> None:
    path = make_scene("ur10e", 13, 30).write(tmp_path)
    run = CliRunner().invoke(app, ["solve", "laser", str(path), "--targets", str(path)])
    assert run.exit_code != 0
    assert "--targets is for axbc, kincal" in str(run.exception)


def test_a_method_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="must be one of adjustment, ml, classic"):
        solve_kincal(tmp_path, method="park")
