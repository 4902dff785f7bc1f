"""A run of the twin is signed, packed and verified; whatever is altered is told, wherever it is verified."""

import json
import re
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from cell.errors import error
from cell.store.fingerprint import fingerprint
from cell.store.runs import RunFolder, load_run
from daemon import report_drawing
from daemon.auditor import Auditor
from daemon.requests import Caller, carry_out
from fakes.object import run_virtual
from tests.kit.cli_harness import CellOnDisk, CommandLine, hand_eye_result
from tests.kit.object_cell import open_cell, write_config

SIGNER = {"name": "E. Muster", "role": "approved", "remark": "", "run_id": 1}


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a cell whose run 1 ended complete, was accepted and signed."""
    place = tmp_path_factory.mktemp("cell")

    async def scenario() -> None:
        async with open_cell(write_config(place)) as cell:

            def audit(who: str, what: str, accepted: bool, detail: str) -> None:
                cell.ledger.audit("control", who, what, accepted, detail)

            assert (await cell.run_job())["outcome"] == "complete"
            drawn: list[Path] = []
            cell.engine.report_wanted = drawn.append
            await cell.engine.decisions.accept(1, "somebody", warned=True)
            auditor = Auditor(audit)
            auditor.start()
            digest = fingerprint(cell.folder(1).path).digest
            made = await carry_out(
                cell.engine, auditor, "sign", {**SIGNER, "digest": digest}, Caller("uid 1000", "control")
            )
            assert made["digest"] == digest
            await auditor.stop()
            assert drawn == 2 * [cell.folder(1).path]  # after the decision, and after the signature

    run_virtual(scenario())
    return place


@pytest.fixture
def place(measured: Path, tmp_path: Path) -> Path:
    """A copy of that cell, which a test may alter."""
    shutil.copytree(measured / "state", tmp_path / "state")
    text = (measured / "cell.toml").read_text().replace(str(measured), str(tmp_path))
    (tmp_path / "cell.toml").write_text(text)
    (tmp_path / "cell.toml").chmod(0o600)
    return tmp_path


@pytest.fixture
def subject(place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> CommandLine:
    return CommandLine(monkeypatch, capsys, place / "cell.toml")


def run_in(place: Path) -> RunFolder:
    return load_run(place / "state" / "runs", 1)


def test_a_run_as_it_was_is_good_and_solves_to_the_same_answer(place: Path, subject: CommandLine) -> None:
    done = subject("verify", 1)
    assert done.code == 0, done.out
    assert "by E. Muster (approved): for these very files" in done.out
    assert "solved again from the raw data: the same answer" in done.out
    assert done.out.splitlines()[-1] == "good"


def test_a_bundle_is_good_without_its_cell(place: Path, subject: CommandLine, tmp_path: Path) -> None:
    assert subject("bundle", 1, "-o", tmp_path / "run.zip").code == 0
    shutil.rmtree(place / "state")
    (place / "cell.toml").unlink()
    done = subject("verify", tmp_path / "run.zip", "--json")
    found = json.loads(done.out)
    assert (done.code, found["good"], found["solved_again"]) == (0, True, True)
    assert [(s["name"], s["wrong"]) for s in found["signatures"]] == [("E. Muster", None)]
    assert subject("verify", tmp_path / "run.zip", "--digest", found["digest"][:16]).code == 0
    wrong = subject("verify", tmp_path / "run.zip", "--digest", "0123456789abcdef")
    assert wrong.code == 1
    assert "not 0123456789abcdef" in wrong.out
    with zipfile.ZipFile(tmp_path / "run.zip") as archive:
        names = {Path(name).name for name in archive.namelist()}
        about = json.loads(archive.read(next(n for n in archive.namelist() if n.endswith("bundle.json"))))
    assert {"run.json", "result.json", "capture.json", "report.html", "journal.jsonl"} <= names
    assert about["decisions"][0]["who"] == "somebody"
    assert about["made_by"]["cellward"]


def shift_the_camera(folder: Path) -> None:
    result = json.loads((folder / "result.json").read_text())
    result["result"]["T_flange_camera"][0] += 1e-6
    (folder / "result.json").write_text(json.dumps(result))


def move_a_pose(folder: Path) -> None:
    data = json.loads((folder / "capture.json").read_text())
    data["observations"][0]["T_base_flange"][0] += 1e-5
    (folder / "capture.json").write_text(json.dumps(data))


@pytest.mark.parametrize(
    ("alter", "name"), [(shift_the_camera, "result.json"), (move_a_pose, "capture.json")]
)
def test_an_altered_file_of_a_signed_run_is_named_and_the_answer_is_not_the_same(
    place: Path, subject: CommandLine, alter: Callable[[Path], None], name: str
) -> None:
    alter(run_in(place).path)
    done = subject("verify", 1)
    assert done.code == 1
    assert f"NOT AS IT WAS: {name} was altered" in done.out
    assert "WRONG: it is for other files" in done.out
    assert "NOT THE SAME ANSWER" in done.out
    assert done.out.splitlines()[-1] == "NOT GOOD"


def test_a_forger_who_corrects_all_sums_is_found_by_answer_and_audit(
    place: Path, subject: CommandLine
) -> None:
    folder = run_in(place).path
    shift_the_camera(folder)
    line = json.loads((folder / "signatures.jsonl").read_text())
    now = fingerprint(folder).record
    line |= {"sums": dict(now.sums), "digest": now.digest}
    (folder / "signatures.jsonl").write_text(json.dumps(line) + "\n")
    done = subject("verify", 1)
    assert done.code == 1
    assert "NOT AS IT WAS" not in done.out  # the files themselves fit together again
    assert "WRONG: the audit of this cell has no such signature" in done.out
    assert "NOT THE SAME ANSWER" in done.out


def test_a_bundle_that_was_packed_anew_names_what_differs(
    place: Path, subject: CommandLine, tmp_path: Path
) -> None:
    assert subject("bundle", 1, "-o", tmp_path / "run.zip").code == 0
    shutil.unpack_archive(tmp_path / "run.zip", tmp_path / "out")
    folder = tmp_path / "out" / run_in(place).path.name
    shift_the_camera(folder)
    (folder / "journal.jsonl").unlink()
    shutil.make_archive(str(tmp_path / "forged"), "zip", tmp_path / "out")
    done = subject("verify", tmp_path / "forged.zip")
    assert done.code == 1
    assert re.findall("NOT AS IT WAS: (.*)", done.out) == [
        "journal.jsonl is missing",
        "result.json was altered",
    ]


def test_the_report_tells_who_decided_and_who_signed(place: Path, subject: CommandLine) -> None:
    path = Path(subject("report", 1).out.strip())
    text = path.read_text("utf-8")
    assert "decided by somebody on" in text
    assert "E. Muster" in text
    assert fingerprint(path.parent).digest in text


def test_a_report_drawn_after_a_signed_record_was_changed_says_so(place: Path, subject: CommandLine) -> None:
    path = Path(subject("report", 1).out.strip())
    assert "changed after signing" not in path.read_text("utf-8")
    move_a_pose(path.parent)
    assert Path(subject("report", 1).out.strip()) == path
    assert "changed after signing: capture.json was altered" in path.read_text("utf-8")


def test_the_daemon_draws_a_report_that_tells_the_decision(place: Path) -> None:
    path = run_in(place).path / "report.html"
    assert "waited for a decision" in path.read_text("utf-8")
    assert report_drawing.main(path.parent) == 0
    text = path.read_text("utf-8")
    assert "decided by somebody on" in text
    assert "E. Muster" in text
    assert "waited for a decision" not in text


def test_who_may_not_write_the_folder_gets_the_report_that_is_there(
    place: Path, subject: CommandLine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path, content: str) -> None:
        raise error("DISK_FAILED", f"{path}: Permission denied")

    earlier = Path(subject("report", 1).out.strip())
    monkeypatch.setattr("procedures.report.write.write_atomic", refuse)
    done = subject("report", 1, "--rebuild")
    assert (done.code, done.out.strip()) == (0, str(earlier))
    assert "this is an earlier one" in done.err
    earlier.unlink()
    assert subject("report", 1).code != 0


def test_a_run_without_a_result_is_packed_and_verified_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = CellOnDisk(tmp_path)
    cell.add_run(1, outcome="aborted", packml="ABORTED", verdict=None, error=None)
    subject = CommandLine(monkeypatch, capsys, cell.config)
    assert subject("bundle", 1, "-o", tmp_path / "run.zip").code == 0
    done = subject("verify", tmp_path / "run.zip")
    assert done.code == 0
    assert "not solved again: the run has no result" in done.out


def test_a_run_that_goes_on_is_not_packed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = CellOnDisk(tmp_path)
    cell.add_run(1, hand_eye_result())
    subject = CommandLine(monkeypatch, capsys, cell.config)
    done = subject("bundle", 1, "-o", tmp_path / "run.zip")
    assert (done.code, (tmp_path / "run.zip").exists()) == (4, False)
    assert "has not ended" in done.err
    assert subject("verify", tmp_path / "run.zip").code == 2
