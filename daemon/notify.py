"""Word to systemd: datagrams to ``$NOTIFY_SOCKET``, sent without ever waiting for a reader."""

import logging
import os
import socket
from collections.abc import Mapping

log = logging.getLogger("cellward.notify")


class Notifier:
    """Says READY, STATUS, WATCHDOG, RELOADING and STOPPING; harmless when nobody asked for it.

    A blocking send hangs when the reader does not read (its queue holds ten datagrams), so a full queue
    drops the message. The beat that systemd's watchdog then misses is what the watchdog is for.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket: socket.socket | None = None
        if self._address.startswith(("/", "\0")):
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)
        self.watchdog_s = _watchdog(environment)
        self.dropped = 0

    def send(self, *lines: str) -> None:
        """One datagram of ``KEY=value`` lines; what cannot be handed over is counted in ``dropped``."""
        if self._socket is None:
            return
        try:
            self._socket.sendto("\n".join(lines).encode("utf-8"), self._address)
        except OSError as exc:
            self.dropped += 1
            if self.dropped == 1:
                log.warning("systemd cannot be told '%s': %s", lines[0], exc.strerror or exc)

    def ready(self, status: str = "") -> None:
        """Start-up, or a reload, is over."""
        self.send("READY=1", *([f"STATUS={_one_line(status)}"] if status else []))

    def status(self, text: str) -> None:
        """The line that ``systemctl status`` shows."""
        self.send(f"STATUS={_one_line(text)}")

    def watchdog(self) -> None:
        """The process is fit."""
        self.send("WATCHDOG=1")

    def stopping(self) -> None:
        """The end begins."""
        self.send("STOPPING=1")

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def _watchdog(environment: Mapping[str, str]) -> float | None:
    """The watchdog's time in seconds, or None when it does not watch this process."""
    try:
        microseconds = int(environment.get("WATCHDOG_USEC", "0"))
        pid = int(environment.get("WATCHDOG_PID", os.getpid()))
    except ValueError:
        return None
    return microseconds / 1e6 if microseconds > 0 and pid == os.getpid() else None


def _one_line(text: str) -> str:
    return " ".join(text.split())
