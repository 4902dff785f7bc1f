"""The crossed-beam jobs in a cell on virtual time: short plans, a reference, and what the tool truly is."""

import json
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from cell.calibrations import laser_reference, tool_calibration
from cell.poses import Array, from_pose6, to_pose6
from daemon.config import CellConfig
from fakes.object import VirtualClock
from procedures.laser.result import LaserAnswer
from procedures.laser.solving import compare_second
from tests.kit.object_cell import ObjectCell, on_disk, open_cell, write_config

SCENARIO = "laser:ideal"
TOOL = "pin"
BRISK = {
    "speed_m_s": 0.5,
    "accel_m_s2": 10.0,
    "joint_speed_rad_s": 3.0,
    "joint_accel_rad_s2": 20.0,
    "workspace": [{"min": [-1.3, -1.3, 0.0], "max": [1.3, 1.3, 1.8]}],
}
QUICK = {
    "descend_step_m": 0.008,
    "max_descents": 2,
    "search_speed_m_s": 0.3,
    "measure_speed_m_s": 0.1,
    "passes": 1,
    "tilt_height_m": 0.0,
    "z_resolution_m": 0.005,
    "settle_s": 0.0,
    "max_out_back_m": 0.002,
}
REJECTED = "rejected"


def laser_config(
    folder: Path,
    reference: Mapping[str, Any] | None = None,
    check: Mapping[str, Any] | None = None,
    update: Mapping[str, Any] | None = None,
    quick: bool = True,
    scenario: str = SCENARIO,
    **overrides: Any,
) -> CellConfig:
    """The crossed-beam cell with fast arms and few passes; the arguments go into the sections of the jobs."""
    jobs = {
        "laser-reference": {**(QUICK if quick else {}), **(reference or {})},
        "laser-check": {**(WIDE if quick else {}), **(check or {})},
        "laser-update": {**(WIDE if quick else {}), **(update or {})},
    }
    overrides.setdefault("limits", BRISK)
    beams = {"poll_period_s": 0.01 if quick else 0.005}
    return write_config(folder, scenario, jobs=jobs, beams_keys=beams, **overrides)


# With one fast pass the point is known to some tenths of a millimetre.
WIDE = {"max_U_m": 0.01, "max_latency_s": 0.1}


@asynccontextmanager
async def laser_cell(
    config: CellConfig,
    job: str,
    reference: Mapping[str, Any] | None = None,
    clock: VirtualClock | None = None,
) -> AsyncIterator[ObjectCell]:
    """A cell for ``job``; ``reference`` is put into effect as if a run had made it."""
    async with open_cell(config, clock, job) as cell:
        if reference is not None:
            name = laser_reference(TOOL)
            on_disk(cell.ledger.accept, cell.ledger.propose(name, reference, {}, 0, None), "test")
        yield cell


def true_point(cell: ObjectCell) -> Array:
    """(3,) the tool's point in the flange as it truly is now."""
    return np.array(cell.plant.world.T_flange_tool_at(cell.clock.now()).translation)


def true_axis(cell: ObjectCell) -> Array:
    """(3,) the tool's axis in the flange as it truly is now."""
    axis: Array = cell.plant.world.T_flange_tool_at(cell.clock.now()).rotation.apply([0.0, 0.0, 1.0])
    return axis


def committed_tool(cell: ObjectCell) -> list[float] | None:
    """``T_flange_tool`` of the version in effect, None while the configured one is."""
    effective = cell.ledger.effective(tool_calibration(TOOL), None)
    return None if effective.version is None else effective.value


def states_of_results(cell: ObjectCell, name: str | None = None) -> list[str]:
    """What became of every result, newest first; the reference of the test is left out."""
    rows = cell.ledger.results(name)
    return [row["state"] for row in rows if row["run_id"] != 0]


def point_of(pose6: list[float]) -> Array:
    return np.array(from_pose6(pose6).translation)


def passes(cell: ObjectCell, run_id: int) -> list[dict[str, Any]]:
    """The lines of ``passes.jsonl``."""
    path = cell.folder(run_id).path / "passes.jsonl"
    return [json.loads(line) for line in path.read_text("utf-8").splitlines()] if path.exists() else []


def the_plain_rule_misses(
    folder: Path, first: Mapping[str, Any], reference: Mapping[str, Any], by_m: float
) -> None:
    """The source's "standard + offset" adds the flange's offset in the base: the second scan refuses it.

    ``folder`` is that of an update, ``first`` its answer, ``by_m`` twice the true displacement in x.
    """
    ref = from_pose6(reference["T_flange_tool"])
    t = ref.translation + np.array(first["flange_offset_base"])
    plain = to_pose6(RigidTransform.from_components(t, ref.rotation)).tolist()
    answer = LaserAnswer.model_validate({**first, "T_flange_tool": plain})
    found = compare_second(folder / "laser.json", answer, reference)
    assert not found.meets
    assert found.apart == pytest.approx(by_m, abs=found.U_m), "x is doubled"
