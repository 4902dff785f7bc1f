"""The grade of a hand-eye result: its accuracy where it is to be used, against what the task leaves free."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from cell.errors import InputError
from fakes.object import run_virtual
from procedures.hand_eye.config import Acceptance
from procedures.hand_eye.result import AbsoluteAccuracy, AtTask, HandEyeResult
from procedures.hand_eye.solve.solver import solve_hand_eye
from procedures.hand_eye.verdict import judged
from procedures.hand_eye.words import hand_eye_lines
from tests.kit.contradictions import good
from tests.kit.object_cell import no_report, open_cell, refused, write_config

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

WIDE = {"max_error_t_m": 0.1, "max_error_r_rad": 0.1, "task_pose": "pick"}
TASK = {"q": [0.3, -1.4, 1.9, -2.0, -1.5, 0.2], "distance_m": 0.45}


def document(joints: bool = True) -> dict[str, Any]:
    return good(np.random.default_rng(3), joints=joints, plan="few") | {"task": TASK}


def solved(folder: Path, document: dict[str, Any]) -> HandEyeResult:
    path = folder / "capture.json"
    path.write_text(json.dumps(document), "utf-8")
    result = solve_hand_eye(path, calls=1)
    assert isinstance(result, HandEyeResult)
    return result


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> HandEyeResult:
    return solved(tmp_path_factory.mktemp("capture"), document())


def task(of: HandEyeResult) -> AtTask:
    assert of.result.task is not None
    return of.result.task


def graded(found: HandEyeResult, clearance_m: float) -> HandEyeResult:
    subject = judged(found, Acceptance(**WIDE, clearance_m=clearance_m))
    assert isinstance(subject, HandEyeResult)
    return subject


def test_an_arm_that_is_accurate_enough_as_configured_passes(found: HandEyeResult) -> None:
    subject = graded(found, 1.01 * task(found).configured95)
    assert task(subject).grade == "pass"
    assert subject.verdict == found.verdict
    assert "is free: pass" in "\n".join(hand_eye_lines(subject))


def test_an_arm_that_is_so_only_when_corrected_is_warned_of(found: HandEyeResult) -> None:
    assert task(found).corrected95 < task(found).configured95
    subject = graded(found, 0.5 * (task(found).corrected95 + task(found).configured95))
    assert task(subject).grade == "warn"
    assert subject.verdict == "warn"
    assert "task.clearance" in [w.code for w in subject.warnings]


def test_beyond_the_clearance_with_the_corrected_arm_the_result_fails(found: HandEyeResult) -> None:
    subject = graded(found, 0.99 * task(found).corrected95)
    assert (task(subject).grade, subject.verdict) == ("fail", "fail")
    assert subject.reasons[0].startswith("clearance_m: at task_pose 95 % of the errors")


def test_without_the_arms_joints_no_clearance_is_held(tmp_path: Path) -> None:
    bare = solved(tmp_path, document(joints=False))
    assert bare.result.task is None
    subject = graded(bare, 0.01)
    assert subject.verdict == "fail"
    assert "nothing is known of the accuracy at task_pose" in subject.reasons[0]


def test_a_task_with_joints_that_the_arm_has_not_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"task\.q has 4 joints; the robot has 6"):
        solved(tmp_path, document() | {"task": TASK | {"q": [0.0, 0.0, 0.0, 0.0]}})


def test_a_clearance_needs_its_place() -> None:
    with pytest.raises(ValidationError, match="clearance_m and task_distance_m need task_pose"):
        Acceptance(clearance_m=0.001)


def test_the_job_grades_its_result_and_the_data_say_where(tmp_path: Path) -> None:
    accept = {"task_pose": "home", "task_distance_m": 0.4, "clearance_m": 0.02}
    config = write_config(tmp_path, "workshop", {"placements": 2, "poses_per_placement": 6, "accept": accept})

    async def main() -> None:
        async with open_cell(config) as cell:
            run_id = await cell.start()
            assert (await cell.finished(run_id))["outcome"] == "complete"
            data = json.loads((cell.folder(run_id).path / "capture.json").read_text("utf-8"))
            assert data["task"] == {"q": config.poses["home"], "distance_m": 0.4}
            at_task = cell.result(run_id)["result"]["task"]
            assert 0.0 < at_task["corrected95"] < at_task["configured95"] < 0.02
            assert (at_task["clearance_m"], at_task["grade"]) == (0.02, "pass")

    run_virtual(main())


def test_a_place_that_the_cell_does_not_have_is_refused(tmp_path: Path) -> None:
    config = write_config(tmp_path, "workshop", {"accept": {"task_pose": "nowhere"}})

    async def main() -> None:
        async with open_cell(config) as cell:
            failure = await refused(cell.start())
            assert "accept.task_pose 'nowhere' is unknown" in failure.detail

    run_virtual(main())


@pytest.mark.parametrize(("before", "shown"), [(3e-4, True), (1e-4, False), (2e-5, False)])
def test_an_arm_whose_error_is_below_what_is_known_of_it_is_not_called_better_corrected(
    found: HandEyeResult, before: float, shown: bool
) -> None:
    accuracy = AbsoluteAccuracy(before=before, after=1e-4, predicted_95=2e-4)
    subject = found.changed(result=found.result.changed(absolute_accuracy=accuracy))
    text = "\n".join(hand_eye_lines(subject))
    assert ("0.100 mm with the corrected arm" in text) == shown
    assert ("do not show that the corrected arm is better" in text) != shown
