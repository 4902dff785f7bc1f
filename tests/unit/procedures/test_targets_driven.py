"""Targets that the arm is driven to after a check of a fixed camera, on virtual time."""

import json
from pathlib import Path

import numpy as np
import pytest

from cell.poses import exp_xi, from_pose6, to_pose6
from daemon.config import CellConfig
from fakes.object import run_virtual
from fakes.world.scenario import Scenario
from fakes.world.world import World
from procedures.documents import read_result
from procedures.eye_to_hand.report.layout import driven_section
from procedures.eye_to_hand.result import AxbcResult
from procedures.eye_to_hand.truth import judge_standard
from procedures.eye_to_hand.words import axbc_lines
from procedures.report.source import Source
from tests.chaos.matrix import inject_at, kind
from tests.kit.object_cell import WHO, ObjectCell, no_report, open_cell
from tests.kit.solved import solve_axbc
from tests.unit.procedures.test_eye_to_hand_check import CHECK, config, erring_scenario, give_hand_eye

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")

STEPS = ([0.03, 0.02, 0.02], [-0.04, 0.03, 0.05], [0.03, -0.04, 0.04], [-0.03, -0.03, -0.02])  # m
AWAY = [0.0, 0.0, 3.0]  # m along the camera's axis: no arm is so long
DRIVING = "Confirm to drive there"  # ends the question before the targets
BEHIND = [0.0, 0.0, -2.0]


def wanted(*steps: list[float]) -> list[list[float]]:
    """The flange in the camera with the arm at home, moved by ``steps`` (m) along the camera's axes."""
    scenario = Scenario.load("hand_eye_to_hand:ideal")
    world = World.from_scenario(scenario)
    home = np.array(scenario.cell.poses["home"], dtype=float)
    at = from_pose6(world.truth()["T_base_camera"]).inv() * world.believed.forward(home)
    return [to_pose6(exp_xi([*step, 0.0, 0.0, 0.0]) * at).tolist() for step in steps]


async def driven_run(cell: ObjectCell, answer: str = "confirm") -> tuple[int, str]:
    """The run, and what was asked before the targets; ``answer`` is a call of the engine."""
    run_id = await cell.start(placed=False)
    asked = ""
    while cell.engine.active:
        run = cell.engine.run
        if run is not None and run.prompt is not None:
            number, text = run.prompt
            if DRIVING in text:
                asked = text
                assert cell.at_rest()
            if asked and answer in ("finish", "abort"):
                await getattr(cell.engine, answer)(WHO)
            else:
                await getattr(cell.engine, answer if asked else "confirm")(number, WHO)
        await cell.clock.sleep(0.05)
    return run_id, asked


def erring(tmp_path: Path, targets: list[list[float]]) -> CellConfig:
    return config(tmp_path, scenario=erring_scenario(tmp_path), poses=24, targets=targets)


def test_corrected_targets_are_nearer_and_what_is_stated_of_them_is_true(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(erring(tmp_path, wanted(*STEPS)), job=CHECK) as cell:
            give_hand_eye(cell)
            run_id, asked = await driven_run(cell)
            end, result = cell.end(run_id), cell.result(run_id)
            assert end["outcome"] == "complete", end
            assert (
                "8 moves to targets, as given and corrected by the arm's model, which moves them by" in asked
            )
            assert asked.startswith(("The check passed", "The check has warnings", "The check FAILED"))
            assert "the given hand-eye is off by" in asked.partition("moves to targets")[0]
            driven = result["result"]["driven"]
            assert driven["lost"] == []
            assert driven["better"] is True
            assert driven["after_rms_m"] < driven["before_rms_m"] / 3.0
            for target in driven["targets"]:
                assert target["after"]["off_m"] < target["before"]["off_m"]
                assert 0.0 < target["after"]["common_95_m"] < target["after"]["off_95_m"]
            found = read_result(result)
            assert isinstance(found, AxbcResult)
            truth = cell.plant.world.truth()
            judged = judge_standard(found, truth, cell.folder(run_id).path)
            print("\n".join(axbc_lines(found)), judged.text, sep="\n")
            assert judged.good, judged.text
            assert "common to all targets, and its own part added in squares)" in "\n".join(axbc_lines(found))
            assert solve_axbc(cell.folder(run_id).path)["result"] == result["result"]
            assert found.result.driven is not None
            page = str(driven_section(Source(found)))
            assert "corrected targets are surely nearer than as given" in page
            assert "common to all targets" in page
            after = found.result.driven.targets[0].after
            assert after is not None
            after.off[0] += 0.002
            assert not judge_standard(found, truth, cell.folder(run_id).path).good
            assert cell.at_rest()
            home = np.array(cell.config.poses["home"])
            at = cell.plant.world.track.at(cell.clock.now())[0]
            np.testing.assert_allclose(at, home, atol=1e-3)

    run_virtual(main())


def test_a_constant_is_driven_and_a_correction_that_is_not_nearer_is_warned_of(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(config(tmp_path, targets=wanted(*STEPS[:3])), job=CHECK) as cell:
            give_hand_eye(cell, off_m=0.0008)
            run_id, asked = await driven_run(cell)
            assert "as given and corrected by a constant" in asked
            assert cell.result(run_id)["result"]["driven"]["better"] is True
            folder = cell.folder(run_id).path
            data = json.loads((folder / "axbc.json").read_text("utf-8"))
            for arrival in data["driven"]["arrivals"]:
                arrival["how"] = "corrected" if arrival["how"] == "given" else "given"
            (tmp_path / "axbc.json").write_text(json.dumps(data), "utf-8")
            worse = solve_axbc(tmp_path)
            assert worse["result"]["driven"]["better"] is False
            (said,) = [w["text"] for w in worse["warnings"] if w["code"] == "targets.not-better"]
            assert said.startswith("corrected targets are not surely nearer than as given")

    run_virtual(main())


def test_where_no_correction_is_better_only_the_given_ones_are_driven_to(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(config(tmp_path, targets=wanted(*STEPS[:2])), job=CHECK) as cell:
            give_hand_eye(cell)
            run_id, asked = await driven_run(cell)
            assert "2 moves to targets, as given only, since no correction is surely better" in asked
            driven = cell.result(run_id)["result"]["driven"]
            assert driven["way"] == "none"
            assert "better" not in driven
            assert not any(t["after"] for t in driven["targets"])
            assert all(t["before"]["off_m"] < t["before"]["off_95_m"] for t in driven["targets"])

    run_virtual(main())


def test_targets_out_of_reach_and_out_of_sight_are_named_and_the_others_driven_to(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(erring(tmp_path, wanted(AWAY, STEPS[0], BEHIND)), job=CHECK) as cell:
            give_hand_eye(cell)
            run_id, asked = await driven_run(cell)
            assert "2 moves to targets" in asked
            listed, _, left_out = asked.partition("; left out: ")
            assert "target 2 as given" in listed
            assert not any(f"target {k} as given" in listed for k in (1, 3))
            assert all(f"target {k} as given: " in left_out for k in (1, 3))
            driven = cell.result(run_id)["result"]["driven"]
            assert any(text == "target 1 corrected: out of the arm's reach" for text in driven["lost"]), (
                driven
            )
            assert sum(text.startswith("target 1 ") for text in driven["lost"]) == 2
            assert sum(text.startswith("target 3 ") for text in driven["lost"]) == 2
            assert driven["targets"][1]["after"]
            assert driven["targets"][0]["before"] is None
            assert "targets.lost" in [w["code"] for w in cell.result(run_id)["warnings"]]

    run_virtual(main())


@pytest.mark.parametrize(
    ("answer", "said"), [("skip", "skipped by the operator"), ("finish", "the run was finished early")]
)
def test_targets_that_were_not_wanted_are_not_driven_to(answer: str, said: str, tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(config(tmp_path, targets=wanted(STEPS[0])), job=CHECK) as cell:
            give_hand_eye(cell)
            run_id, asked = await driven_run(cell, answer)
            assert " 1 move to targets, as given only" in asked
            assert cell.end(run_id)["outcome"] == "complete"
            driven = cell.result(run_id)["result"]["driven"]
            assert driven["lost"] == [f"target 1 as given: {said}"]
            assert "stands" not in driven, "it never left"
            assert cell.notes(run_id, "target seen") == []

    run_virtual(main())


def test_a_run_that_is_finished_on_its_way_keeps_what_was_seen(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(config(tmp_path, targets=wanted(*STEPS[:3])), job=CHECK) as cell:
            give_hand_eye(cell)
            run_id = await cell.start(placed=False)
            finished = False
            while cell.engine.active:
                run = cell.engine.run
                if run is not None and run.prompt is not None:
                    await cell.engine.confirm(run.prompt[0], WHO)
                if not finished and cell.notes(run_id, "target seen"):
                    await cell.engine.finish(WHO)
                    finished = True
                await cell.clock.sleep(0.05)
            assert cell.end(run_id)["outcome"] == "complete"
            driven = cell.result(run_id)["result"]["driven"]
            seen = [t["number"] for t in driven["targets"] if t["before"]]
            assert seen[0] == 1
            assert len(seen) < 3
            assert driven["lost"][-1] == "target 3 as given: the run was finished early"
            assert len(seen) + len(driven["lost"]) == 3
            assert driven["stands"].startswith(
                f"the arm stands at target {seen[-1]} as given: the run was finished early; look whether "
            )
            assert "targets.not-returned" in [w["code"] for w in cell.result(run_id)["warnings"]]

    run_virtual(main())


def test_an_abort_at_the_targets_ends_the_run(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(config(tmp_path, targets=wanted(STEPS[0])), job=CHECK) as cell:
            give_hand_eye(cell)
            run_id, _ = await driven_run(cell, "abort")
            assert cell.end(run_id)["outcome"] == "stopped"
            assert cell.at_rest()

    run_virtual(main())


def test_a_held_run_waits_on_its_way_to_the_targets(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(config(tmp_path, targets=wanted(*STEPS[:2])), job=CHECK) as cell:
            give_hand_eye(cell)
            rested: list[bool] = []
            run_id = await cell.start(placed=False)
            while cell.engine.active:
                run = cell.engine.run
                if run is not None and run.prompt is not None:
                    targets = DRIVING in run.prompt[1]
                    await cell.engine.confirm(run.prompt[0], WHO)
                    if targets:
                        cell.engine.hold(WHO)
                        await cell.clock.sleep(30.0)
                        rested.append(cell.at_rest() and cell.engine.active)
                        assert len(cell.notes(run_id, "target seen")) < 2
                        await cell.engine.resume(WHO)
                await cell.clock.sleep(0.05)
            assert rested == [True]
            assert len(cell.notes(run_id, "target seen")) == 2

    run_virtual(main())


def test_a_move_to_a_target_is_taken_again_after_a_short_silence(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(config(tmp_path, targets=wanted(*STEPS[:2])), job=CHECK) as cell:
            give_hand_eye(cell)
            silent = kind("arm", "silence", "", set(), duration_s=1.5)
            run_id = await cell.start(placed=False)
            while cell.engine.active:
                run = cell.engine.run
                if run is not None and run.prompt is not None:
                    if DRIVING in run.prompt[1]:
                        inject_at(cell, silent, "capture", 0.0)
                    await cell.engine.confirm(run.prompt[0], WHO)
                await cell.clock.sleep(0.05)
            assert cell.end(run_id)["outcome"] == "complete", cell.end(run_id)
            assert cell.engine.run is not None
            assert cell.engine.run.steps_taken.taken_again
            driven = cell.result(run_id)["result"]["driven"]
            assert driven["lost"] == []
            assert all(t["before"] for t in driven["targets"])

    run_virtual(main())


def test_without_targets_nothing_is_asked_and_nothing_is_told(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(config(tmp_path), job=CHECK) as cell:
            give_hand_eye(cell)
            run_id, asked = await driven_run(cell)
            assert asked == ""
            assert "driven" not in cell.result(run_id)["result"]
            assert cell.notes(run_id, "targets") == []

    run_virtual(main())
