"""The operator's page of the demo: one address and one user for all its daemons, to be watched live."""

import socket
from dataclasses import dataclass
from pathlib import Path

from daemon.cli.output import say
from daemon.web.tokens import digest, new_token

HOST, PORT = "127.0.0.1", 8420
USER = "demo"


@dataclass(frozen=True)
class DemoPage:
    """Where the page is, and the token with which a visitor may act on it."""

    port: int
    token: str

    @classmethod
    def on_a_free_port(cls) -> "DemoPage":
        """On the usual port, or on another one where something else has that."""
        return cls(_free(PORT) or _free(0), new_token())

    @property
    def address(self) -> str:
        return f"http://{HOST}:{self.port}/"

    def add_to(self, config: Path) -> None:
        """Into the twin's own ``cell.toml``, which is the demo's to change; a port that somebody took
        meanwhile costs the page, not the demo."""
        if not _free(self.port):
            say(f"port {self.port} is in use by another program: no page for this twin")
            return
        with config.open("a", encoding="utf-8") as file:
            file.write(
                f'\n[http]\nbind = "{HOST}:{self.port}"\nlook_without_login = true\n'
                f'[http.user.{USER}]\nrole = "integrator"\ntoken_sha256 = "{digest(self.token)}"\n'
            )


def _free(port: int) -> int:
    """The port if it can be listened on, any free one for 0; 0 where it cannot."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((HOST, port))
        except OSError:
            return 0
        found: int = probe.getsockname()[1]
        return found
