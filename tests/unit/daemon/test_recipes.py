"""Recipes: a job with some of its arguments, started by its name or, from a PLC, by its number."""

import json
from pathlib import Path
from typing import Any

import pytest

from daemon.config import CellConfig, ConfigInvalid
from daemon.config.schema import json_schema
from daemon.modbus.command import Command
from daemon.plc import PlcFace
from daemon.recipes import arguments_of_recipe, with_recipe
from daemon.start_request import StartRequest
from fakes.object import run_virtual
from procedures.registry import JOBS
from tests.kit.laser_cell import laser_config
from tests.kit.object_cell import ObjectCell, open_cell, refused

PIN = {"job": "laser-reference", "tool": "pin", "number": 120, "settle_s": 0.25, "passes": 2}


def cell(folder: Path, **recipes: Any) -> CellConfig:
    return laser_config(folder, recipe=recipes or {"thick-pin": PIN})


def test_a_start_of_a_recipe_is_one_of_its_job_with_its_arguments(tmp_path: Path) -> None:
    config = cell(tmp_path)
    subject = with_recipe(config, StartRequest("thick-pin", {"passes": "1"}, "anna", "control"))
    assert (subject.job, subject.recipe, subject.params) == ("laser-reference", "thick-pin", {"passes": "1"})
    assert arguments_of_recipe(config, subject) == {"tool": "pin", "settle_s": 0.25, "passes": 2}
    plain = StartRequest("laser-check", {}, "anna", "control")
    assert with_recipe(config, plain) == plain
    assert arguments_of_recipe(config, plain) == {}


async def halted(subject: ObjectCell) -> dict[str, Any]:
    run = subject.engine.running
    assert run is not None
    await subject.engine.halt("test")
    await subject.finished(run.id)
    await subject.engine.reset("test")
    return dict(subject.folder(run.id).info)


def test_what_is_given_goes_before_the_recipe_and_that_before_the_section(tmp_path: Path) -> None:
    async def main() -> None:
        async with open_cell(cell(tmp_path), job="thick-pin") as subject:
            await subject.start(params={"passes": "3"}, placed=False)
            info = await halted(subject)
            assert (info["job"], info["recipe"]) == ("laser-reference", "thick-pin")
            found = info["job_config"]
            assert (found["passes"], found["settle_s"]) == (3, 0.25)
            assert found["descend_step_m"] == 0.008, "as the section has it"
            assert info["parameters"] == {"passes": "3"}, "an adoption asks for the recipe and these"
            plc = PlcFace(subject.config, subject.engine)
            assert await plc.handle(Command(1, 1, 120)) == 1
            assert subject.engine.status()["job_number"] == 2, "the job that runs is told by its own number"
            assert (await halted(subject))["job_config"]["passes"] == 2
            assert await plc.handle(Command(1, 2, 121)) >= 0x8000
            assert await subject.engine.needs.obstacle("thick-pin") is None
            refusal = await refused(subject.start(job="thin-pin"))
            assert refusal.name == "UNKNOWN_JOB"
            assert str(refusal).endswith(", thick-pin")

    run_virtual(main())


@pytest.mark.parametrize(
    ("recipe", "found"),
    [
        ({"job": "laser-chek"}, "recipe.one.job: there is no job 'laser-chek', did you mean 'laser-check'?"),
        ({"tool": "pin"}, "recipe.one.job: is missing"),
        ({**PIN, "pases": 3}, "recipe.one.pases: "),
        ({**PIN, "passes": 0}, "recipe.one.passes: should be"),
        ({**PIN, "tool": "lance"}, "recipe.one.tool: there is no tool 'lance'; there is pin"),
        ({**PIN, "number": 3}, "recipe.one.number: should be"),
        ({**PIN, "retract_pose": "hme"}, "recipe.one.retract_pose: there is no 'hme' in [poses]"),
        ({**PIN, "number": 121}, "recipe.one.number: 121 is the number of [recipe.other], too"),
    ],
)
def test_what_a_recipe_cannot_mean_is_found_before_it_is_started(
    tmp_path: Path, recipe: dict[str, Any], found: str
) -> None:
    with pytest.raises(ConfigInvalid) as caught:
        cell(tmp_path, other={"job": "laser-check", "number": 121}, one=recipe)
    assert found in "\n".join(caught.value.findings)


def test_a_recipe_cannot_have_the_name_of_a_job(tmp_path: Path) -> None:
    with pytest.raises(ConfigInvalid, match=r"recipe.laser-check: a job has this name"):
        laser_config(tmp_path, recipe={"laser-check": {"job": "laser-check"}})


def test_a_file_without_recipes_keeps_its_digest(tmp_path: Path) -> None:
    assert "recipe" not in laser_config(tmp_path).part_of_a_run()
    assert cell(tmp_path).digest != laser_config(tmp_path).digest


def test_the_schema_has_recipes_and_the_tool_of_a_job() -> None:
    subject = json_schema(JOBS)
    (recipe,) = subject["properties"]["recipe"]["patternProperties"].values()
    assert {"job", "number", "tool"} <= recipe["properties"].keys()
    assert recipe["required"] == ["job"]
    reference = subject["properties"]["job"]["properties"]["laser-check"]["$ref"].rpartition("/")[2]
    assert "tool" in subject["$defs"][reference]["properties"]
    json.dumps(subject)
