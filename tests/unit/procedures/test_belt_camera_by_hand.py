"""The picking cell played by hand: its scenario has the capture that calibrates its camera."""

import tomllib
from importlib.resources import files
from pathlib import Path

import pytest

from fakes.object import run_virtual
from fakes.world.scenario import Scenario
from tests.kit.object_cell import WHO, no_report, open_cell, write_config

__all__ = ["no_report"]

SHIPPED = Scenario.load("picking").cell.job
POSES = 6  # of the plan; fewer than shipped take less time to plan


@pytest.mark.usefixtures("no_report")
def test_the_camera_above_the_belt_sees_the_board_in_every_pose_that_its_capture_asks_for(
    tmp_path: Path,
) -> None:
    config = write_config(tmp_path, "picking", job={**SHIPPED["cone-capture"], "poses_per_placement": POSES})

    async def main() -> None:
        async with open_cell(config, None, "cone-capture") as cell:
            run_id = await cell.start()
            await cell.until_state("move")
            await cell.engine.abort(WHO)
            await cell.finished(run_id)
            (made,) = cell.notes(run_id, "plan")
            assert len(made["plan"]["poses"]) == POSES

    run_virtual(main())


def test_the_fast_demo_has_the_jobs_of_the_scenario() -> None:
    fast = tomllib.loads(files("daemon.demo").joinpath("fast_picking.toml").read_text("utf-8"))
    demo = tomllib.loads(files("daemon.demo").joinpath("picking.toml").read_text("utf-8"))["cell"]["job"]
    expected = {name: {**section, **demo.get(name, {})} for name, section in SHIPPED.items()}
    assert fast["job"] == expected
