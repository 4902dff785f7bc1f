"""From a capture data set on disk to a result: figures, refusals, and one clear sentence for bad input."""

import json
import pickle
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from cell.errors import CellError, InputError
from cell.formats.result import Result
from cell.poses import from_pose6, log_xi, to_pose6
from procedures.hand_eye.result import HandEyeAnswer
from procedures.hand_eye.result_spread import Spread
from procedures.hand_eye.words import hand_eye_lines, spread_lines
from tests.kit.hand_eye_scene import BOARD, CAMERA, POINTS, X_TRUE, make_scene
from tests.kit.solved import solve_hand_eye
from tests.kit.whole_results import made


def error_of(result: dict[str, Any], name: str = "T_flange_camera") -> np.ndarray:
    return log_xi(from_pose6(result["result"][name]).inv() * X_TRUE)


def codes(result: dict[str, Any]) -> list[str]:
    """Of the warnings. That the arm is taken as exact is said of every set without joints, as most here."""
    return [w["code"] for w in result["warnings"] if w["code"] != "arm.accuracy"]


def without_times(result: dict[str, Any]) -> dict[str, Any]:
    return {**result, "inputs": {k: v for k, v in result["inputs"].items() if k != "solve_seconds"}}


@pytest.mark.parametrize(
    ("setup", "X", "W"),
    [
        ("eye-in-hand", "T_flange_camera", "T_base_target"),
        ("eye-to-hand", "T_base_camera", "T_flange_target"),
    ],
)
def test_a_capture_of_corners_gives_a_result_in_the_format(
    tmp_path: Path, setup: str, X: str, W: str
) -> None:
    path = make_scene(1, setup, count=24, groups=2).write(tmp_path)
    steps: list[tuple[str, int, int]] = []
    result = solve_hand_eye(path, progress=lambda *step: steps.append(step))
    assert Result.model_validate(result).verdict == "warn"
    assert [w["code"] for w in result["warnings"]] == ["arm.accuracy"]
    assert solve_hand_eye(path, method="ml")["verdict"] == "pass"
    answer, residuals = result["result"], result["residuals"]
    e = error_of(result, X)
    assert e @ np.linalg.solve(np.array(answer["cov"]), e) < 22.5
    assert set(answer[W]) == {"0", "1"}
    assert answer["rejected"] == []
    for name in ("spread_within", "spread_across"):
        assert set(answer[name]) == {"t", "t_norm", "r", "floor_t", "floor_r", "resolved"}
    assert residuals["spread_mean"] == residuals["spread_mean_all"]
    assert residuals["loo_mean"]["t"] > residuals["spread_mean"]["t"] * 0.9
    assert residuals["reprojection_rms_px"] == pytest.approx(0.2 * np.sqrt(2), rel=0.1)
    assert residuals["reprojection_through_arm_rms_px"] > residuals["reprojection_rms_px"]
    assert len(residuals["per_observation"]) == 24
    assert all(c["from_ours"]["t"] < 0.01 for c in residuals["cross_check"].values())
    assert result["heldout"]["observations"] == 24
    assert result["inputs"]["solve_seconds"] > 0
    assert {s[0] for s in steps} == {"detect", "solve"}
    json.dumps(result, allow_nan=False)


def test_solving_again_gives_the_same_answer(tmp_path: Path) -> None:
    path = make_scene(2, count=16).write(tmp_path)
    assert without_times(solve_hand_eye(path)) == without_times(solve_hand_eye(path.parent, calls=2))


def test_the_entry_can_be_sent_to_a_worker_process() -> None:
    assert pickle.loads(pickle.dumps(solve_hand_eye)) is solve_hand_eye


def test_frames_of_one_pose_are_averaged_and_unseen_corners_left_out(tmp_path: Path) -> None:
    scene = make_scene(3, count=16, px=0.0)
    data = scene.data_set()
    rng = np.random.default_rng(0)
    for k, observation in enumerate(data["observations"]):
        del observation["corners"]
        frames = scene.corners[k] + rng.normal(size=(5, 54, 2)) * 0.4
        listed = [
            [None if j == f else uv for j, uv in enumerate(frame.tolist())] for f, frame in enumerate(frames)
        ]
        observation["frames"] = [{"corners": corners, "t": 1.0 + f} for f, corners in enumerate(listed)]
    (tmp_path / "capture.json").write_text(json.dumps(data))
    result = solve_hand_eye(tmp_path)
    assert result["result"]["noise"]["sigma_px"] == pytest.approx(0.4, rel=0.08)
    assert result["residuals"]["per_observation"][0]["corners"] == 54
    e = error_of(result)
    assert e @ np.linalg.solve(np.array(result["result"]["cov"]), e) < 22.5


def test_images_are_searched_when_there_are_no_corners(tmp_path: Path) -> None:
    scene = make_scene(4, count=8, px=0.0, flange_t=1e-4, flange_r=1e-4)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    board = cv2.aruco.CharucoBoard((10, 7), 0.025, 0.018, dictionary).generateImage((1000, 700))
    data = scene.data_set(camera={"width": 1280, "height": 800, "K": list(CAMERA.K), "dist": []})
    for k, observation in enumerate(data["observations"]):
        del observation["corners"]
        R = scene.camera_target[k].rotation.as_matrix()
        H = CAMERA.matrix @ np.column_stack(
            [R[:, 0] * 0.00025, R[:, 1] * 0.00025, scene.camera_target[k].translation]
        )
        image = cv2.warpPerspective(board, H, (1280, 800), flags=cv2.INTER_LINEAR, borderValue=255)
        observation["image"] = f"{k}.png"
        cv2.imwrite(str(tmp_path / f"{k}.png"), cv2.GaussianBlur(image, (3, 3), 0.6))
    cv2.imwrite(str(tmp_path / "3.png"), np.full((800, 1280), 200, np.uint8))
    (tmp_path / "capture.json").write_text(json.dumps(data))
    result = solve_hand_eye(tmp_path)
    assert result["result"]["rejected"] == [{"index": 3, "reason": "the target was not found"}]
    assert np.linalg.norm(error_of(result)[:3]) < 2e-3


def bare_poses(noise: dict[str, float], seed: int = 5) -> dict[str, Any]:
    """A data set of a perfect arm and of target poses that are off by 0.1 mm and 0.2 mrad an axis."""
    scene = make_scene(seed, count=24, groups=3, flange_t=0.0, flange_r=0.0)
    data = scene.data_set(camera=None, noise=noise)
    rng = np.random.default_rng(seed)
    for observation, seen in zip(data["observations"], scene.camera_target, strict=True):
        del observation["corners"]
        off = from_pose6([*(1e-4 * rng.normal(size=3)), *(2e-4 * rng.normal(size=3))])
        observation["T_camera_target"] = to_pose6(seen * off).tolist()
    return data


def test_bare_poses_need_no_camera_and_tell_no_floor_of_their_spread(tmp_path: Path) -> None:
    (tmp_path / "capture.json").write_text(json.dumps(bare_poses({})))
    result = solve_hand_eye(tmp_path)
    assert np.linalg.norm(error_of(result)[:3]) < 1e-3
    assert result["residuals"]["reprojection_rms_px"] is None
    for name in ("spread_within", "spread_across"):
        spread = result["result"][name]
        assert (spread["floor_t"], spread["floor_r"], spread["resolved"]) == (None, None, None)
    lines = spread_lines(HandEyeAnswer.model_validate(result["result"]))
    assert ["what noise alone gives is not known: " in line for line in lines[:2]] == [True, True]


def test_an_arm_that_is_told_leaves_the_noise_of_bare_poses_as_the_floor(tmp_path: Path) -> None:
    data = bare_poses({"sigma_flange_t": 0.0, "sigma_flange_r": 0.0})
    (tmp_path / "capture.json").write_text(json.dumps(data))
    spread = solve_hand_eye(tmp_path)["result"]["spread_within"]
    assert spread["t_norm"] / spread["floor_t"] == pytest.approx(1.0, abs=0.3)
    assert spread["r"] / spread["floor_r"] == pytest.approx(1.0, abs=0.3)
    assert spread["resolved"] is False


def test_a_floor_of_nothing_in_an_earlier_result_counts_as_unknown() -> None:
    earlier = {"t": [1e-3, 0.0, 0.0], "t_norm": 1e-3, "r": 1e-3, "floor_t": 0.0, "floor_r": 0.0}
    assert not Spread.model_validate(earlier | {"resolved": True}).floor_known


def test_degrees_that_were_wrapped_as_radians_are_not_said_to_be_ruled_out(tmp_path: Path) -> None:
    data = bare_poses({})
    for observation in data["observations"]:
        place, vector = np.split(np.array(observation["T_base_flange"]), 2)
        wrapped = Rotation.from_rotvec(np.degrees(vector)).as_rotvec()
        observation["T_base_flange"] = [*place.tolist(), *wrapped.tolist()]
    (tmp_path / "capture.json").write_text(json.dumps(data))
    with pytest.raises(
        InputError, match=r"poses\.time.*some of the orders.*the units and the order of angles"
    ):
        solve_hand_eye(tmp_path)


def test_missing_intrinsics_are_estimated_and_said_so(tmp_path: Path) -> None:
    result = solve_hand_eye(make_scene(6, count=24).write(tmp_path, camera=None))
    assert codes(result) == ["camera.intrinsics"]
    K = np.array(result["result"]["intrinsics"]["K"])
    assert np.all(np.abs(K - CAMERA.K) < 5 * np.array(result["result"]["intrinsics"]["sigma_K"]) + 1)
    assert np.linalg.norm(error_of(result)[:3]) < 0.02


@pytest.mark.parametrize("shift", [(80.0, 0.0), (0.0, -80.0)])
def test_one_shifted_image_does_not_replace_good_intrinsics(
    tmp_path: Path, shift: tuple[float, float]
) -> None:
    scene = make_scene(15, count=12, px=0.05)
    scene.corners[4] += shift
    result = solve_hand_eye(scene.write(tmp_path))
    assert "intrinsics" not in result["result"]
    assert codes(result) == ["images.misfit"]
    assert "observation 4 fit" in result["warnings"][0]["text"]
    assert [r["index"] for r in result["result"]["rejected"]] == [4]
    assert result["result"]["rejected"][0]["reason"]
    e = error_of(result)
    assert e @ np.linalg.solve(np.array(result["result"]["cov"]), e) < 22.5


def test_wrong_intrinsics_are_replaced_in_spite_of_a_shifted_image(tmp_path: Path) -> None:
    scene = make_scene(15, count=24, px=0.05)
    scene.corners[4] += (80.0, 0.0)
    wrong = {"width": 1280, "height": 800, "K": [927.0, 932.0, 640.0, 400.0], "dist": list(CAMERA.dist)}
    result = solve_hand_eye(scene.write(tmp_path, camera=wrong))
    assert codes(result) == ["camera.intrinsics", "images.misfit"]
    found = result["result"]["intrinsics"]
    assert np.all(np.abs(np.array(found["K"]) - CAMERA.K) < 5 * np.array(found["sigma_K"]))
    assert [r["index"] for r in result["result"]["rejected"]] == [4]


def test_a_shifted_image_has_no_part_in_estimated_intrinsics(tmp_path: Path) -> None:
    scene = make_scene(15, count=24, px=0.05)
    scene.corners[4] += (80.0, 0.0)
    result = solve_hand_eye(scene.write(tmp_path, camera=None))
    assert codes(result) == ["camera.intrinsics", "images.misfit"]
    found = result["result"]["intrinsics"]
    assert np.all(np.abs(np.array(found["K"]) - CAMERA.K) < 5 * np.array(found["sigma_K"]))


def test_too_few_images_for_missing_intrinsics_are_refused_with_the_number(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"camera is null .*5 views or more"):
        solve_hand_eye(make_scene(6, count=4).write(tmp_path, camera=None))
    assert solve_hand_eye(make_scene(6, count=5).write(tmp_path, camera=None))["inputs"]["usable"] == 5


def test_given_noise_is_used_as_given(tmp_path: Path) -> None:
    noise = {"sigma_px": 0.2, "sigma_flange_t": 2e-4, "sigma_flange_r": 2e-4}
    found = solve_hand_eye(make_scene(7).write(tmp_path, noise=noise))["result"]["noise"]
    assert {k: found[k] for k in noise} == noise
    assert found["estimated"] == []


@pytest.mark.parametrize("method", ["tsai", "park", "horaud", "daniilidis"])
def test_other_methods_can_be_asked_for(tmp_path: Path, method: str) -> None:
    result = solve_hand_eye(make_scene(8).write(tmp_path), method=method)
    assert result["inputs"]["method"] == method
    assert np.linalg.norm(error_of(result)[:3]) < 0.01
    sigma = np.sqrt(np.diag(result["result"]["cov"])[:3])
    assert 1e-4 < np.linalg.norm(sigma) < 1e-2


def test_a_method_that_does_not_exist_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="it must be one of adjustment, ml, tsai"):
        solve_hand_eye(make_scene().write(tmp_path), method="magic")


def test_equal_poses_are_refused_in_words(tmp_path: Path) -> None:
    scene = make_scene(count=6)
    scene.flange[:] = [scene.flange[0]] * 6
    result = solve_hand_eye(scene.write(tmp_path))
    assert (result["verdict"], result["result"]) == ("fail", None)
    assert result["reasons"][0].startswith("poses-not-distinct: all 6 flange poses are equal")


def test_a_board_that_was_never_seen_is_refused_in_words(tmp_path: Path) -> None:
    data = make_scene(count=4).data_set()
    for observation in data["observations"]:
        observation["corners"] = [None] * 54
    (tmp_path / "capture.json").write_text(json.dumps(data))
    result = solve_hand_eye(tmp_path)
    assert result["result"] is None
    assert result["reasons"][0].startswith("too-few-poses: the target was seen in none of 4 observations")


def test_pairs_without_rotation_are_warned_of(tmp_path: Path) -> None:
    scene = make_scene(9, count=16, flange_r=0.0)
    assert scene.write(tmp_path)
    still = make_scene(
        9, count=16, flange_r=0.0, views=[*scene.camera_target[:15], _beside(scene.camera_target[14])]
    )
    result = solve_hand_eye(still.write(tmp_path))
    assert codes(result) == ["pairs.no-rotation"]
    assert any("14-15" in w["text"] for w in result["warnings"])


def _beside(C: RigidTransform) -> RigidTransform:
    return RigidTransform.from_translation([0.02, 0.01, 0.0]) * C


def broken(data: dict[str, Any], what: str) -> str:
    """``data`` as text with one mistake."""
    observation = data["observations"][2]
    if what == "unknown key":
        data["observatoins"] = []
    elif what == "unknown key inside":
        data["target"]["sqare_m"] = 0.02
    elif what == "missing key":
        del data["target"]["square_m"]
    elif what == "short pose":
        observation["T_base_flange"] = [0.0] * 5
    elif what == "nan":
        return json.dumps(data).replace(str(observation["T_base_flange"][0]), "NaN", 1)
    elif what == "not json":
        return json.dumps(data)[:-30]
    elif what == "wrong schema":
        data["schema"] = "cellward.kincal/1"
    elif what == "too few corners listed":
        observation["corners"] = observation["corners"][:-1]
    elif what == "index twice":
        observation["index"] = 1
    elif what == "nothing measured":
        del observation["corners"]
    elif what == "distortion length":
        data["camera"]["dist"] = [0.1, 0.2, 0.3]
    elif what == "focal length":
        data["camera"]["K"][0] = -5.0
    elif what == "dictionary":
        data["target"]["dictionary"] = "DICT_5X5_99"
    elif what == "setup":
        data["setup"] = "eye-on-hand"
    else:
        del observation["corners"]
        observation["image"] = {"escape": "../secret.png", "absolute": "/etc/hostname"}.get(what, "gone.png")
        if what == "corrupt image":
            observation["image"] = "bad.png"
        if what == "wrong size":
            observation["image"] = "small.png"
    return json.dumps(data)


@pytest.mark.parametrize(
    ("what", "name", "words"),
    [
        ("unknown key", "DATA_INVALID", "observatoins is an unknown key; did you mean 'observations'"),
        ("unknown key inside", "DATA_INVALID", "target.sqare_m is an unknown key; did you mean 'square_m'"),
        ("missing key", "DATA_INVALID", "target.square_m is missing"),
        (
            "short pose",
            "DATA_INVALID",
            "observations[2].T_base_flange has 5 entries; it must have at least 6",
        ),
        ("nan", "DATA_INVALID", "NaN"),
        ("not json", "FILE_UNREADABLE", "is not JSON"),
        ("wrong schema", "DATA_INVALID", "'cellward.kincal/1'; this command reads 'cellward.capture/1'"),
        ("too few corners listed", "DATA_INVALID", "observations[2].corners has 53 entries"),
        ("index twice", "DATA_INVALID", "index 1 twice"),
        ("nothing measured", "DATA_INVALID", "none of image, corners, frames and T_camera_target"),
        ("distortion length", "DATA_INVALID", "camera.dist has 3 entries"),
        ("focal length", "DATA_INVALID", "camera.K"),
        ("dictionary", "DATA_INVALID", "target.dictionary is 'DICT_5X5_99'"),
        ("setup", "DATA_INVALID", "setup should be 'eye-in-hand' or 'eye-to-hand'"),
        ("escape", "DATA_INVALID", "leads out of"),
        ("absolute", "DATA_INVALID", "leads out of"),
        ("missing image", "FILE_MISSING", "gone.png"),
        ("corrupt image", "FILE_UNREADABLE", "not an intact image"),
        ("wrong size", "DATA_INVALID", "320x200 pixels, but the camera has 1280x800"),
    ],
)
def test_bad_input_is_one_sentence_with_file_and_field(
    tmp_path: Path, what: str, name: str, words: str
) -> None:
    (tmp_path.parent / "secret.png").write_bytes(b"secret")
    (tmp_path / "bad.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(60))
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((200, 320), np.uint8))
    data = json.loads(json.dumps(make_scene(count=6).data_set(target=dict(BOARD))))
    (tmp_path / "capture.json").write_text(broken(data, what))
    with pytest.raises(InputError) as caught:
        solve_hand_eye(tmp_path)
    assert caught.value.name == name
    assert words in caught.value.detail
    assert str(tmp_path) in caught.value.detail
    assert "\n" not in caught.value.detail


def test_a_folder_without_a_data_set_says_which_file_is_missing(tmp_path: Path) -> None:
    with pytest.raises(CellError, match=r"capture\.json does not exist"):
        solve_hand_eye(tmp_path)


def test_notes_may_hold_anything(tmp_path: Path) -> None:
    data = make_scene(count=8).data_set(notes={"who": ["me"]}, robot={"model": "ur10e"})
    data["observations"][0]["notes"] = {"planned": [1, 2]}
    (tmp_path / "capture.json").write_text(json.dumps(data))
    assert solve_hand_eye(tmp_path)["result"] is not None


def test_millimetres_and_degrees_are_suspected(tmp_path: Path) -> None:
    data = make_scene(count=8).data_set()
    for observation in data["observations"]:
        observation["T_base_flange"] = [1000 * v for v in observation["T_base_flange"][:3]] + observation[
            "T_base_flange"
        ][3:]
        observation["q"] = [90.0, 0, 0, 0, 0, 0]
    (tmp_path / "capture.json").write_text(json.dumps(data))
    with pytest.raises(
        InputError, match=r"units.translation: .* the translations of T_base_flange are in millimetres"
    ):
        solve_hand_eye(tmp_path)


@pytest.mark.parametrize("setup", ["eye-in-hand", "eye-to-hand"])
def test_a_data_set_all_in_millimetres_is_refused(tmp_path: Path, setup: str) -> None:
    target = {**BOARD, "square_m": 25.0, "marker_m": 18.0}
    data = make_scene(1, setup, count=12).data_set(target=target)
    for observation in data["observations"]:
        pose = observation["T_base_flange"]
        observation["T_base_flange"] = [1000 * v for v in pose[:3]] + pose[3:]
    (tmp_path / "capture.json").write_text(json.dumps(data))
    with pytest.raises(InputError, match=r"T_base_flange .* and the lengths of target by 1000$") as caught:
        solve_hand_eye(tmp_path)
    assert caught.value.name == "DATA_INVALID"


def test_target_poses_in_millimetres_are_refused_though_the_arm_is_in_metres(tmp_path: Path) -> None:
    """On a cone about one axis at one distance such a set agrees with itself."""
    turns = [
        Rotation.from_rotvec([0.44 * np.sin(f), 0.44 * np.cos(f), 0.0]) for f in np.arange(12) * np.pi / 6
    ]
    views = [RigidTransform.from_components([0.0, 0.0, 0.5], R) for R in turns]
    scene = make_scene(10, count=12, px=0.01, flange_t=0.0, flange_r=0.0, views=views)
    data = scene.data_set()
    for observation, C in zip(data["observations"], scene.camera_target, strict=True):
        del observation["corners"]
        pose = to_pose6(C).tolist()
        observation["T_camera_target"] = [1000 * v for v in pose[:3]] + pose[3:]
    (tmp_path / "capture.json").write_text(json.dumps(data))
    with pytest.raises(
        InputError, match=r"no camera is mounted more than 5 m .* are in millimetres"
    ) as caught:
        solve_hand_eye(tmp_path)
    assert caught.value.name == "DATA_INVALID"


def test_poses_in_another_order_are_found_out(tmp_path: Path) -> None:
    scene = make_scene(10, count=16)
    scene.flange.reverse()
    with pytest.raises(InputError, match="T_base_flange does not belong to the images"):
        solve_hand_eye(scene.write(tmp_path))


def test_a_misread_image_is_listed_and_does_not_spoil_the_rest(tmp_path: Path) -> None:
    scene = make_scene(13, count=14)
    scene.corners[3] = scene.corners[3][::-1]  # numbered from the other end
    scene.corners[5] = np.random.default_rng(0).uniform(0, 800, (54, 2))
    result = solve_hand_eye(scene.write(tmp_path))
    assert [r["index"] for r in result["result"]["rejected"]] == [3, 5]
    e = error_of(result)
    assert e @ np.linalg.solve(np.array(result["result"]["cov"]), e) < 22.5


def test_noise_given_as_zero_still_gives_an_answer(tmp_path: Path) -> None:
    noise = {"sigma_px": 0.0, "sigma_flange_t": 0.0, "sigma_flange_r": 0.0}
    result = solve_hand_eye(make_scene(14, count=12).write(tmp_path, noise=noise))
    assert codes(result) == ["noise.too-small"]
    assert np.linalg.norm(error_of(result)[:3]) < 5e-3


def test_the_wrong_setup_is_found_out(tmp_path: Path) -> None:
    path = make_scene(11, "eye-to-hand", count=16).write(tmp_path, setup="eye-in-hand")
    with pytest.raises(InputError, match="the data fit setup 'eye-to-hand'"):
        solve_hand_eye(path)


def test_held_out_figures_count_what_was_left_out_and_judge_a_placement_by_the_others(tmp_path: Path) -> None:
    scene = make_scene(13, count=24, groups=2)
    scene.corners[3] = scene.corners[3][::-1]  # numbered from the other end
    for k in range(12, 24):  # the arm's lengths are off where the second placement was
        t, R = scene.flange[k].translation, scene.flange[k].rotation
        scene.flange[k] = RigidTransform.from_components(1.01 * t, R)
    result = solve_hand_eye(scene.write(tmp_path))
    held = result["heldout"]
    assert held["rejected"] >= 1
    assert held["rms_with_rejected"]["t"] > 1.5 * held["rms"]["t"]
    assert held["rms_by_placement"]["t"] > held["rms"]["t"]
    text = "\n".join(hand_eye_lines(made(result)))
    for words, key in (
        ("counted as well ", "rms_with_rejected"),
        ("judged by the others ", "rms_by_placement"),
    ):
        assert f"{words}{1e3 * held[key]['t']:.3f} mm" in text


def test_one_placement_is_not_judged_by_others(tmp_path: Path) -> None:
    assert solve_hand_eye(make_scene(1, count=12).write(tmp_path))["heldout"]["rms_by_placement"] == {}


@pytest.mark.data
def test_a_real_arm_with_a_charuco_board_on_its_wrist(data_folder: Path) -> None:
    result = solve_hand_eye(data_folder / "ic_charuco_eye_to_hand")
    assert codes(result) == ["camera.intrinsics", "target.scale", "pairs.no-rotation"]
    (still,) = [w for w in result["warnings"] if w["code"] == "pairs.no-rotation"]
    assert "0-1" in still["text"]
    assert "5-6" in still["text"]
    assert [r["index"] for r in result["result"]["rejected"]] == [2, 15]
    assert all(r["reason"] for r in result["result"]["rejected"])
    residuals = result["residuals"]
    assert residuals["spread_mean_all"]["t"] <= 0.95e-3
    assert np.degrees(residuals["spread_mean_all"]["r"]) <= 0.19
    assert residuals["spread_mean"]["t"] <= 0.75e-3
    assert residuals["loo_mean"]["t"] <= 0.86e-3
    assert np.degrees(residuals["loo_mean"]["r"]) <= 0.13


@pytest.mark.data
def test_a_real_camera_on_an_arm_before_a_dark_chessboard(data_folder: Path) -> None:
    result = solve_hand_eye(data_folder / "ur5_realsense_eye_in_hand")
    assert result["inputs"]["used"] == 20
    residuals = result["residuals"]
    assert residuals["spread_mean_all"]["t"] <= 3.3e-3
    assert np.degrees(residuals["spread_mean_all"]["r"]) <= 0.23
    published = [0.33627, -0.46412, 0.02589]  # by ViSP, beside the data
    assert np.linalg.norm(np.array(result["result"]["T_flange_camera"][:3]) - published) < 0.01


def test_points_are_the_boards(tmp_path: Path) -> None:
    """The same corners solved as given points: another way to name the target, the same answer."""
    scene = make_scene(12, count=12)
    board = solve_hand_eye(scene.write(tmp_path))
    points = solve_hand_eye(scene.write(tmp_path, target={"type": "points", "points": POINTS.tolist()}))
    assert np.allclose(board["result"]["T_flange_camera"], points["result"]["T_flange_camera"], atol=1e-12)
