"""Joint limits of the cell against those of the arm's own controller: at a start, and in a probe."""

import json
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cell.errors import CellError
from daemon.cli.probe import judge_limits
from daemon.config import CellConfig
from daemon.controller_limits import limits_in_use, require_within
from daemon.recipes import place_of
from daemon.values import configured_values, resolve_values, with_limits
from fakes.object import run_virtual
from procedures.belt.config import JobLimits
from tests.kit.object_cell import ObjectCell, open_cell, write_config
from tests.kit.picking_cell import picking_config

BOX = [{"min": [-1.3, -1.3, 0.0], "max": [1.3, 1.3, 1.6]}]
TURN = [-6.336, 6.336]  # what a controller tells as delivered
TOLD = {
    "joint_speeds_rad_s": [2.294, 2.294, 3.342, 3.342, 3.342, 3.342],
    "joint_ranges_rad": [[-1.5708, 1.5708], *[TURN] * 5],
}
WIDE = [[-2.5, 1.0], *[[-6.3, 6.3]] * 5]
HALF = [[-1.7, 1.0], *[[-3.0, 3.0]] * 5]


def refusal(limits: dict[str, Any], told: dict[str, Any] = TOLD) -> str:
    with pytest.raises(CellError) as caught:
        require_within({"joint_speed_rad_s": 0.8, "joint_ranges_rad": None, **limits}, told)
    assert caught.value.name == "LIMITS_BEYOND_CONTROLLER"
    return caught.value.detail


def test_each_joint_that_would_be_too_fast_is_named_with_the_limit_that_fits() -> None:
    assert refusal({"joint_speed_rad_s": 2.5}) == (
        "limits.joint_speed_rad_s allows joint 'base' 2.5 rad/s where the controller allows 2.294 rad/s, "
        "joint 'shoulder' 2.5 rad/s where the controller allows 2.294 rad/s: write limits.joint_speed_rad_s "
        "= [2.294, 2.294, 2.5, 2.5, 2.5, 2.5], or raise what the robot's own safety configuration allows"
    )


def test_a_range_beyond_the_controllers_is_named_with_the_one_that_fits() -> None:
    assert refusal({"joint_ranges_rad": HALF}) == (
        "limits.joint_ranges_rad allows joint 'base' from -1.700 to 1.000 rad where the controller allows "
        "from -1.571 to 1.571 rad: write limits.joint_ranges_rad = [[-1.57, 1.0], [-3.0, 3.0], [-3.0, 3.0], "
        "[-3.0, 3.0], [-3.0, 3.0], [-3.0, 3.0]], or raise what the robot's own safety configuration allows"
    )


@pytest.mark.parametrize(
    "limits",
    [
        {"joint_speed_rad_s": [2.294, 2.2, 3.3, 3.3, 3.3, 3.3]},
        {"joint_ranges_rad": [[-1.571, 1.0], *[[-6.3, 6.3]] * 5]},  # a quarter of a turn, rounded
        {"joint_ranges_rad": None},
    ],
)
def test_what_is_within_passes(limits: dict[str, Any]) -> None:
    require_within({"joint_speed_rad_s": 0.8, "joint_ranges_rad": None, **limits}, TOLD)


def test_what_is_written_as_the_fix_passes() -> None:
    speeds = refusal({"joint_speed_rad_s": 3.0}).split("= ")[1].split(", or")[0]
    ranges = refusal({"joint_ranges_rad": HALF}).split("= ")[1].split(", or")[0]
    require_within({"joint_speed_rad_s": json.loads(speeds), "joint_ranges_rad": json.loads(ranges)}, TOLD)


def test_a_range_that_has_nothing_in_common_with_the_controllers_is_told_so() -> None:
    assert refusal({"joint_ranges_rad": [[2.0, 3.0], [-7.0, 3.0], *[[-3.0, 3.0]] * 4]}) == (
        "limits.joint_ranges_rad allows joint 'base' from 2.000 to 3.000 rad where the controller allows "
        "from -1.571 to 1.571 rad, joint 'shoulder' from -7.000 to 3.000 rad where the controller allows "
        "from -6.336 to 6.336 rad: joint 'base' cannot go there; choose another range, or raise what the "
        "robot's own safety configuration allows"
    )


def test_a_range_just_outside_the_controllers_is_no_rounded_one() -> None:
    ranges = [[1.5709, 1.5712], *[[-3.0, 3.0]] * 5]
    assert "joint 'base' cannot go there" in refusal({"joint_ranges_rad": ranges})


def of_job(tmp_path: Path, job_limits: Any, told: dict[str, Any], **limits: Any) -> Any:
    """The limits of a job that moves an arm whose controller ``told`` this."""
    config = write_config(tmp_path, limits={"workspace": BOX, "allow_job_override": True, **limits})
    procedure: Any = SimpleNamespace(
        name="belt-tracking", config=SimpleNamespace(limits=job_limits), uses=lambda: ("arm",)
    )
    return with_limits(configured_values(config), procedure, told).limits


def test_joint_speeds_of_a_job_are_corrected_in_its_own_section(tmp_path: Path) -> None:
    with pytest.raises(CellError) as caught:
        of_job(tmp_path, JobLimits(joint_speed_rad_s=2.5), TOLD)
    assert caught.value.detail.startswith("job.belt-tracking.limits.joint_speed_rad_s allows joint 'base'")
    assert "write job.belt-tracking.limits.joint_speed_rad_s = [2.294, " in caught.value.detail


def test_a_run_plans_no_farther_than_the_controller_allows(tmp_path: Path) -> None:
    """Though a quarter of a turn may be written as 1.571."""
    subject = of_job(tmp_path, None, TOLD, joint_ranges_rad=[[-1.571, 1.0], *[[-6.0, 6.0]] * 5])
    assert subject["joint_ranges_rad"] == [[-1.5708, 1.0], *[[-6.0, 6.0]] * 5]


def test_an_arm_that_tells_nothing_is_judged_by_nothing() -> None:
    require_within({"joint_speed_rad_s": 9.0, "joint_ranges_rad": HALF}, {})


def cell_with(tmp_path: Path, limits: dict[str, Any], **told: Any) -> CellConfig:
    """The shipped cell ``hand_eye`` whose controller was given these limits."""
    text = files("fakes").joinpath("scenarios/hand_eye.toml").read_text("utf-8")
    lines = "".join(f"{key} = {value}\n" for key, value in told.items())
    path = tmp_path / "scenario.toml"
    path.write_text(f"{text}\n[world.arm.controller_limits]\n{lines}", "utf-8")
    return write_config(tmp_path, str(path), limits={"workspace": BOX, **limits})


def with_cell(config: CellConfig, look: Any) -> Any:
    async def main() -> Any:
        async with open_cell(config) as cell:
            return await look(cell)

    return run_virtual(main())


def test_a_start_is_refused_in_one_sentence(tmp_path: Path) -> None:
    config = cell_with(tmp_path, {"joint_speed_rad_s": 0.8}, joint_speeds_rad_s=[0.5, *[3.0] * 5])

    async def look(cell: ObjectCell) -> CellError | None:
        return await cell.engine.needs.obstacle("cone-capture")

    found = with_cell(config, look)
    assert found is not None
    assert found.name == "LIMITS_BEYOND_CONTROLLER"
    assert "joint 'base' 0.8 rad/s where the controller allows 0.500 rad/s" in found.detail


@pytest.mark.parametrize("told", [{}, {"joint_ranges_rad": [TURN] * 6}])
def test_limits_are_as_they_were_where_the_controller_narrows_nothing(
    told: dict[str, Any], tmp_path: Path
) -> None:
    """What ``run.json`` keeps of them, so that a run from before there were ranges can be taken up."""
    subject = limits_in_use(write_config(tmp_path, limits={"workspace": BOX}), told)
    assert "joint_ranges_rad" not in subject


def test_a_controller_that_narrows_a_joint_by_less_than_a_thousandth_is_kept_to(tmp_path: Path) -> None:
    own = [[-6.2831, 6.2831], *[TURN] * 5]
    config = write_config(tmp_path, limits={"workspace": BOX})
    assert limits_in_use(config, {"joint_ranges_rad": own})["joint_ranges_rad"] == own


def test_without_ranges_of_its_own_a_run_keeps_to_those_of_the_controller(tmp_path: Path) -> None:
    narrow = [[-1.0, 1.0], *[[-6.3, 6.3]] * 5]
    config = cell_with(tmp_path, {}, joint_ranges_rad=narrow)

    async def resolved(cell: ObjectCell) -> Any:
        return resolve_values(config, cell.engine.ledger, cell.engine.context.supervisor, {"arm"}, None)

    assert with_cell(config, resolved).limits["joint_ranges_rad"] == narrow


@pytest.mark.parametrize(
    ("limits", "exit_code", "doubt"),
    [
        (
            {"joint_speed_rad_s": 2.5},
            2,
            "joint 'base' from -1.571 to 1.571 rad, which is less than the arm can",
        ),
        ({}, 0, "write it as limits.joint_ranges_rad"),
        ({"joint_ranges_rad": [[-1.5, 1.5], *[[-3.0, 3.0]] * 5]}, 0, ""),
        ({"joint_ranges_rad": HALF}, 2, ""),
    ],
)
def test_a_probe_finds_limits_beyond_the_controllers(
    limits: dict[str, Any], exit_code: int, doubt: str, tmp_path: Path
) -> None:
    config = write_config(tmp_path, limits={"workspace": BOX, **limits})
    report: dict[str, Any] = {"device": "arm", "answer": "ok", "exit_code": 0, "doubts": [], **TOLD}
    judge_limits(config, report)
    assert report["exit_code"] == exit_code
    assert ("(4009)" in report["answer"]) == bool(exit_code)
    assert len(report["doubts"]) == bool(doubt)
    assert all(doubt in text for text in report["doubts"])


def test_a_probe_finds_the_limits_that_a_job_brings_of_its_own(tmp_path: Path) -> None:
    limits = {"workspace": BOX, "allow_job_override": True}
    config = picking_config(tmp_path, {"limits": {"joint_speed_rad_s": 2.4}}, limits=limits)
    report: dict[str, Any] = {"device": "arm", "answer": "ok", "exit_code": 0, "doubts": [], **TOLD}
    judge_limits(config, report)
    assert report["exit_code"] == 2
    assert report["answer"].count("joint 'base'") == 1
    assert "write job.belt-tracking.limits.joint_speed_rad_s = [2.294, 2.294, 2.4, " in report["answer"]


def test_a_probe_finds_the_limits_of_a_recipe_and_tells_each_clause_once(tmp_path: Path) -> None:
    limits = {"workspace": BOX, "allow_job_override": True, "joint_ranges_rad": WIDE}
    fast = {"job": "belt-tracking", "limits": {"joint_speed_rad_s": 3.0}}
    config = picking_config(
        tmp_path, {"limits": {"joint_speed_rad_s": 2.4}}, limits=limits, recipe={"fast": fast}
    )
    report: dict[str, Any] = {"device": "arm", "answer": "ok", "exit_code": 0, "doubts": [], **TOLD}
    judge_limits(config, report)
    told = report["answer"]
    assert told.count("write job.belt-tracking.limits.joint_speed_rad_s = [2.294, 2.294, 2.4, ") == 1
    assert told.count("write recipe.fast.limits.joint_speed_rad_s = [2.294, 2.294, 3.0, ") == 1
    assert told.count("limits.joint_ranges_rad allows joint 'base'") == 1


def test_the_limits_of_a_start_stand_in_its_recipe_if_that_has_them(tmp_path: Path) -> None:
    fast = {"job": "belt-tracking", "limits": {"joint_speed_rad_s": 2.4}}
    config = picking_config(tmp_path, recipe={"fast": fast, "plain": {"job": "belt-tracking"}})
    places = [place_of(config, recipe, "belt-tracking", "limits") for recipe in ("", "plain", "fast")]
    assert places == ["job.belt-tracking", "job.belt-tracking", "recipe.fast"]
