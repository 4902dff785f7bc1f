"""Captures that contradict themselves: the mistake is named by its code, and no good capture is accused."""

import json
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest

from cell.errors import InputError
from tests.kit.contradictions import KINDS, Document, good
from tests.kit.solved import solve_hand_eye

NAMES = {
    "arm.accuracy",
    "pairs.no-rotation",
    "poses.order-unchecked",
    "observations.rejected",
}


@pytest.fixture(scope="module")
def with_joints() -> Document:
    return good(np.random.default_rng(3), joints=True, plan="few")


def told(document: Document, folder: Path) -> tuple[set[str], str]:
    """The codes, and the words of a refusal."""
    path = folder / "capture.json"
    path.write_text(json.dumps(document), "utf-8")
    try:
        result = solve_hand_eye(path)
    except InputError as exc:
        words = exc.detail.removeprefix(f"{path}: ")
        return {word for word in words.split(": ")[0].split(" or ")}, words
    assert result["result"] is not None
    return {w["code"] for w in result["warnings"]} - NAMES, ""  # type: ignore[attr-defined]


def without_joints(document: Document) -> Document:
    del document["robot"]
    for observation in document["observations"]:
        del observation["q"]
    return document


def test_a_good_capture_is_not_accused(with_joints: Document, tmp_path: Path) -> None:
    assert told(with_joints, tmp_path) == (set(), "")
    assert told(without_joints(deepcopy(with_joints)), tmp_path) == (set(), "")


@pytest.mark.parametrize("name", list(KINDS))
def test_a_mistake_is_named(name: str, with_joints: Document, tmp_path: Path) -> None:
    kind, document = KINDS[name], deepcopy(with_joints)
    kind.spoil(np.random.default_rng(5), document)
    assert kind.code in told(document, tmp_path)[0]


@pytest.mark.parametrize("name", [name for name, kind in KINDS.items() if kind.joints is None])
def test_a_mistake_is_named_without_joints(name: str, with_joints: Document, tmp_path: Path) -> None:
    kind, document = KINDS[name], without_joints(deepcopy(with_joints))
    kind.spoil(np.random.default_rng(6), document)
    assert kind.code in told(document, tmp_path)[0]


def test_inverted_poses_and_the_other_setup_are_both_named_where_nothing_parts_them(
    with_joints: Document, tmp_path: Path
) -> None:
    document = without_joints(deepcopy(with_joints))
    KINDS["inverted"].spoil(np.random.default_rng(0), document)
    codes, words = told(document, tmp_path)
    assert codes == {"poses.inverted", "poses.frames-swapped"}
    assert "without robot and joints the two cannot be told apart" in words


def test_a_bent_board_is_not_answered_with_other_intrinsics(with_joints: Document, tmp_path: Path) -> None:
    document = deepcopy(with_joints)
    KINDS["bent board"].spoil(np.random.default_rng(1), document)
    assert "camera.intrinsics" not in told(document, tmp_path)[0]


def test_a_copy_is_used_once(with_joints: Document, tmp_path: Path) -> None:
    document = deepcopy(with_joints)
    count = len(document["observations"])
    KINDS["copies"].spoil(np.random.default_rng(2), document)
    path = tmp_path / "capture.json"
    path.write_text(json.dumps(document), "utf-8")
    result = solve_hand_eye(path)
    assert result["inputs"]["used"] == count  # type: ignore[index]
    reasons = [r["reason"] for r in result["result"]["rejected"]]  # type: ignore[index]
    assert len(reasons) == 3
    assert all(reason.startswith("a copy of observation") for reason in reasons)


def test_a_mistake_that_is_not_found_is_told_with_what_was_tried(tmp_path: Path) -> None:
    """Poses of several placements in disorder: the order is out there, so it is not said to be none."""
    rng = np.random.default_rng([3, 77])
    document = good(rng, joints=True)
    KINDS["shuffled"].spoil(rng, document)
    found, words = told(document, tmp_path)
    assert found == {"poses.time"}
    assert "and some of the orders of the poses, not all of them" in words
    assert "check that each pose was recorded with its own image" in words
    assert "none explains" not in words


def test_the_order_of_few_poses_is_not_said_to_have_been_tried(with_joints: Document, tmp_path: Path) -> None:
    document = without_joints(deepcopy(with_joints))
    few = document["observations"][:4]
    poses = [o["T_base_flange"] for o in few]
    rng = np.random.default_rng(4)
    for observation, pose in zip(few, poses, strict=True):
        observation["T_base_flange"] = [*pose[:3], *rng.normal(size=3)]
    document["observations"] = few
    found, words = told(document, tmp_path)
    assert found == {"poses.time"}
    assert "no other order, which fewer than 5 poses do not tell" in words
