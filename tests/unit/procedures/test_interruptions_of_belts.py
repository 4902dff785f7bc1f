"""Short silences beside a moving belt: counters stay true, no item is picked twice, scales stay right."""

from pathlib import Path

import pytest

from cell.errors import error
from fakes.object import run_virtual
from procedures.belt.motion.picker import Picker
from procedures.belt.motion.putting_down import Put, PuttingDown
from tests.kit.interrupted import Struck, run_struck, silence_at
from tests.kit.object_cell import no_report
from tests.kit.picking_cell import picking_cell, picking_config
from tests.kit.picking_truth import agrees_with_the_world, counted

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

SHORT, LONGER = 0.3, 1.5
FEED = {"spacing_m": "0.8", "profile": "[{ speed_m_s = 0.25 }]"}  # so far apart that the arm waits


@pytest.mark.parametrize(
    ("device", "moment", "duration_s"),
    [
        ("arm", "grip", SHORT),
        ("arm", "lift", LONGER),
        ("arm", "approach", SHORT),
        ("camera", "place", LONGER),
        ("belt", "wait", SHORT),
    ],
)
def test_a_silence_while_picking_leaves_the_counters_true(
    device: str, moment: str, duration_s: float, tmp_path: Path
) -> None:
    config = picking_config(tmp_path, {"picks": 2, "max_duration_s": 60.0}, FEED)

    async def main() -> None:
        async with picking_cell(config) as cell:
            subject = Struck(cell)
            silence_at(subject, device, moment, duration_s)
            await run_struck(subject)
            assert subject.at == [moment]
            subject.tells_the_same_everywhere()
            assert counted(cell, 1)["picked"] == 2
            agrees_with_the_world(cell, 1)
            gripper = cell.plant.world.gripper
            assert gripper is not None
            assert gripper.holds(cell.clock.now()) is None, "it was put down"
            if device == "arm":
                assert subject.taken_again
            if moment in ("grip", "lift", "place"):
                assert counted(cell, 1)["lost"] == 0, "what was in the gripper was put down at the place"

    run_virtual(main())


@pytest.mark.parametrize(("late_s", "times"), [(0.06, 0), (0.15, 1), (0.17, 1), (0.19, 1), (0.25, 1)])
@pytest.mark.parametrize("moment", ["approach", "place"])
def test_set_points_that_are_late_by_more_than_the_arm_has_cost_a_step(
    moment: str, late_s: float, times: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Joined to where the arm was sent before, they would turn its joints faster than it may."""
    config = picking_config(tmp_path, {"picks": 1, "max_duration_s": 60.0}, FEED)
    learn, states = Picker._learn, list[str]()

    async def slow(picker: Picker) -> None:
        states.append(str(picker._run.state))
        if states.count(moment) == 6 and states[-1] == moment:
            await picker._run.clock.sleep(late_s)
        await learn(picker)

    monkeypatch.setattr(Picker, "_learn", slow)

    async def main() -> None:
        async with picking_cell(config) as cell:
            subject = Struck(cell)
            await run_struck(subject)
            assert len(subject.taken_again) == times, subject.taken_again
            assert counted(cell, 1)["picked"] == 1
            agrees_with_the_world(cell, 1)

    run_virtual(main())


def test_an_item_that_was_let_go_at_the_place_is_picked_though_nobody_saw_the_fingers_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    config = picking_config(tmp_path, {"picks": 2, "max_duration_s": 60.0}, FEED)
    release, times = PuttingDown._release, list[float]()

    def paused(putting: PuttingDown, t: float) -> Put:
        times.append(t)
        if len(times) == 1:
            raise error("MOTION_WATCHDOG", "a pause")
        return release(putting, t)

    monkeypatch.setattr(PuttingDown, "_release", paused)

    async def main() -> None:
        async with picking_cell(config) as cell:
            subject = Struck(cell)
            await run_struck(subject)
            assert len(subject.taken_again) == 1
            assert counted(cell, 1)["lost"] == 0
            assert counted(cell, 1)["picked"] == 2
            agrees_with_the_world(cell, 1)

    run_virtual(main())


@pytest.mark.parametrize("moment", ["prepare", "watch"])
def test_a_camera_that_is_silent_costs_a_calibration_of_the_belt_nothing_but_time(
    moment: str, tmp_path: Path
) -> None:
    plan = {"sightings": 60, "patience_s": 6.0, "max_duration_s": 90.0}
    config = picking_config(tmp_path, world={"m_per_count": "1.013e-4"}, sections={"belt-calibration": plan})

    async def main() -> None:
        async with picking_cell(config) as cell:
            cell.job = "belt-calibration"
            subject = Struck(cell)
            silence_at(subject, "camera", moment, LONGER, 0.0 if moment == "prepare" else 2.5)
            await run_struck(subject)
            subject.tells_the_same_everywhere()
            found, belt = cell.result(1), cell.plant.world.belt
            assert belt is not None
            off = abs(found["result"]["m_per_count"]) - abs(belt.truth.m_per_count)
            assert abs(off) <= 2.0 * found["uncertainty"]["half_m_per_count"]

    run_virtual(main())
