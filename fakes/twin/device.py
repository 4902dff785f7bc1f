"""What the twin asks of each device that it serves."""

from typing import Any, Protocol

from fakes.faults.vocabulary import Faulty


class TwinDevice(Protocol):
    """One device of the world on its real protocol."""

    @property
    def faults(self) -> Faulty:
        """What can be made to go wrong with it."""
        ...

    async def start(self) -> None:
        """Listen; ``OSError`` when an address is taken."""
        ...

    async def stop(self) -> None:
        """Close everything."""
        ...

    def addresses(self) -> dict[str, str]:
        """What listens where, by name."""
        ...

    def device(self) -> dict[str, Any]:
        """The table ``[device.NAME]`` of a daemon's configuration."""
        ...
