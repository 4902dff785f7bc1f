"""The faces on which the contract of a tracker is run: object, GeoCOM on TCP and on a serial line."""

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from wire_faces import Face

from cell.clock import MonotonicClock
from cell.devices import Identity
from cell.poses import Array
from cell.testing import TrackerRig
from drivers.tracker import GeocomConfig, GeocomTracker
from fakes.faults.tracker import TrackerFaults
from fakes.geocom import Instrument, StationFaults, StationWires
from fakes.object import ObjectTracker, VirtualClock, run_virtual
from fakes.wire.listening import TcpPlace
from fakes.world.scenario import Scenario
from fakes.world.tracker.tracker import Tracker
from fakes.world.world import World
from tests.kit.ideal_world import prompt_station

SCENARIO = "tracker:ideal"  # a UR10e with two reflectors, and four monuments, before a tracker
HOST = "127.0.41.4"
DRIVER: dict[str, Any] = {
    "sigma0_m": 15e-6,
    "sigma_per_m": 6e-6,
    "poll_period_s": 0.05,
    "timeout_s": 1.0,
    "distance_timeout_s": 1.0,
    "lost_after_failures": 1,
}


IDENTITY = Identity("", "99994400001")


def _where(tracker: Tracker) -> Callable[[str, float], Array]:
    return lambda reflector, t: np.array(tracker.visibility.local(reflector, t))


@asynccontextmanager
async def _object(_: None) -> AsyncIterator[TrackerRig]:
    clock = VirtualClock()
    device = ObjectTracker("tracker", ObjectTracker.Config(scenario=SCENARIO), clock)

    async def inject(kind: str, **arguments: Any) -> None:
        device.inject(kind, **arguments)

    await device.open()
    try:
        yield TrackerRig(
            device, clock, inject=inject, identity=IDENTITY, where=_where(device.tracker_plant.tracker)
        )
    finally:
        await device.close()


def _wire(scheme: str) -> Callable[[None], AbstractAsyncContextManager[TrackerRig]]:
    @asynccontextmanager
    async def rig(_: None) -> AsyncIterator[TrackerRig]:
        clock = MonotonicClock()
        tracker = World.from_scenario(Scenario.parse(prompt_station()), clock.now()).tracker
        assert tracker is not None
        with TemporaryDirectory(prefix="tracker-") as folder:
            line = Path(folder) / "tracker.tty"
            wires = StationWires(Instrument(tracker, time.monotonic), (TcpPlace(HOST, 0),), line)
            of_tracker = TrackerFaults(tracker, time.monotonic)
            faults = StationFaults(wires, of_tracker)
            await wires.start()
            host, port = wires.addresses[0]
            labels = {n: {"constant_m": r.labelled_constant_m} for n, r in tracker.reflectors.items()}
            config = GeocomConfig(
                url=f"tcp://{host}:{port}" if scheme == "tcp" else f"serial://{line}",
                reflectors=labels,  # type: ignore[arg-type]
                checksum=scheme == "serial",
                measure_with="tracking" if scheme == "serial" else "single",
                **DRIVER,
            )
            device = GeocomTracker("tracker", config, clock)

            async def inject(kind: str, **arguments: Any) -> None:
                offered = {fault.value: fault for fault in faults.offers()}
                faults.clear() if kind == "clear" else faults.inject(offered[kind], arguments)

            try:
                await device.open()
                yield TrackerRig(device, clock, inject=inject, identity=IDENTITY, where=_where(tracker))
            finally:
                await device.close()
                faults.close()
                of_tracker.close()
                await wires.stop()
                await asyncio.sleep(0)

    return rig


def tracker_faces() -> list[Any]:
    """Parameters for a fixture."""
    faces = [
        Face("object", run_virtual, _object),
        Face("geocom-tcp", asyncio.run, _wire("tcp"), wire=True),
        Face("geocom-serial", asyncio.run, _wire("serial"), wire=True, lacks=frozenset({"drop"})),
    ]
    return [pytest.param(f, id=f.name, marks=[pytest.mark.wire] if f.wire else []) for f in faces]
