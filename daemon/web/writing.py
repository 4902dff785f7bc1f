"""What changes something: log in and out, and what the control socket asks of the engine, too."""

import asyncio
from collections.abc import Mapping
from typing import Any

from aiohttp import web

from cell.errors import CellError, error
from daemon.auditor import Auditor
from daemon.config.faces import Role
from daemon.requests import WRITES, EngineControl, Params, carry_out
from daemon.web.answers import Visitors, address_of, body, caller, json_answer
from daemon.web.sessions import Session
from daemon.words.plan_text import plan_text

NEEDS: Mapping[str, Role] = {
    "start": "operator",
    "confirm": "operator",
    "skip": "operator",
    "finish": "operator",
    "abort": "viewer",  # whoever is logged in may stop
    "halt": "viewer",
    "pause": "operator",
    "resume": "operator",
    "reset": "integrator",
    "accept": "operator",
    "reject": "operator",
    "rollback": "integrator",
    "sign": "integrator",
    "acknowledge_ledger": "integrator",
}


class Writing:
    """The writing half of the API; every write is audited, and every one that is refused."""

    def __init__(self, engine: EngineControl, auditor: Auditor, visitors: Visitors) -> None:
        self._engine, self._auditor, self._visitors = engine, auditor, visitors

    def routes(self) -> list[web.RouteDef]:
        return [
            web.post("/api/login", self.login),
            web.post("/api/logout", self.logout),
            web.post("/api/do/{method}", self.do),
        ]

    async def login(self, request: web.Request) -> web.Response:
        token = Params("login", await body(request)).get("token", str)
        try:
            cookie, session = self._visitors.sessions.login(token, address_of(request))
        except CellError as exc:
            self._auditor.note(caller(request, None).who, "login", False, str(exc))
            raise
        self._auditor.note(caller(request, session).who, "login", True)
        answer = json_answer(told(session))
        secure = self._visitors.config.tls_cert is not None
        answer.set_cookie(
            self._visitors.cookie, cookie, path="/", httponly=True, secure=secure, samesite="Strict"
        )
        return answer

    async def logout(self, request: web.Request) -> web.Response:
        session = self._visitors.require(request, "viewer")
        self._visitors.sessions.end(request.cookies.get(self._visitors.cookie))
        self._auditor.note(caller(request, session).who, "logout", True)
        answer = json_answer({})
        answer.del_cookie(self._visitors.cookie, path="/")
        return answer

    async def do(self, request: web.Request) -> web.Response:
        method = request.match_info["method"]
        if method not in WRITES:
            raise error("ARGUMENT_INVALID", f"there is no method '{method[:50]}'")
        try:
            session = self._visitors.require(request, NEEDS[method])
            params = await body(request)
            _require_reason(method, params, session)
        except CellError as exc:
            by = caller(request, self._visitors.session(request))
            self._auditor.note(by.who, method, False, str(exc))
            raise
        done = await carry_out(self._engine, self._auditor, method, params, caller(request, session))
        if isinstance(done, dict) and isinstance(plan := done.get("plan"), dict):
            done = {"run_id": done.get("run_id"), "words": await asyncio.to_thread(plan_text, plan)}
        return json_answer({"done": done})


def _require_reason(method: str, params: dict[str, Any], session: Session) -> None:
    """A result with warnings is accepted by an integrator who says why."""
    if method == "accept" and params.get("warned"):
        session.require("integrator")
        if not str(params.get("why") or "").strip():
            raise error("ARGUMENT_INVALID", "to accept a result with warnings, 'why' gives the reason")


def told(session: Session | None) -> dict[str, Any]:
    """A session as its page knows it."""
    if session is None:
        return {"user": None, "role": None, "csrf": None}
    return {"user": session.user, "role": session.role, "csrf": session.csrf}
