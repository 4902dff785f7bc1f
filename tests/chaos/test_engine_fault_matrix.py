"""Device-level faults at every state of a capture, on virtual time; all pairs are in the long runs.

Whatever happens and whenever: the arm ends at rest, the run has one terminal entry that names the right
error, nothing is committed, and after the cause is gone and a reset the next run succeeds.
"""

from pathlib import Path

import pytest

from cell.procedure import Run
from fakes.object import run_virtual
from procedures.hand_eye.states import State
from tests.chaos.matrix import BRISK, Kind, assert_aborted, covering, inject_at, kind, put_right, short
from tests.kit.hand_eye_made import quick_solver
from tests.kit.object_cell import ObjectCell, no_report, open_cell, write_config

__all__ = ["no_report", "quick_solver"]
pytestmark = pytest.mark.usefixtures("no_report", "quick_solver")

PLAN = {
    "poses_per_placement": 3,
    "frames_per_pose": 1,
    "settle_s": 0.0,
    "seek_timeout_s": 2.0,
    "max_duration_s": 25.0,
    "accept": {"auto": True},
}
# When a fault comes. The prompt is where the job asks for a placement.
PROMPT = "prompt"
MOMENTS = [*(s.value for s in State if s is not State.SEARCH), PROMPT]
BEFORE = {"prepare", "place"}
LENT = {"start-pose", "seek", "plan", "move", "settle", "capture", "return"}
BETWEEN = {"refine", PROMPT}
BEFORE_THE_END = BEFORE | LENT | BETWEEN  # what is lost while it solves is not needed any more
EVERYWHERE = BEFORE_THE_END | {"solve"}
ON_THE_WAY_S = 0.15  # after the move began


IN_MOTION_ONLY = LENT
AT_THE_NEXT_LEASE = BEFORE | LENT | BETWEEN
KINDS = [
    kind("arm", "protective-stop", "ARM_PROTECTIVE_STOP", EVERYWHERE),
    kind("arm", "emergency-stop", "ARM_EMERGENCY_STOP", EVERYWHERE),
    kind("arm", "safeguard-stop", "ARM_SAFEGUARD_STOP", EVERYWHERE),
    # The mode of an arm that is not lent is the operator's business; the next lease asks for it.
    kind("arm", "local-mode", "ARM_LOCAL_MODE", AT_THE_NEXT_LEASE),
    short("arm", "drop", EVERYWHERE),
    short("arm", "silence", EVERYWHERE, duration_s=1.5),
    kind("arm", "refuse", "DEVICE_LOST", BEFORE_THE_END, duration_s=8.0),
    kind("arm", "silence", "DEVICE_LOST STALE_DATA", BEFORE_THE_END),
    kind("arm", "reboot", "ARM_REBOOTED DEVICE_LOST", EVERYWHERE),
    kind("arm", "script-death", "ARM_SCRIPT_DIED", IN_MOTION_ONLY),
    kind("arm", "child-crash", "CHILD_DIED", IN_MOTION_ONLY),
    short("arm", "watchdog", IN_MOTION_ONLY),
    kind("arm", "foreign-program", "ARM_PROGRAM_RUNNING", AT_THE_NEXT_LEASE),
    kind("arm", "register-in-use", "ARM_REGISTER_CONFLICT", AT_THE_NEXT_LEASE),
    kind("arm", "hang", "CALL_TIMEOUT", AT_THE_NEXT_LEASE),
    short("camera", "drop", EVERYWHERE),
    kind("camera", "silence", "DEVICE_LOST", BEFORE_THE_END),
    kind("camera", "freeze", "CAMERA_FAULT", AT_THE_NEXT_LEASE),
    # The operator who places the board anew brings it back.
    kind("camera", "lost-board", "CAPTURE_INCOMPLETE", BEFORE | LENT - {"return"}),
]


# Of the moments at which a fault is not felt, the first and the last stand for all.
ALL = [(k, m) for k in KINDS for m in MOMENTS if m in k.felt | k.bridged or m in ("prepare", "solve")]
SHARES = covering(KINDS, MOMENTS)
# Each kind once where it is felt, and once where it is not, if there is such a moment.
CELLS = [(k, m) for k, share in zip(KINDS, SHARES, strict=True) for m in share] + [
    next((k, m) for m in ("prepare", "solve") if m not in k.felt | k.bridged)
    for k in KINDS
    if not {"prepare", "solve"} <= k.felt | k.bridged
]


def at_prompt(run: Run) -> bool:
    return run.prompt is not None


def named(x: Kind | str) -> str:
    return x if isinstance(x, str) else x.label


def test_every_kind_strikes_and_every_state_is_struck() -> None:
    assert all(SHARES)
    assert {moment for share in SHARES for moment in share} == set(MOMENTS)


@pytest.mark.parametrize(("fault", "moment"), CELLS, ids=named)
def test_a_fault_ends_the_run_safely_and_the_next_one_succeeds(
    fault: Kind, moment: str, tmp_path: Path
) -> None:
    strike(fault, moment, tmp_path)


@pytest.mark.soak
@pytest.mark.parametrize(("fault", "moment"), ALL, ids=named)
def test_a_fault_at_any_state_ends_the_run_safely(fault: Kind, moment: str, tmp_path: Path) -> None:
    strike(fault, moment, tmp_path)


def strike(fault: Kind, moment: str, folder: Path) -> None:
    placements = 2 if moment in BETWEEN | {"return"} else 1
    config = write_config(folder, job={**PLAN, "placements": placements}, limits=BRISK)

    async def main() -> None:
        async with open_cell(config) as cell:
            inject_at(
                cell,
                fault,
                moment,
                ON_THE_WAY_S if moment == "move" else 0.0,
                at_prompt if moment == PROMPT else None,
            )
            end = await cell.run_job()
            await cell.clock.sleep(1.0)
            assert cell.at_rest()
            committed = [r["run_id"] for r in cell.ledger.results()]
            if moment in fault.felt:
                assert_aborted(end, fault, f"{fault.label} at {moment}")
                assert committed == []
            else:
                assert end["outcome"] == "complete", end["error"]
            check_stops(cell)
            await put_right(cell)
            second = await cell.run_job(params={"placements": "1"})
            assert second["outcome"] == "complete", second["error"]
            assert cell.at_rest()

    run_virtual(main())


def check_stops(cell: ObjectCell) -> None:
    """Every lease ended in a standstill that was measured, or began nothing, or motion is locked."""
    ends = len(cell.notes(1, "standstill")) + len(cell.notes(1, "nothing begun"))
    open_ends = len(cell.notes(1, "lease")) - ends
    assert open_ends == 0 or (open_ends == 1 and cell.engine.status()["latched"])
