"""What the page offers to start in a cell with several tools, and with recipes."""

import asyncio
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cell.errors import CellError
from daemon.config import CellConfig, load_config
from daemon.startable import Startable, startables
from daemon.web import jobs_view
from daemon.web.jobs_view import JobsView
from daemon.worker import InlineWorker
from fakes.object import run_virtual
from procedures.registry import JOBS
from tests.kit.laser_cell import laser_config
from tests.kit.object_cell import on_disk, open_cell, write_config

POSE = [0.0, 0.0, 0.2, 0.0, 0.0, 0.0]
TOOLS: dict[str, Any] = {
    "gripper": {"T_flange_tool": POSE},
    "needle": {"T_flange_tool": POSE, "radius_m": 0.01},
}
BOTH = ("gripper", "needle")
RECIPES = {
    "quick": {"job": "laser-reference", "tool": "needle", "number": 101},
    "any": {"job": "laser-check"},
}


def two_tools(folder: Path) -> CellConfig:
    """The crossed-beam cell where every start has to say which of two tools is on the flange."""
    path = Path(laser_config(folder, tool=TOOLS, recipe=RECIPES).source)
    head, _, rest = path.read_text("utf-8").partition("[robot.tool]")
    path.write_text(head + "[" + rest.partition("\n[")[2], "utf-8")
    return load_config(path)


def of(config: CellConfig, name: str) -> Startable:
    return next(one for one in startables(config, JOBS) if one.name == name)


def test_jobs_come_with_the_tools_to_choose_from_and_recipes_after_them(tmp_path: Path) -> None:
    config = two_tools(tmp_path)
    assert of(config, "laser-check") == Startable("laser-check", "laser-check", 3, False, BOTH, None)
    assert of(config, "quick") == Startable("quick", "laser-reference", 101, True, BOTH, "needle")
    assert of(config, "any") == Startable("any", "laser-check", None, True, BOTH, None)
    assert of(config, "belt-tracking").tools == (), "it has no section, so nothing can be chosen for it"
    assert [one.name for one in startables(config, JOBS)][-2:] == ["quick", "any"]


def test_what_a_plc_may_give_with_a_start_can_be_chosen_but_what_a_recipe_has_settled(tmp_path: Path) -> None:
    recipe = {"pull-2": {"job": "slot-insertion", "slot": 2}}
    config = write_config(tmp_path, "slot", jobs={"slot-insertion": {"slot": 1}}, recipe=recipe)
    slot, action = of(config, "slot-insertion").choices
    assert (slot.key, slot.value, slot.least, slot.most) == ("slot", 1, 1, 10000)
    assert (action.key, action.value, action.words) == ("action", "insert", ("insert", "pull", "replace"))
    assert of(config, "pull-2").choices == (action,)
    assert of(config, "belt-tracking").choices == (), "it has no section"


def test_one_tool_alone_leaves_no_choice(tmp_path: Path) -> None:
    assert of(laser_config(tmp_path), "laser-check") == Startable(
        "laser-check", "laser-check", 3, False, (), "pin"
    )


def write_altered(folder: Path) -> None:
    """A run whose result is not the one that it ended with."""
    folder.mkdir()
    (folder / "result.json").write_text("{}", "utf-8")
    (folder / "end.json").write_text(json.dumps({"result_sha256": 64 * "0"}), "utf-8")


def test_the_page_lists_them_and_predicts_for_the_tool_that_was_chosen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(jobs_view, "prediction_of", lambda config, job, tool: {"of": [job, tool]})

    async def main() -> None:
        async with open_cell(two_tools(tmp_path), job="laser-reference") as cell:
            on_disk(cell.ledger.start_run, 7, "laser-reference", "folder", "anna", "web", "needle")
            visitors: Any = SimpleNamespace(require_look=lambda request: None)
            subject = JobsView(cell.engine, visitors, InlineWorker())
            request: Any = SimpleNamespace(match_info={"job": "laser-reference"}, query={})
            listed = {one["name"]: one for one in json.loads((await subject.jobs(request)).body)}
            assert listed["laser-reference"]["obstacle"] is None, "with one of the tools it can be started"
            assert "no reference for this tool" in listed["any"]["obstacle"]["text"]
            assert (listed["quick"]["configured"], listed["quick"]["last"]["run_id"]) == (True, 7)
            assert listed["quick"]["last"]["verdict"] is None
            await asyncio.to_thread(write_altered, cell.engine.runs / "folder")
            listed = {one["name"]: one for one in json.loads((await subject.jobs(request)).body)}
            assert listed["quick"]["last"]["verdict"] == "altered", "the ledger does not know"
            with pytest.raises(CellError, match="tool=gripper or tool=needle"):
                await subject.expected(request)
            for tool in BOTH:
                request.query = {"tool": tool}
                answer = json.loads((await subject.expected(request)).body)
                assert answer == {"expected": {"of": ["laser-reference", tool]}}

    run_virtual(main())


def test_a_prediction_is_never_computed_where_jobs_plan_and_solve(tmp_path: Path) -> None:
    """Somebody who looks at the page delays no job, and is told when the computer is too busy."""

    class TooLate(InlineWorker):
        async def call(self, fn: Any, *args: Any, **kwargs: Any) -> Any:
            raise TimeoutError

    async def main() -> None:
        async with open_cell(laser_config(tmp_path), job="laser-reference") as cell:
            cell.engine.context.worker = Broken()
            visitors: Any = SimpleNamespace(require_look=lambda request: None)
            request: Any = SimpleNamespace(match_info={"job": "laser-reference"}, query={})
            answer = await JobsView(cell.engine, visitors, InlineWorker()).expected(request)
            assert json.loads(answer.body)["expected"]["job"] == "laser-reference"
            late = await JobsView(cell.engine, visitors, TooLate()).expected(request)
            assert "too busy" in json.loads(late.body)["expected"]["cautions"][0]

    class Broken(InlineWorker):
        async def call(self, fn: Any, *args: Any, **kwargs: Any) -> Any:
            raise AssertionError("the worker of the jobs was asked")

    run_virtual(main())
