"""A short silence of a device costs a step of a capture, and not the run; on virtual time."""

from pathlib import Path

import pytest

from fakes.object import run_virtual
from procedures.hand_eye.states import State
from tests.chaos.matrix import inject_at, kind
from tests.chaos.test_engine_fault_matrix import BRISK, ON_THE_WAY_S, PLAN, check_stops, quick_solver
from tests.kit.object_cell import no_report, open_cell, write_config

__all__ = ["no_report", "quick_solver"]
pytestmark = pytest.mark.usefixtures("no_report", "quick_solver")

MOMENTS = [s.value for s in State if s is not State.SEARCH]
SILENT = kind("arm", "silence", "", set(), duration_s=1.5)
TOO_LONG = kind("arm", "silence", "DEVICE_LOST STALE_DATA", set(), duration_s=8.0)


@pytest.mark.parametrize("device", ["arm", "camera"])
@pytest.mark.parametrize("moment", MOMENTS)
def test_a_short_silence_costs_a_step_and_the_run_completes(device: str, moment: str, tmp_path: Path) -> None:
    config = write_config(tmp_path, job={**PLAN, "placements": 1}, limits=BRISK)

    async def main() -> None:
        async with open_cell(config) as cell:
            fault = kind(device, "silence", "", set(), duration_s=1.5)
            inject_at(cell, fault, moment, ON_THE_WAY_S if moment == "move" else 0.0)
            end = await cell.run_job()
            assert end["outcome"] == "complete", end["error"]
            print(moment, cell.engine.run.steps_taken.taken_again)
            assert cell.at_rest()
            check_stops(cell)

    run_virtual(main())
