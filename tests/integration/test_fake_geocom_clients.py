"""A client that is not ours drives the twin's station unchanged: geocompy on TCP and on a serial line."""

import asyncio
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geocompy.communication import open_serial, open_socket
from geocompy.data import Coordinate
from geocompy.geo import GeoCom
from geocompy.geo.gctypes import GeoComCode, GeoComResponse

from cell.errors import CellError
from fakes.faults.tracker import TrackerFaults
from fakes.faults.vocabulary import Fault
from fakes.geocom import Instrument, StationFaults, StationWires
from fakes.wire.listening import TcpPlace
from fakes.world.scenario import Scenario
from fakes.world.tracker.tracker import Tracker, polar
from fakes.world.world import World
from tests.kit.ideal_world import prompt_station

pytestmark = pytest.mark.wire
HOST = "127.0.42.2"
Visit = Callable[[GeoCom, Tracker, Callable[..., None]], None]


def serve(tmp_path: Path, visit: Visit, wire: str = "tcp", checksum: bool = False) -> None:
    """Run the blocking ``visit`` in a thread while a station serves."""

    async def scene() -> None:
        world = World.from_scenario(Scenario.parse(prompt_station()), time.monotonic())
        assert world.tracker is not None
        tracker = world.tracker
        line = tmp_path / "tracker.tty"
        wires = StationWires(Instrument(tracker, time.monotonic), (TcpPlace(HOST, 0),), line)
        of_tracker = TrackerFaults(tracker, time.monotonic)
        faults = StationFaults(wires, of_tracker)
        loop = asyncio.get_running_loop()

        def inject(fault: Fault, **arguments: object) -> None:
            async def act() -> None:
                faults.inject(fault, arguments)

            asyncio.run_coroutine_threadsafe(act(), loop).result(5.0)

        def talk() -> None:
            host, port = wires.addresses[0]
            opened = open_socket(host, port, "tcp", timeout=5) if wire == "tcp" else None
            with closing(opened or open_serial(str(line), speed=115200, timeout=5)) as connection:
                visit(GeoCom(connection, checksum=checksum), tracker, inject)

        await wires.start()
        try:
            await asyncio.to_thread(talk)
        finally:
            faults.close()
            of_tracker.close()
            await wires.stop()
            await asyncio.sleep(0)

    asyncio.run(scene())


def good(response: GeoComResponse[Any]) -> Any:
    assert response.response.startswith("%R1P,0,"), response
    assert response.error == GeoComCode.OK, response
    return response.params


def locked(station: GeoCom, tracker: Tracker, name: str = "smr1") -> None:
    hz, v = polar(tracker.visibility.local(name, time.monotonic()))
    good(station.aut.turn_to(hz + 0.002, v - 0.002, "NORMAL", "POSITION"))
    good(station.aut.switch_atr(True))
    good(station.aut.fine_adjust(0.03, 0.03))
    good(station.aut.switch_lock(True))
    good(station.aut.lock_in())


@pytest.mark.parametrize("checksum", [False, True], ids=["plain", "checked"])
@pytest.mark.parametrize("wire", ["tcp", "pty"])
def test_geocompy_sets_up_aims_locks_and_measures(tmp_path: Path, wire: str, checksum: bool) -> None:
    def visit(station: GeoCom, tracker: Tracker, inject: Callable[..., None]) -> None:
        assert station.precision == 15
        assert good(station.csv.get_serial_number()) == 99994400001
        assert good(station.csv.get_instrument_name()) == "Twin tracker"
        assert good(station.com.get_geocom_version()) == (3, 1, 0)
        good(station.com.set_double_precision(12))
        assert good(station.com.get_double_precision()) == 12

        good(station.bap.set_prism_type("MINI360"))
        assert good(station.tmc.get_prism_correction()) == pytest.approx(0.03)
        good(station.tmc.set_prism_correction(0.0))
        assert good(station.tmc.get_prism_correction()) == 0.0
        good(station.tmc.set_edm_mode_v2("SINGLE_FAST"))
        assert good(station.tmc.get_edm_mode_v2()).name == "SINGLE_FAST"
        good(station.tmc.set_station(Coordinate(0.0, 0.0, 0.0), 0.0))
        good(station.tmc.set_atmospheric_corrections(658e-9, 1005.0, 21.5, 20.0))
        assert good(station.tmc.get_atmospheric_corrections())[1:3] == (1005.0, 21.5)

        assert good(station.mot.get_lockon_status()).name == "NONE"
        locked(station, tracker)
        assert good(station.mot.get_lockon_status()).name == "LOCK"
        assert good(station.aut.get_lock_status()) is True

        true = tracker.visibility.local("smr1", time.monotonic())
        good(station.tmc.do_measurement("DISTANCE"))
        coordinate = good(station.tmc.get_coordinate(2))[0]
        assert [*coordinate] == pytest.approx(true.tolist(), abs=2e-4)
        simple = good(station.tmc.get_simple_coordinate(2))
        assert [*simple] == [*coordinate]
        hz, v, slope = good(station.tmc.get_simple_measurement(2))
        assert (float(hz), float(v)) == pytest.approx(polar(true), abs=1e-4)
        assert slope == pytest.approx(np.linalg.norm(true), abs=2e-4)
        assert good(station.tmc.get_complete_measurement(2))[6] == slope
        assert good(station.bap.measure_distance_angle("DISTANCE"))[2] == pytest.approx(slope, abs=3e-4)
        assert good(station.tmc.quick_distance())[2] == pytest.approx(slope, abs=3e-4)
        assert good(station.tmc.get_angle()) is not None

    serve(tmp_path, visit, wire, checksum)


def test_geocompy_sees_return_codes_of_the_instrument_and_of_the_line(tmp_path: Path) -> None:
    def visit(station: GeoCom, tracker: Tracker, inject: Callable[..., None]) -> None:
        good(station.aut.switch_atr(True))
        assert station.aut.fine_adjust(0.03, 0.03).error == GeoComCode.AUT_NO_TARGET
        good(station.tmc.do_measurement("DISTANCE"))
        assert station.tmc.get_simple_measurement(1).error == GeoComCode.TMC_DIST_ERROR
        assert station.bap.get_prism_definition("ROUND").error == GeoComCode.NOT_IMPL
        locked(station, tracker)
        inject(Fault.BEAM_BREAK, for_s=0.05)
        time.sleep(0.1)
        assert good(station.mot.get_lockon_status()).name == "NONE"
        inject(Fault.RETURN_CODE, code=1290, rpc=2107)
        assert station.tmc.get_angle().error == GeoComCode.TMC_ANGLE_ERROR
        inject(Fault.RETURN_CODE, code=3077, for_s=0.5)
        assert station.com.nullprocess().response.startswith("%R1P,3077,")
        time.sleep(0.6)
        good(station.com.nullprocess())
        inject(Fault.SPLIT)
        inject(Fault.DELAY, s=0.05)
        begun = time.monotonic()
        good(station.com.nullprocess())
        assert time.monotonic() - begun > 0.05
        with pytest.raises(CellError, match="not a return code"):
            inject(Fault.RETURN_CODE, code=70000)

    serve(tmp_path, visit)


def test_a_restarted_station_has_forgotten_its_lock_and_its_settings(tmp_path: Path) -> None:
    def visit(station: GeoCom, tracker: Tracker, inject: Callable[..., None]) -> None:
        locked(station, tracker)
        good(station.tmc.set_prism_correction(0.02))
        inject(Fault.REBOOT, boot_s=0.3, serial="99994400007")
        time.sleep(0.5)
        good(station.com.nullprocess())
        assert good(station.csv.get_serial_number()) == 99994400007
        assert good(station.mot.get_lockon_status()).name == "NONE"
        assert good(station.tmc.get_prism_correction()) == 0.0

    serve(tmp_path, visit, wire="pty")
