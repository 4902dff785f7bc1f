"""A report on A4: no figure wider than the page, all of them as vectors, and no big file."""

import json
import re
from pathlib import Path

import pytest
from playwright.async_api import Browser

from cell.errors import CellError
from daemon.cli.printing import VARIABLE, print_pdf
from procedures.report.write import write_report
from tests.kit.browser import CHROMIUM, in_browser, needs_chromium
from tests.kit.solved import solve_hand_eye
from tests.unit.procedures.test_report_page import capture, make_run

pytestmark = [pytest.mark.wire, needs_chromium]

A4_WIDTH_PX = (210 - 2 * 14) / 25.4 * 96  # within the margins of page.css
EDGES = """() => [...document.querySelectorAll('.js-plotly-plot')]
    .filter(figure => figure.offsetParent !== null)
    .map(figure => [figure.id, figure.querySelector('.main-svg').getBoundingClientRect().right])"""


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    data = tmp_path_factory.mktemp("set") / "capture.json"
    data.write_text(json.dumps(capture(poses=5)))
    return write_report(make_run(tmp_path_factory.mktemp("run"), data, solve_hand_eye(data, method="ml")))


def test_figures_have_the_width_of_the_paper_and_then_that_of_the_screen_again(report: Path) -> None:
    async def use(browser: Browser) -> None:
        page = await browser.new_page(viewport={"width": 1400, "height": 900})
        problems: list[str] = []
        page.on("pageerror", lambda problem: problems.append(str(problem)))
        await page.goto(report.as_uri())
        await page.wait_for_selector(".main-svg")
        before = await page.evaluate(EDGES)
        await page.emulate_media(media="print")
        await page.set_viewport_size({"width": round(A4_WIDTH_PX), "height": 1000})
        await page.evaluate("dispatchEvent(new Event('beforeprint'))")
        await page.wait_for_timeout(500)
        printed = await page.evaluate(EDGES)
        assert {name for name, _ in printed} == {"views", "before-after", "residuals", "timeline"}
        assert [name for name, right in printed if right > A4_WIDTH_PX] == []
        await page.emulate_media(media="screen")
        await page.set_viewport_size({"width": 1400, "height": 900})
        await page.evaluate("dispatchEvent(new Event('afterprint'))")
        await page.wait_for_timeout(500)
        after = dict(await page.evaluate(EDGES))
        assert {name: right for name, right in before if abs(after[name] - right) > 20} == {}
        assert problems == []

    in_browser(use)


def test_the_paper_is_a4_with_vectors_and_below_a_megabyte(
    report: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(VARIABLE, str(CHROMIUM))
    made = print_pdf(report)
    assert made == report.with_suffix(".pdf")
    content = made.read_bytes()
    assert content.startswith(b"%PDF-")
    assert len(content) < 1e6
    boxes = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", content)
    assert len(boxes) >= 3
    assert {(round(float(w)), round(float(h))) for w, h in boxes} == {(595, 842)}
    assert content.count(b"/Subtype /Image") == 0


def test_a_browser_that_is_not_there_is_named_with_what_to_do(
    report: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(VARIABLE, "no-such-browser")
    with pytest.raises(CellError, match="names 'no-such-browser', which is not installed; 'apt install"):
        print_pdf(report)
