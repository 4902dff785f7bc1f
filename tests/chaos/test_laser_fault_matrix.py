"""Device-level faults at every state of the crossed-beam jobs, on virtual time.

Whatever happens and whenever: the arm ends at rest, the run has one terminal entry that names the right
error, no candidate stays open or takes effect, and after the cause is gone and a reset the next run succeeds.

A fault strikes run after run in one cell, each time at another state; that the next run gets as far as the
state it is struck in shows that the one before left nothing behind. Each kind of fault strikes at least once
and each state is struck at least once; all pairs are in the long runs. What is solved does not matter here,
what is committed does.
"""

from pathlib import Path

import pytest

from cell.calibrations import tool_calibration
from cell.procedure import Run
from fakes.object import run_virtual
from procedures.laser.update import State
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
from tests.kit.laser_cell import TOOL, laser_cell, laser_config
from tests.kit.laser_made import Solved, drawn_reference, solved
from tests.kit.object_cell import WHO, ObjectCell, no_report, on_disk

__all__ = ["no_report", "solved"]
pytestmark = pytest.mark.usefixtures("no_report")

# -- the states, and where a fault can be felt

SECOND = "second scan"  # at the first sweep with the candidate
MOMENTS = [*(s.value for s in State if s.value not in ("reject",)), SECOND]
BEFORE = {"prepare", "plan"}
LENT = {"approach", "sweep", "return", "descend", "bisect", "measure", "lift", "retract"}
BETWEEN = {"solve", "ask", "verify"}
AT_THE_NEXT_LEASE = BEFORE | LENT | BETWEEN | {SECOND}
EVERYWHERE = AT_THE_NEXT_LEASE | {"compare"}
IN_MOTION = LENT | {SECOND}
AT_THE_NEXT_SWEEP = BEFORE | LENT | BETWEEN | {SECOND}
ON_THE_WAY_S = 0.03

BEAM_ERRORS = (
    "LASER_BEAM_DARK LASER_BEAM_STUCK LASER_TOOL_NOT_FOUND LASER_TOOL_TOO_LONG LASER_RETURN_LOST LASER_EDGES"
)


KINDS = [
    kind("arm", "protective-stop", "ARM_PROTECTIVE_STOP", EVERYWHERE),
    kind("arm", "emergency-stop", "ARM_EMERGENCY_STOP", EVERYWHERE),
    kind("arm", "safeguard-stop", "ARM_SAFEGUARD_STOP", EVERYWHERE),
    kind("arm", "local-mode", "ARM_LOCAL_MODE", AT_THE_NEXT_LEASE),
    short("arm", "drop", EVERYWHERE),
    kind("arm", "silence", "DEVICE_LOST STALE_DATA", AT_THE_NEXT_LEASE),
    kind("arm", "reboot", "ARM_REBOOTED DEVICE_LOST", EVERYWHERE),
    kind("arm", "script-death", "ARM_SCRIPT_DIED", IN_MOTION),
    kind("arm", "child-crash", "CHILD_DIED", IN_MOTION),
    short("arm", "watchdog", IN_MOTION),
    kind("arm", "foreign-program", "ARM_PROGRAM_RUNNING", AT_THE_NEXT_LEASE),
    kind("arm", "register-in-use", "ARM_REGISTER_CONFLICT", AT_THE_NEXT_LEASE),
    # On the last way the next call is that of the stop ladder, which has a deadline and further steps.
    kind("arm", "hang", "CALL_TIMEOUT", AT_THE_NEXT_LEASE - {"retract"}),
    short("beams", "drop", EVERYWHERE),
    # Noticed after 0.1 s; a comparison takes no time here, and after it nothing is asked of the beams.
    kind("beams", "silence", "DEVICE_LOST STALE_DATA", AT_THE_NEXT_LEASE),
    short("beams", "reboot", EVERYWHERE),
    kind("beams", "stuck", BEAM_ERRORS, AT_THE_NEXT_SWEEP, level="on"),
    kind("beams", "stuck", BEAM_ERRORS, AT_THE_NEXT_SWEEP, level="off"),
]
SHARES = covering(KINDS, MOMENTS)
CELLS = in_cells(KINDS, SHARES, each=3)
ALL = in_cells(KINDS, [MOMENTS] * len(KINDS), each=1)
PLAN = {"z_resolution_m": 0.008, "retries": 0}


def test_every_kind_strikes_and_every_state_is_struck() -> None:
    assert all(SHARES)
    assert {moment for share in SHARES for moment in share} == set(MOMENTS)


@pytest.mark.parametrize("strikes", CELLS)
def test_a_fault_ends_an_update_safely_and_the_next_run_succeeds(
    strikes: list[Strike], tmp_path: Path, solved: Solved
) -> None:
    strike_updates(strikes, tmp_path, solved)


@pytest.mark.soak
@pytest.mark.parametrize("strikes", ALL)
def test_a_fault_at_any_state_ends_an_update_safely(
    strikes: list[Strike], tmp_path: Path, solved: Solved
) -> None:
    strike_updates(strikes, tmp_path, solved)


def strike_updates(strikes: list[Strike], folder: Path, solved: Solved) -> None:
    update = {"accept": {"auto": True}, "retract_pose": "home", "max_duration_s": 25.0}
    plan = {**PLAN, "z_resolution_m": 0.005} if "bisect" in {m for _, m in strikes} else PLAN
    config = laser_config(folder, reference=plan, update=update)

    async def main() -> None:
        async with laser_cell(config, "laser-update", drawn_reference(config)) as cell:
            for fault, moment in strikes:
                await strike(cell, fault, moment, solved)
            end = await cell.run_job(job="laser-check")
            assert end["outcome"] == "complete", end["error"]

    run_virtual(main())


async def strike(cell: ObjectCell, fault: Kind, moment: str, solved: Solved) -> None:
    before = {row["id"] for row in cell.ledger.results()}
    solved.verdict = "warn" if moment == "ask" else "pass"  # only what passes is accepted without asking
    struck = strike_at(cell, fault, moment)
    end = await cell.run_job()
    solved.verdict = "pass"
    assert struck, f"the job never was at {moment} for {fault.label}"
    await cell.clock.sleep(0.5)
    assert cell.at_rest()
    states = [row["state"] for row in cell.ledger.results() if row["id"] not in before]
    if moment == "commit":  # what is being written is written; the run may still end for the fault
        assert end["error"] is None or end["error"]["name"] in fault.errors
        assert states == ["committed"]
        on_disk(cell.ledger.rollback, tool_calibration(TOOL), WHO)
    elif moment in fault.felt:
        assert_aborted(end, fault, f"{fault.label} at {moment}")
        assert set(states) <= {"rejected"}
    else:
        assert end["outcome"] == "complete", (fault.label, moment, end["error"])
        assert states == ["committed"]
        on_disk(cell.ledger.rollback, tool_calibration(TOOL), WHO)
    await put_right(cell)


def strike_at(cell: ObjectCell, fault: Kind, moment: str) -> list[str]:
    def at_second_scan(run: Run) -> bool:
        second = any(to.value == "verify" for _, to in run.visited)
        return second and run.state is not None and run.state.value == "sweep"

    if moment == SECOND:
        return inject_at(cell, fault, moment, ON_THE_WAY_S, at_second_scan)
    return inject_at(cell, fault, moment, ON_THE_WAY_S if moment in LENT else 0.0)


# -- the other jobs share all states but those of the decision: a thin share of the faults shows that they do

THIN = [
    ("laser-reference", "descend", KINDS[0]),
    ("laser-reference", "measure", KINDS[15]),
    ("laser-reference", "solve", KINDS[4]),
    ("laser-check", "approach", KINDS[12]),
    ("laser-check", "return", KINDS[13]),
    ("laser-check", "lift", KINDS[9]),
]


@pytest.mark.parametrize(
    ("job", "moment", "fault"), THIN, ids=lambda x: x.label if isinstance(x, Kind) else x
)
def test_a_fault_ends_the_other_jobs_as_safely(
    job: str, moment: str, fault: Kind, tmp_path: Path, solved: Solved
) -> None:
    sections = {"retract_pose": "home", "max_duration_s": 25.0}
    config = laser_config(tmp_path, reference={**PLAN, **sections}, check=sections)

    async def main() -> None:
        async with laser_cell(config, job, drawn_reference(config)) as cell:
            struck = strike_at(cell, fault, moment)
            end = await cell.run_job()
            assert struck
            await cell.clock.sleep(0.5)
            assert cell.at_rest()
            if moment in fault.bridged:
                assert end["outcome"] == "complete", end["error"]
                return
            assert_aborted(end, fault, f"{fault.label} at {moment}")
            assert cell.ledger.results(limit=1)[0]["run_id"] == 0, "nothing was proposed"
            await put_right(cell)
            assert (await cell.run_job())["outcome"] == "complete"

    run_virtual(main())
