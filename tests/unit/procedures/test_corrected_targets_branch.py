"""Which of the joints that reach a target are asked for, and what is said of those that were not sampled."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.identification.application import chain_of, goals_from_yaw
from cell.errors import CellError, present
from cell.poses import Array
from cell.run_values import RunValues
from fakes.world.scenario import Scenario
from fakes.world.world import World
from procedures.corrected_targets.config import CorrectedTargetsConfig
from procedures.corrected_targets.expectation import targets_expectation
from procedures.corrected_targets.judging import solve_targets
from procedures.corrected_targets.plan import plan_targets
from procedures.setup import Setup
from tests.unit.procedures.test_corrected_targets import SCENARIO, TARGETS, TRUTH, true_kinematics
from tests.unit.procedures.test_corrected_targets_truth import run_of

BEHIND = [-1.7, 0.2, 0.6, 0.0]
ALLOWED = np.array(present(TRUTH.observed, "observed arm").limits)


def values(**changes: Any) -> RunValues:
    """Those of a run, with ``changes`` of the accepted kinematics."""
    robot = present(TRUTH.observed, "observed arm").robot
    return RunValues({}, robot, kinematics={"observed_arm": true_kinematics() | changes})


def planned(job: dict[str, Any], q_now: list[float] | None = None, **changes: Any) -> Array:
    """(k, 2, 4): joints as given and corrected."""
    raw = {"targets": TARGETS, **job}
    targets = plan_targets(values(**changes), raw, q_now or [])
    return np.array([[t.given, t.corrected] for t in targets])


@pytest.mark.parametrize(
    "near",
    [None, [0.0, 5.3, -1.4, 0.0], [0.0, 1.45, -1.4, 6.2], [2.3, -1.2, 1.4, -6.2], [0.0, 1.45, 1.9, 3.0]],
)
def test_joints_are_inside_the_ranges_wherever_the_hint_is(near: list[float] | None) -> None:
    Q = planned({"q_near": near}, [0.0, 5.3, -1.4, 9.2])
    assert np.all((ALLOWED[:, 0] <= Q) & (ALLOWED[:, 1] >= Q))
    model = chain_of(present(TRUTH.observed, "observed arm").robot)
    assert np.allclose(model.flange(Q[:, 0]), goals_from_yaw(np.array(TARGETS)), atol=1e-6)


def test_of_two_turns_inside_the_one_next_to_the_hint_is_taken_or_to_what_was_sampled() -> None:
    wide = [*ALLOWED[:3].tolist(), [-9.0, 9.0]]
    low, high = (planned({"q_near": [0.0, 1.45, -1.4, q]}, joint_ranges_rad=wide) for q in (-6.0, 6.0))
    assert np.all(np.abs(high[..., 3] - 6.0) < np.pi + 0.01)
    assert np.all(np.abs(low[..., 3] + 6.0) < np.pi + 0.01)
    sampled = [*ALLOWED[:3].tolist(), [5.0, 7.0]]
    subject = planned({}, joint_ranges_rad=wide, joints_sampled_rad=sampled)
    np.testing.assert_allclose(subject, high, atol=1e-9)


def test_a_target_without_joints_inside_is_refused_with_its_number_and_the_joint() -> None:
    said = (
        r"target 2: .* reaches it with joint 1 at .* joint_ranges_rad of the sampling allows -2.4 to 2.4 rad"
    )
    with pytest.raises(CellError, match=said) as refused:
        planned({"targets": [TARGETS[0], BEHIND]})
    assert refused.value.name == "TARGETS_UNREACHABLE"


@pytest.mark.parametrize("accepted", [True, False])
def test_check_refuses_it_with_accepted_kinematics_and_by_the_ranges_of_the_sampling_to_come(
    accepted: bool,
) -> None:
    job = CorrectedTargetsConfig.model_validate({"targets": [TARGETS[0], BEHIND]})
    (problem,) = checked(job, true_kinematics() if accepted else None)["problems"]
    assert "target 2: the controller's own model reaches it with joint 1" in problem


def test_check_warns_of_a_target_outside_what_was_sampled() -> None:
    job = CorrectedTargetsConfig.model_validate({"targets": TARGETS})
    assert checked(job, true_kinematics())["cautions"] == []
    narrow = [*ALLOWED[:3].tolist(), [-3.0, 0.0]]
    (caution,) = checked(job, true_kinematics() | {"joints_sampled_rad": narrow})["cautions"]
    assert "outside what the calibration sampled, joint 4 of target" in caution


def checked(job: CorrectedTargetsConfig, kinematics: dict[str, Any] | None) -> dict[str, Any]:
    """What ``cellward check`` says with these ``kinematics`` in effect, or none."""
    rows = [{"name": "kinematics.palletizer", "state": "committed", "value": kinematics}]
    sampling = SamplingToCome.model_validate({"joint_ranges_rad": ALLOWED.tolist()})
    setup = Setup(
        roles={"observed_arm": "palletizer", "tracker": "tracker"},
        devices={},
        values=RunValues({}, present(TRUTH.observed, "observed arm").robot),
        nominal={},
        jobs=[sampling],
        calibrations=lambda: rows if kinematics else [],
    )
    return targets_expectation(setup, job)


class SamplingToCome(CorrectedTargetsConfig):
    """The keys that tell a job that samples the observed arm."""

    targets: list[list[float]] = []  # noqa: RUF012
    arm: str = "observed_arm"
    joint_ranges_rad: list[list[float]]


@pytest.mark.parametrize("reflector", ["smr1", None])
def test_targets_outside_what_was_sampled_are_named_and_no_bare_pass(
    reflector: str | None, tmp_path: Path
) -> None:
    path = run_of(tmp_path, World.from_scenario(Scenario.load(SCENARIO)).truth(), reflector)
    path = path / "corrected-targets.json"
    whole, narrow = [[-2.4, 2.4], [0.8, 2.1], [-2.2, -0.6], [-3.0, 3.0]], [[-2.4, 2.4]] * 4
    narrow[1] = [0.8, 1.6]  # target 3 rests at 1.7
    inside, outside, unknown = (with_sampled(path, joints) for joints in (whole, narrow, None))
    assert (inside.verdict, inside.warnings) == ("pass", [])
    assert inside.uncertainty.error_95_m is not None
    for found, said in (
        (outside, "joint 2 of target 3 by 0.100 rad"),
        (unknown, "run tracker-sampling again"),
    ):
        assert found.verdict == "warn"
        (warning,) = found.warnings
        assert warning.code == "targets.outside-sampled"
        assert said in found.uncertainty.meaning
        assert (found.uncertainty.error_95_m is None) == (reflector is None)
    bounds = [present(t.after, "after").error_95_m is None for t in outside.result.targets]
    assert bounds == [False, False, reflector is None, False]


def with_sampled(path: Path, joints: list[list[float]] | None) -> Any:
    """The result of a run whose calibration sampled these."""
    data = json.loads(path.read_text("utf-8")) | {"joints_sampled_rad": joints}
    path.write_text(json.dumps(data), "utf-8")
    return solve_targets(path, None)
