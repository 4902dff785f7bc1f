"""The cell of the scenario ``slot`` on the object face: a calibrated camera, a gripper and a rack."""

from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from cell.devices import Intrinsics
from cell.poses import Array, exp_xi, from_pose6, to_pose6
from daemon.config import CellConfig
from fakes.world.rack.rack import Rack
from tests.kit.object_cell import ObjectCell, on_disk, write_config

SLOT = "slot-insertion"
# Of a hand-eye by a good capture with a good arm: 0.05 mm and 0.1 mrad.
HAND_EYE_COV = np.diag([5e-5**2] * 3 + [1e-4**2] * 3)
BUDGET = [
    {"block": "arm", "t": 2e-5, "r": 5e-5},
    {"block": "target", "t": 3e-5, "r": 5e-5},
    {"block": "noise", "t": 3.5e-5, "r": 7e-5},
]


def config(
    folder: Path, *, scenario: str = "slot", gripper_keys: Mapping[str, Any] | None = None, **job: Any
) -> CellConfig:
    """The scenario's own, in haste."""
    hasty = {"look": {"frames": 1, "settle_s": 0.1}, "insertion": {"speed_m_s": 0.05}, "slot": 1}
    return write_config(folder, scenario, jobs={SLOT: {**hasty, **job}}, gripper_keys=gripper_keys)


def scenario_with(folder: Path, old: str, new: str) -> str:
    """The scenario with one of its lines changed, as a file."""
    text = files("fakes").joinpath("scenarios", "slot.toml").read_text("utf-8")
    assert text.count(old) == 1
    path = folder / "changed.toml"
    path.write_text(text.replace(old, new), "utf-8")
    return str(path)


def give_hand_eye(
    cell: ObjectCell, off: Sequence[float] = (0.0,) * 6, cov: Array = HAND_EYE_COV, **more: Any
) -> None:
    """A calibration of the camera, ``off`` (6,) from the pose that serves the arm best, with its stated
    covariance, the true lens, and the board's size as configured; ``more`` is what else its answer says."""
    world = cell.plant.world
    true = from_pose6(world.truth()["T_flange_camera"])
    T = [float(v) for v in to_pose6(true * exp_xi(np.asarray(off)))]
    nominal = list(cell.config.robot.T_flange_camera_nominal or [])
    size = {"x": 0.0, "y": 0.0, "sigma_x": 5e-5, "sigma_y": 5e-5}
    answer = {"T_flange_camera": T, "cov": cov.tolist(), "budget": BUDGET, "target_scale": size}
    answer |= {"lens": lens_of(world.intrinsics) | {"rms_px": 0.1}, **more}
    inputs = {"target": next(iter(cell.config.target.values()), None)}
    result = {"schema": "cellward.result/1", "kind": "hand-eye", "verdict": "pass", "result": answer}
    result |= {"inputs": inputs}
    entry = on_disk(cell.ledger.propose, "T_flange_camera", T, result, 0, nominal)
    on_disk(cell.ledger.accept, entry, "test")


def lens_of(lens: Intrinsics) -> dict[str, Any]:
    """As an answer says it."""
    return {"width": lens.width, "height": lens.height, "K": list(lens.K), "dist": list(lens.dist)}


def rack_of(cell: ObjectCell) -> Rack:
    rack = cell.plant.world.rack
    assert rack is not None
    return rack


def beside(cell: ObjectCell, part: int, slot: int) -> float:
    """How far the front of a part truly is beside the middle of a slot, m."""
    return float(np.linalg.norm(rack_of(cell).offset(part, slot, cell.clock.now()).translation[:2]))
