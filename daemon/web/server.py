"""The page's server: one application on one address, whose connections are few and heard from in time."""

import asyncio
import logging
import socket
import ssl
from collections.abc import Awaitable, Callable

from aiohttp import web

from cell.errors import CellError, error
from daemon.auditor import Audit, Auditor
from daemon.config.faces import HttpSection, split_bind
from daemon.requests import EngineControl
from daemon.web.answers import Visitors, caller, refusal
from daemon.web.feed import Feed, States
from daemon.web.origin import HEADERS, PAGE_POLICY, SAFE_METHODS, OwnOrigin
from daemon.web.page_files import page_files
from daemon.web.serving import Serving
from daemon.web.sessions import Sessions
from daemon.web.writing import Writing

log = logging.getLogger("cellward.web")

MAX_BODY_BYTES = 64 * 1024
MAX_CONNECTIONS = 96
FIRST_REQUEST_S = 10.0  # a connection that asks nothing for so long is closed
KEEP_ALIVE_S = 30.0
SHUTDOWN_S = 1.0

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class WebServer:
    """Serves the page of one engine. ``more`` are the routes of what is only read."""

    def __init__(
        self,
        config: HttpSection,
        engine: EngineControl,
        states: States,
        audit: Audit | None,
        more: Callable[[Visitors], list[web.RouteDef]] = lambda visitors: [],
    ) -> None:
        self._config, self._engine, self._states, self._more = config, engine, states, more
        self._auditor = Auditor(audit)
        self._feed = Feed(states)
        self._silent: set[asyncio.BaseProtocol] = set()  # connections that asked nothing so far
        self._server: asyncio.Server | None = None
        self._runner: web.AppRunner | None = None
        self._making: asyncio.Task[None] | None = None
        self.address = split_bind(config.bind)

    @property
    def url(self) -> str:
        host, port = self.address
        shown = f"[{host}]" if ":" in host else host
        return f"{'http' if self._config.tls_cert is None else 'https'}://{shown}:{port}/"

    async def start(self) -> None:
        """Listen; ``ADDRESS_NOT_SERVED``, or ``CONFIG_INVALID`` for a certificate that cannot be used."""
        context = await asyncio.to_thread(_tls, self._config)
        listener = _listen(*self.address)
        self.address = listener.getsockname()[:2]
        self._origin = OwnOrigin(self._config, self.address[1])
        runner = self._runner = web.AppRunner(
            await self._application(),
            access_log=None,
            keepalive_timeout=KEEP_ALIVE_S,
            shutdown_timeout=SHUTDOWN_S,
        )
        await runner.setup()
        self._auditor.start()
        self._making = asyncio.create_task(self._feed.run(), name="page state")
        loop = asyncio.get_running_loop()
        self._server = await loop.create_server(lambda: self._connect(runner), sock=listener, ssl=context)
        log.info("the page is on %s, %d users may log in", self.url, len(self._config.user))

    async def stop(self) -> None:
        """Close everything, and write the audit lines that wait."""
        self._states.close()
        if self._server is not None:
            self._server.close()
        if self._making is not None:
            self._making.cancel()
            await asyncio.wait([self._making])
        if self._runner is not None:
            await self._runner.cleanup()
        await self._auditor.stop()

    async def _application(self) -> web.Application:
        app = web.Application(middlewares=[self._guard], client_max_size=MAX_BODY_BYTES)
        # Cookies know no port: two cells on one computer need names of their own.
        prefix = "__Host-" if self._config.tls_cert is not None else ""
        sessions = Sessions(self._config.user, self._config.session_s, asyncio.get_running_loop().time)
        visitors = Visitors(self._config, sessions, f"{prefix}cellward-{self.address[1]}")
        files = await asyncio.to_thread(page_files)
        app.add_routes(Serving(files, self._engine, self._feed, visitors).routes())
        app.add_routes(Writing(self._engine, self._auditor, visitors).routes())
        app.add_routes(self._more(visitors))
        return app

    @web.middleware
    async def _guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse what is not the page's own, answer errors as JSON, and put the headers on every answer."""
        self._silent.discard(request.protocol)
        answer: web.StreamResponse
        try:
            self._require_own(request)
            answer = await handler(request)
        except web.HTTPException as exc:
            answer = web.Response(text=f"{exc.status} {exc.reason}", status=exc.status)
        except CellError as exc:
            answer = refusal(exc)
        except (ConnectionError, asyncio.CancelledError):
            raise
        except Exception as exc:
            answer = refusal(exc)
        if not answer.prepared:
            self.protect(answer)
        return answer

    def _require_own(self, request: web.Request) -> None:
        try:
            self._origin.require_host(request)
            if request.path.startswith("/api/") or request.method not in SAFE_METHODS:
                self._origin.require_own(request)
        except CellError as exc:
            if request.method not in SAFE_METHODS:
                what = f"{request.method} {request.path}"
                self._auditor.note(caller(request, None).who, what, False, str(exc))
            raise

    @staticmethod
    def protect(answer: web.StreamResponse) -> None:
        for name, value in HEADERS.items():
            answer.headers.setdefault(name, value)
        answer.headers.setdefault("Content-Security-Policy", PAGE_POLICY)
        answer.headers.setdefault("Cache-Control", "no-store")
        answer.headers["Server"] = "cellward"

    def _connect(self, runner: web.AppRunner) -> asyncio.Protocol:
        server = runner.server
        if server is None or len(server.connections) >= MAX_CONNECTIONS:
            return _Full()
        protocol = server()
        self._silent.add(protocol)

        def close_if_silent() -> None:
            if protocol in self._silent:
                self._silent.discard(protocol)
                protocol.force_close()

        asyncio.get_running_loop().call_later(FIRST_REQUEST_S, close_if_silent)
        return protocol


class _Full(asyncio.Protocol):
    """A connection for which there is no place."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        transport.close()


def _listen(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.setblocking(False)
        listener.bind((host, port))
    except OSError as exc:
        listener.close()
        raise error("ADDRESS_NOT_SERVED", f"[http] bind {host}:{port}: {exc.strerror or exc}") from exc
    return listener


def _tls(config: HttpSection) -> ssl.SSLContext | None:
    if config.tls_cert is None:
        return None
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        context.load_cert_chain(config.tls_cert, config.tls_key, password="")
    except (OSError, ssl.SSLError) as exc:
        raise error("CONFIG_INVALID", f"[http] tls_cert or tls_key cannot be used: {exc}") from exc
    return context
