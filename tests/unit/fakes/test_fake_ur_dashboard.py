"""The fake dashboard, against the patterns that UR's C++ client library expects of each reply."""

import logging
import re

import pytest

from tests.kit.fake_ur_stepped import Stepped


@pytest.fixture
def subject() -> Stepped:
    return Stepped()


def unknown(subject: Stepped, command: str) -> bool:
    return subject.dashboard.answer(command).startswith("could not understand")


def test_stop_right_after_a_program_ended_says_stopped(subject: Stepped) -> None:
    subject.control()
    subject.register(i0=255)
    subject.until(lambda: not subject.robot.runtime.active)
    assert subject.dashboard.answer("stop") == "Stopped"
    assert subject.dashboard.answer("programState").startswith("STOPPED ")


def test_the_operational_mode_is_set_told_and_cleared(subject: Stepped) -> None:
    ask = subject.dashboard.answer
    assert ask("get operational mode") == "NONE"
    assert re.fullmatch(r"Operational mode .*AUTOMATIC.*", ask("set operational mode AUTOMATIC"))
    assert ask("get operational mode") == "AUTOMATIC"
    assert re.fullmatch(r"No longer controlling the operational mode\..*", ask("clear operational mode"))
    assert ask("get operational mode") == "NONE"
    assert ask("set operational mode sideways") == "Failed setting operational mode: sideways"
    assert ask("get operational mode") == "NONE"


def test_user_roles_are_known_to_cb3_alone() -> None:
    cb3 = Stepped((3, 15, 8, 1))
    for role in ("PROGRAMMER", "OPERATOR", "NONE", "LOCKED", "RESTRICTED"):
        assert cb3.dashboard.answer(f"setUserRole {role}") == f"Setting user role: {role}"
        assert cb3.dashboard.answer("getUserRole") == role
    assert unknown(Stepped(), "getUserRole")
    assert unknown(Stepped(), "setUserRole none")


@pytest.mark.parametrize(
    ("command", "version", "known"),
    [
        ("safetystatus", (5, 3, 0, 1), False),
        ("safetystatus", (5, 4, 0, 1), True),
        ("safetystatus", (3, 15, 8, 1), False),
        ("safetymode", (3, 15, 8, 1), True),
        ("is in remote control", (5, 5, 1, 1), False),
        ("is in remote control", (5, 6, 0, 1), True),
        ("is in remote control", (3, 15, 8, 1), False),
        ("saveLog", (5, 7, 0, 1), False),
        ("saveLog", (5, 8, 0, 1), True),
        ("saveLog", (3, 13, 0, 1), True),
        ("get operational mode", (5, 5, 0, 1), False),
    ],
)
def test_a_command_is_known_from_its_version_on(
    command: str, version: tuple[int, int, int, int], known: bool
) -> None:
    assert unknown(Stepped(version), command) is not known


def test_the_program_state_names_the_file_without_its_folder(subject: Stepped) -> None:
    ask = subject.dashboard.answer
    assert ask("load /ursim/programs/wait_program.urp") == (
        "Loading program: /ursim/programs/wait_program.urp"
    )
    assert ask("programState") == "STOPPED wait_program.urp"
    assert re.fullmatch(r"(false|true) .*\.urp", ask("isProgramSaved"))
    assert ask("load installation default.installation") == "Loading installation: default.installation"
    assert ask("load nonsense.txt") == "File not found: nonsense.txt"


def test_a_flight_report_is_written_to_the_log_and_numbered(
    subject: Stepped, caplog: pytest.LogCaptureFixture
) -> None:
    ask = subject.dashboard.answer
    with caplog.at_level(logging.INFO, "cellward.twin.arm"):
        assert ask("generate flight report ") == "Flight Report generated with id: 1"
        assert ask("generate flight report system") == "Flight Report generated with id: 2"
        assert ask("addToLog testing") == "Added log message"
    assert "flight report 2 (system): q [0.0, -1.8, 1.8" in caplog.text
    assert "log entry of a client: testing" in caplog.text
    assert ask("saveLog") == "Log saved to disk"


def test_a_support_file_is_refused_because_the_twin_writes_none(subject: Stepped) -> None:
    assert subject.dashboard.answer("generate support file .").startswith("Error: ")
