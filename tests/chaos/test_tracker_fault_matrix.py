"""Device-level faults at every state of a tracker sampling, on virtual time.

Whatever happens and whenever: the arm ends at rest, the run has one terminal entry that names the right
error, no finished pose is lost, nothing takes effect, and after the cause is gone and a reset the next run
succeeds. Each kind of fault strikes at least once and each state is struck at least once; all pairs are in
the long runs. What breaks a beam has tests of its own: it does not end a job.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from cell.calibrations import kinematics
from fakes.object import run_virtual
from procedures.tracker.record import SampleRecord
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
from tests.kit.object_cell import WHO, ObjectCell, no_report, on_disk, open_cell
from tests.kit.tracker_cell import JOB, tracker_config

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

SMALL = {
    "poses": 10,
    "held_out_share": 0.0,
    "monument_every": 5,
    "accept": {"max_error_m": 0.1, "auto": True},
}
ALWAYS = {"prepare", "plan", "locate", "monuments", "next", "settle", "measure", "solve"}
MOMENTS = {"tracker": [*sorted(ALWAYS), "move"], "palletizer": [*sorted(ALWAYS), "request"]}
LENT = {"locate", "monuments", "next", "settle", "measure", "move"}
IN_MOTION = {"move"}
AT_THE_NEXT_LEASE = {"prepare", "plan", "locate", "monuments"}
NOT_AT_THE_END = ALWAYS - {"solve"} | {"move", "request"}
EVERYWHERE = ALWAYS | {"move", "request"}
ON_THE_WAY_S = 0.05


MOVED = [
    kind("arm", "protective-stop", "ARM_PROTECTIVE_STOP", EVERYWHERE),
    kind("arm", "emergency-stop", "ARM_EMERGENCY_STOP", EVERYWHERE),
    short("arm", "drop", EVERYWHERE),
    kind("arm", "silence", "DEVICE_LOST STALE_DATA", NOT_AT_THE_END),
    kind("arm", "reboot", "ARM_REBOOTED DEVICE_LOST", EVERYWHERE),
    kind("arm", "child-crash", "CHILD_DIED", IN_MOTION),
    short("arm", "watchdog", IN_MOTION),
    kind("arm", "local-mode", "ARM_LOCAL_MODE", AT_THE_NEXT_LEASE | {"move"}),
    kind("arm", "foreign-program", "ARM_PROGRAM_RUNNING", AT_THE_NEXT_LEASE),
    short("tracker", "drop", EVERYWHERE),
    kind("tracker", "silence", "DEVICE_LOST STALE_DATA TRACKER_UNSTABLE", NOT_AT_THE_END),
    short("tracker", "reboot", EVERYWHERE),
]
READ = [
    short("palletizer", "drop", EVERYWHERE),
    kind("palletizer", "silence", "DEVICE_LOST STALE_DATA", NOT_AT_THE_END),
    short("palletizer", "reboot", EVERYWHERE),
    short("tracker", "drop", EVERYWHERE),
]
# What reads an arm that moves itself passes the same states but one.
SHARES = {
    "tracker": covering(MOVED, MOMENTS["tracker"]),
    "palletizer": covering(READ, MOMENTS["palletizer"], needed=["request"]),
}


def cells(scenario: str, kinds: Sequence[Kind], each: int) -> list[Any]:
    return [
        pytest.param(scenario, *param.values, id=param.id)
        for param in in_cells(kinds, SHARES[scenario], each)
    ]


CELLS = [*cells("tracker", MOVED, 3), *cells("palletizer", READ, 4)]
ALL = [
    pytest.param(scenario, [(k, m) for m in MOMENTS[scenario]], id=f"{scenario}: {k.label}")
    for scenario, kinds in (("tracker", MOVED), ("palletizer", READ))
    for k in kinds
]


def test_every_kind_strikes_and_every_state_is_struck() -> None:
    assert all(share for shares in SHARES.values() for share in shares)
    met = {moment for shares in SHARES.values() for share in shares for moment in share}
    assert met == {moment for moments in MOMENTS.values() for moment in moments}


@pytest.mark.parametrize(("scenario", "strikes"), CELLS)
def test_a_fault_ends_a_sampling_safely_and_the_next_run_succeeds(
    scenario: str, strikes: list[Strike], tmp_path: Path
) -> None:
    strike_all(scenario, strikes, tmp_path)


@pytest.mark.soak
@pytest.mark.parametrize(("scenario", "strikes"), ALL)
def test_a_fault_at_any_state_ends_a_sampling_safely(
    scenario: str, strikes: list[Strike], tmp_path: Path
) -> None:
    strike_all(scenario, strikes, tmp_path)


def strike_all(scenario: str, strikes: list[Strike], folder: Path) -> None:
    config = tracker_config(folder, SMALL, scenario=f"{scenario}:ideal")

    async def main() -> None:
        async with open_cell(config, job=JOB) as cell:
            for fault, moment in strikes:
                await strike(cell, fault, moment)
            end = await cell.run_job()
            assert end["outcome"] == "complete", end["error"]

    run_virtual(main())


async def strike(cell: ObjectCell, fault: Kind, moment: str) -> None:
    struck = inject_at(cell, fault, moment, ON_THE_WAY_S if moment in ("move", "measure", "request") else 0.0)
    begun = len(cell.ledger.results())
    run_id = await cell.start()
    end = await cell.finished(run_id)
    assert struck, f"the job never was at {moment} for {fault.label}"
    await cell.clock.sleep(0.5)
    assert cell.at_rest()
    if moment in fault.felt:
        assert_aborted(end, fault, f"{fault.label} at {moment}")
        assert len(cell.ledger.results()) == begun, "nothing was proposed"
        assert len(SampleRecord.read(cell.folder(run_id).path).samples) == len(
            cell.notes(run_id, "pose taken")
        )
    else:
        assert end["outcome"] in ("complete", "aborted")
        assert end["error"] is None or end["error"]["name"] in fault.errors, (
            fault.label,
            moment,
            end["error"],
        )
    for row in cell.ledger.results(kinematics("arm")):
        if row["state"] == "committed":
            on_disk(cell.ledger.rollback, kinematics("arm"), WHO)
    await put_right(cell)
