"""Reading and writing a CANopen node's objects: expedited SDO, which holds up to four bytes."""

import asyncio
from collections.abc import Awaitable, Callable

from cell.errors import error
from drivers.can_encoder.words import WRONG_LENGTH, abort_words

_READ, _ABORT = 0x40, 0x80
_READ_REPLY, _WRITE_REPLY = 0x40, 0x60  # upper three bits
_REQUEST_ID, REPLY_ID = 0x600, 0x580
_NOT_EXPEDITED = 0x05040001


class SdoAbort(Exception):
    """The node refuses; ``code`` is CANopen's."""

    def __init__(self, index: int, sub: int, code: int) -> None:
        super().__init__(f"object {index:04X}h:{sub:02X}h: {abort_words(code)}")
        self.code = code


class SdoClient:
    """One request at a time; a request or reply that got lost is sent again, which expedited ones allow."""

    def __init__(
        self,
        name: str,
        node: int,
        send: Callable[[int, bytes], Awaitable[None]],
        timeout_s: float,
        tries: int = 2,
    ) -> None:
        self._name, self._node, self._send = name, node, send
        self._timeout_s, self._tries = timeout_s, tries
        self._waiting: tuple[bytes, asyncio.Future[bytes]] | None = None

    async def read(self, index: int, sub: int = 0) -> int:
        """An unsigned number of up to four bytes; ``SdoAbort``, or ``DEVICE_LOST`` without an answer."""
        return (await self.read_sized(index, sub))[0]

    async def read_sized(self, index: int, sub: int = 0) -> tuple[int, int | None]:
        """The number as :meth:`read` gives it, and how many bytes it has where the node says so."""
        reply = await self._ask(bytes([_READ]) + _place(index, sub) + bytes(4))
        if reply[0] & 0xE0 != _READ_REPLY or not reply[0] & 0x02:
            await self._send(
                _REQUEST_ID + self._node,
                bytes([_ABORT]) + _place(index, sub) + _NOT_EXPEDITED.to_bytes(4, "little"),
            )
            raise SdoAbort(index, sub, _NOT_EXPEDITED)
        size = 4 - (reply[0] >> 2 & 3) if reply[0] & 0x01 else None
        return int.from_bytes(reply[4 : 4 + (size or 4)], "little"), size

    async def write_sized(self, index: int, sub: int, value: int, usual: int) -> None:
        """Write in the size that the node says the object has, else in the ``usual`` one.

        Makers give the times of an object 16 bits, as CiA 301 has them, or 32. A node that refuses the length
        all the same is asked for the other.
        """
        _, told = await self.read_sized(index, sub)
        size = told or usual
        try:
            await self.write(index, sub, value, size)
        except SdoAbort as exc:
            if exc.code not in WRONG_LENGTH:
                raise
            await self.write(index, sub, value, 6 - size if size in (2, 4) else usual)

    async def write(self, index: int, sub: int, value: int, size: int) -> None:
        """Write ``size`` bytes; errors as :meth:`read`."""
        head = 0x23 | (4 - size) << 2
        data = value.to_bytes(size, "little").ljust(4, b"\0")
        reply = await self._ask(bytes([head]) + _place(index, sub) + data)
        if reply[0] & 0xE0 != _WRITE_REPLY:
            raise error("PROTOCOL_VIOLATION", f"{self._name}: reply {reply.hex(' ')} to a write")

    def receive(self, data: bytes) -> None:
        """Take a frame of the node's reply identifier."""
        if self._waiting is None or len(data) != 8:
            return
        place, future = self._waiting
        if data[1:4] == place and not future.done():
            future.set_result(data)

    async def _ask(self, request: bytes) -> bytes:
        place = request[1:4]
        index, sub = int.from_bytes(place[:2], "little"), place[2]
        for _ in range(self._tries):
            future: asyncio.Future[bytes] = asyncio.get_running_loop().create_future()
            self._waiting = place, future
            try:
                await self._send(_REQUEST_ID + self._node, request)
                async with asyncio.timeout(self._timeout_s):
                    reply = await future
            except TimeoutError:
                continue
            finally:
                self._waiting = None
            if reply[0] == _ABORT:
                raise SdoAbort(index, sub, int.from_bytes(reply[4:8], "little"))
            return reply
        raise error(
            "DEVICE_LOST", f"{self._name}: node {self._node} does not answer (object {index:04X}h:{sub:02X}h)"
        )


def _place(index: int, sub: int) -> bytes:
    return index.to_bytes(2, "little") + bytes([sub])
