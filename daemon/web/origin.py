"""Which requests come from the page itself: by host, by origin, and by what the browser says of itself.

A browser sends what any site tells it to. So a host that is not ours is refused (a name that another site
points at this computer), a write needs our own origin and JSON (a form of another site has neither), and
answers carry headers that keep them out of other sites' pages.
"""

from collections.abc import Iterable
from urllib.parse import urlsplit

from aiohttp import web

from cell.errors import error
from daemon.config.faces import HttpSection, is_loopback, split_bind

SAFE_METHODS = {"GET", "HEAD"}
PAGE_POLICY = (
    "default-src 'self'; object-src 'none'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
# A report carries its scripts inside. It runs in a sandbox without an origin: it can ask the cell nothing.
REPORT_POLICY = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=(), payment=(), usb=()",
}


class OwnOrigin:
    """What a request must say to be taken for one of the page's own."""

    def __init__(self, config: HttpSection, port: int) -> None:
        self.scheme = "http" if config.tls_cert is None else "https"
        self._hosts = {f"{name}:{port}" for name in _names(config)}
        if port == (80 if self.scheme == "http" else 443):  # which browsers leave out
            self._hosts |= set(_names(config))

    def require_host(self, request: web.BaseRequest) -> None:
        """``PAGE_REFUSED`` for a name that is not one of this cell's."""
        if request.headers.get("Host", "").lower() not in self._hosts:
            raise error("PAGE_REFUSED", f"the host '{request.headers.get('Host', '')[:100]}' is not known")

    def require_own(self, request: web.BaseRequest) -> None:
        """``PAGE_REFUSED`` for a request that another site's page made."""
        site = request.headers.get("Sec-Fetch-Site", "same-origin")
        if site not in ("same-origin", "none"):
            raise error("PAGE_REFUSED", f"the browser says that it came from elsewhere ({site[:20]})")
        if request.method in SAFE_METHODS:
            return
        origin = urlsplit(request.headers.get("Origin", ""))
        if origin.scheme != self.scheme or origin.netloc != request.headers.get("Host", "").lower():
            raise error("PAGE_REFUSED", f"the origin '{request.headers.get('Origin', '')[:100]}' is not ours")
        if request.content_type != "application/json":
            raise error("PAGE_REFUSED", f"the content is '{request.content_type[:50]}', not JSON")


def _names(config: HttpSection) -> Iterable[str]:
    host = split_bind(config.bind)[0]
    yield f"[{host}]" if ":" in host else host
    if is_loopback(host):
        yield "localhost"
    yield from (name.lower() for name in config.names)
