"""One Modbus connection through pymodbus, without its retries and without its reconnecting."""

import asyncio
import ssl
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from pymodbus.client import AsyncModbusSerialClient, AsyncModbusTcpClient
from pymodbus.exceptions import ModbusException
from pymodbus.framer import FramerType
from pymodbus.transport import CommParams, CommType

from cell.answer_time import answer_within
from cell.clock import Clock
from cell.errors import CellError, error
from cell.wire_recording.tap import NO_TAP, Tap, tap
from drivers.modbus.address import ModbusAddress
from drivers.modbus.registers import Span, Table

_REFUSAL_BIT = 0x80

_CALLS = {
    Table.COILS: "read_coils",
    Table.DISCRETE: "read_discrete_inputs",
    Table.HOLDING: "read_holding_registers",
    Table.INPUT: "read_input_registers",
}
_REFUSALS = {
    1: "it does not know this function; check {keys}",
    2: "it has no such addresses; check {keys}",
    3: "it does not take this; check {keys}",
    4: "it failed inside; look at the module's own page or lamps",
    5: "it needs longer; raise poll_period_s",
    6: "it is busy; raise poll_period_s or end other clients",
    10: "the gateway has no path; check unit",
    11: "nothing answers behind the gateway; check unit and the line behind it",
}


class NoAnswer(Exception):
    """No reply, or none that can be used, to one request."""


@dataclass(frozen=True)
class TlsFiles:
    """PEM files, and the name that the other end's certificate must have; absent: the host."""

    ca: str | None = None
    certificate: str | None = None
    key: str | None = None
    server_name: str | None = None


@dataclass(frozen=True)
class LinkSettings:
    """Where a device is and how long to wait; ``keys`` of its section are named when it refuses a request."""

    url: str
    address: ModbusAddress
    unit: int
    timeout_s: float
    connect_timeout_s: float
    keys: str
    tls: TlsFiles = TlsFiles()


class ModbusLink:
    """``disconnected`` is called once when the other end closes the connection."""

    def __init__(
        self, name: str, config: LinkSettings, clock: Clock, disconnected: Callable[[], None]
    ) -> None:
        self._name, self._config, self._clock = name, config, clock
        self._disconnected = disconnected
        self._turn = asyncio.Lock()  # who waits for it waits for no reply yet
        self._client: Any = None
        self._reason = ""
        self._tap: Tap = NO_TAP
        self.sent_at = self.received_at = 0.0  # of the newest request and of bytes that came, clock's s

    async def connect(self) -> None:
        """Connect once; ``DEVICE_UNREACHABLE`` with the reason, also for certificates that do not fit."""
        config = self._config
        try:
            self._client = client = self._make_client()
        except (OSError, ssl.SSLError) as exc:
            raise self._unreachable(f"the TLS files cannot be used: {exc}") from exc
        except RuntimeError as exc:  # how pymodbus says that pyserial is not installed
            raise self._unreachable(str(exc)) from exc
        self._tap = tap("modbus", config.url)
        received = client.ctx.data_received

        def note_and_receive(data: bytes) -> None:
            self.received_at = self._clock.now()
            self._tap.received(data, self.received_at)
            received(data)

        client.ctx.data_received = note_and_receive
        create = client.ctx.call_create

        async def create_or_note() -> Any:
            """pymodbus keeps the reason to itself."""
            try:
                return await create()
            except Exception as exc:  # termios.error is no OSError, and would pass through pymodbus
                self._reason = str(exc) or type(exc).__name__
                raise OSError(self._reason) from exc

        client.ctx.call_create = create_or_note
        if not await client.connect():
            reason = self._reason or f"no connection in {config.connect_timeout_s:g} s"
            await self.close()
            raise self._unreachable(reason)
        # We wait for replies ourselves; pymodbus would count a pause of this process against the module,
        # and close the connection after some timeouts.
        client.ctx.comm_params.timeout_connect = None

    async def close(self) -> None:
        """End the connection without waiting for the other end."""
        client, self._client = self._client, None
        if client is None:
            return
        if client.ctx.transport is not None and self._config.address.scheme != "rtu":
            client.ctx.transport.abort()  # a close of TLS would wait for the other end
        client.close()
        self._tap.closed()

    async def read(self, span: Span) -> list[int]:
        """Bits or registers; :class:`NoAnswer`, or ``MODBUS_REFUSED`` when the module says no."""
        call = getattr(self._client, _CALLS[span.table])
        reply = await self._ask(
            span.table.function, lambda: call(span.start, count=span.count, device_id=self._config.unit)
        )
        if reply.isError():
            raise self._refused(str(span), reply)
        values: list[int] = reply.bits if span.table.has_bits else reply.registers
        if len(values) < span.count:
            await self._let_late_replies_pass()
            raise NoAnswer(f"a reply with {len(values)} values to {span}")
        return values[: span.count]

    async def write(self, start: int, words: Sequence[int]) -> None:
        """Write holding registers from ``start`` on in one request; errors as :meth:`read`."""
        reply = await self._ask(
            16, lambda: self._client.write_registers(start, list(words), device_id=self._config.unit)
        )
        if reply.isError():
            last = start + len(words) - 1
            raise self._refused(f"function 16, addresses 0x{start:04X} to 0x{last:04X}", reply)

    async def write_coil(self, address: int, on: bool) -> None:
        """Switch one coil; errors as :meth:`read`."""
        reply = await self._ask(5, lambda: self._client.write_coil(address, on, device_id=self._config.unit))
        if reply.isError():
            raise self._refused(f"function 5, address 0x{address:04X}", reply)

    async def identification(self, read_code: int, object_id: int) -> tuple[dict[int, bytes], int]:
        """Objects of function 43/14, and the number of the next object, 0 at the end. Errors as ``read``."""
        reply = await self._ask(
            43,
            lambda: self._client.read_device_information(
                read_code=read_code, object_id=object_id, device_id=self._config.unit
            ),
        )
        if reply.isError():
            raise self._refused(f"function 43, object 0x{object_id:02X}", reply)
        found = {n: v[0] if isinstance(v, list) else v for n, v in reply.information.items()}
        return found, reply.next_object_id if reply.more_follows else 0

    async def _ask(self, function: int, call: Callable[[], Any]) -> Any:
        if self._client is None:
            raise NoAnswer("the connection is closed")
        async with self._turn:  # until a late reply has passed: the next request would take it for its own
            try:
                async with answer_within(self._config.timeout_s):
                    reply = await call()
            except (ModbusException, TimeoutError) as exc:
                await self._let_late_replies_pass()
                raise NoAnswer(f"no answer in {self._config.timeout_s:g} s") from exc
            if (answered := reply.function_code & ~_REFUSAL_BIT) != function:
                await self._let_late_replies_pass()
                raise NoAnswer(f"a reply to function {answered} came for a request of function {function}")
            return reply

    async def _let_late_replies_pass(self) -> None:
        """Replies on a serial line carry no number: a late one must not answer the next request."""
        if self._config.address.scheme == "rtu":
            await self._clock.sleep(self._config.timeout_s)

    def _refused(self, what: str, reply: Any) -> CellError:
        code = reply.exception_code
        why = _REFUSALS.get(code, "look it up in its manual").format(keys=self._config.keys)
        return error(
            "MODBUS_REFUSED",
            f"{self._name} at {self._config.url}, unit {self._config.unit},"
            f" answered exception {code} to {what}: {why}",
        )

    def _unreachable(self, reason: str) -> CellError:
        return error("DEVICE_UNREACHABLE", f"{self._name} at {self._config.url}: {reason}")

    def _make_client(self) -> Any:
        config, address = self._config, self._config.address
        common: dict[str, Any] = {
            "name": self._name,
            "reconnect_delay": 0,  # the supervisor reconnects
            "timeout": config.connect_timeout_s,
            "retries": 0,
            "trace_connect": self._note_connection,
            "trace_packet": self._note_sent,
        }
        if address.scheme == "rtu":
            serial = {"baudrate": address.baudrate, "parity": address.parity, "stopbits": address.stopbits}
            return AsyncModbusSerialClient(address.host, **serial, **common)
        if address.scheme == "tls":
            return _TlsClient(address.host, address.port, _tls_context(config.tls), **common)
        return AsyncModbusTcpClient(address.host, port=address.port, **common)

    def _note_sent(self, sending: bool, data: bytes) -> bytes:
        """pymodbus shows also what it received, but bytes of a reply in two parts twice."""
        if sending:
            self.sent_at = self._clock.now()
            self._tap.sent(data, self.sent_at)
        return data

    def _note_connection(self, connected: bool) -> None:
        if not connected and self._client is not None:
            self._disconnected()


class _TlsClient(AsyncModbusTcpClient):  # type: ignore[misc]
    """Modbus over TLS with the framer of TCP.

    That of pymodbus for TLS takes whatever has arrived for a whole frame, so a reply in two parts is lost.
    """

    def __init__(self, host: str, port: int, context: ssl.SSLContext, **common: Any) -> None:
        self.comm_params = CommParams(
            comm_type=CommType.TLS,
            comm_name=common["name"],
            host=host,
            port=port,
            sslctx=context,
            reconnect_delay=common["reconnect_delay"],
            timeout_connect=common["timeout"],
        )
        super().__init__(host, framer=FramerType.SOCKET, port=port, **common)


class _NamedContext(ssl.SSLContext):
    """Expects ``server_name`` in the certificate, whatever address was connected to."""

    server_name: str | None = None

    def wrap_bio(
        self,
        incoming: ssl.MemoryBIO,
        outgoing: ssl.MemoryBIO,
        server_side: bool = False,
        server_hostname: str | bytes | None = None,
        session: ssl.SSLSession | None = None,
    ) -> ssl.SSLObject:
        name = self.server_name or server_hostname
        return super().wrap_bio(incoming, outgoing, server_side, name, session)


def _tls_context(files: TlsFiles) -> ssl.SSLContext:
    """Verifies certificate and name, always: an input that anybody can imitate would steer the arm."""
    context = _NamedContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.server_name = files.server_name
    if files.ca is not None:
        context.load_verify_locations(files.ca)
    else:
        context.load_default_certs()
    if files.certificate is not None:
        context.load_cert_chain(files.certificate, files.key)
    return context
