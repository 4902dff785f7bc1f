"""The page in a real browser: legible, usable by keys, safe from other sites, and honest about silence."""

import signal
from collections.abc import Awaitable, Callable, Iterator
from typing import Any

import pytest
from aiohttp import web
from playwright.async_api import Browser

from tests.kit.browser import Use, Visitor, needs_chromium, one_browser
from tests.kit.page_cell import PageCell
from tests.kit.page_rig import TOKENS, PageRig, on_page

# A browser starts and ends children as windows come and go; one_browser sees whether all are gone at its end.
pytestmark = [pytest.mark.wire, pytest.mark.restarts_children, needs_chromium]
InBrowser = Callable[[Use], None]

SCREENS = (
    "now", "start", "start/laser-check", "start/latency-calibration", "run", "result/2", "result/1",
    "results", "runs", "runs/2", "compare/1/3", "compare/1/2", "trends", "cell", "plc", "teach", "login",
)  # fmt: skip
EVIL = """<script>
async function ask(init) {{ try {{ await fetch("{url}/api/do/start", init); }} catch (refused) {{}} }}
(async () => {{
  const sent = {{method: "POST", body: JSON.stringify({{job: "laser-check"}}), credentials: "include"}};
  await ask({{...sent, mode: "no-cors"}});
  await ask({{...sent, headers: {{"Content-Type": "application/json"}}}});
  const form = document.createElement("form");
  form.method = "POST"; form.action = "{url}/api/do/start";
  form.enctype = "text/plain"; form.target = "hidden";
  const field = document.createElement("input");
  field.name = '{{"job":"laser-check","x":"'; field.value = '"}}';
  form.append(field); document.body.append(form); form.submit();
  document.title = "tried";
}})();
</script><body><iframe name="hidden"></iframe><iframe src="{url}/"></iframe></body>"""


@pytest.fixture(scope="module")
def in_browser() -> Iterator[InBrowser]:
    with one_browser() as run:
        yield run


@pytest.mark.parametrize(("scheme", "rules"), [("light", ()), ("dark", ("color-contrast",))])
def test_every_screen_is_legible_for_everybody_and_fits_every_width(
    subject: PageCell, in_browser: InBrowser, scheme: str, rules: tuple[str, ...]
) -> None:
    async def use(browser: Browser) -> None:
        # axe is a script of the test's own, which the page's policy rightly refuses.
        visitor = await Visitor.at(browser, subject.url, color_scheme=scheme, bypass_csp=True)
        await visitor.login(TOKENS["ida"])
        found = {}
        for screen in SCREENS:
            await visitor.show(screen)
            found[screen] = await visitor.axe(*rules)
            for width in (360, 820, 1920):
                await visitor.page.set_viewport_size({"width": width, "height": 900})
                if wide := await visitor.too_wide_by():
                    found[screen].append(f"at {width} px it scrolls sideways by {wide} px")
        assert {screen: findings for screen, findings in found.items() if findings} == {}
        assert visitor.complaints == []

    in_browser(use)


def test_all_screens_run_within_their_own_policy_in_both_languages(
    subject: PageCell, in_browser: InBrowser
) -> None:
    async def use(browser: Browser) -> None:
        for locale, words in (("en-GB", "Ready. Nothing moves."), ("de-DE", "Bereit. Nichts bewegt sich.")):
            visitor = await Visitor.at(browser, subject.url, locale=locale)
            await visitor.sees(words)
            for screen in SCREENS:
                await visitor.show(screen)
            assert visitor.complaints == []

    in_browser(use)


def test_two_runs_are_chosen_and_seen_beside_each_other(subject: PageCell, in_browser: InBrowser) -> None:
    async def use(browser: Browser) -> None:
        visitor = await Visitor.at(browser, subject.url, locale="de-DE")
        await visitor.show("runs")
        for run in (3, 1):
            await visitor.page.get_by_label(f"Lauf {run} vergleichen").check()
        await visitor.page.get_by_role("link", name="Lauf 1 mit Lauf 3 vergleichen").click()
        await visitor.sees("Sie unterscheiden sich um mehr, als ihre Unsicherheiten erklären.")
        row = visitor.page.get_by_role("row").filter(has=visitor.page.get_by_text("x", exact=True))
        assert await row.locator("td").all_inner_texts() == ["x", "–", "–", "1,000 mm", "0,141 mm"]
        await visitor.show("results")
        link = visitor.page.get_by_role("link", name="mit dem geltenden")
        assert await link.get_attribute("href") == "#compare/1/3"
        assert visitor.complaints == []

    in_browser(use)


LASER_CHECK = {
    "name": "laser-check", "job": "laser-check", "number": 3, "recipe": False, "configured": True,
    "tools": ["gripper", "needle"], "tool": None, "obstacle": None, "last": None, "seconds": None,
    "choices": [
        {"key": "slot", "value": 1, "meaning": "from 1", "words": [], "least": 1, "most": 6},
        {"key": "picks", "value": 0, "meaning": "", "words": [], "least": 0, "most": 9},
        {"key": "action", "value": "insert", "meaning": "", "words": ["insert", "pull"], "least": None,
         "most": None},
    ],
}  # fmt: skip


def test_a_job_is_started_with_what_is_chosen_once_somebody_has_said_which_tool_is_on_the_flange(
    subject: PageCell, in_browser: InBrowser
) -> None:
    asked: list[Any] = []

    async def refuse(route: Any) -> None:
        asked.append(route.request.post_data_json)
        await route.fulfill(status=409, json={"error": {"name": "BUSY", "text": "not now", "hint": ""}})

    async def use(browser: Browser) -> None:
        visitor = await Visitor.at(browser, subject.url, locale="en-GB")
        await visitor.login(TOKENS["otto"])
        page = visitor.page
        await page.route("**/api/jobs", lambda route: route.fulfill(json=[LASER_CHECK]))
        await page.route("**/expected?tool=needle", lambda route: route.fulfill(json={"expected": None}))
        await page.route("**/api/do/start", refuse)
        await visitor.show("start/laser-check")
        await page.get_by_label("Nobody is within reach").check()
        assert await visitor.button("Start: the arm will move").is_disabled()
        await page.get_by_label("Tool on the flange").select_option("needle")
        await page.get_by_label("Nobody is within reach").check()
        await page.get_by_label("Slot").fill("4")
        await page.get_by_label("What to do there").select_option("pull the part out")
        assert await visitor.button("Start: the arm will move").is_disabled(), "another slot is another way"
        await page.get_by_label("Nobody is within reach").check()
        await visitor.press("Start: the arm will move")
        await visitor.sees("not now")
        changed = {"slot": "4", "action": "pull", "tool": "needle"}
        assert asked == [{"job": "laser-check", "params": changed}]
        never = await page.evaluate("import('/static/format.js').then((format) => format.asWritten(null))")
        assert never == "–", "of a calibration that was never measured"
        assert visitor.complaints == []

    in_browser(use)


def test_by_keys_alone_somebody_logs_in_and_comes_to_a_job(subject: PageCell, in_browser: InBrowser) -> None:
    async def use(browser: Browser) -> None:
        visitor = await Visitor.at(browser, subject.url, locale="en-GB")
        await visitor.login(TOKENS["otto"])
        page = visitor.page
        for _ in range(40):
            await page.keyboard.press("Tab")
            if await page.evaluate("document.activeElement.getAttribute('href')") == "#start":
                break
        await page.keyboard.press("Enter")
        await visitor.sees("What do you want to know")

    in_browser(use)


def test_a_daemon_that_says_nothing_greys_the_page_until_it_speaks_again(
    subject: PageCell, in_browser: InBrowser
) -> None:
    process = subject.process
    assert process is not None

    async def use(browser: Browser) -> None:
        visitor = await Visitor.at(browser, subject.url, locale="en-GB")
        await visitor.login(TOKENS["ida"])
        await visitor.show("result/2")
        await visitor.button("Reject").wait_for()
        assert await visitor.button("Reject").is_enabled()
        process.send_signal(signal.SIGSTOP)
        try:
            await visitor.sees("no news for")
            assert not await visitor.button("Reject").is_enabled()
        finally:
            process.send_signal(signal.SIGCONT)
        await visitor.page.wait_for_selector("html:not(.stale)")

    in_browser(use)


def with_stand_in(use: Callable[[PageRig, Browser], Awaitable[None]], **keys: object) -> None:
    """A page with a stand-in engine, and a browser."""

    async def both(rig: PageRig) -> None:
        from playwright.async_api import async_playwright

        from tests.kit.browser import CHROMIUM

        async with async_playwright() as driver:
            browser = await driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
            try:
                await use(rig, browser)
            finally:
                await browser.close()

    on_page(both, **keys)


def test_the_page_of_another_origin_starts_no_job_for_somebody_who_is_logged_in() -> None:
    async def use(subject: PageRig, browser: Browser) -> None:
        async def evil(request: web.Request) -> web.Response:
            return web.Response(text=EVIL.format(url=subject.origin), content_type="text/html")

        app = web.Application()
        app.router.add_get("/", evil)
        runner = web.AppRunner(app)
        await runner.setup()
        site = web.TCPSite(runner, "127.0.0.1", 0)  # another port: the same site, so that cookies go along
        await site.start()
        try:
            context = await browser.new_context()
            page = await context.new_page()
            await page.goto(subject.origin)
            csrf = await page.evaluate(
                "async (token) => (await (await fetch('/api/login', {method: 'POST', body: JSON.stringify("
                "{token}), headers: {'Content-Type': 'application/json'}})).json()).csrf",
                TOKENS["ida"],
            )
            own = (
                "async (csrf) => (await fetch('/api/do/pause', {method: 'POST', body: '{}', headers: "
                "{'Content-Type': 'application/json', 'X-Cellward-Csrf': csrf}})).status"
            )
            assert await page.evaluate(own, csrf) == 200  # the login is good
            host, port = runner.addresses[0]
            other = await context.new_page()
            await other.goto(f"http://{host}:{port}/")
            await other.wait_for_function("document.title === 'tried'")
            await other.wait_for_timeout(300)
        finally:
            await runner.cleanup()
        assert [what for what, *_ in subject.engine.asked] == ["pause"]

    with_stand_in(use)


def test_without_a_login_no_button_writes_and_no_script_can() -> None:
    async def use(subject: PageRig, browser: Browser) -> None:
        visitor = await Visitor.at(browser, subject.origin)
        for method in ("start", "halt", "accept", "reset"):
            kind = {"Content-Type": "application/json", "X-Cellward-Csrf": ""}
            assert await visitor.fetched("POST", f"/api/do/{method}", **kind) == 401
        assert subject.engine.asked == []

    with_stand_in(use)
