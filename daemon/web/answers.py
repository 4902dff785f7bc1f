"""How the page's API answers: JSON, errors with their number and hint, and who is asking."""

import asyncio
import json
from dataclasses import dataclass
from typing import Any

from aiohttp import web

from cell.errors import CellError, Reaction, error
from daemon.config.faces import HttpSection, Role
from daemon.requests import Caller, check_bounds, described, too_deep
from daemon.web.sessions import Session, Sessions

BODY_TIMEOUT_S = 5.0
STATUS = {
    "LOGIN_NEEDED": 401,
    "LOGIN_REFUSED": 401,
    "ROLE_TOO_LOW": 403,
    "PAGE_REFUSED": 403,
    "NOT_FOUND": 404,
    "LOGIN_TOO_OFTEN": 429,
}
BY_REACTION = {Reaction.INPUT: 400, Reaction.REFUSE: 409, Reaction.INTERNAL: 500}


def json_answer(content: Any, status: int = 200) -> web.Response:
    text = json.dumps(content, default=str, separators=(",", ":"))
    return web.Response(text=text, status=status, content_type="application/json")


def refusal(exc: Exception) -> web.Response:
    """The answer that an error makes; one without a code is a defect, and is logged."""
    status = 500
    if isinstance(exc, CellError):
        status = STATUS.get(exc.name, BY_REACTION.get(exc.reaction, 409))
    return json_answer({"error": described(exc)}, status)


async def body(request: web.Request) -> dict[str, Any]:
    """The JSON object that was sent; ``ARGUMENT_INVALID`` for anything else."""
    try:
        async with asyncio.timeout(BODY_TIMEOUT_S):
            raw = await request.read()
        sent = json.loads(raw) if raw else {}
    except TimeoutError:
        raise error("ARGUMENT_INVALID", f"the request did not come within {BODY_TIMEOUT_S:g} s") from None
    except web.HTTPRequestEntityTooLarge as exc:
        raise error("ARGUMENT_INVALID", "the request is too long") from exc
    except RecursionError as exc:
        raise too_deep() from exc
    except ValueError as exc:
        raise error("ARGUMENT_INVALID", f"the request is not JSON: {exc}") from exc
    if not isinstance(sent, dict):
        raise error("ARGUMENT_INVALID", "the request is not a JSON object")
    check_bounds(sent)
    return sent


@dataclass(frozen=True)
class Visitors:
    """Who asks: by cookie, and what those may see who have none."""

    config: HttpSection
    sessions: Sessions
    cookie: str  # its name

    def session(self, request: web.Request) -> Session | None:
        return self.sessions.find(request.cookies.get(self.cookie))

    def may_look(self, request: web.Request) -> bool:
        return self.config.look_without_login or self.session(request) is not None

    def require_look(self, request: web.Request) -> None:
        """``LOGIN_NEEDED`` unless the visitor may look."""
        if not self.may_look(request):
            raise error("LOGIN_NEEDED")

    def require(self, request: web.Request, role: Role) -> Session:
        """Who is logged in and has ``role``; for a write, by a page that knows the session's secret, too."""
        session = self.session(request)
        if session is None:
            raise error("LOGIN_NEEDED")
        if request.headers.get("X-Cellward-Csrf") != session.csrf:
            raise error("PAGE_REFUSED", "it does not carry the page's own mark")
        session.require(role)
        self.sessions.use(session)
        return session


def address_of(request: web.BaseRequest) -> str:
    return request.remote or "unknown"


def caller(request: web.Request, session: Session | None) -> Caller:
    """Who asks, as the audit and the journal name them."""
    who = session.user if session is not None else "nobody"
    return Caller(f"{who} (page, {address_of(request)})", "web")
