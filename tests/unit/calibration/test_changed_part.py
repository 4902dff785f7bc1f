"""Which part of a cell has changed: the right one is named, and who cannot tell says so."""

import numpy as np
import pytest

from calibration.hand_eye.problem import Setup
from tests.kit.cross_check_scene import JOINT_RAD, TOOL_M, Change, by_tracker, checked
from tests.kit.eye_to_hand_scene import make_scene
from tests.kit.imperfect_cell import MODEL


def test_nothing_is_named_where_nothing_has_changed() -> None:
    subject = checked(0, "none")
    assert (subject.part, subject.joint) == ("none", None)
    # The last joint's zero turns target and tool about its axis, so neither measurement shows it.
    assert subject.unseen == (5,)


@pytest.mark.parametrize("setup", ["eye-to-hand", "eye-in-hand"])
def test_a_bent_tool_is_named_with_its_shift(setup: Setup) -> None:
    subject = checked(1, "tool", setup=setup)
    assert subject.part == "tool"
    assert np.linalg.norm(subject.change) == pytest.approx(TOOL_M, rel=0.2)


def test_a_bent_tool_is_named_where_another_part_may_have_changed_with_it() -> None:
    subject = checked(1014, "tool", setup="eye-in-hand", poses=100)
    assert 0.03 < subject.probable["several"] < 0.1
    assert subject.part == "tool"


@pytest.mark.parametrize(("setup", "poses"), [("eye-to-hand", 40), ("eye-in-hand", 100)])
def test_a_moved_camera_is_named(setup: Setup, poses: int) -> None:
    subject = checked(3, "camera", setup=setup, poses=poses)
    assert subject.part == "camera"
    assert subject.sigma.shape == (6,)


def test_what_the_lens_leaves_open_hides_no_moved_camera() -> None:
    """Both captures are of one lens: by itself neither tells where its focal length moves the camera to."""
    assert checked(1053, "camera", setup="eye-in-hand", poses=100, arm_m=6e-5).part == "camera"


@pytest.mark.parametrize(("setup", "joint"), [("eye-to-hand", 1), ("eye-in-hand", 2)])
def test_a_joint_whose_zero_is_off_is_named_with_its_error(setup: Setup, joint: int) -> None:
    subject = checked(4, "joint", joint, setup)
    assert (subject.part, subject.joint) == ("joint zero", joint)
    assert abs(subject.change[0]) == pytest.approx(JOINT_RAD, rel=0.2)


def test_a_zero_that_shows_in_nothing_is_no_reason_to_blame_another_part() -> None:
    subject = checked(5, "joint", 5)
    assert subject.part in ("none", "cannot-tell")


def test_a_tracker_makes_a_zero_more_certain_and_agrees_with_the_board() -> None:
    without, subject = (checked(4, "joint", 1, tracker=tracker) for tracker in (False, True))
    assert (subject.part, subject.joint) == ("joint zero", 1)
    assert subject.sigma[0] < without.sigma[0]
    assert abs(abs(subject.change[0]) - JOINT_RAD) < 4.0 * subject.sigma[0]


def test_a_tracker_alone_finds_the_numbers_of_an_arm_as_the_truth_has_them() -> None:
    rng = np.random.default_rng(3)
    cell = make_scene(rng, 4).cell
    zeros = Change(zeros=1e-3 * np.eye(6)[2])
    then, now = (by_tracker(np.random.default_rng(8), cell, what) for what in (Change(), zeros))
    names = MODEL.names
    sigma = np.full(len(then.pull), 2e-4)
    found = [np.linalg.solve(one.information + np.diag(sigma**-2.0), one.pull) for one in (then, now)]
    change = (found[1] - found[0])[names.index("theta3")]
    assert 5e-4 < change < 1.2e-3  # the rest of it is in numbers that do alike


def test_a_zero_that_the_beams_alone_show_is_not_told_from_a_bent_tool() -> None:
    """A camera on the flange sees a board that is put anew: where the base is turned to is not seen."""
    subject = checked(1, "joint", 0, "eye-in-hand")
    assert (subject.part, subject.joint) == ("cannot-tell", None)
    assert subject.by_beams_alone == (0,)
