"""The page itself: its files, who is logged in, the stream of states, and the rows of a running job."""

import asyncio
import json
from collections import Counter
from collections.abc import Mapping

from aiohttp import web

from cell.errors import error
from daemon.requests import EngineControl, Params, check_bounds, live
from daemon.web.answers import Visitors, address_of, json_answer
from daemon.web.feed import Feed
from daemon.web.origin import HEADERS, PAGE_POLICY
from daemon.web.page_files import PageFile
from daemon.web.writing import told

SEND_TIMEOUT_S = 5.0
MAX_STREAMS, MAX_STREAMS_EACH = 48, 12  # in all, and from one address


class Serving:
    """What every visitor gets."""

    def __init__(
        self, files: Mapping[str, PageFile], engine: EngineControl, feed: Feed, visitors: Visitors
    ) -> None:
        self._files, self._engine, self._feed, self._visitors = files, engine, feed, visitors
        self._streams: Counter[str] = Counter()

    def routes(self) -> list[web.RouteDef]:
        return [
            web.get("/", self.page),
            web.get("/static/{path:.+}", self.file),
            web.get("/api/me", self.me),
            web.get("/api/events", self.events),
            web.get("/api/live", self.live),
        ]

    async def page(self, request: web.Request) -> web.Response:
        return self._send(request, "index.html")

    async def file(self, request: web.Request) -> web.Response:
        return self._send(request, request.match_info["path"])

    def _send(self, request: web.Request, name: str) -> web.Response:
        found = self._files.get(name)
        if found is None:
            raise web.HTTPNotFound
        headers = {"ETag": f'"{found.etag}"', "Cache-Control": "no-cache"}
        if request.headers.get("If-None-Match") == headers["ETag"]:
            return web.Response(status=304, headers=headers)
        return web.Response(body=found.content, content_type=found.type, charset="utf-8", headers=headers)

    async def me(self, request: web.Request) -> web.Response:
        """Who is logged in, and what a visitor may do without it."""
        users = bool(self._visitors.config.user)
        session = self._visitors.session(request)
        return json_answer({**told(session), "look": self._visitors.may_look(request), "users": users})

    async def live(self, request: web.Request) -> web.Response:
        """Rows of the traces of the running job; ``since`` is JSON as the control socket takes it."""
        self._visitors.require_look(request)
        try:
            since = json.loads(request.query.get("since", "{}"))
            check_bounds(since)
        except (ValueError, RecursionError) as exc:
            raise error("ARGUMENT_INVALID", "live: 'since' is not JSON") from exc
        return json_answer(live(self._engine, Params("live", {"since": since})))

    async def events(self, request: web.Request) -> web.StreamResponse:
        """The state now and after every change, as server-sent events, while the visitor may look."""
        self._visitors.require_look(request)
        address = address_of(request)
        if self._streams.total() >= MAX_STREAMS or self._streams[address] >= MAX_STREAMS_EACH:
            raise web.HTTPServiceUnavailable
        headers = {**HEADERS, "Cache-Control": "no-store", "Content-Security-Policy": PAGE_POLICY}
        answer = web.StreamResponse(headers=headers)
        answer.content_type = "text/event-stream"
        await answer.prepare(request)
        self._streams[address] += 1
        number = self._feed.begin_watch()
        try:
            await self._stream(request, answer, number)
        except ConnectionError:
            pass  # it went away
        except TimeoutError:  # it does not read: what waits for it is thrown away
            if request.transport is not None:
                request.transport.abort()
        finally:
            self._feed.end_watch()
            self._streams -= Counter({address: 1})
        return answer

    async def _stream(self, request: web.Request, answer: web.StreamResponse, number: int) -> None:
        while not self._feed.closed:
            number, event = await self._feed.after(number)
            if not self._visitors.may_look(request):
                return  # the page asks again, and is told why
            async with asyncio.timeout(SEND_TIMEOUT_S):
                await answer.write(event)
