"""Targets that are handed to a palletizer one by one: what remains off, held against where it truly went."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.identification.application import chain_of
from cell.calibrations import kinematics
from cell.poses import from_pose6
from daemon.config import CellConfig
from daemon.plc import PlcFace
from daemon.predictions import setup_of
from daemon.words.plan_text import plan_text
from fakes.object import run_virtual
from fakes.world.scenario import OBSERVED, Scenario
from procedures.corrected_targets.config import CorrectedTargetsConfig
from procedures.corrected_targets.expectation import targets_expectation
from procedures.corrected_targets.judging import solve_targets
from tests.kit.object_cell import ObjectCell, no_report, on_disk, open_cell, refused, write_config

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

JOB, SCENARIO = "corrected-targets", "palletizer:ideal"
TARGETS = [[1.7, 0.4, 0.6, 0.3], [1.5, -0.7, 0.9, -0.8], [2.0, 0.1, 0.4, 0.0], [1.6, 0.8, 1.1, 1.0]]
TRUTH = Scenario.load(SCENARIO).world


def targets_config(folder: Path, job: Mapping[str, Any] | None = None, **how: Any) -> CellConfig:
    """The palletizer's cell with four targets."""
    section: dict[str, Any] = {
        "targets": TARGETS,
        "reflector": "smr1",
        "settle_s": 0.1,
        "window_s": 0.2,
        "find_timeout_s": 2.0,
        "reacquire_wait_s": 0.2,
        "request_timeout_s": 20.0,
        **(job or {}),
    }
    return write_config(folder, SCENARIO, jobs={JOB: section}, **how)


def true_kinematics() -> dict[str, Any]:
    """What a perfect calibration would have found."""
    assert TRUTH.observed is not None
    assert TRUTH.tracker is not None
    error = TRUTH.observed.error.model_dump()
    parameters = {k: v + error.get(k, 0.0) for k, v in TRUTH.observed.parameters.model_dump().items()}
    parameters |= dict(zip(("tx", "ty", "tz"), TRUTH.reflectors["smr1"].point, strict=True))
    return {
        "robot": {"family": "palletizer4", "parameters": parameters},
        "T_base_tracker": list(TRUTH.tracker.T_base_tracker),
        "payload_kg": 60.0,
        "predicted_95": 0.0001,
        "joint_ranges_rad": [list(ends) for ends in TRUTH.observed.limits],
        "joints_sampled_rad": [list(ends) for ends in TRUTH.observed.limits],
    }


def commit(cell: ObjectCell, value: Mapping[str, Any]) -> None:
    number = cell.ledger.propose(kinematics(OBSERVED), dict(value), {}, 0, None)
    on_disk(lambda: cell.ledger.accept(number, "test"))


def true_place(cell: ObjectCell, q: Any, point: Any = TRUTH.reflectors["smr1"].point) -> Any:
    """(3,): where the reflector truly is at joints ``q``, in the base, or another ``point`` of the flange."""
    arm = cell.plant.world.observed
    assert arm is not None
    return arm.true.flange(np.asarray(q)).apply(point)


def test_targets_are_asked_for_as_given_and_corrected_and_what_remains_is_true(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(targets_config(tmp_path, {"max_error_m": 0.0005}), job=JOB) as cell:
            assert (await refused(cell.start())).name == "TARGETS_NO_KINEMATICS"
            commit(cell, true_kinematics())
            planned = plan_text((await cell.dry_run())["plan"])
            assert "4       x 1" in planned.replace("\n", " "), planned
            end = await cell.run_job()
            assert (end["outcome"], end["verdict"]) == ("complete", "pass"), end
            run_id = cell.engine.last["run_id"] if cell.engine.last else 0
            found = cell.result(run_id)["result"]
            assert (found["before"]["targets"], found["after"]["targets"]) == (4, 4)
            assert found["after"]["max_m"] < 0.0001 < 0.002 < found["before"]["rms_m"]
            for target in found["targets"]:
                wanted = from_pose6(target["T_base_flange"]).apply(TRUTH.reflectors["smr1"].point)
                for way in ("before", "after"):
                    reached = target[way]
                    off = np.linalg.norm(true_place(cell, reached["q"]) - wanted)
                    assert abs(off - reached["error_m"]) < reached["error_95_m"] < 0.0002
            path = cell.folder(run_id).path / "corrected-targets.json"
            assert solve_targets(path, 0.0005).as_json()["result"] == found
            assert judged(path, tmp_path, moved_m=0.002) == ["targets.stand"]
            assert judged(path, tmp_path, arrivals=5) == ["targets.lost"]

    run_virtual(main())


def judged(path: Path, folder: Path, moved_m: float = 0.0, arrivals: int = 8) -> list[str]:
    """Codes of the warnings about a run whose tracker was moved, or that ended early."""
    data = json.loads(path.read_text("utf-8"))
    data["T_base_tracker"][0] += moved_m
    data["arrivals"] = data["arrivals"][:arrivals]
    changed = folder / "corrected-targets.json"
    changed.write_text(json.dumps(data), "utf-8")
    return [w.code for w in solve_targets(changed, None).warnings]


def test_a_person_is_told_the_command_which_a_plc_reads_and_without_a_tracker_the_joints_judge(
    tmp_path: Path,
) -> None:
    async def main() -> None:
        job = {"reflector": None, "as_given": False}
        config = targets_config(tmp_path, job, observed_keys={"handshake": False})
        async with open_cell(config, job=JOB) as cell:
            commit(cell, true_kinematics())
            run_id, plc = await cell.start(), PlcFace(config, cell.engine)
            await cell.until(lambda: plc.snapshot()["prompt_id"], "a prompt")
            assert cell.engine.run is not None
            assert cell.engine.run.prompt is not None
            number, text = cell.engine.run.prompt
            said, shown = text.split("move palletizer to ")[1].split(" deg")[0], plc.snapshot()
            q = np.radians([float(v) for v in said.split(", ")])
            command = [shown[name] for name in ("target_x_m", "target_y_m", "target_z_m", "target_yaw_rad")]
            assert f"corrected (x {1e3 * command[0]:.3f} mm, y {1e3 * command[1]:.3f} mm" in text
            believed = chain_of(config.robot.observed_robot_spec() or {}).flange(q[None])
            assert np.allclose(believed[0, :3, 3], command[:3], atol=1e-5), "what the controller is told"
            assert 0.001 < np.linalg.norm(np.subtract(command[:3], TARGETS[0][:3])) < 0.01

            arm = cell.plant.world.observed
            assert arm is not None
            cell.plant.observed.settle_past()
            arm.go(cell.clock.now(), q + 0.001)
            await cell.clock.sleep(6.0)
            await cell.engine.confirm(number, "test")
            await cell.until(lambda: cell.engine.run and cell.engine.run.prompt, "the next prompt")
            await cell.engine.finish("test")
            await cell.until(lambda: not cell.engine.active, "the end")
            assert plc.snapshot().get("target_x_m", 0.0) == 0.0
            found = cell.result(run_id)
            assert [w["code"] for w in found["warnings"]] == ["targets.lost"]
            reached = found["result"]["targets"][0]["after"]
            assert found["result"]["after"]["targets"] == 1
            assert reached["error_m"] == reached["by_joints_m"]
            wanted = true_place(cell, found["result"]["targets"][0]["q"], [0.0, 0.0, 0.0])
            off = np.linalg.norm(true_place(cell, reached["q"], [0.0, 0.0, 0.0]) - wanted)
            assert abs(off - reached["error_m"]) < 1e-5 < 0.001 < off
            assert reached["error_95_m"] == 0.0001

    run_virtual(main())


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ([9.0, 0.0, 0.5, 0.0], "target 1: the controller's own model does not reach it"),
        ([1.7, 0.4, 0.6, 0.0, 0.0, 0.3], "an arm with 4 joints needs x, y, z, yaw"),
    ],
)
def test_check_names_a_target_that_the_arm_cannot_take(
    tmp_path: Path, target: list[float], said: str
) -> None:
    config = targets_config(tmp_path, {"targets": [target], "q_near": [0.0, 1.57, -1.57, 0.0]})
    job = CorrectedTargetsConfig.model_validate(config.job_section(JOB))
    (problem,) = targets_expectation(setup_of(config), job)["problems"]
    assert said in problem


def test_a_target_that_the_arm_refuses_is_left_out_and_a_broken_beam_is_found_again(tmp_path: Path) -> None:
    async def main() -> None:
        beyond = [-1.7, 0.2, 0.6, 0.0]  # behind the arm, where its own program does not go
        job = {"targets": [beyond, TARGETS[0]], "as_given": False, "request_timeout_s": 8.0}
        async with open_cell(targets_config(tmp_path, job), job=JOB) as cell:
            unknown = ("joint_ranges_rad", "joints_sampled_rad")  # of kinematics from before they were kept
            commit(cell, {k: v for k, v in true_kinematics().items() if k not in unknown})
            tracker = cell.plant.plants["tracker"]
            cell.at_state("measure", lambda: tracker.inject("beam-break", {"duration_s": 2.7}), 0.05)
            end = await cell.run_job()
            assert (end["outcome"], end["verdict"]) == ("complete", "warn"), end
            assert "shows no number, not 1" in cell.notes(1, "target lost")[0]["why"]
            assert "reacquire" in [line.get("state") for line in cell.journal(1)]
            assert "targets.outside-sampled" in [w["code"] for w in cell.result(1)["warnings"]]
            found = cell.result(1)["result"]
            assert [t["after"] is None for t in found["targets"]] == [True, False]
            assert found["after"]["max_m"] < 0.0001

    run_virtual(main())
