"""The latency calibration on the object face: the delay of the beams as the world has it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cell.calibrations import laser_reference, time_offset
from cell.poses import from_pose6
from fakes.object import run_virtual
from fakes.scenario import Scenario
from procedures.laser.config import LaserReferenceConfig, Search
from tests.object_cell import WHO, ObjectCell, no_report, open_cell, refused, write_config

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

JOB = "latency-calibration"
TOOL = "pin"
QUICK = {"speeds_m_s": [0.02, 0.08], "passes": 6, "accept": {"auto": True}}


def made_by_hand() -> dict[str, Any]:
    """The reference that a perfect measurement of the scenario's world would have given."""
    scenario = Scenario.load("laser")
    config = LaserReferenceConfig.model_validate(scenario.cell.job["laser-reference"])
    search = Search.from_config(config, scenario.cell.poses, "beams")
    point = from_pose6(scenario.world.tool.T_flange_tool).translation
    down = np.array([np.pi, 0.0, 0.0])
    beams = {name: {"point": beam.point, "dir": beam.dir} for name, beam in scenario.world.beams.items()}
    at = {name: np.add(beam.point, [0.0, 0.0, point[2]]) for name, beam in scenario.world.beams.items()}
    return {
        "schema": "cellward.laser-reference/1",
        "tool": {"id": TOOL, "p_ref": point.tolist(), "axis_ref": [0.0, 0.0, 1.0], "radius": 0.003},
        "R_base_flange": down.tolist(),
        "beams": beams,
        "hits": {name: hit.tolist() for name, hit in at.items()},
        "passes": [],
        "search": search.model_dump(),
        "tau_s": 0.0,
        "time_offset_s": 0.0,
        "cov": None,
    }


def with_reference(cell: ObjectCell) -> None:
    """Committed as if a job had found it."""
    result = {"verdict": "pass", "result": {}}
    cell.ledger.accept(cell.ledger.propose(laser_reference(TOOL), made_by_hand(), result, 0, None), WHO)


def cell_config(folder: Path, **job: Any) -> Any:
    return write_config(folder, "laser", jobs={JOB: {**QUICK, **job}})


def test_the_delay_is_found_within_its_interval_and_takes_effect(tmp_path: Path) -> None:
    config = cell_config(tmp_path)

    async def main() -> None:
        async with open_cell(config, job=JOB) as cell:
            with_reference(cell)
            end = await cell.run_job()
            assert (end["outcome"], end["verdict"]) == ("complete", "pass"), end["error"]
            truth = cell.plant.world.config.beams["xs"]
            answer = cell.result(1)["result"]
            low, high = answer["interval95_s"]
            assert 0.0 < high - low < 0.002
            assert abs(answer["time_offset_s"] - truth.latency_s) < high - low
            assert abs(answer["hysteresis_m"] - truth.hysteresis_m) < 3e-4
            assert cell.ledger.effective(time_offset("beams"), 0.0).value == answer["time_offset_s"]
            assert cell.at_rest()
            again = await cell.run_job()
            # What is in effect is not subtracted twice.
            assert abs(cell.result(2)["result"]["time_offset_s"] - answer["time_offset_s"]) < high - low
            assert again["verdict"] == "pass"

    run_virtual(main())


def test_without_a_reference_the_job_is_refused(tmp_path: Path) -> None:
    config = cell_config(tmp_path)

    async def main() -> None:
        async with open_cell(config, job=JOB) as cell:
            assert (await refused(cell.start())).name == "LASER_NO_REFERENCE"

    run_virtual(main())


def test_a_speed_beyond_the_limits_is_refused_and_not_slowed_down(tmp_path: Path) -> None:
    config = cell_config(tmp_path, speeds_m_s=[0.02, 0.5])

    async def main() -> None:
        async with open_cell(config, job=JOB) as cell:
            with_reference(cell)
            refusal = await refused(cell.start())
            assert refusal.name == "MOTION_LIMIT"
            assert "speeds_m_s has 0.5 m/s" in str(refusal)

    run_virtual(main())


def test_a_wide_interval_is_a_fail_that_names_the_limit(tmp_path: Path) -> None:
    config = cell_config(tmp_path, accept={"auto": True, "max_interval_s": 1e-5})

    async def main() -> None:
        async with open_cell(config, job=JOB) as cell:
            with_reference(cell)
            end = await cell.run_job()
            assert (end["outcome"], end["verdict"]) == ("complete", "fail")
            assert cell.result(1)["reasons"][0].startswith("max_interval_s")
            assert cell.ledger.effective(time_offset("beams"), 0.0).version is None

    run_virtual(main())


def test_a_finish_on_the_way_uses_what_was_taken_and_lifts_the_tool(tmp_path: Path) -> None:
    config = cell_config(tmp_path)

    async def main() -> None:
        async with open_cell(config, job=JOB) as cell:
            with_reference(cell)
            run_id = await cell.start()
            await cell.until(lambda: cell.engine.status()["step"] == 4, "four passes", 120.0)
            await cell.engine.finish(WHO)
            end = await cell.finished(run_id)
            assert end["outcome"] == "complete"
            assert cell.result(run_id)["residuals"]["edges"] < 2 * 2 * 12
            assert cell.plant.world.inputs is not None
            assert not any(cell.plant.world.inputs.levels(cell.clock.now()))
            assert cell.at_rest()

    run_virtual(main())


def test_the_plan_is_shown_without_moving(tmp_path: Path) -> None:
    config = cell_config(tmp_path)

    async def main() -> None:
        async with open_cell(config, job=JOB) as cell:
            with_reference(cell)
            before = cell.plant.world.track.at(cell.clock.now())[0]
            shown = await cell.engine.start(JOB, {}, dry_run=True, who=WHO, channel="test")
            assert "xs approach" in [row["index"] for row in shown["plan"]["sweeps"]]
            assert shown["plan"]["problems"] == []
            assert np.array_equal(cell.plant.world.track.at(cell.clock.now())[0], before)

    run_virtual(main())
