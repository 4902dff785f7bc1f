"""The delays of a camera and of an encoder on the object face: as the world has them, and in effect after."""

import asyncio
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cell.calibrations import time_offset
from cell.devices import Intrinsics
from cell.run_values import RunValues
from daemon.cli.replay import differences
from daemon.demo.ending import beside_truth
from daemon.rehearsal.objects import rehearsed_cell
from daemon.rehearsal.play import rehearse
from fakes.object import run_virtual
from fakes.world.scenario import Scenario
from procedures.latency.camera import FixedCamera, FlangeCamera
from procedures.latency.config import LatencyCalibrationConfig
from tests.kit.object_cell import (
    WHO,
    ObjectCell,
    no_report,
    on_disk,
    open_cell,
    refused,
    write_config,
)
from tests.kit.picking_cell import picking_cell, picking_config
from tests.kit.solved import solve_again

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

JOB = "latency-calibration"
OTHER = "time_offset_s.exchanged"
CAMERA_S, ENCODER_S = 0.015, 0.008
QUICK = {"speeds_m_s": [0.1, 0.25], "passes": 2, "way_m": 0.15, "settle_s": 0.1, "accept": {"auto": True}}
BELT = {"source": "belt", "changes": 8, "sightings": 60, "accept": {"auto": True}}
STOPS = (
    "[{ speed_m_s = 0.2 }]\nstops = { every_s = [1.0, 2.0], accel_m_s2 = [0.5, 1.2], held_s = [0.4, 0.8] }"
)


def late_cell(folder: Path, profile: str = STOPS, arm_s: float = 0.0, **job: Any) -> Any:
    """The picking cell whose camera, encoder and arm stamp late; items come all the time."""
    world = {
        "profile": profile,
        "exposure_s": f"0.004\nstamp_late_s = {CAMERA_S}",
        "node": f"5\nlate_s = {ENCODER_S}",
        "spacing_m": "0.2",
        "repeatability_t_m": f"0.0\n[world.arm.reported]\nstamp_late_s = {arm_s}",
    }
    return picking_config(folder, {}, world, sections={JOB: {**QUICK, **job}})


def known(cell: ObjectCell, device: str, offset_s: float) -> None:
    """Committed as if a run had found it, to 0.1 ms."""
    found = {"interval95_s": [offset_s - 1e-4, offset_s + 1e-4]}
    committed(cell, device, offset_s, {"verdict": "pass", "result": found})


def committed(cell: ObjectCell, device: str, offset_s: float, result: dict[str, Any]) -> None:
    on_disk(cell.ledger.accept, cell.ledger.propose(time_offset(device), offset_s, result, 0, 0.0), WHO)


def judged(cell: ObjectCell, device: str, delay_s: float) -> dict[str, Any]:
    """The result of run 1, which agrees with the world and is in effect, and which replay comes to, too."""
    result, folder = cell.result(1), cell.folder(1)
    low, high = result["result"]["interval95_s"]
    assert abs(result["result"]["time_offset_s"] - delay_s) < min(high - low, 0.001)
    told = cell.plant.world.truth(cell.clock.now())
    assert beside_truth(result, told, folder.path).good
    told["camera"]["stamp_late_s"] += 2.0 * (high - low)
    told["belt"]["late_s"] += 2.0 * (high - low)
    assert not beside_truth(result, told, folder.path).good
    assert cell.ledger.effective(time_offset(device), 0.0).value == result["result"]["time_offset_s"]
    assert differences(result, solve_again(folder.job, folder.path, folder.info, result)) == []
    return dict(result)


@pytest.mark.parametrize("arm_s", [0.0, 0.002])
def test_a_fixed_camera_is_as_late_against_the_arm_as_its_world_says_and_jobs_go_by_it(
    tmp_path: Path, arm_s: float
) -> None:
    async def main() -> None:
        async with picking_cell(late_cell(tmp_path, arm_s=arm_s)) as cell:
            end = await cell.run_job(job=JOB)
            assert (end["outcome"], end["verdict"]) == ("complete", "pass"), end["error"]
            result = judged(cell, "camera", CAMERA_S - arm_s)
            assert abs(result["result"]["hysteresis_m"]) < 3e-5
            assert cell.at_rest()
            run_id = await cell.start()  # picking
            run = cell.engine.run
            assert run is not None
            await cell.clock.sleep(1.0)
            own, seen = run.cell.device("fixed_camera"), run.camera("fixed_camera")
            late = own.frames.last().t - seen.frames.last().t  # type: ignore[attr-defined, union-attr]
            assert late == pytest.approx(result["result"]["time_offset_s"], abs=1e-9)
            await cell.engine.finish(WHO)
            await cell.finished(run_id)

    run_virtual(main())


def test_an_encoder_is_late_against_a_camera_whose_delay_is_known(tmp_path: Path) -> None:
    async def main() -> None:
        async with picking_cell(late_cell(tmp_path, **BELT, belt_z_m=0.15)) as cell:
            assert (await refused(cell.start(job=JOB))).name == "LATENCY_CAMERA_UNKNOWN"
            known(cell, "camera", CAMERA_S)
            before = cell.plant.world.track.at(cell.clock.now())[0]
            end = await cell.run_job(job=JOB)
            assert (end["outcome"], end["verdict"]) == ("complete", "pass"), end["error"]
            result = judged(cell, "belt", ENCODER_S)
            data = json.loads((cell.folder(1).path / "latency.json").read_text())
            assert data["camera"]["told"]["width"] > 0
            assert "lens" in data["camera"], "that the items were placed with"
            run = cell.engine.run
            assert run is not None
            assert run.step == run.steps == BELT["changes"]
            assert result["uncertainty"]["camera_sigma_s"] == pytest.approx(1e-4 / 1.96, rel=0.01)
            assert result["uncertainty"]["sigma_s"] > result["uncertainty"]["camera_sigma_s"]
            assert (cell.plant.world.track.at(cell.clock.now())[0] == before).all()
            camera_sigma = result["uncertainty"]["camera_sigma_s"]
            assert await in_the_encoder(cell) == camera_sigma
            inputs = result["inputs"]
            committed(cell, "belt", ENCODER_S, {**result, "inputs": {**inputs, "camera_calibration": OTHER}})
            assert await in_the_encoder(cell) == 0.0, "version 1 of another camera, exchanged since"
            unnamed = {key: value for key, value in inputs.items() if key != "camera_calibration"}
            committed(cell, "belt", ENCODER_S, {**result, "inputs": unnamed})
            assert await in_the_encoder(cell) is None, "a result of before, of which nobody knows"
            committed(cell, "belt", ENCODER_S, result)
            assert await in_the_encoder(cell) == camera_sigma
            known(cell, "camera", CAMERA_S)  # once more, so that its error is another one
            assert await in_the_encoder(cell) == 0.0

    run_virtual(main())


async def in_the_encoder(cell: ObjectCell) -> float | None:
    """What a job of now takes as the camera's part of how well the encoder's delay is known, s."""
    run_id = await cell.start()
    await cell.engine.finish(WHO)
    await cell.finished(run_id)
    offsets = json.loads((cell.folder(run_id).path / "run.json").read_text())["values"]["time_offset_s"]
    part: float | None = offsets["belt"].get("camera_sigma")
    return part


def test_a_jump_of_the_count_ends_the_run_by_name(tmp_path: Path) -> None:
    async def main() -> None:
        async with picking_cell(late_cell(tmp_path, **BELT, belt_z_m=0.15)) as cell:
            known(cell, "camera", CAMERA_S)
            run_id = await cell.start(job=JOB)
            await cell.until_state("watch")
            await cell.clock.sleep(1.0)
            cell.plant.plant("belt").inject("wrap", {"before": 30000})
            assert (await cell.finished(run_id))["error"]["name"] == "ENCODER_JUMP"

    run_virtual(main())


@pytest.mark.parametrize("then", ["resume", "finish"])
def test_a_jump_while_the_run_is_held_ends_it_by_name(tmp_path: Path, then: str) -> None:
    async def main() -> None:
        async with picking_cell(late_cell(tmp_path, **BELT, belt_z_m=0.15)) as cell:
            known(cell, "camera", CAMERA_S)
            run_id = await cell.start(job=JOB)
            await cell.until_state("watch")
            await cell.clock.sleep(1.0)
            await cell.engine.pause(WHO)
            await cell.clock.sleep(1.0)
            cell.plant.plant("belt").inject("wrap", {"before": 30000})
            await cell.clock.sleep(60.0)  # enough starts, stops and sightings to be done
            await getattr(cell.engine, then)(WHO)
            assert (await cell.finished(run_id))["error"]["name"] == "ENCODER_JUMP"

    run_virtual(main())


def test_a_belt_that_does_not_stop_ends_the_wait_with_what_is_missing(tmp_path: Path) -> None:
    config = late_cell(tmp_path, "[{ speed_m_s = 0.2 }]", **BELT, belt_z_m=0.15, patience_s=12.0)

    async def main() -> None:
        async with picking_cell(config) as cell:
            known(cell, "camera", CAMERA_S)
            end = await cell.run_job(job=JOB)
            assert (end["outcome"], end["verdict"]) == ("complete", "fail")
            assert cell.result(1)["reasons"][0].startswith("steady-belt: ")

    run_virtual(main())


def test_a_camera_on_the_flange_is_carried_past_its_board(tmp_path: Path) -> None:
    job = {"source": "flange_camera", "target": "board", **QUICK, "speeds_m_s": [0.08, 0.2]}
    config = write_config(tmp_path, "hand_eye:ideal", jobs={JOB: job})

    async def main() -> None:
        async with open_cell(config, job=JOB) as cell:
            end = await cell.run_job()
            assert (end["outcome"], end["verdict"]) == ("complete", "pass"), end["error"]
            answer = cell.result(1)["result"]
            assert abs(answer["time_offset_s"]) < 0.001
            low, high = answer["interval95_s"]
            assert low < 0.0 < high
            assert cell.at_rest()

    run_virtual(main())


@pytest.mark.parametrize(
    ("subject", "name"), [(FlangeCamera, "T_flange_camera"), (FixedCamera, "T_base_camera")]
)
def test_pictures_are_solved_with_the_lens_that_belongs_to_the_pose_of_the_camera(
    subject: Any, name: str
) -> None:
    told = Intrinsics(640, 480, (500.0, 500.0, 319.5, 239.5), (0.0,) * 5)
    found = {"width": 640, "height": 480, "K": [503.0, 503.0, 322.0, 240.0], "dist": [0.01] * 5}
    board = SimpleNamespace(ids=range(99))
    seen = SimpleNamespace(t=1.0, value=SimpleNamespace(board=board, intrinsics=told))
    camera = SimpleNamespace(frames=SimpleNamespace(last=lambda: seen))

    def lens(of: dict[str, Any]) -> Any:
        values = RunValues(
            {},
            targets={"board": {}},
            calibration={subject.setup: {"X": [0.0] * 6}},
            uncertainty={name: {"lens": of}},
        )
        clock = SimpleNamespace(now=lambda: 0.0)
        run: Any = SimpleNamespace(
            values=values, clock=clock, device=lambda *_: camera, arm=lambda: None, cell=None
        )
        job = LatencyCalibrationConfig.model_validate({"source": subject.role, "target": "board"})
        source = subject(job, run)
        asyncio.run(source._see_target())
        return source.data()["camera"]

    assert list(lens(found)["K"]) == found["K"]
    assert list(lens(found | {"width": 1280})["K"]) == list(told.K), "it is for larger pictures"


def test_a_finish_before_the_first_way_says_that_nothing_was_taken(tmp_path: Path) -> None:
    async def main() -> None:
        async with picking_cell(late_cell(tmp_path)) as cell:
            run_id = await cell.start(job=JOB)
            await cell.engine.finish(WHO)
            end = await cell.finished(run_id)
            assert end["error"]["name"] == "LATENCY_INCOMPLETE"
            assert cell.at_rest()

    run_virtual(main())


def test_what_the_job_cannot_do_with_is_refused_in_one_sentence(tmp_path: Path) -> None:
    async def main() -> None:
        async with picking_cell(late_cell(tmp_path)) as cell:
            for params, word in (
                ({"target": "poster"}, "target 'poster' is unknown; there is board"),
                ({"pose": "nowhere"}, "pose 'nowhere' is unknown"),
            ):
                assert word in str(await refused(cell.start(job=JOB, params=params)))
            far = await cell.run_job(job=JOB, params={"way_m": 1.0, "speeds_m_s": [0.1, 0.2]})
            assert far["error"]["name"] == "LATENCY_WAY_REFUSED"

    run_virtual(main())


def test_a_twin_for_a_rehearsal_has_the_camera_and_its_target(tmp_path: Path) -> None:
    config, out = late_cell(tmp_path), tmp_path / "out"
    out.mkdir()
    subject = rehearsed_cell(config, tmp_path / "cell.toml", JOB, 1, out)
    world = Scenario.load(out / "scenario.toml").world
    assert world.camera is not None
    assert world.camera.T_base_camera is not None
    assert world.target is not None
    assert subject.rehearsals[-1].look == "show"


def test_the_delay_of_an_encoder_is_rehearsed_on_a_belt_that_stops(tmp_path: Path) -> None:
    job = {"changes": 8, "sightings": 60, "belt_z_m": 0.15, "source": "belt"}
    config, out = late_cell(tmp_path, **job), tmp_path / "out"
    out.mkdir()
    outcome = rehearse(config, tmp_path / "cell.toml", JOB, 1, out)
    world = Scenario.load(out / "scenario.toml").world
    assert world.belt is not None
    assert world.belt.stops is not None
    assert (outcome.ended, outcome.good) == ("complete", True), outcome.why
    assert outcome.off
