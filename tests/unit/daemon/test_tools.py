"""Several tools in one cell: which one a start means, and whose calibrations it works with."""

import re
import shutil
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from cell.calibrations import laser_reference, tool_calibration
from cell.errors import CellError
from cell.store.ledger import Ledger
from daemon.check_due import HOUR_S, CheckDue
from daemon.cli.next_step import next_commands
from daemon.cli.status_text import status_text
from daemon.committed_registers import committed_registers
from daemon.config import CellConfig, ConfigInvalid, load_config
from daemon.config.findings import Findings
from daemon.config.schema import init_text
from daemon.config.untold_loads import check_loads
from daemon.decisions import use_of
from daemon.job_arguments import given_params
from daemon.modbus.command import Command
from daemon.plc import PlcFace
from daemon.start_request import StartRequest
from daemon.tool_references import without_reference
from daemon.tools import asked_tool, loaded_tool, tools_of, usual_tool
from daemon.values import resolve_values, tell_configured
from fakes.object import VirtualClock, run_virtual
from procedures.laser.check import LaserCheck
from procedures.registry import JOBS
from tests.kit.laser_cell import laser_config
from tests.kit.object_cell import ObjectCell, on_disk, open_cell, refused

NEEDLE = [0.0, 0.0, 0.22, 0.0, 0.0, 0.0]
GRIPPER = [0.0, 0.0, 0.18, 0.0, 0.0, 0.0]
TOOLS: dict[str, Any] = {
    "gripper": {"T_flange_tool": GRIPPER, "changer": 1},
    "needle": {"T_flange_tool": NEEDLE, "radius_m": 0.01, "payload_kg": 0.4, "changer": 7},
}
MEASURED = [0.001, 0.0, 0.22, 0.0, 0.0, 0.0]


@pytest.fixture
def ledger(tmp_path: Path) -> Iterator[Ledger]:
    ledger = Ledger(tmp_path / "ledger.sqlite")
    yield ledger
    ledger.close()


def cell(folder: Path, plain: bool = False, **more: Any) -> CellConfig:
    """The crossed-beam cell with two tools of a changer; ``plain``: beside that of ``[robot]``, 'pin'."""
    config = laser_config(folder, tool=TOOLS, **more)
    return config if plain else without_plain(Path(config.source))


def without_plain(path: Path) -> CellConfig:
    """The same without the table ``[robot.tool]``."""
    head, _, rest = path.read_text("utf-8").partition("[robot.tool]")
    path.write_text(head + "[" + rest.partition("\n[")[2], "utf-8")
    return load_config(path)


def commit(ledger: Ledger, name: str, value: Any, configured: Any = None) -> None:
    ledger.accept(ledger.propose(name, value, {}, 1, configured), "test")


def test_the_plain_tool_is_the_one_of_a_start_that_names_none(tmp_path: Path) -> None:
    alone = laser_config(tmp_path)
    assert list(tools_of(alone)) == ["pin"]
    subject = cell(tmp_path, plain=True)
    assert list(tools_of(subject)) == ["pin", "gripper", "needle"]
    assert (usual_tool(subject) or pytest.fail("none")).name == "pin"
    assert (asked_tool(subject, "laser-check", "needle", True) or pytest.fail("none")).name == "needle"


def test_without_a_plain_tool_a_start_has_to_name_one_and_is_told_which_there_are(tmp_path: Path) -> None:
    subject = cell(tmp_path)
    with pytest.raises(CellError, match=r"laser-check needs a tool: .* tool=gripper or tool=needle"):
        asked_tool(subject, "laser-check", None, needed=True)
    with pytest.raises(CellError, match="no tool 'lance'; there is gripper, needle"):
        asked_tool(subject, "laser-check", "lance", needed=True)
    with pytest.raises(CellError, match="no tool 'nedle'; there is gripper, needle"):
        asked_tool(subject, "laser-check", "nedle", needed=True)
    assert asked_tool(subject, "tracker-sampling", None, needed=False) is None


def test_the_section_of_a_job_may_name_its_usual_tool(tmp_path: Path) -> None:
    subject = cell(tmp_path, check={"tool": "needle"})
    assert (usual_tool(subject, "laser-check") or pytest.fail("none")).name == "needle"
    assert usual_tool(subject, "laser-update") is None
    assert "tool" not in subject.job_section("laser-check"), "it is no key of the job's own model"


def test_what_cannot_be_told_apart_is_found_with_its_line(tmp_path: Path) -> None:
    tools = {
        "gripper": {"T_flange_tool": GRIPPER, "changer": 1},
        "needle": {"T_flange_tool": NEEDLE, "changer": 1, "payload_kg": 40.0},
        "pin": {"T_flange_tool": NEEDLE},
    }
    with pytest.raises(ConfigInvalid) as caught:
        laser_config(tmp_path, tool=tools, check={"tool": "needel"})
    found = "\n".join(caught.value.findings)
    assert "tool.needle.changer: 1 is the number of [tool.gripper], too" in found
    assert "tool.needle.payload_kg: 40 kg is more than a" in found
    assert "tool.pin: [robot] tool has this name, too" in found
    assert "job.laser-check.tool: there is no tool 'needel', did you mean 'needle'?" in found


def test_a_file_without_several_tools_keeps_its_digest_and_what_a_run_notes_of_it(tmp_path: Path) -> None:
    subject = laser_config(tmp_path)
    assert "tool" not in subject.part_of_a_run()
    assert "tool" in cell(tmp_path, plain=True).part_of_a_run()
    assert cell(tmp_path, plain=True).digest != subject.digest


def test_a_run_works_with_the_pose_the_load_and_the_reference_of_its_tool(
    tmp_path: Path, ledger: Ledger
) -> None:
    config = cell(tmp_path)
    commit(ledger, tool_calibration("needle"), MEASURED, NEEDLE)
    commit(ledger, laser_reference("gripper"), {"of": "gripper"})
    supervisor: Any = SimpleNamespace(devices={})
    tools = tools_of(config)
    subject = resolve_values(config, ledger, supervisor, ("arm", "beams"), tools["needle"])
    assert subject.tool == {"name": "needle", "T_flange_tool": MEASURED, "radius_m": 0.01}
    assert (subject.payload_kg, subject.laser_reference) == (0.4, None)
    assert {name for name in subject.configured if "gripper" in name} == set(), "nothing of another tool"
    other = resolve_values(config, ledger, supervisor, ("arm", "beams"), tools["gripper"])
    assert (other.tool["T_flange_tool"], other.laser_reference) == (GRIPPER, {"of": "gripper"})
    assert other.payload_kg == config.robot.payload_kg


def test_the_arm_is_not_moved_with_a_load_that_nobody_has_stated(tmp_path: Path) -> None:
    config = cell(tmp_path)
    unloaded = config.model_copy(update={"robot": config.robot.model_copy(update={"load_stated": False})})
    assert loaded_tool(unloaded, "laser-check", "gripper", needed=True) is not None, "a twin carries nothing"
    real = unloaded.model_copy(update={"cell": config.cell.model_copy(update={"twin": False})})
    assert loaded_tool(real, "laser-check", "needle", needed=True) is not None, "it has a load of its own"
    assert loaded_tool(real, "tracker-sampling", "gripper", needed=False) is not None, "it moves nothing"

    async def main() -> None:
        async with open_cell(unloaded, job="laser-reference") as subject:
            subject.engine.context.config = real
            refusal = await refused(subject.start(params={"tool": "gripper"}))
            assert refusal.name == "CONFIG_INVALID"
            assert f"{config.source}: [robot] payload_kg is missing: weigh what is on the" in str(refusal)
            request = StartRequest("laser-reference", {"tool": "gripper"}, "test", "test", dry_run=True)
            planned = await subject.engine.start(request)
            assert planned["plan"]["kind"] == "laser-reference", "a plan moves nothing"

    run_virtual(main())


PLAIN, CAPTURE = "robot.payload_kg: is missing, so ", "cone-capture may not move the arm with tool "


@pytest.mark.parametrize(
    ("plain", "needle", "job", "problem", "warning"),
    [
        ("", {"payload_kg": 0.4}, {}, "", ""),
        ("", {}, {}, f"tool.needle.payload_kg: is missing, so {CAPTURE}'needle'", ""),
        ("tool = {}", {"payload_kg": 0.4}, {}, f"{PLAIN}{CAPTURE}'flange'", ""),
        ("tool = {}", {"payload_kg": 0.4}, {"tool": "needle"}, "", f"{PLAIN}no job may move the arm with"),
        ("tool = {}", None, None, "", f"{PLAIN}no job may move the arm with tool 'flange'"),
    ],
)
def test_a_load_that_is_not_told_is_a_problem_of_the_jobs_that_move_the_arm_with_it(
    plain: str, needle: dict[str, float] | None, job: dict[str, str] | None, problem: str, warning: str
) -> None:
    text = init_text().replace("payload_kg = 1.2", "")
    raw = tomllib.loads(re.sub(r"(?m)^tool = .*$", plain, text))
    raw["tool"] = {} if needle is None else {"needle": needle}
    raw["job"] = {} if job is None else {"cone-capture": {**raw["job"]["cone-capture"], **job}}
    findings = Findings("cell.toml")
    check_loads(raw, JOBS, {"arm": "arm"}, findings)
    assert [problem in said for said in findings.problems] == ([True] if problem else [])
    assert [warning in said for said in findings.warnings] == ([True] if warning else [])


def test_a_job_that_moves_no_arm_wants_no_load_and_a_recipe_is_judged_by_its_own_tool() -> None:
    raw = tomllib.loads(init_text().replace("payload_kg = 1.2", ""))
    belt = {"source": "belt", "belt_z_m": 0.1}
    capture = raw["job"].pop("cone-capture")
    raw["job"] = {"latency-calibration": belt}
    raw["tool"] = {"needle": {"payload_kg": 0.4}}
    findings = Findings("cell.toml")
    check_loads(raw, JOBS, {"arm": "arm"}, findings)
    assert (findings.problems, len(findings.warnings)) == ([], 1)
    capture["tool"] = "needle"
    raw["recipe"] = {"with-gripper": {"job": "cone-capture", **capture, "tool": "gripper"}}
    findings = Findings("cell.toml")
    check_loads(raw, JOBS, {"arm": "arm"}, findings)
    (said,) = findings.problems
    assert "so with-gripper may not move the arm with tool 'gripper'" in said


def test_a_tool_that_was_edited_under_its_version_bars_that_tool_alone(
    tmp_path: Path, ledger: Ledger
) -> None:
    config = cell(tmp_path)
    commit(ledger, tool_calibration("needle"), MEASURED, GRIPPER)
    supervisor: Any = SimpleNamespace(devices={})
    with pytest.raises(CellError, match=r"T_flange_tool\.needle was edited since"):
        resolve_values(config, ledger, supervisor, ("arm",), tools_of(config)["needle"])
    resolve_values(config, ledger, supervisor, ("arm",), tools_of(config)["gripper"])


def test_a_rollback_knows_the_configured_pose_of_each_tool(tmp_path: Path, ledger: Ledger) -> None:
    config = cell(tmp_path)
    for value in (MEASURED, GRIPPER):
        commit(ledger, tool_calibration("needle"), value, NEEDLE)
    tell_configured(config, ledger)
    assert ledger.rollback(tool_calibration("needle"), "test")["value"] == MEASURED
    assert ledger.rollback(tool_calibration("needle"), "test")["value"] == NEEDLE


def test_what_accepting_changes_names_the_tool_and_those_that_stay(tmp_path: Path) -> None:
    config = cell(tmp_path)
    said = use_of(config, tool_calibration("needle"), 2)
    assert said.endswith("while 'needle' is on the flange; nothing changes for 'gripper'.")
    assert "not used: the tools are 'gripper' and 'needle'." in use_of(config, tool_calibration("lance"), 2)


def test_a_plc_names_the_tool_by_its_changer_number() -> None:
    tools = {1: "gripper", 7: "needle"}
    assert given_params(LaserCheck, (0, 0, 7), tools) == {"tool": "needle"}
    assert given_params(LaserCheck, (0, 0, 0), tools) == {}
    with pytest.raises(CellError, match=r"argument_3 \(tool\) is 3; there is 1 gripper, 7 needle"):
        given_params(LaserCheck, (0, 0, 3), tools)
    with pytest.raises(CellError, match="laser-check takes no argument_3, which must be 0"):
        given_params(LaserCheck, (0, 0, 7), {})


def test_what_changed_last_says_by_number_of_which_tool(tmp_path: Path, ledger: Ledger) -> None:
    config = cell(tmp_path)
    commit(ledger, tool_calibration("needle"), MEASURED, NEEDLE)
    subject = committed_registers(config, ledger.versions_now())
    assert (subject["changed_calibration"], subject["changed_changer"]) == (3, 7)
    assert [subject[f"changed_{axis}_m"] for axis in "xyz"] == MEASURED[:3]
    assert "tool_x_m" not in subject, "no tool is the one of a start that names none"
    commit(ledger, "T_flange_camera", [0.0] * 6)
    assert committed_registers(config, ledger.versions_now())["changed_changer"] == 0
    beside = committed_registers(cell(tmp_path, plain=True), ledger.versions_now())
    assert (beside["tool_version"], beside["tool_z_m"]) == (0, tools_of(config)["gripper"].T_flange_tool[2])


def test_a_check_of_one_tool_is_none_of_another(tmp_path: Path) -> None:
    now = 1_800_000_000.0
    ledger = Ledger(tmp_path / "due.sqlite", lambda: now)
    config = cell(tmp_path, plain=True, check_due={"T_flange_tool": {"max_age_h": 24, "max_runs": 1}})
    subject = CheckDue(config, ledger, JOBS, VirtualClock(), lambda: now)

    def run(job: str, tool: str | None) -> None:
        number = ledger.next_run_id()
        ledger.start_run(number, job, f"run-{number}", "test", "test", tool)
        ledger.end_run(number, "complete", "pass")

    for name, value in (("pin", GRIPPER), ("gripper", GRIPPER), ("needle", NEEDLE)):
        commit(ledger, tool_calibration(name), value, value)
    assert subject.due() == []
    now += 25.0 * HOUR_S
    run("laser-check", "needle")
    run("laser-check", None)  # as runs of before several tools are noted: it was the plain one
    (due,) = subject.due()
    assert (due["name"], due["job"], due["tool"]) == ("T_flange_tool.gripper", "laser-check", "gripper")
    for _ in range(2):
        now += 1.0
        run("cone-capture", "needle")
    assert [one["name"] for one in subject.due()] == ["T_flange_tool.gripper", "T_flange_tool.needle"]
    ledger.close()


def test_a_due_check_names_its_tool_where_the_job_has_another_usual_one(tmp_path: Path) -> None:
    ledger = Ledger(tmp_path / "due.sqlite")
    due_after = {"T_flange_tool": {"max_runs": 1}}
    config = cell(tmp_path, plain=True, check={"tool": "needle"}, check_due=due_after)
    asked = {one["name"]: one["tool"] for one in CheckDue(config, ledger, JOBS, VirtualClock()).due()}
    assert asked == {
        "T_flange_tool.pin": "pin",
        "T_flange_tool.gripper": "gripper",
        "T_flange_tool.needle": None,
    }
    ledger.close()


def test_a_tool_without_a_reference_is_told_with_the_command_for_it(tmp_path: Path) -> None:
    config = cell(tmp_path)
    state = Path(config.cell.state_dir)
    state.mkdir(parents=True)
    ledger = Ledger(state / "ledger.sqlite")
    commit(ledger, laser_reference("gripper"), {"of": "gripper"})
    (said,) = without_reference(config)
    assert said.startswith("tool 'needle' has no reference of the crossed beams, so laser-check and laser-up")
    assert said.endswith("cellward start laser-reference -p tool=needle")
    commit(ledger, laser_reference("needle"), {"of": "needle"})
    ledger.close()
    assert without_reference(config) == []
    shutil.rmtree(state)
    assert without_reference(laser_config(tmp_path)) == [], "one tool alone is told when it is used"


def last_run(**said: Any) -> dict[str, Any]:
    return {"run_id": 4, "job": "laser-check", "outcome": "complete", "verdict": "pass", **said}


def test_status_says_of_which_tool_a_run_was_and_gives_commands_for_it() -> None:
    moved = {"result": {"moved": {"moved": True}}}
    said = next_commands(last_run(tool="needle", result=moved), [])
    assert said == ["The tool has moved. To correct its frame: cellward start laser-update -p tool=needle."]
    due = {"name": "T_flange_tool.needle", "why": "it is old", "job": "laser-check", "tool": "needle"}
    status = {"cell": "bay", "packml": "IDLE", "last_run": last_run(tool="needle"), "due": [due]}
    text = status_text(status)
    assert "4 (laser-check of tool 'needle'): complete, verdict pass" in text
    assert "due       T_flange_tool.needle: it is old; cellward start laser-check -p tool=needle" in text
    assert "(laser-check): complete" in status_text({**status, "last_run": last_run(tool=None)})


async def halted(subject: ObjectCell) -> Mapping[str, Any]:
    """What the run that goes on was told, and noted."""
    run = subject.engine.running
    assert run is not None
    await subject.engine.halt("test")
    await subject.finished(run.id)
    await subject.engine.reset("test")
    return subject.folder(run.id).info


def test_a_start_works_with_the_tool_that_it_names_over_every_channel(tmp_path: Path) -> None:
    config = cell(tmp_path)

    async def main() -> None:
        async with open_cell(config, job="laser-reference") as subject:
            refusal = await refused(subject.start())
            assert (refusal.name, "tool=gripper or tool=needle" in str(refusal)) == ("ARGUMENT_INVALID", True)
            await subject.start(params={"tool": "needle"})
            status = subject.engine.status()
            assert status["tool"] == "needle"
            info = await halted(subject)
            assert (info["parameters"], info["values"]["tool"]["name"]) == ({"tool": "needle"}, "needle")
            assert subject.engine.status()["last_run"]["tool"] == "needle"
            plc = PlcFace(config, subject.engine)
            assert await plc.handle(Command(1, 1, 2, args=(0, 0, 0, 0, 0, 1))) == 1
            assert (await halted(subject))["values"]["tool"]["name"] == "gripper"
            assert await plc.handle(Command(1, 2, 2, args=(0, 0, 0, 0, 0, 9))) >= 0x8000
            assert [row["tool"] for row in on_disk(subject.ledger.runs)] == ["gripper", "needle"]

    run_virtual(main())
