"""An integrator signs the record of a run on the page; page and report tell it, and what is changed later."""

import asyncio
import json
import shutil
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.async_api import Browser

from cell.clock import MonotonicClock
from cell.store.fingerprint import fingerprint
from cell.store.runs import RunFolder
from tests.kit.browser import Visitor, in_browser, needs_chromium
from tests.kit.page_cell import PageCell
from tests.kit.page_rig import TOKENS

pytestmark = [pytest.mark.wire, pytest.mark.restarts_children, needs_chromium]  # its daemon draws reports

NUMBER = 33
END = {"outcome": "aborted", "packml": "ABORTED", "verdict": None, "error": {"text": "The arm is lost"}}
REPORT_S = 120.0


@pytest.fixture
def run(subject: PageCell) -> Iterator[RunFolder]:
    """A run of this test alone: others count those of the cell."""
    made = RunFolder.create(subject.folder / "state/runs", "laser-check", NUMBER, {}, MonotonicClock())
    made.finish(END)
    yield made
    shutil.rmtree(made.path)


def drawn_with(text: str, report: Path) -> str:
    """The report once it has ``text`` in it."""
    give_up = time.monotonic() + REPORT_S
    while time.monotonic() < give_up:
        if report.exists() and text in (content := report.read_text("utf-8")):
            return content
        time.sleep(0.1)
    raise AssertionError(f"the report was not drawn with {text} in {REPORT_S:g} s")


def test_a_record_is_signed_and_a_later_change_shows(subject: PageCell, run: RunFolder) -> None:
    report = run.path / "report.html"

    async def use(browser: Browser) -> None:
        visitor = await Visitor.at(browser, subject.url, locale="en-GB")
        await visitor.login(TOKENS["otto"])
        await visitor.show(f"runs/{NUMBER}")
        await visitor.sees("This needs a login as integrator.")
        await visitor.page.click("text=Log out")
        await visitor.login(TOKENS["ida"])
        await visitor.show(f"runs/{NUMBER}")
        await visitor.sees("Nobody has signed it.")
        digest = fingerprint(run.path).digest
        await visitor.sees(digest)
        await visitor.page.fill("input[autocomplete=name]", "E. Muster")
        await visitor.page.select_option("main select", "approved")
        await visitor.press("Sign: I stand for this record")
        await visitor.sees("Signed. The report shows it in a moment.")
        await visitor.sees("signed by E. Muster (approved)")
        assert f"content SHA-256 {digest[:16]}…" in await asyncio.to_thread(drawn_with, "E. Muster", report)
        (run.path / "journal.jsonl").write_text("scribble\n")
        await visitor.show("runs")
        await visitor.sees("changed after signing: journal.jsonl was altered")
        assert visitor.complaints == []

    in_browser(use)
    (line,) = (run.path / "signatures.jsonl").read_text("utf-8").splitlines()
    assert json.loads(line)["user"] == "ida (page, 127.0.0.1)"


def test_a_run_that_goes_on_cannot_be_signed(subject: PageCell, run: RunFolder) -> None:
    (run.path / "end.json").unlink()
    assert subject.get(f"/api/runs/{NUMBER}/record")["error"]["name"] == "NOT_NOW"
