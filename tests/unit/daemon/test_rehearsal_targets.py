"""``cellward rehearse`` of an arm that its own program or a person moves, and of targets for it."""

import json
from pathlib import Path

import pytest

from cell.errors import CellError, present
from daemon.config import load_config
from daemon.rehearsal.objects import rehearsed_cell
from daemon.rehearsal.play import rehearse
from fakes.world.scenario import Scenario
from tests.kit.example_cell import palletizer_example

ARM = 'arm = "observed_arm"\npayload_kg'
PROGRAM = {
    "allow_requests = false ": (
        "handshake = { targets = [20, 22, 24, 26], number = 30, reached = 40 }\nallow_requests = true "
    )
}


def test_targets_are_rehearsed_behind_a_sampling_and_judged_by_where_the_arm_went(tmp_path: Path) -> None:
    path = palletizer_example(tmp_path, PROGRAM)
    outcome = rehearse(load_config(path), path, "corrected-targets", 1, tmp_path)
    assert (outcome.ended, outcome.good) == ("complete", True), outcome
    assert outcome.off
    assert outcome.of95
    assert outcome.inside95 is not None


@pytest.mark.parametrize(("program", "reaction_s"), [(PROGRAM, 1.0), ({}, 20.0)])
def test_the_arm_of_a_twin_is_off_by_its_seed_and_waits_for_a_person_where_no_program_takes_requests(
    program: dict[str, str], reaction_s: float, tmp_path: Path
) -> None:
    path, drawn = palletizer_example(tmp_path, program), []
    for seed in (1, 2):
        rehearsed_cell(load_config(path), path, "corrected-targets", seed, tmp_path)
        drawn.append(present(Scenario.load(tmp_path / "scenario.toml").world.observed, "observed arm"))
    first, second = drawn
    assert first.parameters == second.parameters
    assert first.error.a2 != second.error.a2
    assert first.joint_errors.sag_rad != second.joint_errors.sag_rad
    assert first.reaction_s == reaction_s


@pytest.mark.parametrize(
    ("replaced", "family", "words"),
    [
        (
            {'arm = "observed_arm"\n': ""},
            "palletizer4",
            r"\[job.tracker-sampling\] has sampled, and that has arm",
        ),
        ({}, "serial", "of family 'serial', and a twin of an arm that is only read is a palletizer4"),
        ({"observed_model": "# observed_model"}, "palletizer4", "observed_model is missing"),
        ({'targets]\nreflector = "smr1"': "targets]"}, "palletizer4", "without a reflector no tracker looks"),
    ],
)
def test_what_a_rehearsal_of_targets_lacks_is_said(
    replaced: dict[str, str], family: str, words: str, tmp_path: Path
) -> None:
    path = palletizer_example(tmp_path, replaced)
    if family == "serial":
        links = [{"d": 1.0}, *[{"a": 0.5, "alpha": 0.1}] * 3]
        robot = {"family": "serial", "links": links}
        (tmp_path / "palletizer.json").write_text(json.dumps(robot), "utf-8")
    with pytest.raises(CellError, match=words):
        rehearsed_cell(load_config(path), path, "corrected-targets", 1, tmp_path)
