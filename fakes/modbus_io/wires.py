"""All wires of one module: TCP, TLS and RTU as asked for, with power that can be cut."""

import asyncio
from pathlib import Path

from fakes.modbus_io.module import UnitTables
from fakes.modbus_io.rtu import RtuLine
from fakes.modbus_io.service import Pace, Service
from fakes.modbus_io.tcp import Connection, Connections
from fakes.wire.listening import Listener, TcpPlace


class ModuleWires:
    """One module on any number of addresses and at most one serial line."""

    def __init__(
        self,
        module: UnitTables,
        places: tuple[TcpPlace, ...],
        line: Path | None = None,
        pace: Pace | None = None,
    ) -> None:
        self.service = Service(module, pace or Pace())
        self.connections = Connections(self.service, lambda: self._listener.accepting)
        self.line = RtuLine(self.service, line) if line is not None else None
        self._listener = Listener(lambda: Connection(self.connections), places)

    @property
    def addresses(self) -> list[tuple[str, int]]:
        """Where the TCP wires listen; the ports are known after :meth:`start`."""
        return self._listener.addresses

    async def start(self) -> None:
        """Listen; ``OSError`` when an address is taken, and then nothing is left open."""
        try:
            await self.listen()
            if self.line is not None:
                self.line.open()
        except OSError:
            await self.stop()
            raise

    async def stop(self) -> None:
        """Close everything."""
        self._listener.off = True
        self.refuse()
        self.connections.abort_all()
        await self._listener.closed()
        if self.line is not None:
            self.line.close()

    async def listen(self) -> None:
        """Accept connections; not while the module is without power."""
        await self._listener.listen()

    def refuse(self) -> None:
        """Stop accepting connections; open ones stay."""
        self._listener.refuse()

    def cut(self, reset: bool = False) -> None:
        """End open connections, with FIN or with RST."""
        self.connections.close_all(reset)

    def junk(self, data: bytes) -> None:
        """Send bytes that nobody asked for, on every wire."""
        self.connections.send_all(data)
        if self.line is not None:
            self.line.send(data)

    async def reboot(self, boot_s: float, serial: str | None = None) -> None:
        """Lose power for ``boot_s``: connections go, nothing answers, counters begin at 0 again."""
        self._power(False)
        self.refuse()
        self.cut(reset=True)
        await asyncio.sleep(boot_s)
        self.service.module.restart(serial)
        self._power(True)
        await self.listen()

    def _power(self, on: bool) -> None:
        self._listener.off = not on
        if self.line is not None:
            self.line.powered = on
            self.line.mute()
