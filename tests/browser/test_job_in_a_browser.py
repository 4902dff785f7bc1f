"""A whole job by the page alone, on a twin: started, stopped, prompted, done, accepted, rolled back."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.async_api import Browser

from tests.kit.browser import Visitor, in_browser, needs_chromium
from tests.kit.page_cell import free_url, page_section
from tests.kit.page_rig import TOKENS
from tests.kit.wire_cell import WireCell, shipped, wire_cell

pytestmark = [pytest.mark.wire, pytest.mark.soak, needs_chromium]

SMALL = {"placements": 2, "poses_per_placement": 5, "frames_per_pose": 2, "settle_s": 0.1}


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[WireCell, str]]:
    url = free_url()

    def add_page(cell: WireCell) -> None:
        with (cell.folder / "cell.toml").open("a", encoding="utf-8") as file:
            file.write(page_section(url))

    folder: Path = tmp_path_factory.mktemp("job")
    with wire_cell(folder, "127.0.0.41", shipped("hand_eye", **SMALL), add_page) as cell:
        yield cell, url


def test_a_job_is_started_prompted_stopped_accepted_and_rolled_back(served: tuple[WireCell, str]) -> None:
    cell, url = served

    async def use(browser: Browser) -> None:
        visitor = await Visitor.at(browser, url, locale="en-GB")
        await visitor.login(TOKENS["ida"])

        await start(visitor)
        await confirm_placement(visitor, cell, 1)
        await visitor.sees("step 1 of 10")
        await visitor.press("Stop run")  # one click
        await visitor.page.wait_for_selector("button.stop:disabled")
        assert cell.status()["last_run"]["outcome"] == "halted"
        assert not cell.moving()

        await visitor.show("now")
        await visitor.sees("Ready. Nothing moves.")
        await start(visitor)
        for placement in (1, 2):
            await confirm_placement(visitor, cell, placement)
        await visitor.page.wait_for_selector("a[href^='#result/']")

        await visitor.page.click("a[href^='#result/']")
        await visitor.sees("Before and now")
        if cell.status()["last_run"]["verdict"] == "warn":
            await visitor.page.fill("textarea", "two placements are enough for this test")
        await visitor.press("Accept: used from the next job on")
        await visitor.sees("in effect")
        (name,) = [entry["what"] for entry in audit(cell) if entry["what"].startswith("accept")]
        assert "result_id" in name

        await visitor.show("results")
        await visitor.press("Roll back")
        await visitor.press("Roll back: used from the next job on")
        await visitor.sees("The configured value is in effect.")
        assert visitor.complaints == []

    in_browser(use)
    who = {entry["who"] for entry in audit(cell)}
    assert who == {"ida (page, 127.0.0.1)"}


async def start(visitor: Visitor) -> None:
    await visitor.show("start/cone-capture")
    await visitor.page.check("input[type=checkbox]")
    await visitor.press("Start: the arm will move")


async def confirm_placement(visitor: Visitor, cell: WireCell, placement: int) -> None:
    """Do in the twin what the prompt on the page asks for, and say so on the page."""
    await visitor.sees(f"Placement {placement} of 2")
    cell.move_board()
    await visitor.press("It is done: the arm may move")


def audit(cell: WireCell) -> list[dict[str, str]]:
    from contextlib import closing

    from cell.store.ledger import Ledger

    path = Path(cell.config()["cell"]["state_dir"]) / "ledger.sqlite"
    with closing(Ledger(path, read_only=True)) as ledger:
        return ledger.audit_lines(channel="web")
