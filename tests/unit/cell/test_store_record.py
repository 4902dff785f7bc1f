"""Check sums, signatures and bundles of a run folder, held against the ``sha256sum`` of the system."""

import hashlib
import json
import shutil
import subprocess
import zipfile
from pathlib import Path

import pytest

from cell.clock import MonotonicClock
from cell.errors import CellError
from cell.store.bundle import unpack_bundle, write_bundle
from cell.store.fingerprint import SIGNATURES_FILE, SUMS_FILE, fingerprint, parse_sums
from cell.store.pruning import unused_pictures
from cell.store.runs import RunFolder
from cell.store.signatures import Statement, read_signatures, sign


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    made = RunFolder.create(tmp_path / "runs", "cone-capture", 7, {"parameters": {}}, MonotonicClock())
    (made.path / "images").mkdir()
    (made.path / "images" / "a b.png").write_bytes(bytes(range(256)) * 9)
    (made.path / "images" / "p000_0_depth.png").write_bytes(b"depth")
    (made.path / "capture.json").write_text('{"observations": [{"image": "images/a b.png"}]}')
    made.write_result({"kind": "hand-eye"})
    made.finish({"outcome": "complete", "packml": "COMPLETE", "verdict": "pass", "error": None})
    return made


def signed(run: RunFolder, name: str = "A. Tester", role: str = "checked") -> None:
    sign(run, Statement(name, role, "", fingerprint(run.path).digest), "uid 1000")


def test_the_sums_are_those_of_sha256sum(run: RunFolder) -> None:
    found = fingerprint(run.path)
    done = subprocess.run(
        ["sha256sum", *sorted(found.sums)], cwd=run.path, capture_output=True, text=True, check=True
    )
    assert done.stdout == found.text
    assert parse_sums(done.stdout, "list") == found
    assert found.digest == hashlib.sha256(done.stdout.encode()).hexdigest()


def test_a_report_and_a_signature_change_no_digest_and_anything_else_does(run: RunFolder) -> None:
    before = fingerprint(run.path)
    (run.path / "report.html").write_text("<html>")
    signed(run)
    (run.path / ".x.tmp").write_text("half")
    assert fingerprint(run.path).digest == before.digest
    (run.path / "images" / "report.html").write_text("not the report")
    assert fingerprint(run.path).digest != before.digest
    (run.path / "capture.json").unlink()
    now = fingerprint(run.path).record
    assert now.against(before) == ["capture.json is missing", "images/report.html was added"]


def test_a_link_is_refused_because_what_it_holds_is_elsewhere(run: RunFolder, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").write_text("x")
    (run.path / "linked.json").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(CellError, match=r"linked\.json is a link"):
        fingerprint(run.path)


def test_a_signature_is_for_the_files_that_were_looked_at(run: RunFolder) -> None:
    looked = fingerprint(run.path).digest
    (run.path / "result.json").write_text("{}")
    with pytest.raises(CellError) as caught:
        sign(run, Statement("A. Tester", "checked", "", looked), "uid 1000")
    assert caught.value.name == "RECORD_ALTERED"
    assert read_signatures(run.path) == []
    signed(run)
    (found,) = read_signatures(run.path)
    assert (found.name, found.role, found.user) == ("A. Tester", "checked", "uid 1000")
    assert found.signed.digest == found.digest == fingerprint(run.path).digest


@pytest.mark.parametrize(
    ("name", "role"), [("", "checked"), ("A", " "), ("A\nB", "checked"), ("A" * 81, "x")]
)
def test_a_name_and_a_role_are_one_line(name: str, role: str) -> None:
    with pytest.raises(CellError, match="one line of 1 to 80"):
        Statement(name, role, "", "00")


def test_a_run_that_goes_on_cannot_be_signed(tmp_path: Path) -> None:
    run = RunFolder.create(tmp_path, "cone-capture", 1, {"parameters": {}}, MonotonicClock())
    with pytest.raises(CellError) as caught:
        signed(run)
    assert caught.value.name == "NOT_NOW"
    run.close()


def test_a_damaged_line_of_signatures_is_named(run: RunFolder) -> None:
    signed(run)
    with (run.path / SIGNATURES_FILE).open("a") as file:
        file.write('{"schema": "cellward.signature/1", "name": "B"}\n')
    with pytest.raises(CellError, match=rf"{SIGNATURES_FILE}:2: no signature"):
        read_signatures(run.path)


def test_pictures_of_a_signed_run_are_not_pruned(run: RunFolder) -> None:
    assert [path.name for path in unused_pictures(run)] == ["p000_0_depth.png"]
    signed(run)
    assert unused_pictures(run) == []


def test_sha256sum_checks_an_unpacked_bundle(run: RunFolder, tmp_path: Path) -> None:
    signed(run)
    sums = write_bundle(run.path, tmp_path / "run.zip", {"job": "cone-capture"})
    with zipfile.ZipFile(tmp_path / "run.zip") as archive:
        assert archive.testzip() is None
    shutil.unpack_archive(tmp_path / "run.zip", tmp_path / "out")
    folder = tmp_path / "out" / run.path.name
    done = subprocess.run(["sha256sum", "-c", SUMS_FILE], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    assert done.stdout.count(": OK") == len(sums.sums)
    assert json.loads((folder / "bundle.json").read_text())["digest"] == fingerprint(run.path).digest
    assert {path.name for path in tmp_path.iterdir()} == {"runs", "run.zip", "out"}


def test_a_bundle_unpacks_to_the_folder_that_it_was_made_of(run: RunFolder, tmp_path: Path) -> None:
    write_bundle(run.path, tmp_path / "run.zip", {})
    folder, listed, damaged = unpack_bundle(tmp_path / "run.zip", tmp_path / "out")
    assert damaged == []
    assert fingerprint(folder).digest == listed.digest == fingerprint(run.path).digest


@pytest.mark.parametrize(
    "name", ["../../evil", "/etc/evil", "run/../../evil", "alone", "..\\evil\\x", "run/x/../../../y"]
)
def test_a_file_that_would_leave_the_folder_makes_no_bundle(name: str, tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "bad.zip", "w") as archive:
        archive.writestr("run/SHA256SUMS", "")
        archive.writestr(name, "x")
    (tmp_path / "out").mkdir()
    with pytest.raises(CellError, match="not in one folder"):
        unpack_bundle(tmp_path / "bad.zip", tmp_path / "out")
    assert list((tmp_path / "out").iterdir()) == []


def test_a_damaged_byte_in_a_packed_file_is_told_by_the_file(run: RunFolder, tmp_path: Path) -> None:
    write_bundle(run.path, tmp_path / "run.zip", {})
    content = bytearray((tmp_path / "run.zip").read_bytes())
    place = content.index(bytes(range(256)))  # of the picture, which is stored as it is
    content[place + 100] ^= 1
    (tmp_path / "run.zip").write_bytes(content)
    _, _, damaged = unpack_bundle(tmp_path / "run.zip", tmp_path / "out")
    assert damaged == ["images/a b.png is damaged"]


def test_a_run_folder_in_the_place_of_its_bundle_is_refused_in_a_sentence(
    run: RunFolder, tmp_path: Path
) -> None:
    with pytest.raises(CellError, match="is a folder; give the number of the run, or its bundle") as caught:
        unpack_bundle(run.path, tmp_path)
    assert caught.value.name == "ARGUMENT_INVALID"


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04"])
def test_what_is_no_archive_is_refused_in_a_sentence(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "x.zip").write_bytes(content)
    with pytest.raises(CellError, match="no bundle of a run"):
        unpack_bundle(tmp_path / "x.zip", tmp_path)
