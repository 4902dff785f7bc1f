"""Real jobs with an arm that is not what its controller believes: with the calibrated arm, and without."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.kinematics import measured_arm
from cell.calibrations import belt_scale, kinematics
from cell.poses import from_pose6, to_pose6
from cell.store.files import read_json
from daemon.config import CellConfig, load_config
from fakes.object import run_virtual
from fakes.world.scenario import Scenario
from tests.kit.ideal_world import ideal_text
from tests.kit.object_cell import JOB, ObjectCell, no_report, on_disk, open_cell, refused, write_config
from tests.kit.picking_cell import JOB as PICKING
from tests.kit.picking_cell import contact_errors

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

ARM, NOW = kinematics("arm"), {"name": kinematics("arm"), "version": 1}
ERROR = Scenario.load("tracker:ideal").world.arm.error  # an arm about 2 mm off its drawing
ROBOT = {"model": "ur10e", "calibration": {key: list(row) for key, row in ERROR.model_dump().items()}}


def config_of(folder: Path, scenario: str, use: bool, jobs: Mapping[str, Any], **more: Any) -> CellConfig:
    """A shipped scenario with those errors, and the switch."""
    text = ideal_text(scenario)
    rows = "\n".join(f"{key} = {row}" for key, row in ROBOT["calibration"].items())  # type: ignore[attr-defined]
    text = text.replace("[world.tool]", f"[world.arm.error]\n{rows}\n\n[world.tool]", 1)
    text = text.replace("first_m = 0.75", "first_m = -0.1")
    path = folder / "scenario.toml"
    path.write_text(text, "utf-8")
    write_config(folder, str(path), jobs=jobs, **more)
    toml = folder / "cell.toml"
    toml.write_text(toml.read_text().replace("[robot]", f"[robot]\nuse_kinematics = {str(use).lower()}", 1))
    return load_config(toml)


def commit(cell: ObjectCell, name: str, value: Any, model: Any, configured: Any = None) -> None:
    on_disk(cell.ledger.accept, cell.ledger.propose(name, value, {}, 0, configured, model), "test")


def calibrate(cell: ObjectCell) -> None:
    """The arm, as a calibration without noise would have found it."""
    commit(cell, ARM, {"robot": ROBOT, "controller": {"model": "ur10e"}, "payload_kg": 1.2}, None)


def camera(cell: ObjectCell, model: Any) -> None:
    """The true pose of the camera above the belt, made with ``model``."""
    truth = to_pose6(cell.plant.world.T_mount_camera).tolist()
    commit(cell, "T_base_camera", truth, model, cell.config.robot.T_base_camera_nominal)


@pytest.mark.parametrize("use", [False, True])
def test_a_capture_keeps_the_flange_poses_of_the_model_in_use(tmp_path: Path, use: bool) -> None:
    config = config_of(tmp_path, "hand_eye", use, {})

    async def main() -> tuple[Any, Any, Any]:
        async with open_cell(config, job=JOB) as cell:
            calibrate(cell)
            await cell.run_job()
            poses = cell.poses(1)
            true = cell.plant.world.true.forward(np.array([o["q"] for o in poses]))
            seen = from_pose6(np.array([o["T_base_flange"] for o in poses]))
            off = np.linalg.norm(seen.translation - true.translation, axis=1)
            robot = read_json(cell.folder(1).path / "capture.json")["robot"]
            return off, robot, cell.result(1)["inputs"]["arm_model"]

    off, robot, model = run_virtual(main())
    print(f"use_kinematics = {use}: T_base_flange is up to {1e3 * off.max():.4f} mm off the true flange")
    assert len(off) == 4
    assert robot["model"] == "ur10e"
    if use:
        assert off.max() < 5e-6
        assert (model, robot["calibration"]) == (NOW, ROBOT["calibration"])
    else:
        assert off.min() > 1e-3
        assert (model, max(robot["calibration"]["delta_theta"])) == ({"name": "controller"}, 0.0)


@pytest.mark.parametrize("use", [False, True])
def test_the_tool_meets_items_as_truly_as_the_arm_is_known(tmp_path: Path, use: bool) -> None:
    config = config_of(tmp_path, "picking", use, {PICKING: {"picks": 3}})

    async def main() -> tuple[Any, Any]:
        async with open_cell(config, job=PICKING) as cell:
            calibrate(cell)
            camera(cell, NOW if use else None)
            end = await cell.run_job()
            assert end["outcome"] == "complete"
            return contact_errors(cell), cell.result(1)["inputs"]["arm_model"]

    off, model = run_virtual(main())
    rms = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    print(f"use_kinematics = {use}: {len(off)} contacts {1e3 * rms:.3f} mm off (RMS)")
    assert len(off) >= 3
    if use:
        assert rms < 3e-4
        assert model == NOW
    else:
        assert rms > 6e-4
        assert model == {"name": "controller"}


def test_picking_refuses_a_camera_and_a_belt_that_were_calibrated_with_another_model(tmp_path: Path) -> None:
    config = config_of(tmp_path, "picking", True, {PICKING: {"picks": 3}})

    async def main() -> None:
        async with open_cell(config, job=PICKING) as cell:
            calibrate(cell)
            camera(cell, None)
            failure = await refused(cell.start())
            assert failure.name == "KINEMATICS_DIFFER"
            assert "T_base_camera version 1 was made with the controller's own kinematics" in str(failure)
            camera(cell, NOW)
            nominal = config.robot.belt_nominal
            assert nominal is not None
            scale = {"m_per_count": nominal.scale, "dir": nominal.dir}
            commit(cell, belt_scale("belt"), scale, {"name": ARM, "version": 7}, scale)
            failure = await refused(cell.start())
            assert "belt.belt version 1 was made with kinematics.arm version 7" in str(failure)
            commit(cell, belt_scale("belt"), scale, NOW, scale)
            run_id = await cell.start()
            await cell.engine.abort("test")
            await cell.finished(run_id)

    run_virtual(main())


def test_the_measured_arm_is_the_twins_true_one(tmp_path: Path) -> None:
    arm = measured_arm({"model": "ur10e"}, ROBOT)

    async def main() -> None:
        async with open_cell(config_of(tmp_path, "hand_eye", True, {})) as cell:
            Q = np.random.default_rng(1).uniform(-2.0, 2.0, (20, 6))
            true = cell.plant.world.true.matrix(Q)
            np.testing.assert_allclose(arm.forward_many(Q).as_matrix(), true, atol=1e-12)

    run_virtual(main())
