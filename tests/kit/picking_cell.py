"""Picking from a belt in a cell on virtual time."""

from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from daemon.config import CellConfig
from fakes.object import VirtualClock
from fakes.world.scenario import Scenario
from tests.kit.ideal_world import ideal_text, shipped_text
from tests.kit.object_cell import JOB as CAPTURE
from tests.kit.object_cell import ObjectCell, on_disk, open_cell, write_config

JOB = "belt-tracking"
POSE_M, POSE_RAD = 5e-5, 1e-4  # of the camera's pose, per axis
CAMERA_COV = np.diag([POSE_M**2] * 3 + [POSE_RAD**2] * 3).tolist()
# For ``world``: the camera tells another lens than it has.
TELLS_WRONG = {
    "nominal": "[-0.75, 0.55, 0.95, 3.141592653589793, 0.0, 0.0]\n"
    "told = { focal = 0.003, centre_px = [5.0, -4.0] }"
}

# Twice the pictures of the shipped twin: scenes are short.
_QUICKER = {"period_s = 0.5\n": "period_s = 0.25\n", "camera_stall_s = 1.5\n": ""}


def picking_config(
    folder: Path,
    job: Mapping[str, Any] | None = None,
    world: Mapping[str, str] | None = None,
    sections: Mapping[str, Mapping[str, Any]] | None = None,
    real: bool = False,
    arm: Mapping[str, Any] | None = None,
    as_shipped: bool = False,
    gripper: Mapping[str, Any] | None = None,
    **overrides: Any,
) -> CellConfig:
    """The picking cell with the first item in view, in an ideal world or a ``real`` one, with twice the
    pictures or ``as_shipped``.

    ``world`` replaces lines of the scenario by key,
    ``sections`` are those of other jobs."""
    text = (shipped_text if real else ideal_text)("picking")
    for shipped, own in () if as_shipped else _QUICKER.items():
        text = text.replace(shipped, own)
    for key, value in {"first_m": "-0.1", **(world or {})}.items():
        lines = [
            f"{key} = {value}" if line.split("=")[0].strip() == key else line for line in text.splitlines()
        ]
        text = "\n".join(lines) + "\n"
    Scenario.parse(text)
    path = folder / "scenario.toml"
    path.write_text(text, "utf-8")
    return write_config(
        folder,
        str(path),
        arm_keys=arm,
        gripper_keys=gripper,
        jobs={CAPTURE: None, JOB: job or {}, **(sections or {})},
        **overrides,
    )


@asynccontextmanager
async def picking_cell(
    config: CellConfig, clock: VirtualClock | None = None, lens: bool = True
) -> AsyncIterator[ObjectCell]:
    """A cell whose camera is calibrated to a tenth of a millimetre for the arm as configured, as a run would
    have left it: with its ``lens``, or as one of before these were kept."""
    async with open_cell(config, clock, JOB) as cell:
        truth, drawn = cell.plant.world.truth()["T_base_camera"], config.robot.T_base_camera_nominal
        found = (
            {"result": {"lens": asdict(cell.plant.world.intrinsics), "cov": CAMERA_COV, "budget": []}}
            if lens
            else {}
        )
        row = cell.ledger.propose("T_base_camera", truth, found, 0, drawn)
        on_disk(cell.ledger.accept, row, "test")
        yield cell


def contact_errors(cell: ObjectCell) -> np.ndarray:
    """(n, 2) m: the tool's point beside the item's grasp point at each first contact, as it truly was."""
    world = cell.plant.world
    assert world.gripper is not None
    world.gripper.settle(cell.clock.now())
    offs = [c.off_m for c in world.gripper.contacts if c.off_m is not None]
    return np.array(offs).reshape(-1, 2)
