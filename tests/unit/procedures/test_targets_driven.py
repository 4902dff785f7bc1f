"""Targets that the arm is driven to after a check of a fixed camera, on virtual time."""

import json
from pathlib import Path

import numpy as np
import pytest

from daemon.config import CellConfig
from fakes.object import run_virtual
from procedures.documents import read_result
from procedures.eye_to_hand.report.layout import driven_section
from procedures.eye_to_hand.result import AxbcResult
from procedures.eye_to_hand.truth import judge_standard
from procedures.eye_to_hand.words import axbc_lines
from procedures.report.source import Source
from procedures.words import deg, mm
from tests.chaos.matrix import inject_at, kind
from tests.kit.check_cell import (
    AWAY,
    BEHIND,
    STEPS,
    check_cell,
    config,
    driven_run,
    erring_scenario,
    once,
    wanted,
)
from tests.kit.object_cell import WHO, no_report
from tests.kit.solved import solve_axbc

__all__ = ["no_report"]
pytestmark = pytest.mark.usefixtures("no_report")


def erring(tmp_path: Path, targets: list[list[float]]) -> CellConfig:
    return config(tmp_path, scenario=erring_scenario(tmp_path), poses=24, targets=targets)


def test_corrected_targets_are_nearer_and_what_is_stated_of_them_is_true(tmp_path: Path) -> None:
    async def main() -> None:
        async with check_cell(erring(tmp_path, wanted(*STEPS))) as cell:
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
            assert {name: unit for name, (_, unit) in judged.limits95.items()} == {
                "translation": "m",
                "rotation": "rad",
                "the worst of 8 arrivals": "m",
            }
            off = {name: judged.of95[name] * size for name, (size, _) in judged.limits95.items()}
            assert judged.off == f"{mm(off['translation'])}, {deg(off['rotation'])}"
            assert "common to all targets, and its own part added in squares)" in "\n".join(axbc_lines(found))
            assert solve_axbc(cell.folder(run_id).path)["result"] == result["result"]
            assert found.result.driven is not None
            page = str(driven_section(Source(found)))
            assert "corrected targets are surely nearer than as given" in page
            assert "common to all targets" in page
            after = found.result.driven.targets[0].after
            assert after is not None
            after.off[0] += 0.003
            assert not judge_standard(found, truth, cell.folder(run_id).path).good
            assert cell.at_rest()
            home = np.array(cell.config.poses["home"])
            at = cell.plant.world.track.at(cell.clock.now())[0]
            np.testing.assert_allclose(at, home, atol=1e-3)

    run_virtual(main())


def test_a_constant_is_driven_and_a_correction_that_is_not_nearer_is_warned_of(tmp_path: Path) -> None:
    async def main() -> None:
        async with check_cell(config(tmp_path, targets=wanted(*STEPS[:3])), off_m=0.0008) as cell:
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
        async with check_cell(config(tmp_path, targets=wanted(*STEPS[:2]))) as cell:
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
        async with check_cell(erring(tmp_path, wanted(AWAY, STEPS[0], BEHIND))) as cell:
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
        async with check_cell(config(tmp_path, targets=wanted(STEPS[0]))) as cell:
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
        async with check_cell(config(tmp_path, targets=wanted(*STEPS[:3]))) as cell:
            run_id, _ = await driven_run(cell, meanwhile=once(cell, cell.engine.finish, seen=1))
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
        async with check_cell(config(tmp_path, targets=wanted(STEPS[0]))) as cell:
            run_id, _ = await driven_run(cell, "abort")
            assert cell.end(run_id)["outcome"] == "stopped"
            assert cell.at_rest()

    run_virtual(main())


def test_a_held_run_waits_on_its_way_to_the_targets(tmp_path: Path) -> None:
    async def main() -> None:
        async with check_cell(config(tmp_path, targets=wanted(*STEPS[:2]))) as cell:
            rested: list[bool] = []

            async def hold(run_id: int) -> None:
                if not rested and cell.notes(run_id, "targets") and cell.state == "move":
                    cell.engine.hold(WHO)
                    await cell.clock.sleep(30.0)
                    rested.append(cell.at_rest() and cell.engine.active)
                    assert len(cell.notes(run_id, "target seen")) < 2
                    await cell.engine.resume(WHO)

            run_id, _ = await driven_run(cell, meanwhile=hold)
            assert rested == [True]
            assert len(cell.notes(run_id, "target seen")) == 2

    run_virtual(main())


def test_a_move_to_a_target_is_taken_again_after_a_short_silence(tmp_path: Path) -> None:
    async def main() -> None:
        async with check_cell(config(tmp_path, targets=wanted(*STEPS[:2]))) as cell:
            silent = kind("arm", "silence", "", set(), duration_s=1.5)

            async def strike() -> None:
                inject_at(cell, silent, "capture", 0.0)

            run_id, _ = await driven_run(cell, asked_first=strike)
            assert cell.end(run_id)["outcome"] == "complete", cell.end(run_id)
            assert cell.engine.run is not None
            assert cell.engine.run.steps_taken.taken_again
            driven = cell.result(run_id)["result"]["driven"]
            assert driven["lost"] == []
            assert all(t["before"] for t in driven["targets"])

    run_virtual(main())


def test_without_targets_nothing_is_asked_and_nothing_is_told(tmp_path: Path) -> None:
    async def main() -> None:
        async with check_cell(config(tmp_path)) as cell:
            run_id, asked = await driven_run(cell)
            assert asked == ""
            assert "driven" not in cell.result(run_id)["result"]
            assert cell.notes(run_id, "targets") == []

    run_virtual(main())
