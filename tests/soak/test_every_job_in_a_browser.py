"""Every job by the page alone, on the twin: stopped, started again, answered, done, accepted, rolled back."""

import asyncio
import re
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from playwright.async_api import Browser

from bench.hiccups import GRIPPING, SCENES, InterruptedJob, accept_proposed
from cell.store.ledger import Ledger
from fakes.twin.control import ask
from tests.kit.browser import Visitor, in_browser, needs_chromium
from tests.kit.page_cell import free_url, page_section
from tests.kit.page_rig import TOKENS
from tests.kit.wire_cell import WireCell, wait_for, wire_cell

pytestmark = [pytest.mark.wire, pytest.mark.soak, needs_chromium]

BACK = re.compile("in effect again|The configured value is in effect")
BY_THE_PAGE = "ida (page, 127.0.0.1)"
LONGEST_S, WATCHED_S, STILL_S = 400.0, 20.0, 3.0
STILL = ("belt-calibration", "corrected-targets")  # the arm of the twin takes no part


@pytest.fixture
def served(tmp_path: Path, job: str) -> Iterator[tuple[WireCell, str]]:
    """The cell of the job with a page, after the jobs that it needs."""
    scene, url = SCENES[job], free_url()

    def prepare(cell: WireCell) -> None:
        scene.first(cell)
        with (cell.folder / "cell.toml").open("a", encoding="utf-8") as file:
            file.write(page_section(url))

    with wire_cell(tmp_path, "127.0.0.63", scene.text, prepare) as cell:
        for before in scene.before:
            cell.start_job(before)
            accept_proposed(cell, cell.wait_for_end(LONGEST_S)["run_id"])
        yield cell, url


@pytest.mark.parametrize("job", sorted(SCENES))
def test_a_job_by_the_page_alone(job: str, served: tuple[WireCell, str]) -> None:
    cell, url = served
    scene = SCENES[job]

    async def use(browser: Browser) -> None:
        visitor = await Visitor.at(browser, url, locale="en-GB")
        await visitor.login(TOKENS["ida"])
        await start(visitor, job, scene)
        await until_it_moves(visitor, cell, job)
        await visitor.press("Stop run")
        await until(lambda: cell.status()["job"] is None, "end of the run")
        assert cell.status()["last_run"]["outcome"] == "halted"
        assert not cell.moving()
        if job in GRIPPING:  # what is held is taken out by hand
            ask(cell.folder, {"do": "gripper", "empty": True})

        await until(cell.ready, "ready cell")
        await start(visitor, job, scene)
        last = await to_its_end(visitor, cell, scene)
        assert last["outcome"] == "complete", last["error"]
        for result_id, name in proposed(cell, last["run_id"]):
            await decide(visitor, result_id, name)
        assert visitor.complaints == []

    in_browser(use)
    assert {entry["who"] for entry in audit(cell)} == {BY_THE_PAGE}


async def start(visitor: Visitor, job: str, scene: InterruptedJob) -> None:
    await visitor.show(f"start/{job}")
    params = scene.params(0)
    if "slot" in params:
        await visitor.page.get_by_label("Slot").fill(params["slot"])
    await visitor.page.check("input[type=checkbox]")
    await visitor.press("Start: the arm will move")
    await visitor.page.wait_for_url("**/#run")


async def answer(visitor: Visitor, cell: WireCell, scene: InterruptedJob, status: dict[str, Any]) -> None:
    """Do in the twin what the prompt asks for, and say so on the page."""
    await visitor.show("now")
    await visitor.sees(status["prompt"]["text"])
    await asyncio.to_thread(scene.answer, cell, status)
    await visitor.press("It is done: the arm may move")
    asked = status["prompt"]["id"]
    await until(lambda: (cell.status()["prompt"] or {}).get("id") != asked, "taken answer")


async def until_it_moves(visitor: Visitor, cell: WireCell, job: str) -> None:
    """Or for a while."""
    give_up = time.monotonic() + (STILL_S if job in STILL else WATCHED_S)
    while not await asyncio.to_thread(cell.moving) and time.monotonic() < give_up:
        status = await asyncio.to_thread(cell.status)
        assert status["job"] is not None, status["last_run"]["error"]
        if status["prompt"]:
            await answer(visitor, cell, SCENES[job], status)
        await asyncio.sleep(0.05)


async def to_its_end(visitor: Visitor, cell: WireCell, scene: InterruptedJob) -> dict[str, Any]:
    begun, finished = time.monotonic(), False
    while (status := await asyncio.to_thread(cell.status))["job"] is not None:
        spent = time.monotonic() - begun
        assert spent < LONGEST_S, status
        if status["prompt"]:
            await answer(visitor, cell, scene, status)
        elif scene.finish_after_s is not None and spent > scene.finish_after_s and not finished:
            finished = True
            await visitor.show("now")
            await visitor.press("End here: use the data so far")
        await asyncio.sleep(0.1)
    last: dict[str, Any] = status["last_run"]
    return last


async def decide(visitor: Visitor, result_id: int, name: str) -> None:
    """Accept a result, and go back to what was before."""
    await visitor.show(f"result/{result_id}")
    await visitor.page.fill("textarea", "by the page alone")
    await visitor.press("Accept: used from the next job on")
    await visitor.sees("in effect")
    await visitor.show("results")
    card = visitor.page.locator(".card").filter(has_text=name)
    await card.get_by_role("button", name="Roll back").click()
    await card.get_by_role("button", name="Roll back: used from the next job on").click()
    await card.get_by_text(BACK).first.wait_for()


def proposed(cell: WireCell, run_id: int) -> list[tuple[int, str]]:
    with closing(Ledger(cell.folder / "state/ledger.sqlite", read_only=True)) as ledger:
        rows = ledger.results()
    return [(row["id"], row["name"]) for row in rows if (row["run_id"], row["state"]) == (run_id, "proposed")]


def audit(cell: WireCell) -> list[dict[str, Any]]:
    with closing(Ledger(cell.folder / "state/ledger.sqlite", read_only=True)) as ledger:
        return ledger.audit_lines(channel="web")


async def until(condition: Callable[[], bool], what: str) -> None:
    await asyncio.to_thread(wait_for, condition, what, 60.0)
