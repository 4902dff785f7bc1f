"""Who is logged in: tokens held against digests, sessions in memory, and attempts kept few."""

import hashlib
import hmac
import secrets
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from cell.errors import error
from daemon.config.faces import Role, UserSection
from daemon.web.tokens import digest

MAX_SESSIONS = 256
MAX_ADDRESSES = 1000
FAILURES, WINDOW_S = 5, 60.0  # so many unknown tokens from one address in this time
RANK: Mapping[Role, int] = {"viewer": 0, "operator": 1, "integrator": 2}


@dataclass
class Session:
    """One login. ``csrf`` is what its page repeats in a header, which another site's page cannot know."""

    user: str
    role: Role
    csrf: str
    used: float

    def require(self, role: Role) -> None:
        """``ROLE_TOO_LOW`` unless this user has at least ``role``."""
        if RANK[self.role] < RANK[role]:
            raise error("ROLE_TOO_LOW", f"{self.user} is {self.role}, this needs {role}")


class Sessions:
    """Logins of one daemon; its end ends them. ``now`` gives seconds that never go back."""

    def __init__(self, users: Mapping[str, UserSection], idle_s: float, now: Callable[[], float]) -> None:
        self._users, self._idle_s, self._now = dict(users), idle_s, now
        self._sessions: OrderedDict[str, Session] = OrderedDict()  # by digest of the cookie, oldest first
        self._failed: OrderedDict[str, list[float]] = OrderedDict()  # by address

    def login(self, token: str, address: str) -> tuple[str, Session]:
        """The cookie and the session of a token; ``LOGIN_REFUSED``, or ``LOGIN_TOO_OFTEN``."""
        session = self.known(token, address)
        cookie = secrets.token_urlsafe(32)
        self._sessions[_key(cookie)] = session
        if len(self._sessions) > MAX_SESSIONS:
            self._sessions.popitem(last=False)
        return cookie, session

    def known(self, token: str, address: str) -> Session:
        """Who has this token, for one request or for a login; refused as :meth:`login` tells."""
        self._require_few(address)
        given, found = digest(token), None
        for name, user in self._users.items():  # each of them, so that time tells nothing
            if hmac.compare_digest(given, user.token_sha256):
                found = name, user
        if found is None:
            self._failed.setdefault(address, []).append(self._now())
            if len(self._failed) > MAX_ADDRESSES:
                self._failed.popitem(last=False)
            raise error("LOGIN_REFUSED")
        return Session(found[0], found[1].role, secrets.token_urlsafe(32), self._now())

    def find(self, cookie: str | None) -> Session | None:
        """The session of a cookie; None when there is none, or when nothing was done in it for too long."""
        key = _key(cookie or "")
        session = self._sessions.get(key)
        if session is not None and self._now() - session.used > self._idle_s:
            del self._sessions[key]
            return None
        return session

    def use(self, session: Session) -> None:
        """Something is done in it: it does not end yet."""
        session.used = self._now()

    def end(self, cookie: str | None) -> None:
        self._sessions.pop(_key(cookie or ""), None)

    def _require_few(self, address: str) -> None:
        since = self._now() - WINDOW_S
        recent = [t for t in self._failed.get(address, ()) if t > since]
        if recent:
            self._failed[address] = recent
        else:
            self._failed.pop(address, None)
        if len(recent) >= FAILURES:
            raise error("LOGIN_TOO_OFTEN", address)


def _key(cookie: str) -> str:
    """Sessions are found by a digest: how long a look-up takes says nothing about a cookie."""
    return hashlib.sha256(cookie.encode("utf-8", "replace")).hexdigest()
