"""An encoder on its bus, with the adapter and the gateway through which clients reach it."""

from collections.abc import Callable
from pathlib import Path

from fakes.can.bus import CanBus
from fakes.can.node import EncoderNode, Shaft
from fakes.can.slcan import SlcanAdapter
from fakes.can.socketcand import Gateway
from fakes.faults.vocabulary import LinkFaults
from fakes.wire.listening import TcpPlace

CHANNEL = "can0"


class CanWires:
    """``line`` is the path of the serial adapter, ``place`` the address of the gateway; either or both."""

    def __init__(
        self,
        shaft: Shaft,
        number: int,
        serial: int,
        now: Callable[[], float],
        line: Path | None = None,
        place: TcpPlace | None = None,
        by_events: bool = False,
    ) -> None:
        self.link_faults = LinkFaults()
        self.bus = CanBus()
        self.node = EncoderNode(self.bus, number, serial, shaft, now, by_events)
        self.adapter = None if line is None else SlcanAdapter(self.bus, line, self.link_faults, now)
        self.gateway = None if place is None else Gateway(self.bus, CHANNEL, place, self.link_faults, now)

    async def start(self) -> None:
        """Plug everything in and switch the encoder on; ``OSError`` when the address is taken."""
        if self.gateway is not None:
            await self.gateway.listen()
        if self.adapter is not None:
            self.adapter.plug_in()
        self.node.power_on()

    async def stop(self) -> None:
        """Close everything."""
        self.node.power_off()
        if self.adapter is not None:
            self.adapter.pull_out()
        if self.gateway is not None:
            await self.gateway.stop()

    @property
    def buses(self) -> dict[str, str]:
        """What a driver's key ``bus`` must say, by interface."""
        found = {}
        if self.adapter is not None:
            found["slcan"] = f"slcan:{self.adapter.path}@{self.bus.bit_rate}"
        if self.gateway is not None:
            host, port = self.gateway.address
            found["socketcand"] = f"socketcand:{host}:{port}/{CHANNEL}"
        return found
