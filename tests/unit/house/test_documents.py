"""The written documents: records of decisions have a date and a status, and links lead somewhere."""

import re
from datetime import date
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
DECISIONS = ROOT / "docs" / "decisions"
RECORDS = sorted(DECISIONS.glob("[0-9]*.md"))
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"), *(ROOT / "tests").glob("*.md")])
HEAD = re.compile(r"# (\d{4}): (.+)\n\nDate: (\d{4}-\d\d-\d\d)\. Status: (accepted|superseded by \d{4})\.\n")
LINK = re.compile(r"(?<!`)\[[^\]`]*(?:`[^`]*`[^\]`]*)*\]\(([^)\s]+)\)")


def _anchors(document: Path) -> set[str]:
    """The anchors of a document's headings, as GitHub makes them."""
    heads = re.findall(r"^#+ (.+)$", document.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


def _broken(document: Path) -> list[str]:
    wrong = []
    for link in LINK.findall(document.read_text()):
        if re.match(r"[a-z]+:", link):
            continue
        name, _, anchor = link.partition("#")
        target = (document.parent / name).resolve() if name else document
        if not target.exists() or (anchor and anchor not in _anchors(target)):
            wrong.append(link)
    return wrong


@pytest.mark.parametrize("subject", RECORDS, ids=lambda p: p.name)
def test_a_record_of_a_decision_has_its_number_a_date_and_a_status(subject: Path) -> None:
    head = HEAD.match(subject.read_text())
    assert head is not None, (
        "begin with '# NNNN: title', an empty line and 'Date: YYYY-MM-DD. Status: accepted.'"
    )
    assert subject.name.startswith(f"{head[1]}-")
    date.fromisoformat(head[3])


def test_the_records_of_decisions_are_numbered_without_a_gap() -> None:
    assert [int(record.name[:4]) for record in RECORDS] == list(range(1, len(RECORDS) + 1))


def test_the_index_of_decisions_lists_each_record_as_it_stands() -> None:
    rows = re.findall(
        r"^\| \[(\d{4})\]\((.+?)\) \| (.+) \| (.+) \| (.+) \|$", (DECISIONS / "README.md").read_text(), re.M
    )
    heads = [(record, HEAD.match(record.read_text())) for record in RECORDS]
    assert rows == [(head[1], record.name, head[2], head[3], head[4]) for record, head in heads if head]


@pytest.mark.parametrize("subject", DOCUMENTS, ids=lambda p: str(p.relative_to(ROOT)))
def test_each_link_of_a_document_leads_to_a_file_and_a_heading(subject: Path) -> None:
    assert _broken(subject) == []


def test_a_link_to_a_missing_file_or_heading_is_found(tmp_path: Path) -> None:
    subject = tmp_path / "page.md"
    subject.write_text(
        "# One `key`\n[a](#one-key) [b](gone.md) [c](#two) [`d`](page.md) [e](https://example.org/x)\n"
    )
    assert _broken(subject) == ["gone.md", "#two"]
