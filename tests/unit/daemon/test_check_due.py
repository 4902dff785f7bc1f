"""Calibrations that want to be checked again: by age, by runs, and what counts as a check."""

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from cell.errors import CellError
from cell.store.ledger import Ledger
from daemon.check_due import HOUR_S, CheckDue, calibrations_of
from daemon.cli.status_text import status_text
from daemon.config import CellConfig, load_config
from daemon.config.checks import CALIBRATED_ROLES
from daemon.modbus import register_table
from daemon.plc import PlcFace
from fakes.object import VirtualClock, run_virtual
from procedures.kind import KINDS
from procedures.registry import JOBS
from tests.kit.object_cell import open_cell, write_config
from tests.kit.warnings_shown import warnings_shown

TOOL, CAMERA = "T_flange_tool.probe", "T_flange_camera"
BEGIN = 1_800_000_000.0


class Wall:
    """The time of day, s."""

    now = BEGIN

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def wall() -> Wall:
    return Wall()


@pytest.fixture
def ledger(tmp_path: Path, wall: Wall) -> Iterator[Ledger]:
    ledger = Ledger(tmp_path / "ledger.sqlite", wall)
    yield ledger
    ledger.close()


def cell(folder: Path, **rules: dict[str, Any]) -> CellConfig:
    return write_config(folder, "laser:ideal", check_due=rules)


def subject_of(config: CellConfig, ledger: Ledger, wall: Wall) -> CheckDue:
    return CheckDue(config, ledger, JOBS, VirtualClock(), wall)


def run(ledger: Ledger, job: str, verdict: str | None = "pass", outcome: str = "complete") -> None:
    number = ledger.next_run_id()
    ledger.start_run(number, job, f"run-{number}", "test", "test")
    ledger.end_run(number, outcome, verdict)


def commit(ledger: Ledger, name: str, value: Any = None) -> None:
    ledger.accept(ledger.propose(name, value, {}, 1, None), "test")


def tool_name(config: CellConfig) -> str:
    return next(name for name, sort in calibrations_of(config).items() if sort == "T_flange_tool")


def test_without_the_section_nothing_is_due(tmp_path: Path, ledger: Ledger, wall: Wall) -> None:
    subject = subject_of(cell(tmp_path), ledger, wall)
    assert not subject.wanted
    assert subject.due() == []


def test_what_was_never_measured_is_due_at_once_and_names_the_job(
    tmp_path: Path, ledger: Ledger, wall: Wall
) -> None:
    config = cell(tmp_path, T_flange_tool={"max_age_h": 24})
    (entry,) = subject_of(config, ledger, wall).due()
    assert (entry["name"], entry["job"]) == (tool_name(config), "laser-check")
    assert "never measured" in entry["why"]


def test_it_is_due_when_its_measurement_is_older_than_permitted(
    tmp_path: Path, ledger: Ledger, wall: Wall
) -> None:
    config = cell(tmp_path, T_flange_tool={"max_age_h": 24})
    subject = subject_of(config, ledger, wall)
    waiting = ledger.propose(tool_name(config), [0.0] * 6, {}, 1, None)
    wall.now += 20.0 * HOUR_S
    ledger.accept(waiting, "test")  # what counts is when it was measured
    wall.now += 3.9 * HOUR_S
    assert subject.due() == []
    wall.now += 0.2 * HOUR_S
    assert subject.due()[0]["why"] == "checked 24.1 h ago, more than max_age_h = 24"


@pytest.mark.parametrize(
    ("job", "verdict", "outcome", "counts"),
    [
        ("laser-check", "pass", "complete", True),
        ("laser-check", "fail", "complete", False),
        ("laser-check", "warn", "complete", False),
        ("laser-check", None, "aborted", False),
        ("laser-reference", "pass", "complete", False),
    ],
)
def test_only_a_check_that_passed_begins_the_time_anew(
    tmp_path: Path, ledger: Ledger, wall: Wall, job: str, verdict: str | None, outcome: str, counts: bool
) -> None:
    config = cell(tmp_path, T_flange_tool={"max_age_h": 24})
    subject = subject_of(config, ledger, wall)
    commit(ledger, tool_name(config), [0.0] * 6)
    wall.now += 25.0 * HOUR_S
    run(ledger, job, verdict, outcome)
    assert (subject.due() == []) is counts


def test_runs_of_other_jobs_are_counted_since_the_last_check(
    tmp_path: Path, ledger: Ledger, wall: Wall
) -> None:
    config = cell(tmp_path, T_flange_tool={"max_runs": 2})
    subject = subject_of(config, ledger, wall)
    commit(ledger, tool_name(config), [0.0] * 6)
    for job in ("belt-tracking", "laser-check", "belt-tracking", "belt-tracking"):
        assert subject.due() == []
        wall.now += 1.0
        run(ledger, job, "fail" if job == "laser-check" else "pass")
    assert subject.due()[0]["why"] == "3 runs since its last check, more than max_runs = 2"
    wall.now += 1.0
    run(ledger, "laser-check")
    assert subject.due() == []


def test_the_outlook_tells_when_each_is_due_and_the_reason_comes_with_its_figures(
    tmp_path: Path, ledger: Ledger, wall: Wall
) -> None:
    config = cell(tmp_path, T_flange_tool={"max_age_h": 24, "max_runs": 2}, laser_reference={"max_runs": 5})
    subject, name = subject_of(config, ledger, wall), tool_name(config)
    never = next(entry for entry in subject.outlook() if entry["name"] != name)
    assert (never["checked"], never["due_at"], never["runs_left"], never["due"]) == (None, None, None, True)
    commit(ledger, name, [0.0] * 6)
    for left in (3, 2, 1, 0):
        tool = next(entry for entry in subject.outlook() if entry["name"] == name)
        assert (tool["checked"], tool["due_at"]) == (BEGIN, BEGIN + 24 * HOUR_S)
        assert (tool["runs_left"], tool["due"], tool["job"]) == (left, left == 0, "laser-check")
        wall.now += 1.0
        run(ledger, "belt-tracking")
    reasons = {entry["name"]: (entry["cause"], entry["value"], entry["limit"]) for entry in subject.due()}
    assert reasons == {name: ("runs", 4, 2), never["name"]: ("never", None, None)}


def test_a_rollback_brings_back_the_age_of_the_version_before(
    tmp_path: Path, ledger: Ledger, wall: Wall
) -> None:
    config = cell(tmp_path, T_flange_tool={"max_age_h": 24})
    subject, name = subject_of(config, ledger, wall), tool_name(config)
    commit(ledger, name, [0.0] * 6)
    wall.now += 30.0 * HOUR_S
    commit(ledger, name, [0.1] * 6)
    assert subject.due() == []
    ledger.rollback(name, "test")
    assert len(subject.due()) == 1


def test_status_and_plc_are_told_and_nothing_starts(tmp_path: Path) -> None:
    async def main() -> None:
        config = cell(tmp_path, T_flange_tool={"max_age_h": 24})
        clock = VirtualClock()
        async with open_cell(config, clock, "laser-check") as opened:
            subject = CheckDue(config, opened.ledger, JOBS, clock)
            plc = PlcFace(config, opened.engine)
            opened.engine.due = subject.status
            assert warnings_shown(plc.snapshot()["warning_bits"]) == []
            watch = asyncio.create_task(subject.watch())
            await opened.until(subject.status, "what is due")
            assert warnings_shown(plc.snapshot()["warning_bits"]) == ["check_due"]
            text = status_text(opened.engine.status())
            assert f"due       {tool_name(config)}: it was never measured" in text
            assert "cellward start laser-check" in text
            await clock.sleep(30.0)
            assert not opened.engine.active
            assert list(opened.runs.iterdir()) == []
            watch.cancel()
            await asyncio.wait([watch])

    run_virtual(main())


def test_a_rule_says_when_and_for_what(tmp_path: Path) -> None:
    cell(tmp_path, T_flange_tool={"max_age_h": 24})
    path = tmp_path / "cell.toml"
    text = path.read_text("utf-8")
    for wrong, words in (
        ("max_age_h = 0", "check_due.T_flange_tool.max_age_h"),
        ("max_ageh = 24", "did you mean 'max_age_h'"),
        ("", "give max_age_h, max_runs or both"),
    ):
        path.write_text(text.replace("max_age_h = 24", wrong), "utf-8")
        with pytest.raises(CellError, match=words):
            load_config(path)


def test_a_rule_about_what_the_cell_does_not_have_is_found(tmp_path: Path) -> None:
    with pytest.raises(CellError, match=r"check_due.belt: this cell has no device with the role belt"):
        cell(tmp_path, belt={"max_runs": 10})


def test_when_a_check_is_due_is_no_part_of_what_a_run_does(tmp_path: Path) -> None:
    without = write_config(tmp_path, "laser:ideal")
    assert cell(tmp_path, T_flange_tool={"max_age_h": 24}).checksum == without.checksum


def test_every_calibration_of_a_cell_has_a_job_and_a_key() -> None:
    keys = {"T_flange_camera", "T_base_camera", "T_flange_tool", "laser_reference", "kinematics", "belt"}
    keys |= {"time_offset_s"}
    assert {sort for kind in KINDS.values() for sort in kind.measures} == keys
    assert set(CellConfig.model_fields["check_due"].annotation.model_fields) == keys  # type: ignore[union-attr]
    assert set(CALIBRATED_ROLES) == keys
    told = register_table().register("changed_calibration").values.values()
    assert keys <= {text.partition(":")[0] for text in told}
