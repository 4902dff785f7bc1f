"""The index of reports: each run with its figure, who decided, who signed, and whether that still holds."""

import re
from contextlib import closing
from html import unescape
from pathlib import Path

import pytest

from cell.store.fingerprint import fingerprint
from cell.store.ledger import Ledger
from cell.store.runs import RunFolder
from cell.store.signatures import Statement, sign
from tests.kit.cli_harness import CellOnDisk, CommandLine, hand_eye_result

FIGURE = {"name": "error95_t_m", "words": "95 % error of the place", "value": 3.14e-4, "unit": "m"}
COMPLETE = {"outcome": "complete", "packml": "COMPLETE", "verdict": "pass", "error": None, "figure": FIGURE}
ABORTED = {"outcome": "aborted", "packml": "ABORTED", "verdict": None, "error": {"text": "the <arm> is lost"}}


@pytest.fixture
def cell(tmp_path: Path) -> CellOnDisk:
    """Run 1 with a report, accepted and replaced; run 2 was aborted; run 3 goes on."""
    found = CellOnDisk(tmp_path)
    found.state.mkdir()
    with closing(Ledger(found.state / "ledger.sqlite")) as ledger:
        for _ in range(3):
            number = ledger.next_run_id()
            ledger.start_run(number, "cone-capture", f"folder {number}", "anna", "control")
        ledger.accept(ledger.propose("T_flange_camera", [0.0] * 6, {}, 1, None), "bert", why="as measured")
    found.add_run(1, hand_eye_result(), **COMPLETE)
    found.add_run(2, **ABORTED)
    found.add_run(3)
    (run_of(found).path / "report.html").write_text("<title>report</title>")
    return found


def run_of(cell: CellOnDisk) -> RunFolder:
    path = next((cell.state / "runs").glob("*_1"))
    return RunFolder(path, 1, "cone-capture", {})


def rows_of(done_out: str) -> list[str]:
    """The rows of the table as plain text, by line."""
    page = Path(done_out.strip()).read_text("utf-8")
    rows = re.findall(r"<tr>(.*?)</tr>", page.partition("<tbody>")[2])
    return [unescape(re.sub(r"<[^>]+>", " ", row)) for row in rows]


def test_each_run_has_its_figure_its_verdict_and_who_decided(subject: CommandLine, cell: CellOnDisk) -> None:
    done = subject("reports")
    assert done.code == 0
    assert done.out.strip() == str(cell.state / "reports.html")
    going_on, aborted, complete = rows_of(done.out)
    assert "goes on" in going_on
    assert "the <arm> is lost" in aborted
    assert "pass" in complete
    assert "0.314 mm" in complete
    assert re.search(r"accepted\s+as version 1 by bert on .*: as measured", complete)


def test_links_lead_to_the_reports_that_there_are(
    subject: CommandLine, cell: CellOnDisk, tmp_path: Path
) -> None:
    (tmp_path / "elsewhere").mkdir()
    for target in (cell.state / "reports.html", tmp_path / "elsewhere" / "all.html"):
        assert subject("reports", "-o", target).code == 0
        (link,) = re.findall(r'href="([^"]+)"', target.read_text("utf-8"))
        assert (target.parent / link).resolve() == run_of(cell).path / "report.html"


def test_a_signature_is_told_with_its_digest_and_what_was_changed_after_it(
    subject: CommandLine, cell: CellOnDisk
) -> None:
    run = run_of(cell)
    digest = fingerprint(run.path).digest
    sign(run, Statement("E. Muster", "checked", "", digest), "uid 1000", lambda: 1.7e9)
    signed = rows_of(subject("reports").out)[2]
    assert (
        f"signed by E. Muster (checked) on 2023-11-14 22:13:20 UTC, content SHA-256 {digest[:16]}…" in signed
    )
    assert "changed" not in signed
    (run.path / "result.json").write_text("{}")
    changed = rows_of(subject("reports").out)[2]
    assert "changed after signing: result.json was altered" in changed


def test_a_file_of_signatures_that_cannot_be_read_hides_no_run(
    subject: CommandLine, cell: CellOnDisk
) -> None:
    (run_of(cell).path / "signatures.jsonl").write_text("scribble\n")
    rows = rows_of(subject("reports").out)
    assert len(rows) == 3
    assert "the signatures cannot be read" in rows[2]
    assert "no signature" in rows[2]


def test_a_folder_that_there_is_not_is_refused_in_words(subject: CommandLine, tmp_path: Path) -> None:
    done = subject("reports", "-o", tmp_path / "nowhere" / "all.html")
    assert done.code == 2
    assert "nowhere does not exist" in done.err
