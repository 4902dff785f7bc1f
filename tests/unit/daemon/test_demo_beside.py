"""The steps of the demo on objects, beside those on real protocols."""

from dataclasses import replace
from pathlib import Path

import pytest

from daemon.demo.beside import FOLDER, IDEAL_FOLDER, ObjectSteps
from daemon.demo.closing import Row, beside_ideal, closing_table
from daemon.demo.steps import BELT_TRACKING, STEPS

STEPS_OF_SLOT = STEPS["slot-insertion"]
ROW = '{"job": "slot-insertion", "stated": "0.4 mm", "off": "0.1 mm", "verdict": "pass", "code": 0}'


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What is started instead of the demo's own command."""
    path = tmp_path / "stand-in"
    monkeypatch.setattr("daemon.demo.beside.console_script", lambda name: path)
    return path


def script(path: Path, text: str) -> None:
    path.write_text(f"#!/bin/sh\n{text}\n", "utf-8")
    path.chmod(0o755)


def test_its_rows_say_that_they_are_virtual(
    tmp_path: Path, command: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / FOLDER
    script(command, f"echo \"$@\"; mkdir -p {out}; echo '[{ROW}]' > {out}/rows.json")
    subject = ObjectSteps(tmp_path, STEPS_OF_SLOT)
    with subject.begun():
        (row,) = subject.rows()
    assert (row.job, row.off, row.code) == ("slot-insertion", "0.1 mm", 0)
    assert closing_table([row]) == 0
    assert "slot-insertion (virtual)" in capsys.readouterr().out
    words = (tmp_path / "objects.log").read_text()
    assert "--fast" in words
    assert "--ideal" not in words
    assert [cell.name for cell in subject.cells()] == ["rack"]


def test_what_it_did_not_come_to_is_told_with_its_last_words(tmp_path: Path, command: Path) -> None:
    script(command, "echo the disk is full; exit 3")
    subject = ObjectSteps(tmp_path, STEPS_OF_SLOT)
    with subject.begun():
        rows = subject.rows()
    assert [row.job for row in rows] == ["cone-capture", "slot-insertion"]
    assert all(row.code and "the disk is full" in row.verdict for row in rows)


def test_rows_of_an_earlier_demo_do_not_count(tmp_path: Path, command: Path) -> None:
    out = tmp_path / FOLDER
    out.mkdir()
    (out / "rows.json").write_text(f"[{ROW}]")
    script(command, "exit 0")
    subject = ObjectSteps(tmp_path, STEPS_OF_SLOT)
    with subject.begun():
        assert all(row.code for row in subject.rows())


def test_rows_of_one_job_say_in_which_twin_they_ran(capsys: pytest.CaptureFixture[str]) -> None:
    found = Row("cone-capture", "0.4 mm", "0.1 mm", "pass", 0, "workshop")
    rows = [found, replace(found, twin="rack", virtual=True), replace(found, job="laser-check", twin="bay")]
    assert closing_table(rows) == 0
    first = [line.split("  ")[0] for line in capsys.readouterr().out.strip().splitlines()]
    assert first == ["job", "cone-capture (workshop)", "cone-capture (rack, virtual)", "laser-check"]


def test_ideal_worlds_have_a_process_and_a_folder_of_their_own(tmp_path: Path, command: Path) -> None:
    out = tmp_path / IDEAL_FOLDER
    script(command, f"echo \"$@\"; mkdir -p {out}; echo '[{ROW}]' > {out}/rows.json")
    subject = ObjectSteps(tmp_path, [BELT_TRACKING, *STEPS_OF_SLOT], ideal=True)
    with subject.begun():
        (row,) = subject.rows()
    assert row.off == "0.1 mm"
    words = (tmp_path / "ideal.log").read_text()
    assert all(word in words for word in ("--ideal", "--job belt-tracking", "--job slot-insertion"))


def test_each_row_has_what_became_of_it_in_an_ideal_world(capsys: pytest.CaptureFixture[str]) -> None:
    capture = Row("cone-capture", "0.4 mm", "0.1 mm", "pass", 0, "workshop")
    delays = [Row("latency-calibration", "1 ms", f"0.{k} ms", "pass", 0, "delays") for k in (1, 2)]
    lost = Row("belt-tracking", "-", "-", "not done: no core", 4, "picking")
    kind = [replace(row, off=f"{row.off} there") for row in delays]
    worse = replace(capture, off="2 mm", verdict="fail", code=1)
    rows = beside_ideal([capture, *delays, lost], [*kind, worse])
    assert [row.ideal for row in rows] == ["2 mm: fail", "0.1 ms there", "0.2 ms there", ""]
    assert [row.code for row in rows] == [1, 0, 0, 4]
    assert closing_table(rows) == 4
    assert "off it in an ideal world" in capsys.readouterr().out


def test_without_such_steps_nothing_is_started(tmp_path: Path, command: Path) -> None:
    subject = ObjectSteps(tmp_path, [])
    with subject.begun():
        assert subject.rows() == []
    assert list(tmp_path.iterdir()) == []
