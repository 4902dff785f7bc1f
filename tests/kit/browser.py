"""Debian's chromium, driven by playwright, which brings no browser of its own here."""

import asyncio
import shutil
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any

import pytest
from playwright.async_api import Browser, BrowserContext, Page, async_playwright

from tests.kit import left_behind

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
AXE = Path(__file__).parents[1] / "browser/vendor/axe.min.js"
ANSWER_MS = 60_000.0

needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="there is no chromium; apt-get install chromium")


Use = Callable[[Browser], Awaitable[None]]


@asynccontextmanager
async def _browser() -> AsyncIterator[Browser]:
    async with async_playwright() as driver:
        browser = await driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        try:
            yield browser
        finally:
            await browser.close()


def in_browser(use: Use) -> None:
    """Run ``use`` with a browser that is closed at its end."""

    async def scenario() -> None:
        async with _browser() as browser:
            await use(browser)

    asyncio.run(scenario())


@contextmanager
def one_browser() -> Iterator[Callable[[Use], None]]:
    """As :func:`in_browser` for several uses, of which each closes its windows only: a browser takes a second
    of a core to start. A task that outlives its use fails it, a process that outlives the browser the end."""
    before = left_behind.children()
    served = [int(child.split()[0]) for child in before]
    with asyncio.Runner() as runner:
        opened = _browser()
        browser = runner.run(opened.__aenter__())
        try:
            yield lambda use: runner.run(_once(use, browser))
        finally:
            runner.run(opened.__aexit__(None, None, None))
    left_behind.require_gone("children", before, lambda: left_behind.children(served))


async def _once(use: Use, browser: Browser) -> None:
    before = asyncio.all_tasks()
    with ThreadPoolExecutor(1) as reads_files:  # the loop's own would outlive this use
        asyncio.get_running_loop().set_default_executor(reads_files)
        try:
            await use(browser)
        finally:
            for context in browser.contexts:
                await context.close()
    if left := asyncio.all_tasks() - before:
        left = (await asyncio.wait(left, timeout=left_behind.PATIENCE_S))[1]
    for task in left:
        task.cancel()
    assert not left, f"tasks left behind: {left}"


class Visitor:
    """One window on the page; what its console complains of is kept."""

    def __init__(self, page: Page, url: str) -> None:
        self.page, self.url = page, url
        self.complaints: list[str] = []
        page.set_default_timeout(ANSWER_MS)
        page.on("pageerror", lambda problem: self.complaints.append(str(problem)))
        page.on("console", self._heard)

    def _heard(self, message: Any) -> None:
        # An answer that refuses is shown on the page; the browser lists it, too.
        if message.type in ("error", "warning") and "Failed to load resource" not in message.text:
            self.complaints.append(message.text)

    @classmethod
    async def at(cls, browser: Browser, url: str, **context: Any) -> "Visitor":
        made: BrowserContext = await browser.new_context(**context)
        visitor = cls(await made.new_page(), url)
        await visitor.show("now")
        return visitor

    async def show(self, screen: str) -> None:
        if not self.page.url.startswith(self.url):
            await self.page.goto(f"{self.url}/#{screen}")
        else:  # as a link does, without loading the page again
            await self.page.evaluate("(screen) => { location.hash = screen; }", screen)
            await self.page.wait_for_timeout(50)
        await self.page.wait_for_selector("main h1, main .big, main h2", state="attached")

    async def login(self, token: str) -> None:
        await self.show("login")
        await self.page.fill("input[type=password]", token)
        await self.page.press("input[type=password]", "Enter")
        await self.page.wait_for_selector(".user", state="attached")

    def button(self, text: str) -> Any:
        return self.page.get_by_role("button", name=text)

    async def press(self, text: str) -> None:
        """Press a button once it can be pressed."""
        await self.button(text).click()

    async def sees(self, text: str) -> None:
        await self.page.get_by_text(text).first.wait_for()

    async def fetched(self, method: str, path: str, **headers: str) -> int:
        """The status of a request that a script of the page makes."""
        script = "([m, p, h]) => fetch(p, {method: m, headers: h, body: m === 'GET' ? undefined : '{}'})"
        status: int = await self.page.evaluate(
            f"async (a) => (await ({script})(a)).status", [method, path, headers]
        )
        return status

    async def axe(self, *rules: str) -> list[str]:
        """What axe-core finds by these rules, or by all; one line a finding."""
        if not await self.page.evaluate("'axe' in window"):
            await self.page.add_script_tag(path=AXE)
        only = {"resultTypes": ["violations"], **({"runOnly": list(rules)} if rules else {})}
        found = await self.page.evaluate("(only) => axe.run(document, only)", only)
        return [f"{v['id']}: {v['help']}: {v['nodes'][0]['html'][:150]}" for v in found["violations"]]

    async def too_wide_by(self) -> int:
        wide: int = await self.page.evaluate(
            "document.documentElement.scrollWidth - document.documentElement.clientWidth"
        )
        return wide
