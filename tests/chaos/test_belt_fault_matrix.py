"""Device-level faults at every state of picking and of the belt's calibration, on virtual time.

Whatever happens and whenever: the run ends by the right name with the arm at rest, nothing is picked twice,
and what journal, ledger and registers count is what the world's gripper truly did. After the cause is gone
and a reset the next run picks.

Each kind of fault strikes at least once and each state is struck at least once; all pairs are in the long
runs.
"""

from pathlib import Path

import pytest

from fakes.object import run_virtual
from procedures.belt.states import MOVING, PickState
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
from tests.kit.object_cell import ObjectCell, no_report
from tests.kit.picking_cell import picking_cell, picking_config
from tests.kit.picking_truth import agrees_with_the_world, counted, truth_of

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

# -- the states, and where a fault can be felt

# Of waiting at a place, which this cell never does, test_belt_place_clear has silences.
ELSEWHERE = (PickState.REPORT, PickState.STANDING, PickState.WAIT_PLACE)
MOMENTS = [s.value for s in PickState if s not in ELSEWHERE]
AT_REST = {"prepare", "ready"}
IN_MOTION = {s.value for s in MOVING} | {"to-wait"}
EVERYWHERE = AT_REST | IN_MOTION
WITH_LEASE = EVERYWHERE - {"prepare"}
ON_THE_WAY_S = 0.03


KINDS = [
    kind("arm", "protective-stop", "ARM_PROTECTIVE_STOP", EVERYWHERE),
    kind("belt", "unplug", "DEVICE_LOST", EVERYWHERE),
    short("camera", "drop", EVERYWHERE),
    kind("arm", "emergency-stop", "ARM_EMERGENCY_STOP", EVERYWHERE),
    kind("belt", "bus-off", "CAN_BUS_OFF", EVERYWHERE),
    kind("camera", "silence", "DEVICE_LOST", EVERYWHERE),
    kind("arm", "safeguard-stop", "ARM_SAFEGUARD_STOP", EVERYWHERE),
    kind("belt", "node-stop", "ENCODER_NOT_OPERATIONAL", EVERYWHERE),
    short("arm", "drop", EVERYWHERE),
    kind("belt", "reboot", "DEVICE_LOST DEVICE_IDENTITY", EVERYWHERE, serial="999966002"),
    kind("arm", "silence", "DEVICE_LOST STALE_DATA MOTION_WATCHDOG", EVERYWHERE),
    short("camera", "reboot", EVERYWHERE),
    kind("arm", "script-death", "ARM_SCRIPT_DIED", WITH_LEASE),
    kind("arm", "child-crash", "CHILD_DIED", WITH_LEASE),
    short("arm", "watchdog", IN_MOTION),
    short("belt", "drop", EVERYWHERE),  # where items lie is not known any more, and they count as lost
]
BORNE = [  # the job goes on
    kind("belt", "wrap", "", set(), before=20),
    kind("belt", "slip", "", set(), m=0.005),
    kind("belt", "belt-stop", "", set(), for_s=3.0),
    kind("belt", "reboot", "", set(), boot_s=0.1),
    kind("belt", "slip", "", set(), m=-0.005),
    kind("belt", "gap", "", set(), count=20),
    kind("belt", "belt-reverse", "", set(), for_s=2.0),
    kind("camera", "silence", "", set(), duration_s=0.7),
]


SHARES = covering([*KINDS, *BORNE], MOMENTS)
ENDED, OUTLIVED = SHARES[: len(KINDS)], SHARES[len(KINDS) :]
ALL = in_cells([*KINDS, *BORNE], [MOMENTS] * (len(KINDS) + len(BORNE)), each=1)


def test_every_kind_strikes_and_every_state_is_struck() -> None:
    assert all(SHARES)
    assert {moment for share in SHARES for moment in share} == set(MOMENTS)


@pytest.mark.parametrize("strikes", in_cells(KINDS, ENDED, each=4))
def test_a_fault_ends_picking_at_rest_with_true_counters_and_the_next_run_picks(
    strikes: list[Strike], tmp_path: Path
) -> None:
    strike_picking(strikes, tmp_path)


@pytest.mark.parametrize("strikes", in_cells(BORNE, OUTLIVED, each=4))
def test_what_a_job_bears_leaves_its_counters_true(strikes: list[Strike], tmp_path: Path) -> None:
    strike_picking(strikes, tmp_path)


@pytest.mark.soak
@pytest.mark.parametrize("strikes", ALL)
def test_a_fault_at_any_state_ends_picking_at_rest(strikes: list[Strike], tmp_path: Path) -> None:
    strike_picking(strikes, tmp_path)


# so far apart that the arm waits for the next one
FEED = {"spacing_m": "0.8", "profile": "[{ speed_m_s = 0.25 }]"}


def strike_picking(strikes: list[Strike], folder: Path) -> None:
    config = picking_config(folder, {"picks": 1, "max_duration_s": 60.0}, FEED)

    async def main() -> None:
        async with picking_cell(config) as cell:
            for fault, moment in strikes:
                await strike(cell, fault, moment)
            run_id = await cell.start()
            end = await cell.finished(run_id)
            assert end["outcome"] == "complete", end["error"]
            assert counted(cell, run_id)["picked"] == 1

    run_virtual(main())


async def strike(cell: ObjectCell, fault: Kind, moment: str) -> None:
    before, struck = (
        truth_of(cell),
        inject_at(cell, fault, moment, ON_THE_WAY_S if moment in IN_MOTION else 0.0),
    )
    # Over its first item the arm does not wait.
    run_id = await cell.start(params={"picks": "2"} if moment == "wait" else {})
    end = await cell.finished(run_id)
    where = f"{fault.label} at {moment}"
    assert struck, f"the job never was at {moment} for {where}: {end}"
    await cell.clock.sleep(0.5)
    assert cell.at_rest(), where
    if moment in fault.felt:
        assert_aborted(end, fault, where)
    else:
        assert end["outcome"] == "complete", (where, end["error"])
    agrees_with_the_world(cell, run_id, before, where)
    await start_afresh(cell)


async def start_afresh(cell: ObjectCell) -> None:
    """What a person does, who also takes the part out of the gripper."""
    cell.plant.plants["belt"].serial = cell.plant.encoder.encoder.truth.serial
    gripper = cell.plant.world.gripper
    assert gripper is not None
    gripper.command(cell.clock.now(), False)
    await put_right(cell)
