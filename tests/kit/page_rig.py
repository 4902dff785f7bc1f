"""The operator's page on a free port, with a stand-in engine behind it and a client like a browser."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

import aiohttp

from daemon.config.faces import HttpSection
from daemon.web.server import WebServer
from daemon.web.tokens import digest
from tests.kit.control_harness import RecordingEngine

TOKENS = {
    "vera": "1111-AAAA-1111-AAAA",
    "otto": "2222-BBBB-2222-BBBB",
    "ida": "3333-CCCC-3333-CCCC",
}
ROLES = {"vera": "viewer", "otto": "operator", "ida": "integrator"}


def http_section(**keys: Any) -> HttpSection:
    users = {name: {"role": ROLES[name], "token_sha256": digest(token)} for name, token in TOKENS.items()}
    return HttpSection.model_validate({"bind": "127.0.0.1:0", "user": users, **keys})


class RecordedStates:
    """The state of the stand-in engine."""

    def __init__(self, engine: RecordingEngine) -> None:
        self._engine = engine

    def make(self) -> dict[str, Any]:
        return {"status": self._engine.status()}

    def subscribe(self, listener: Callable[[], None], /) -> Callable[[], None]:
        return self._engine.subscribe(listener)

    def close(self) -> None: ...


@dataclass
class PageRig:
    """One server, and what its visitors send as a browser would."""

    server: WebServer
    engine: RecordingEngine
    client: aiohttp.ClientSession
    audited: list[tuple[str, str, bool, str]]
    csrf: str = ""
    headers: dict[str, str] = field(default_factory=dict)

    @property
    def origin(self) -> str:
        return self.server.url.rstrip("/")

    async def get(self, path: str, **headers: str) -> tuple[int, Any]:
        async with self.client.get(self.origin + path, headers=headers) as answer:
            return answer.status, await _content(answer)

    async def post(self, path: str, content: Any = None, **changed: str | None) -> tuple[int, Any]:
        """As the page's own script; ``changed`` are headers with another value, or without any (None)."""
        headers: dict[str, str | None] = {
            "Origin": self.origin,
            "Content-Type": "application/json",
            "X-Cellward-Csrf": self.csrf,
            **{name.replace("_", "-"): value for name, value in changed.items()},
        }
        sent = {name: value for name, value in headers.items() if value is not None}
        skipped = [name for name, value in headers.items() if value is None]
        kind = {"data": content} if isinstance(content, bytes) else {"json": content or {}}
        async with self.client.post(
            self.origin + path, headers=sent, skip_auto_headers=skipped, **kind
        ) as answer:
            return answer.status, await _content(answer)

    async def login(self, name: str) -> tuple[int, Any]:
        status, content = await self.post("/api/login", {"token": TOKENS[name]})
        if status == 200:
            self.csrf = content["csrf"]
        return status, content


async def _content(answer: aiohttp.ClientResponse) -> Any:
    return await answer.json() if answer.content_type == "application/json" else await answer.text()


@asynccontextmanager
async def open_page(**keys: Any) -> AsyncIterator[PageRig]:
    """The page with three users: vera looks, otto operates, ida integrates."""
    engine, audited = RecordingEngine(), list[tuple[str, str, bool, str]]()
    server = WebServer(
        http_section(**keys), engine, RecordedStates(engine), lambda *line: audited.append(line)
    )
    await server.start()
    jar = aiohttp.CookieJar(unsafe=True)  # of an address instead of a name
    try:
        async with aiohttp.ClientSession(cookie_jar=jar) as client:
            yield PageRig(server, engine, client, audited)
    finally:
        await server.stop()


def on_page(use: Callable[[PageRig], Awaitable[None]], **keys: Any) -> PageRig:
    """Run ``use`` with a page; what is left of it, with all audit lines written."""

    async def scenario() -> PageRig:
        async with open_page(**keys) as rig:
            async with asyncio.timeout(20.0):
                await use(rig)
        return rig

    return asyncio.run(scenario())
