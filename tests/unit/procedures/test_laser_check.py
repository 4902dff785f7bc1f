"""A check measures and proposes nothing: where its passes lie, and which reference it refuses."""

import asyncio
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.calibrations import time_offset
from fakes.object import run_virtual
from procedures.laser.config import Search
from tests.kit.laser_cell import (
    TOOL,
    laser_cell,
    laser_config,
    passes,
    states_of_results,
)
from tests.kit.laser_made import Solved, drawn_reference, solved
from tests.kit.laser_runs import asked, replayed
from tests.kit.object_cell import WHO, ObjectCell, no_report, on_disk, refused

__all__ = ["no_report", "solved"]

pytestmark = pytest.mark.usefixtures("no_report")


POLL_S = 0.01


def true_tip(cell: ObjectCell) -> Any:
    """(3,) m: the tool's point in the base, as it truly is."""
    world, now = cell.plant.world, cell.clock.now()
    return (world.true_flange(now) * world.T_flange_tool_at(now)).translation


def test_passes_are_late_by_what_the_reference_was_whatever_delay_was_found_since(
    tmp_path: Path, solved: Solved
) -> None:
    config = laser_config(tmp_path)

    async def main() -> None:
        async with laser_cell(config, "laser-check", drawn_reference(config)) as cell:
            await cell.run_job()
            offset = cell.ledger.propose(time_offset("beams"), 0.004, {"verdict": "pass"}, 0, 0.0)
            on_disk(cell.ledger.accept, offset, WHO)
            await cell.run_job()
            polls = [np.array(passes(cell, run_id)[0]["poll_t"]) for run_id in (1, 2)]
            first, second = (np.angle(np.exp(2j * np.pi * t / POLL_S)) for t in polls)  # within a period
            turned = np.abs(np.angle(np.exp(1j * (second[0] - first[0]))))
            assert turned < 0.01, "the polls' stamps moved"

    run_virtual(main())


def test_a_floor_that_was_raised_since_the_reference_holds(tmp_path: Path) -> None:
    config = laser_config(tmp_path)
    reference = drawn_reference(config)
    low = Search.from_reference(reference, None)
    assert Search.from_reference(reference, low.floor_m + 0.02).floor_m == low.floor_m + 0.02
    assert Search.from_reference(reference, low.floor_m - 0.02).floor_m == low.floor_m


def test_a_tool_left_between_the_sensors_goes_straight_up_first(tmp_path: Path, solved: Solved) -> None:
    config = laser_config(tmp_path)

    async def main() -> None:
        async with laser_cell(config, "laser-check", drawn_reference(config)) as cell:
            run_id = await cell.start()
            await cell.until_state("measure")
            await cell.until_state("return")
            await cell.engine.abort(WHO)
            await cell.finished(run_id)
            left = true_tip(cell)
            second = await cell.start()
            await cell.until(lambda: cell.notes(second, "move_linear"), "the first move", 30.0)
            way = [left]

            def goes_on() -> bool:
                if cell.notes(second, "move_joints"):
                    return True
                way.append(true_tip(cell))
                return False

            await cell.until(goes_on, "the second move", 30.0)
            up = way[-1] - left
            assert up[2] > 0.005
            assert float(np.linalg.norm(up[:2])) < 1e-4
            assert cell.notes(second, "lifted first")
            await cell.finished(second)

    run_virtual(main())


def test_a_check_measures_and_proposes_nothing(tmp_path: Path, solved: Solved) -> None:
    config = laser_config(tmp_path)

    async def main() -> None:
        async with laser_cell(config, "laser-check", drawn_reference(config)) as cell:
            end = await cell.run_job()
            assert (end["outcome"], end["verdict"]) == ("complete", "fail")
            assert states_of_results(cell) == []
            assert replayed(cell, 1) == []
            trend = cell.result(1)["inputs"]["trend"]
            assert [value for _, value in trend[f"tool.offset_y_m.{TOOL}"]] == [-0.0007]

    run_virtual(main())


def test_a_pause_holds_between_two_ways_and_a_resume_goes_on(tmp_path: Path, solved: Solved) -> None:
    config = laser_config(tmp_path)

    async def main() -> None:
        async with laser_cell(config, "laser-check", drawn_reference(config)) as cell:
            run_id = await cell.start()
            await cell.until_state("return")
            await cell.engine.pause(WHO)
            await cell.until(lambda: cell.engine.status()["packml"] == "HELD", "hold")
            assert cell.at_rest()
            taken = len(passes(cell, run_id))
            await cell.clock.sleep(5.0)
            assert cell.engine.status()["state"] == "sweep"
            assert len(passes(cell, run_id)) == taken == 2
            await cell.engine.resume(WHO)
            assert (await cell.finished(run_id))["outcome"] == "complete"

    run_virtual(main())


def test_a_pose_taught_anew_makes_the_reference_another_fixture_s(tmp_path: Path) -> None:
    config = laser_config(tmp_path)
    reference = drawn_reference(config)
    reference["search"]["ys"]["q"][5] += 0.001

    async def main() -> None:
        async with laser_cell(config, "laser-check", reference) as cell:
            refusal = await refused(cell.start())
            assert refusal.name == "LASER_OTHER_FIXTURE"
            assert "'aux_ys' was taught anew" in str(refusal)

    run_virtual(main())


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"device": "others"}, "it used the inputs 'others', not 'beams'"),
        ({"xs": {"input": "zs"}}, "beams has no input 'zs', there is xs, ys"),
    ],
)
def test_a_reference_of_other_inputs_is_another_fixture_s(
    change: dict[str, Any], told: str, tmp_path: Path
) -> None:
    config = laser_config(tmp_path)
    reference = drawn_reference(config)
    for key, value in change.items():
        search = reference["search"]
        search[key] = {**search[key], **value} if isinstance(value, dict) else value

    async def main() -> None:
        async with laser_cell(config, "laser-check", reference) as cell:
            end = await cell.run_job()
            assert end["error"]["name"] == "LASER_OTHER_FIXTURE"
            assert told in end["error"]["text"]
            assert not [line for line in cell.journal(1) if line["kind"] == "motion"]

    run_virtual(main())


def test_a_run_of_the_beams_cannot_be_adopted(tmp_path: Path) -> None:
    config = laser_config(tmp_path)

    async def main() -> None:
        async with laser_cell(config, "laser-check", drawn_reference(config)) as cell:
            tasks = asked(cell, "return", lambda: cell.engine.abort(WHO))
            await cell.run_job()
            await asyncio.wait(tasks)
            end = await cell.run_job(adopt=1)
            assert end["error"]["name"] == "NOT_NOW"
            assert "start anew" in end["error"]["text"]

    run_virtual(main())
