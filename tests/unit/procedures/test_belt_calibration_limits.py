"""What a belt calibration's limits judge: what puts a contact beside the item, and what lifts the tool."""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from cell.poses import to_pose6
from cell.store.files import to_json, write_atomic
from procedures.belt.calibrating.config import BeltCalibrationConfig
from procedures.belt.calibrating.record import DATA_FILE, SCHEMA
from procedures.belt.calibrating.solving import solve_within_limits
from procedures.belt.result import BeltCalibrationResult
from tests.kit.belt_sightings import BESIDE, MANY, SCALE, WAY, seen

FRAME_S = 0.1
CAMERA = RigidTransform.from_components([0.55, 0.0, 0.8], Rotation.from_rotvec([np.pi, 0.0, 0.0]))


def solved(folder: Path, steps_m: float, off: np.ndarray, **accept: float) -> BeltCalibrationResult:
    """With steps of so much along ``off`` (3,), which all items have at the same place of the picture."""
    rows = seen(np.random.default_rng(4), feed=MANY)
    steps = steps_m * np.sin(8.0 * (rows.points @ WAY) + 1.0)
    points = CAMERA.inv().apply(rows.points + steps[:, None] * off)
    times = np.arange(0.0, MANY.frames * FRAME_S, 0.005)
    data: dict[str, Any] = {
        "schema": SCHEMA,
        "source": "camera",
        "device": "belt",
        "period_s": 0.005,
        "T_base_camera": to_pose6(CAMERA).tolist(),
        "encoder": [
            [t, n] for t, n in zip(times, np.round(MANY.step / FRAME_S * times / SCALE), strict=True)
        ],
        "sightings": [{"t": t, "points": points[rows.t == t].tolist()} for t in np.unique(rows.t)],
    }
    write_atomic(folder / DATA_FILE, to_json(data))
    config = BeltCalibrationConfig.model_validate({"belt_z_m": 0.0, "accept": accept})
    found = solve_within_limits(folder / DATA_FILE, config.model_dump())
    assert isinstance(found, BeltCalibrationResult)
    return found


def test_steps_in_height_are_held_against_the_limit_of_the_rise_alone(tmp_path: Path) -> None:
    subject = solved(tmp_path, 5e-4, np.cross(WAY, BESIDE))
    level, rise = subject.direction_95_rad()
    assert level is not None
    assert rise is not None
    assert level < 0.001 < 0.003 < rise < 0.007
    assert subject.result.dir_95_rad == rise
    assert subject.verdict == "pass", subject.reasons
    subject = solved(tmp_path, 5e-4, np.cross(WAY, BESIDE), max_rise_rad=0.002)
    (reason,) = subject.reasons
    assert reason.startswith(f"max_rise_rad: how dir rises is known to {1e3 * rise:.2f} mrad (95 %)")


def test_steps_beside_the_belt_are_held_against_the_limit_of_the_direction(tmp_path: Path) -> None:
    (reason,) = solved(tmp_path, 5e-4, BESIDE).reasons
    assert reason.startswith("max_dir_rad:")


def test_older_configurations_have_the_usual_limit_of_the_rise(tmp_path: Path) -> None:
    config = BeltCalibrationConfig(belt_z_m=0.0).model_dump()
    del config["accept"]["max_rise_rad"]
    solved(tmp_path, 0.0, BESIDE)
    assert solve_within_limits(tmp_path / DATA_FILE, config).verdict == "pass"
