"""A bus behind a socketcand gateway, as a python-can bus.

python-can's own waits for ever for a silent gateway, tries a refusing one ten seconds long in a busy loop,
never tells that the gateway closed the connection, and has no descriptor to wait for. Its codec is used.
"""

import re
import select
import socket
import time
from collections import deque
from typing import Any

import can
from can.interfaces.socketcand.socketcand import (
    convert_ascii_message_to_can_message,
    convert_can_message_to_ascii_message,
)

from cell.wire_recording.tap import tap
from drivers.can_bus.address import BusAddress

_CHUNK = 16384
_LONGEST = 200
_TOKEN = re.compile(r"<[^<>]*>")


class GatewayBus(can.BusABC):
    """``recv`` raises ``CanOperationError`` once when the gateway is gone; stamps are the gateway's."""

    def __init__(self, address: BusAddress, timeout: float) -> None:
        self.malformed = 0
        self._text = ""
        self._tokens: deque[str] = deque()
        self._unrecorded: list[bytes] = []
        self._write_timeout = timeout
        deadline = time.monotonic() + timeout
        self._socket = socket.create_connection((address.host, address.port), timeout)
        self._tap = tap("socketcand", f"{address.host}:{address.port}")
        try:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._socket.setblocking(False)
            self._expect("< hi >", deadline)
            self._say(f"< open {address.channel} >")
            self._expect("< ok >", deadline)
            self._say("< rawmode >")
            self._expect("< ok >", deadline)
        except BaseException:
            self._socket.close()
            raise
        self.channel_info = f"socketcand {address.channel} at {address.host}:{address.port}"
        super().__init__(channel=address.channel)

    def fileno(self) -> int:
        return self._socket.fileno()

    def record_received(self, t: float | None = None) -> None:
        """What was read belongs to ``t``, the monotonic s that its frames are taken to have come by."""
        for chunk in self._unrecorded:
            self._tap.received(chunk, t)
        self._unrecorded.clear()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """``CanOperationError`` when the gateway does not take it in time."""
        self._say(convert_can_message_to_ascii_message(msg))

    def shutdown(self) -> None:
        super().shutdown()
        self._socket.close()
        self._tap.closed()

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        while self._tokens or self._fill(timeout):
            token = self._tokens.popleft()
            try:
                message: Any = convert_ascii_message_to_can_message(token)
            except (ValueError, LookupError):
                message = None
            if message is not None:
                return message, False
            self.malformed += 1
        return None, False

    def _fill(self, timeout: float | None) -> bool:
        """Read what has arrived; whether there are whole messages."""
        if timeout != 0 and not select.select([self._socket], [], [], timeout)[0]:
            return False
        try:
            chunk = self._socket.recv(_CHUNK)
        except BlockingIOError:
            return False
        except OSError as exc:
            raise can.CanOperationError(f"the gateway is gone ({exc.strerror})") from exc
        if not chunk:
            raise can.CanOperationError("the gateway closed the connection")
        self._unrecorded.append(chunk)
        self._text += chunk.decode("ascii", "replace")
        end = 0
        for found in _TOKEN.finditer(self._text):
            self._tokens.append(found.group())
            end = found.end()
        self._text = self._text[end:]
        if len(self._text) > _LONGEST:
            self.malformed += 1
            self._text = ""
        return bool(self._tokens)

    def _say(self, text: str) -> None:
        data, deadline = text.encode("ascii"), time.monotonic() + self._write_timeout
        self._tap.sent(data)
        try:
            while data:
                left = max(deadline - time.monotonic(), 0.0)
                if not select.select([], [self._socket], [], left)[1]:
                    raise can.CanOperationError("the gateway does not take what it is sent")
                data = data[self._socket.send(data) :]
        except (OSError, ValueError) as exc:
            raise can.CanOperationError(f"the gateway is gone ({exc})") from exc

    def _expect(self, answer: str, deadline: float) -> None:
        while not self._tokens:
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise can.CanInitializationError(f"the gateway did not say '{answer}' in time")
            self._fill(left)
            self.record_received()
        token = self._tokens.popleft()
        if token != answer:
            raise can.CanInitializationError(f"the gateway said '{token}' instead of '{answer}'")
