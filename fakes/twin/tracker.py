"""The laser tracker of a twin: GeoCOM and lines of text on the wire, and what a daemon must know of it."""

import time
from pathlib import Path
from typing import Any

from cell.errors import error
from fakes.faults.tracker import TrackerFaults
from fakes.geocom import Instrument, LineFaults, StationFaults, StationWires
from fakes.lines.stream import LineStream
from fakes.wire.listening import TcpPlace
from fakes.world.scenario import FakeAddresses
from fakes.world.tracker.tracker import Tracker

SERIAL_LINE = "tracker.tty"


class TwinTracker:
    """Serves ``tracker`` between :meth:`start` and :meth:`stop`."""

    def __init__(self, tracker: Tracker, addresses: FakeAddresses, bind: str, folder: Path) -> None:
        self._tracker, self._by = tracker, addresses.tracker_by
        self._line = folder / SERIAL_LINE
        faults, form = LineFaults(), addresses.tracker_lines
        if form is not None:
            self._check(form.reflector)
        self._lines = None if form is None else LineStream(tracker, form, bind, time.monotonic, faults)
        self._wires = StationWires(
            Instrument(tracker, time.monotonic, addresses.tracker_delay_s),
            (TcpPlace(bind, addresses.tracker_port),),
            self._line,
            faults,
            self._lines,
        )
        self._tracker_faults = TrackerFaults(tracker, time.monotonic)
        self.faults = StationFaults(self._wires, self._tracker_faults)

    async def start(self) -> None:
        """Listen; ``OSError`` when an address is taken."""
        await self._wires.start()

    async def stop(self) -> None:
        """Close everything."""
        self.faults.close()
        self._tracker_faults.close()
        await self._wires.stop()

    def lock(self, reflector: str) -> None:
        """What somebody does at the instrument's panel; ``NOT_NOW`` when the reflector cannot be seen."""
        self._check(reflector)
        if status := self._tracker.lock(time.monotonic(), reflector):
            raise error("NOT_NOW", f"the tracker cannot lock {reflector}: {status}")

    def _check(self, reflector: str) -> None:
        if reflector not in self._tracker.reflectors:
            known = ", ".join(self._tracker.reflectors)
            raise error("ARGUMENT_INVALID", f"there is no reflector {reflector!r}; there are {known}")

    def addresses(self) -> dict[str, str]:
        """What listens where, by name."""
        host, port = self._wires.addresses[0]
        found = {
            "tracker": f"tcp://{host}:{port}",
            "tracker serial": f"serial://{self._line}?baudrate=115200",
        }
        if self._lines is not None:
            host, port = self._lines.listener.addresses[0]
            found["tracker lines"] = f"tcp://{host}:{port}"
        return found

    def device(self) -> dict[str, Any]:
        """The table ``[device.tracker]`` of a daemon's configuration."""
        truth = self._tracker.truth
        url = {"tcp": "tracker", "serial": "tracker serial"}[self._by]
        return {
            "driver": "geocom",
            "url": self.addresses()[url],
            "checksum": self._by == "serial",
            "reflectors": {
                name: {"constant_m": reflector.labelled_constant_m}
                for name, reflector in self._tracker.reflectors.items()
            },
            "sigma0_m": truth.sigma0_m,
            "sigma_per_m": truth.sigma_per_m,
            "measure_with": "tracking",
            "search_window_rad": min(2.0 * truth.search_rad, 1.5),
        }
