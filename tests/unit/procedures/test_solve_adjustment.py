"""``solve hand-eye --method adjustment`` on data sets of a cell that is not as its model."""

import json
from copy import deepcopy
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from calibration.adjustment import hand_eye
from calibration.adjustment.arm_terms import reference_joints
from calibration.hand_eye import se3
from cell.errors import InputError
from cell.poses import from_pose6, to_pose6
from procedures.documents import read_result
from procedures.hand_eye.result import HandEyeResult
from procedures.hand_eye.solve.adjustment import NOT_SETTLED
from procedures.hand_eye.words import hand_eye_lines
from tests.kit.hand_eye_scene import BOARD, make_scene
from tests.kit.imperfect_cell import ARM, CAMERA, MODEL, World, capture, world
from tests.kit.solved import solve_hand_eye


@pytest.fixture(scope="module")
def imperfect() -> tuple[World, dict[str, Any]]:
    """An arm good to 0.2 mm, a focal length off by 0.3 %, and a bowed board."""
    rng = np.random.default_rng(8)
    cell = world(rng, 2e-4, "off", "bow")
    measured, Q = capture(rng, cell, "cone")
    observations = []
    for i, view in enumerate(measured.views):
        assert view is not None
        observations.append(
            {
                "index": i,
                "group": int(measured.group[i]),
                "corners": view.corners.tolist(),
                "T_base_flange": to_pose6(se3.transforms(measured.F[i])).tolist(),
                "q": Q[i].tolist(),
            }
        )
    return cell, {
        "schema": "cellward.capture/1",
        "setup": "eye-in-hand",
        "camera": asdict(CAMERA),
        "target": BOARD,
        "robot": {"model": "ur10e"},
        "observations": observations,
    }


def solved(folder: Path, document: dict[str, Any], method: str) -> dict[str, Any]:
    path = folder / "capture.json"
    path.write_text(json.dumps(document), "utf-8")
    result: dict[str, Any] = solve_hand_eye(path, method=method)
    return result


def off(result: dict[str, Any], cell: World) -> tuple[float, float]:
    """Distance from the truth and its standard deviation, both of the translation in m."""
    X = from_pose6(np.array(result["result"]["T_flange_camera"])).as_matrix()
    return float(np.linalg.norm((X - cell.X)[:3, 3])), result["uncertainty"]["sigma_t_norm"]


def test_the_answer_is_true_within_what_it_states(
    imperfect: tuple[World, dict[str, Any]], tmp_path: Path
) -> None:
    cell, document = imperfect
    distance, sigma = off(solved(tmp_path, document, "adjustment"), cell)
    assert distance < 3.0 * sigma < 5e-4
    plain, stated = off(solved(tmp_path, document, "ml"), cell)
    assert plain > 5.0 * stated, "with noise alone the same data state too little"


def test_the_result_says_what_was_found_and_where_the_uncertainty_comes_from(
    imperfect: tuple[World, dict[str, Any]], tmp_path: Path
) -> None:
    cell, document = imperfect
    subject = solved(tmp_path, document, "adjustment")
    focal = subject["result"]["unknowns"]["lens"]["focal"]
    assert abs(focal["value"] - (cell.camera.K[0] / CAMERA.K[0] - 1.0)) < 3.0 * focal["sigma"]
    budget = subject["result"]["budget"]
    assert [part["block"] for part in budget] == ["arm", "lens", "target", "noise"]
    whole = np.sqrt(sum(part["t"] ** 2 for part in budget))
    assert whole == pytest.approx(subject["uncertainty"]["sigma_t_norm"])
    together, lens = np.array(subject["result"]["lens_cov"]), subject["result"]["unknowns"]["lens"]
    assert together[:6, :6] == pytest.approx(np.array(subject["result"]["cov"]))
    assert np.sqrt(np.diag(together)[6:]) == pytest.approx([one["sigma"] for one in lens.values()])
    assert np.linalg.eigvalsh(together)[0] > 0.0
    assert subject["uncertainty"]["covers"] == ["arm", "gears", "sag", "lens", "target"]
    first, now = subject["result"]["as_configured"]["spread_across"], subject["result"]["spread_across"]
    assert now["t_norm"] < first["t_norm"], "what was found makes the placements agree better"


def test_an_answer_that_still_moves_in_the_last_round_is_warned_of(
    imperfect: tuple[World, dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert NOT_SETTLED[0] not in {w["code"] for w in solved(tmp_path, imperfect[1], "adjustment")["warnings"]}
    monkeypatch.setattr(hand_eye, "_ROUNDS", 1)
    assert NOT_SETTLED[0] in {w["code"] for w in solved(tmp_path, imperfect[1], "adjustment")["warnings"]}


def told(result: dict[str, Any]) -> str:
    found = read_result(result)
    assert isinstance(found, HandEyeResult)
    return "\n".join(hand_eye_lines(found))


def test_held_out_figures_name_what_was_found_from_all_poses(
    imperfect: tuple[World, dict[str, Any]], tmp_path: Path
) -> None:
    _, document = imperfect
    bare = [{k: v for k, v in o.items() if k != "q"} for o in document["observations"]]
    for data, parts in (
        (document, ["arm", "lens", "target"]),
        (document | {"observations": bare}, ["lens", "target"]),
    ):
        found = solved(tmp_path, data, "adjustment")
        assert found["heldout"]["from_all"] == parts
        words = " and ".join(", ".join(parts).rsplit(", ", 1))
        assert f"{words} as found from all observations" in found["heldout"]["meaning"]
        text = told(found)
        assert f"by a camera's pose from the others, with {words} as found from all: " in text
        assert "did not see it" not in text
    plain = solved(tmp_path, document, "ml")
    assert plain["heldout"]["from_all"] is None
    assert "by a solution that did not see it" in told(plain)


def test_the_arms_accuracy_is_told_from_the_board_alone(
    imperfect: tuple[World, dict[str, Any]], tmp_path: Path
) -> None:
    cell, document = imperfect
    subject = solved(tmp_path, document, "adjustment")["result"]["arm"]
    Q = reference_joints(ARM.joint_limits, 9, seed=5)
    nominal = cell.base @ MODEL.base.flange(Q) @ cell.flange
    off = se3.log(se3.inverse(nominal) @ cell.true_flange(Q))
    true = float(np.sqrt(np.mean(np.sum(off[:, :3] ** 2, axis=1))))
    assert 0.7 * true < subject["configured"]["t"] < 1.4 * true
    assert subject["corrected"]["t"] < 0.6 * subject["configured"]["t"]


def test_without_joints_the_result_has_the_errors_that_neighbouring_poses_share(
    imperfect: tuple[World, dict[str, Any]], tmp_path: Path
) -> None:
    _, document = imperfect
    bare = [{k: v for k, v in o.items() if k != "q"} for o in document["observations"]]
    subject = solved(tmp_path, document | {"observations": bare}, "adjustment")
    assert subject["uncertainty"]["covers"] == ["arm", "lens", "target"]
    (warning,) = [w for w in subject["warnings"] if w["code"] == "arm.accuracy"]
    assert "no q of every observation" in warning["text"]
    noise = subject["result"]["noise"]
    assert 5e-5 < noise["sigma_shared_t"] < 2e-3
    assert f"({1e3 * noise['sigma_shared_t']:.2g} mm" in warning["text"]
    assert "an axis by the data)" in warning["text"]
    assert set(subject["result"]["unknowns"]) == {"lens", "target"}
    assert "share (assumed of the arm before the data: " in subject["uncertainty"]["priors"]["arm"]
    assert subject["verdict"] == "warn"


def five_joints(o: dict[str, Any]) -> None:
    o["q"] = o["q"][:5]


def degrees(o: dict[str, Any]) -> None:
    o["q"] = np.degrees(o["q"]).tolist()


def tool(o: dict[str, Any]) -> None:
    flange = from_pose6(np.array(o["T_base_flange"]))
    o["T_base_flange"] = to_pose6(flange * RigidTransform.from_translation([0.0, 0.0, 0.15])).tolist()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (five_joints, "observation 0: q has 5 numbers, and robot has 6 joints"),
        (degrees, "units.rotation: .* q is in degrees; give radians"),
        (tool, r"poses.tcp: .* they carry a tool: a TCP of \[-?0.0, -?0.0, 150.0\] mm"),
    ],
)
def test_joints_that_do_not_belong_to_the_poses_are_refused_with_the_cause(
    imperfect: tuple[World, dict[str, Any]], tmp_path: Path, change: Any, told: str
) -> None:
    document = deepcopy(imperfect[1])
    for observation in document["observations"]:
        change(observation)
    with pytest.raises(InputError, match=told):
        solved(tmp_path, document, "adjustment")


def test_an_arm_of_four_joints_is_known_by_its_poses_alone_and_said_so(
    imperfect: tuple[World, dict[str, Any]], tmp_path: Path
) -> None:
    keys = [*(f"{kind}{k}" for kind in "akt" for k in (1, 2, 3, 5)), "a4", "d1", "d5", "tx", "ty", "tz"]
    palletizer = {"family": "palletizer4", "parameters": dict.fromkeys(keys, 0.1)}
    subject = solved(tmp_path, imperfect[1] | {"robot": palletizer}, "adjustment")
    (warning,) = [w for w in subject["warnings"] if w["code"] == "arm.accuracy"]
    assert "robot has 4 joints" in warning["text"]
    assert subject["uncertainty"]["covers"] == ["arm", "lens", "target"]


def test_bare_poses_are_refused_by_name(tmp_path: Path) -> None:
    scene = make_scene(1)
    document = scene.data_set()
    for observation, C in zip(document["observations"], scene.camera_target, strict=True):
        del observation["corners"]
        observation["T_camera_target"] = to_pose6(C).tolist()
    with pytest.raises(InputError, match="every observation are needed, and observation 0 gives a bare"):
        solved(tmp_path, document, "adjustment")
