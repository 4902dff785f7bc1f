"""The gripper of a twin where it is not on the arm's outputs: on a Modbus module, or a Robotiq."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fakes.faults.actions import Actions, Arguments, switch
from fakes.faults.vocabulary import Fault, Faulty
from fakes.faults.wire import WireFaults
from fakes.modbus_io.module import Action, Identity
from fakes.modbus_io.pdu import ILLEGAL_ADDRESS, ILLEGAL_FUNCTION, Refused
from fakes.modbus_io.service import Pace
from fakes.modbus_io.wires import ModuleWires
from fakes.robotiq.hand import Hand
from fakes.robotiq.registers import RobotiqTables
from fakes.robotiq.urcap import UrcapSocket
from fakes.wire.listening import TcpPlace
from fakes.world.belt.gripper import Gripper
from fakes.world.scenario import FakeAddresses

SERIAL = "99996600001"
CLOSES, HOLDS = 0, 0  # coil and discrete input of the module
SERIAL_LINE = "gripper.tty"


class ValveTables:
    """``UnitTables`` of a module: a valve on its output, and an input that confirms."""

    def __init__(self, gripper: Gripper) -> None:
        self._gripper, self._on = gripper, False
        self.identity = Identity("outputs", SERIAL)

    def coils(self) -> Mapping[int, bool]:
        return {CLOSES: self._on}

    def discrete(self) -> Mapping[int, bool]:
        return {HOLDS: self._gripper.holds(time.monotonic()) is not None}

    def holding(self) -> Mapping[int, int]:
        raise Refused(ILLEGAL_FUNCTION)

    def input(self) -> Mapping[int, int]:
        raise Refused(ILLEGAL_FUNCTION)

    def coil(self, address: int, on: bool) -> Action:
        if address != CLOSES:
            raise Refused(ILLEGAL_ADDRESS)

        def switch() -> None:
            self._on = on
            self._gripper.command(time.monotonic(), on)

        return switch

    def register(self, address: int, value: int) -> Action:
        raise Refused(ILLEGAL_FUNCTION)

    def restart(self, serial: str | None = None) -> None:
        """Outputs are off: the valve opens."""
        self.coil(CLOSES, False)()


class _SocketFaults:
    """What can go wrong with the URCap's socket: it says nothing."""

    def __init__(self, socket: UrcapSocket) -> None:
        self._actions = Actions({Fault.SILENCE: switch(socket, "silent")})

    def offers(self) -> frozenset[Fault]:
        return self._actions.offers()

    def inject(self, fault: Fault, arguments: Arguments) -> None:
        self._actions.inject(fault, arguments)

    def clear(self) -> None:
        self._actions.end_all()


class TwinGripper:
    """Serves ``gripper`` as ``addresses.gripper_by`` says, between :meth:`start` and :meth:`stop`."""

    def __init__(self, gripper: Gripper, addresses: FakeAddresses, bind: str, folder: Path) -> None:
        self._by = addresses.gripper_by
        hand = Hand(gripper, gripper.truth.close_s, time.monotonic)
        self._socket: UrcapSocket | None = None
        self._wires: ModuleWires | None = None
        self.faults: Faulty
        if self._by == "robotiq-urcap":
            self._socket = UrcapSocket(hand, TcpPlace(bind, addresses.gripper_port))
            self.faults = _SocketFaults(self._socket)
            return
        self._wires = wires = ModuleWires(
            ValveTables(gripper) if self._by == "modbus" else RobotiqTables(hand),
            (TcpPlace(bind, addresses.gripper_port),),
            folder / SERIAL_LINE if self._by == "robotiq-rtu" else None,
            Pace(addresses.io_delay_s, addresses.io_jitter_s),
        )
        self.faults = self._wire_faults = WireFaults(wires, wires.service.faults, lambda: SERIAL)

    async def start(self) -> None:
        """Listen; ``OSError`` when the address is taken."""
        if self._wires is not None:
            await self._wires.start()
        if self._socket is not None:
            await self._socket.start()

    async def stop(self) -> None:
        """Close everything."""
        if self._wires is not None:
            self._wire_faults.close()
            await self._wires.stop()
        if self._socket is not None:
            await self._socket.stop()

    def addresses(self) -> dict[str, str]:
        """What listens where, by name."""
        if self._socket is not None:
            return {"gripper": "urcap://{}:{}".format(*self._socket.address)}
        found: dict[str, str] = {}
        if self._wires is not None:
            found = {"gripper": "tcp://{}:{}".format(*self._wires.addresses[0])}
            if self._wires.line is not None:
                found["gripper"] = f"rtu://{self._wires.line.path}?baudrate=115200"
        return found

    def device(self) -> dict[str, Any]:
        """The table ``[device.gripper]`` of a daemon's configuration."""
        common = {"url": self.addresses()["gripper"], "serial": SERIAL}
        if self._by == "modbus":
            return {"driver": "modbus-gripper", **common, "output": CLOSES, "confirm": HOLDS}
        return {"driver": "robotiq", **common, "activate": True}
