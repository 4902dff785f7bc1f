"""Device-level faults at every state of the test of accuracy and repeatability, on virtual time.

Whatever happens and whenever: the arm ends at rest, the run has one terminal entry that names the right
error, what was measured by then is on disk, and after the cause is gone and a reset the next run succeeds.
"""

from pathlib import Path

import pytest

from fakes.object import run_virtual
from procedures.iso9283.states import State
from tests.chaos.matrix import (
    Kind,
    Strike,
    assert_aborted,
    covering,
    in_cells,
    inject_at,
    kind,
    put_right,
    short,
)
from tests.kit.object_cell import ObjectCell, no_report, open_cell
from tests.unit.procedures.test_iso9283_job import JOB, iso_config

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

MOMENTS = [s.value for s in State if s is not State.REACQUIRE]  # which only a lost beam leads to
EVERYWHERE = set(MOMENTS)
LENT = {"next", "move", "settle", "measure"}
BEFORE_THE_LEASE = {"prepare", "plan"}
AT_THE_NEXT_LEASE = BEFORE_THE_LEASE | LENT
ON_THE_WAY_S = 0.03
LOST = "TRACKER_NO_TARGET TRACKER_BEAM_BROKEN"
KINDS = [
    kind("arm", "protective-stop", "ARM_PROTECTIVE_STOP", EVERYWHERE),
    kind("arm", "emergency-stop", "ARM_EMERGENCY_STOP", EVERYWHERE),
    kind("arm", "local-mode", "ARM_LOCAL_MODE", AT_THE_NEXT_LEASE),
    short("arm", "drop", EVERYWHERE),
    kind("arm", "silence", "DEVICE_LOST STALE_DATA", EVERYWHERE),
    kind("arm", "reboot", "ARM_REBOOTED DEVICE_LOST", EVERYWHERE),
    kind("arm", "script-death", "ARM_SCRIPT_DIED", LENT),
    kind("arm", "child-crash", "CHILD_DIED", LENT),
    kind("arm", "foreign-program", "ARM_PROGRAM_RUNNING", AT_THE_NEXT_LEASE),
    short("tracker", "drop", EVERYWHERE),
    kind("tracker", "silence", "DEVICE_LOST STALE_DATA", EVERYWHERE - {"solve"}),  # told after a second
    short("tracker", "reboot", EVERYWHERE),
    kind("tracker", "out-of-view", LOST, AT_THE_NEXT_LEASE, reflector="smr1"),
    kind("tracker", "beam-break", LOST, AT_THE_NEXT_LEASE, for_s=600.0),
    kind("tracker", "vibration", "TRACKER_UNSTABLE", AT_THE_NEXT_LEASE, m=0.002, hz=7.0),
]
SHARES = covering(KINDS, MOMENTS)  # all pairs: in the long runs


def test_every_kind_strikes_and_every_state_is_struck() -> None:
    assert all(SHARES)
    assert {moment for share in SHARES for moment in share} == set(MOMENTS)


@pytest.mark.parametrize("strikes", in_cells(KINDS, SHARES, each=5))
def test_a_fault_ends_the_test_safely_and_the_next_run_succeeds(
    strikes: list[Strike], tmp_path: Path
) -> None:
    strike_runs(strikes, tmp_path)


@pytest.mark.soak
@pytest.mark.parametrize("strikes", in_cells(KINDS, [MOMENTS] * len(KINDS), each=1))
def test_a_fault_at_any_state_ends_the_test_safely(strikes: list[Strike], tmp_path: Path) -> None:
    strike_runs(strikes, tmp_path)


def strike_runs(strikes: list[Strike], folder: Path) -> None:
    quick = {"cycles": 2, "retries_per_pose": 0, "find_timeout_s": 0.5, "measure_timeout_s": 1.0}
    config = iso_config(folder, quick)

    async def main() -> None:
        async with open_cell(config, job=JOB) as cell:
            for fault, moment in strikes:
                await strike(cell, fault, moment)
            end = await cell.run_job()
            assert end["outcome"] == "complete", end["error"]

    run_virtual(main())


async def strike(cell: ObjectCell, fault: Kind, moment: str) -> None:
    struck = inject_at(cell, fault, moment, ON_THE_WAY_S if moment in LENT - {"next"} else 0.0)
    run_id = await cell.start()
    end = await cell.finished(run_id)
    assert struck, f"the job never was at {moment} for {fault.label}"
    await cell.clock.sleep(0.5)
    assert cell.at_rest()
    if moment in fault.felt:
        assert_aborted(end, fault, f"{fault.label} at {moment}")
    else:
        assert end["outcome"] == "complete", (fault.label, moment, end["error"])
    await put_right(cell)
