"""A gripper's own time beside the timeout of a job, as ``check`` sees it."""

from dataclasses import replace
from pathlib import Path

import pytest

from daemon.predictions import setup_of
from drivers.ur.gripper import ArmGripperConfig
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.expectation import belt_expectation
from procedures.setup import Setup
from tests.kit.picking_cell import JOB, picking_config


def cell(folder: Path, moves_s: float | None, confirm: int | None = None) -> tuple[Setup, BeltTrackingConfig]:
    """A cell whose gripper says how long it moves; the job waits for it for 1 s."""
    config = picking_config(folder, {"grip_timeout_s": 1.0})
    setup = setup_of(config)
    section = ArmGripperConfig(output=0, moves_s=moves_s, confirm=confirm if moves_s is not None else 0)
    return (
        replace(setup, devices={**setup.devices, setup.roles["gripper"]: section}),
        BeltTrackingConfig.model_validate(config.job[JOB]),
    )


@pytest.mark.parametrize(
    ("moves_s", "confirm", "problem", "caution"),
    [
        (None, None, "", ""),
        (0.5, None, "", ""),
        (0.9, None, "", "that leaves little more"),
        (1.2, None, "the gripper refuses to move", ""),
        (1.2, 3, "", "every grip would count as failed"),
    ],
)
def test_a_timeout_that_the_gripper_does_not_keep_is_found_before_the_run(
    tmp_path: Path, moves_s: float | None, confirm: int | None, problem: str, caution: str
) -> None:
    found = belt_expectation(*cell(tmp_path, moves_s, confirm))
    for told, word in ((found["problems"], problem), (found["cautions"], caution)):
        about = [text for text in told if "moves_s" in text]
        assert len(about) == bool(word)
        assert all(
            text.startswith("grip_timeout_s = 1 s, and [device.gripper] moves_s is") and word in text
            for text in about
        )


def test_a_gripper_that_nothing_confirms_is_told_to_count_empty_grips(tmp_path: Path) -> None:
    for moves_s, confirm, told in ((0.5, None, 1), (0.5, 3, 0), (None, None, 0)):
        found = belt_expectation(*cell(tmp_path, moves_s, confirm))
        about = [text for text in found["cautions"] if text.startswith("[device.gripper] has no confirm")]
        assert len(about) == told


def test_the_cycle_is_told_with_the_grippers_own_time(tmp_path: Path) -> None:
    unknown, slow = (belt_expectation(*cell(tmp_path, moves_s)) for moves_s in (None, 0.6))
    assert "a third of grip_timeout_s for each motion" in unknown["text"]
    assert "with 0.6 s (moves_s) for each motion" in slow["text"]
    assert slow["zone"]["grip_s"] == pytest.approx(0.6)
    for before, after in zip(unknown["speeds"], slow["speeds"], strict=True):
        # At the item and at the place 0.6 s in place of a third of 1 s; the item goes on meanwhile.
        assert after["cycle_s"][0] - before["cycle_s"][0] == pytest.approx(2 * (0.6 - 1.0 / 3.0), rel=0.3)
