"""A camera that gives colour alone, as an OAK-1: hand-eye, picking at a known height, what needs depth."""

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np

from cell.poses import from_pose6, log_xi
from daemon.config import CellConfig
from daemon.predictions import setup_of
from drivers.oak.config import OakConfig
from fakes.frames.render import Picture
from fakes.frames.server import FrameServer
from fakes.object import run_virtual
from fakes.twin.camera import TwinCamera
from fakes.world.scenario import Scenario
from fakes.world.world import World
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.expectation import belt_expectation
from procedures.latency.config import LatencyCalibrationConfig
from procedures.latency.expectation import delay_expectation
from procedures.setup import Setup
from procedures.slot.config import SlotInsertionConfig
from procedures.slot.expectation import slot_expectation
from tests.kit.ideal_world import ideal_text
from tests.kit.object_cell import no_report, open_cell, write_config
from tests.kit.picking_cell import JOB, contact_errors, picking_cell, picking_config
from tests.kit.slot_cell import config as slot_config

__all__ = ["no_report"]
COLOUR_ALONE = {"exposure_s": "0.004\ndepth = false"}


def test_hand_eye_needs_no_depth(tmp_path: Path, no_report: None) -> None:
    scenario = tmp_path / "scenario.toml"
    scenario.write_text(
        ideal_text("hand_eye").replace("[world.camera]", "[world.camera]\ndepth = false"), "utf-8"
    )

    async def main() -> None:
        async with open_cell(write_config(tmp_path, str(scenario))) as cell:
            end = await cell.run_job()
            assert end["outcome"] == "complete", end
            assert not any("depth" in frame for pose in cell.poses(1) for frame in pose["frames"])
            found = cell.result(1)
            truth = from_pose6(cell.plant.world.truth()["T_flange_camera"])
            xi = log_xi(truth.inv() * from_pose6(found["result"]["T_flange_camera"]))
            assert xi @ np.linalg.solve(np.array(found["uncertainty"]["cov"]), xi) < 20.1  # 99.7 %
            assert np.linalg.norm(xi[:3]) < 0.001

    run_virtual(main())


def belt_config(folder: Path, height_m: float | None) -> CellConfig:
    return picking_config(folder, {"picks": 1, "items": {"height_m": height_m}}, COLOUR_ALONE)


def test_items_of_a_known_height_are_picked_by_colour(tmp_path: Path, no_report: None) -> None:
    async def main() -> None:
        async with picking_cell(belt_config(tmp_path, 0.03)) as cell:
            end = await cell.run_job()
            assert end["outcome"] == "complete", end
            assert sum(c.taken for c in cell.plant.world.gripper.contacts) == 1  # type: ignore[union-attr]
            off = np.linalg.norm(contact_errors(cell), axis=1)
            assert off.max() < 0.001

    run_virtual(main())


def test_without_a_known_height_the_run_says_what_is_missing(tmp_path: Path, no_report: None) -> None:
    async def main() -> None:
        async with picking_cell(belt_config(tmp_path, None)) as cell:
            end = await cell.run_job()
            assert end["error"]["name"] == "CAMERA_FAULT"
            assert "items are looked for by depth" in end["error"]["text"]

    run_virtual(main())


def without_depth(config: CellConfig, camera: str) -> Setup:
    """The setup of a cell whose camera's section says that it has no depth."""
    setup = setup_of(config)
    return replace(setup, devices={**setup.devices, camera: OakConfig.model_validate({"depth": False})})


def test_check_says_where_depth_is_needed(tmp_path: Path) -> None:
    for height_m, said in ((None, ["give [job.belt-tracking.items] height_m"]), (0.03, [])):
        config = belt_config(tmp_path, height_m)
        job = BeltTrackingConfig.model_validate(config.job_section(JOB))
        problems = belt_expectation(without_depth(config, "camera"), job)["problems"]
        assert len(problems) == len(said)
        assert all(words in text for words, text in zip(said, problems, strict=True))
    late = LatencyCalibrationConfig.model_validate({"source": "belt", "belt_z_m": 0.15})
    (problem,) = delay_expectation(without_depth(belt_config(tmp_path, 0.03), "camera"), late)["problems"]
    assert "give [job.latency-calibration.items] height_m" in problem
    config = slot_config(tmp_path)
    slot = SlotInsertionConfig.model_validate(config.job_section("slot-insertion"))
    assert (
        "looks into a slot by depth" in slot_expectation(without_depth(config, "camera"), slot)["problems"][0]
    )


def test_the_twins_camera_sends_frames_without_depth_and_names_it_in_its_config(tmp_path: Path) -> None:
    text = ideal_text("hand_eye").replace("[world.camera]", "[world.camera]\ndepth = false")
    world = World.from_scenario(Scenario.parse(text))
    server = FrameServer(world, str(tmp_path / "frames.sock"))
    try:
        colour = np.zeros((world.camera.height, world.camera.width, 3), np.uint8)
        data = server._encoded(1, 0.5, 0.01, Picture(colour, np.zeros(colour.shape[:2], np.uint16)), None)
    finally:
        server.close()
    (length,) = struct.unpack_from("<I", data)
    assert json.loads(data[4 : 4 + length])["depth"] is None
    assert len(data) == 4 + length + colour.nbytes
    section = TwinCamera(tmp_path / "frames.sock", "hand_eye", world).device()
    assert OakConfig.model_validate({k: v for k, v in section.items() if k != "driver"}).depth is False
