"""Device-level faults at every state of a belt's calibration, on virtual time.

Whatever happens and whenever: the run ends by the right name with the arm at rest, and no scale is presented
as good that is not true. A run that a fault does not end holds the true scale in its interval, or fails and
says why. After the cause is gone and a reset the next run finds the truth.

Nothing is known here to be wrong with the camera's pose, so the intervals hold what the sightings show alone:
with its usual half a millimetre they would hide a slip.
"""

import asyncio
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from cell.procedure import Run
from fakes.object import run_virtual
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
from tests.kit.belt_teacher import Teacher
from tests.kit.object_cell import ObjectCell, no_report
from tests.kit.picking_cell import picking_cell, picking_config

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")
JOB = "belt-calibration"

MOMENTS = ["prepare", "watch", "standing", "solve"]
EVERYWHERE = set(MOMENTS)
NOT_AT_THE_END = EVERYWHERE - {"solve"}  # done before it counts as lost
ON_THE_WAY_S = 2.5  # items have been seen by then, and more will be

ENDS = [
    kind("belt", "unplug", "DEVICE_LOST", NOT_AT_THE_END),
    short("camera", "drop", EVERYWHERE),
    kind("belt", "silence", "DEVICE_LOST", NOT_AT_THE_END),
    kind("belt", "bus-off", "CAN_BUS_OFF", EVERYWHERE),
    kind("camera", "silence", "DEVICE_LOST", NOT_AT_THE_END),
    kind("belt", "node-stop", "ENCODER_NOT_OPERATIONAL", EVERYWHERE),
    kind("belt", "reboot", "DEVICE_LOST DEVICE_IDENTITY", EVERYWHERE, serial="999966002"),
    short("camera", "reboot", EVERYWHERE),
    short("belt", "reboot", EVERYWHERE),
    short("belt", "drop", EVERYWHERE),
]
BORNE = [
    kind("belt", "wrap", "", set(), before=20),
    kind("belt", "gap", "", set(), count=20),
    kind("belt", "slip", "", set(), m=0.005),
    kind("belt", "slip", "", set(), m=-0.005),
    kind("belt", "slip", "", set(), m=0.001),
    kind("belt", "slip", "", set(), m=-0.0006),
    kind("belt", "belt-stop", "", set(), for_s=3.0),
    kind("belt", "belt-reverse", "", set(), for_s=2.0),
    kind("belt", "stuck", "", set(), for_s=0.7),
    kind("belt", "freeze", "", set(), for_s=0.4),
    kind("camera", "silence", "", set(), duration_s=0.7),
    kind("camera", "freeze", "", set(), duration_s=1.5),
    kind("arm", "protective-stop", "", set()),  # the arm is not used
    kind("arm", "drop", "", set()),
]


ENDED, OUTLIVED = covering(ENDS, MOMENTS), covering(BORNE, MOMENTS)
ALL = in_cells([*ENDS, *BORNE], [MOMENTS] * (len(ENDS) + len(BORNE)), each=1)


def test_every_kind_strikes_and_every_state_is_struck() -> None:
    for shares in (ENDED, OUTLIVED):
        assert all(shares)
        assert {moment for share in shares for moment in share} == set(MOMENTS)


@pytest.mark.parametrize("strikes", in_cells(ENDS, ENDED, each=5))
def test_a_fault_ends_a_calibration_by_name_and_the_next_one_finds_the_truth(
    strikes: list[Strike], tmp_path: Path
) -> None:
    strike_calibrations(strikes, tmp_path)


@pytest.mark.parametrize("strikes", in_cells(BORNE, OUTLIVED, each=5))
def test_what_a_calibration_bears_never_makes_a_false_scale_look_good(
    strikes: list[Strike], tmp_path: Path
) -> None:
    strike_calibrations(strikes, tmp_path)


@pytest.mark.soak
@pytest.mark.parametrize("strikes", ALL)
def test_a_fault_at_any_state_of_a_calibration_leaves_no_false_scale(
    strikes: list[Strike], tmp_path: Path
) -> None:
    strike_calibrations(strikes, tmp_path)


PLAN = {
    "sightings": 60,
    "patience_s": 6.0,
    "max_duration_s": 90.0,
    "camera_turn_95_rad": 0,
    "distance_95_m": 0,
}
# a belt that stands now and then, so that every run comes by all states
FEED = {"profile": "[{ speed_m_s = 0.15, for_s = 3.0 }, { speed_m_s = 0.0, for_s = 1.8 }]\nrepeat = true"}


def strike_calibrations(strikes: list[Strike], folder: Path) -> None:
    config = picking_config(folder, world={**FEED, "m_per_count": "1.013e-4"}, sections={JOB: PLAN})

    async def main() -> None:
        async with picking_cell(config) as cell:
            cell.job = JOB
            for fault, moment in strikes:
                await strike(cell, fault, moment)
            run_id = await cell.start()
            end = await cell.finished(run_id)
            assert (end["outcome"], end["verdict"]) == ("complete", "pass"), end
            assert_true(cell, run_id, "the last run")

    run_virtual(main())


async def strike(cell: ObjectCell, fault: Kind, moment: str) -> None:
    struck = inject_at(cell, fault, moment, ON_THE_WAY_S if moment == "watch" else 0.0)
    run_id = await cell.start()
    await cell.finished(run_id)
    await judge(cell, run_id, fault, moment, struck)


async def judge(cell: ObjectCell, run_id: int, fault: Kind, moment: str, struck: list[str]) -> None:
    """How the run ended and what it proposed; then a person puts things right."""
    end, where = cell.end(run_id), f"{fault.label} at {moment}"
    assert struck, f"the job never was at {moment} for {where}: {end}"
    await cell.clock.sleep(0.5)
    assert cell.at_rest(), where
    if moment in fault.felt:
        assert_aborted(end, fault, where)
        assert not [row for row in cell.ledger.results() if row["run_id"] == run_id], "something was proposed"
    else:
        assert end["outcome"] == "complete", (where, end["error"])
        assert_true(cell, run_id, where)
    cell.plant.plants["belt"].serial = cell.plant.encoder.encoder.truth.serial
    await put_right(cell)


def assert_true(cell: ObjectCell, run_id: int, where: str) -> None:
    """The scale is within twice its 95 % interval, which no chance leaves; or the run failed and says why."""
    result, belt = cell.result(run_id), cell.plant.world.belt
    assert belt is not None
    if result["verdict"] == "fail":
        assert result["reasons"], where
        return
    found, half = result["result"]["m_per_count"], result["uncertainty"]["half_m_per_count"]
    same_way = float(np.dot(result["result"]["dir"], belt.direction))
    assert abs(same_way) > 0.9999, where
    assert abs(found - np.sign(same_way) * belt.truth.m_per_count) <= 2.0 * half, (where, found, half)
    told = {warning["code"] for warning in result["warnings"]}
    assert same_way > 0.0 or "belt.both-ways" in told, f"{where}: the belt was turned round"


# -- by touch: an operator jogs, and lets the belt run in between

TOUCH_MOMENTS = ["prepare", "touch 1", "touch 2", "touch 3", "solve"]
TOUCHING = {"touch 1", "touch 2", "touch 3"}
BEFORE_THE_END = {"prepare", *TOUCHING}
TOUCH_ENDS = [
    kind("belt", "silence", "DEVICE_LOST", BEFORE_THE_END),
    kind("arm", "silence", "STALE_DATA DEVICE_LOST DEVICE_NOT_READY", BEFORE_THE_END),
    kind("belt", "reboot", "DEVICE_LOST", BEFORE_THE_END),
    kind("belt", "bus-off", "CAN_BUS_OFF", {*BEFORE_THE_END, "solve"}),
    kind("belt", "drop", "DEVICE_LOST", BEFORE_THE_END),
    kind("belt", "wrap", "ENCODER_JUMP", {"touch 2", "touch 3"}, before=30000),  # by a jump, after a count
]
TOUCH_BORNE = [
    kind("arm", "protective-stop", "", set()),  # the arm is only read, and stands
    kind("belt", "slip", "", set(), m=0.005),
    kind("belt", "gap", "", set(), count=20),
    kind("camera", "drop", "", set()),
]
TOUCH_PLAN = {
    "source": "touch",
    "touches": 3,
    "touch_sigma_m": 0.0001,
    "max_duration_s": 90.0,
    "accept": {"max_scale_share": 0.005, "max_dir_rad": 0.005},
}


TOUCH_KINDS = [*TOUCH_ENDS, *TOUCH_BORNE]
ALL_TOUCHES = in_cells(TOUCH_KINDS, [TOUCH_MOMENTS] * len(TOUCH_KINDS), each=1)


@pytest.mark.parametrize(
    "strikes",
    [
        *in_cells(TOUCH_ENDS, covering(TOUCH_ENDS, TOUCH_MOMENTS), each=5),
        *in_cells(TOUCH_BORNE, covering(TOUCH_BORNE, TOUCH_MOMENTS), each=5),
    ],
)
def test_a_fault_while_a_mark_is_touched_leaves_no_false_scale(strikes: list[Strike], tmp_path: Path) -> None:
    strike_touches(strikes, tmp_path)


@pytest.mark.soak
@pytest.mark.parametrize("strikes", ALL_TOUCHES)
def test_a_fault_at_any_touch_leaves_no_false_scale(strikes: list[Strike], tmp_path: Path) -> None:
    strike_touches(strikes, tmp_path)


def strike_touches(strikes: list[Strike], folder: Path) -> None:
    config = picking_config(folder, world={"m_per_count": "1.013e-4"}, sections={JOB: TOUCH_PLAN})

    async def main() -> None:
        async with picking_cell(config) as cell:
            cell.job = JOB
            for fault, moment in strikes:
                at = partial(at_touch, int(moment.split()[1])) if moment in TOUCHING else None
                struck = inject_at(cell, fault, moment, here=at)
                await judge(cell, await touched(cell), fault, moment, struck)
            run_id = await touched(cell)
            assert cell.result(run_id)["verdict"] == "pass"
            assert_true(cell, run_id, "the last run")

    run_virtual(main())


def at_touch(number: int, run: Run) -> bool:
    return run.prompt is not None and [to.value for _, to in run.visited].count("touch") == number


async def touched(cell: ObjectCell) -> int:
    """A run with its operator, until it has ended."""
    teacher = Teacher(cell)

    async def teach() -> None:
        while True:
            await teacher.touch()

    run_id = await cell.start()
    operator = asyncio.create_task(teach())
    await cell.until(lambda: not cell.engine.active, "the end of the run", 120.0)
    operator.cancel()
    await asyncio.wait([operator])
    return run_id
