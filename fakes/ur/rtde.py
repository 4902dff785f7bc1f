"""The RTDE server: any number of clients, protocol versions 1 and 2, one output and many input recipes each.

Ownership of input variables belongs to a connection and ends with it. A client that does not read is
dropped once its bounded buffer is full, so it can never slow the others.
"""

import asyncio
import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from fakes.faults.vocabulary import Link
from fakes.ur import wire
from fakes.ur.faults import StreamFaults
from fakes.ur.variables import INPUTS, OutputRecipe
from fakes.ur.wire import Level, Package

if TYPE_CHECKING:
    from fakes.ur.robot import Instant, Robot

PORT = 30004
NAME_LIMIT = 2048
V1_FREQUENCY = 125.0


@dataclass
class InputOwnership:
    """Who may write which input variable; a fieldbus counts as an owner too."""

    owners: dict[str, object] = field(default_factory=dict)

    def claim(self, names: list[str], owner: object, missing: frozenset[str]) -> list[str]:
        """The type of each name, NOT_FOUND or IN_USE; takes them only when all can be had."""
        types = [self._type(name, owner, missing) for name in names]
        if wire.NOT_FOUND not in types and wire.IN_USE not in types:
            self.owners.update(dict.fromkeys(names, owner))
        return types

    def release(self, owner: object) -> None:
        """Give back everything that ``owner`` had."""
        self.owners = {name: who for name, who in self.owners.items() if who is not owner}

    def _type(self, name: str, owner: object, missing: frozenset[str]) -> str:
        if name not in INPUTS or name in missing:
            return wire.NOT_FOUND
        return INPUTS[name] if self.owners.get(name, owner) is owner else wire.IN_USE


@dataclass(frozen=True)
class InputRecipe:
    """Variables that a client writes together."""

    names: list[str]
    layout: wire.Layout


class RtdeServer:
    """Port 30004 of one controller."""

    def __init__(self, robot: "Robot", faults: StreamFaults) -> None:
        self.robot, self.faults = robot, faults
        self.ownership = InputOwnership()
        self.connections: set[RtdeConnection] = set()

    def publish(self, now: "Instant") -> None:
        """Send this cycle's package to every started client."""
        if self.faults.stream_open(now.t):
            for connection in tuple(self.connections):
                connection.cycle(now)

    def message(self, text: str, level: Level) -> None:
        """A text message to every client."""
        for connection in self.connections:
            connection.send(wire.text_message(text, level, connection.version))

    def drop_all(self, reset: bool) -> None:
        """Close every connection, with FIN or with RST."""
        for connection in tuple(self.connections):
            connection.close(reset)


class RtdeConnection(asyncio.Protocol):
    """One client."""

    def __init__(self, server: RtdeServer) -> None:
        self._server = server
        self._robot = server.robot
        self._framer = wire.Framer()
        self._link: Link | None = None
        self.version = 1
        self._outputs: OutputRecipe | None = None
        self._divisor = 1
        self._countdown = 0
        self._inputs: dict[int, InputRecipe] = {}
        self._started = False
        self._last: bytes | None = None
        self._handlers = {
            Package.PROTOCOL_VERSION: self._on_protocol_version,
            Package.CONTROL_VERSION: self._on_control_version,
            Package.SETUP_OUTPUTS: self._on_setup_outputs,
            Package.SETUP_INPUTS: self._on_setup_inputs,
            Package.START: self._on_start,
            Package.PAUSE: self._on_pause,
            Package.DATA: self._on_data,
        }

    # -- asyncio's side

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._link = Link.over(transport, self._server.faults.link)
        self._server.connections.add(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self._server.connections.discard(self)
        self._server.ownership.release(self)

    def data_received(self, data: bytes) -> None:
        if self._server.faults.link.half_open:
            return
        try:
            for kind, payload in self._framer.feed(data):
                handler = self._handlers.get(kind)  # type: ignore[call-overload]
                if handler is not None:
                    handler(payload)
        except wire.FramingError:
            self.close(reset=False)

    def send(self, data: bytes) -> None:
        """Queue bytes; a client whose queue is full is dropped."""
        if self._link is not None:
            self._link.send(data)

    def close(self, reset: bool) -> None:
        """End the connection, with FIN or with RST."""
        if self._link is not None:
            self._link.close(reset)

    # -- the stream

    def cycle(self, now: "Instant") -> None:
        """Send a data package when this client's turn has come."""
        if not self._started or self._outputs is None:
            return
        self._countdown -= 1
        if self._countdown > 0:
            return
        self._countdown = self._divisor
        faults = self._server.faults
        if not (faults.freeze and self._last is not None):
            values = self._outputs.pack(self._robot, now)
            recipe = b"\x01" if self.version == 2 else b""
            self._last = wire.package(Package.DATA, recipe + values)
        for _ in range(faults.copies()):
            self.send(self._last)

    # -- requests

    def _reply(self, kind: Package, payload: bytes) -> None:
        note = self._server.faults.handshake_message
        if note is not None:
            self.send(wire.text_message(note, Level.WARNING, self.version))
        self.send(wire.package(kind, payload))

    def _complain(self, text: str) -> None:
        self.send(wire.text_message(text, Level.ERROR, self.version))

    def _on_protocol_version(self, payload: bytes) -> None:
        wanted = int.from_bytes(payload, "big") if len(payload) == 2 else 0
        accepted = wanted in (1, 2)
        if accepted:
            self.version = wanted
        self._reply(Package.PROTOCOL_VERSION, bytes([accepted]))

    def _on_control_version(self, payload: bytes) -> None:
        self._reply(Package.CONTROL_VERSION, struct.pack(">4I", *self._robot.identity.version))

    def _on_setup_outputs(self, payload: bytes) -> None:
        rate = self._robot.rate
        wanted = min(V1_FREQUENCY, rate)
        if self.version == 2:
            if len(payload) < 8:
                self._complain("output setup without a frequency")
                return
            (wanted,) = struct.unpack_from(">d", payload)
            payload = payload[8:]
        if len(payload) > NAME_LIMIT or not 0 < wanted < float("inf"):
            self._complain("output setup with too many names or an impossible frequency")
            return
        hidden = self._server.faults.missing
        names = [f"?{n}" if n in hidden else n for n in wire.split_names(payload)]
        recipe = OutputRecipe(names, self._robot.identity.version[:3])
        self._outputs = recipe if recipe.valid else None
        self._divisor = self._countdown = max(1, round(rate / min(wanted, rate)))
        types = ",".join(recipe.types).encode()
        recipe_id = bytes([1 if recipe.valid else 0]) if self.version == 2 else b""
        self._reply(Package.SETUP_OUTPUTS, recipe_id + types)

    def _on_setup_inputs(self, payload: bytes) -> None:
        names = wire.split_names(payload)
        types = self._server.ownership.claim(names, self, self._server.faults.missing)
        recipe_id = 0
        if names and not {wire.NOT_FOUND, wire.IN_USE} & set(types) and len(self._inputs) < 255:
            recipe_id = len(self._inputs) + 1
            self._inputs[recipe_id] = InputRecipe(names, wire.Layout(tuple(types)))
        self._reply(Package.SETUP_INPUTS, bytes([recipe_id]) + ",".join(types).encode())

    def _on_start(self, payload: bytes) -> None:
        ready = self._outputs is not None or bool(self._inputs)
        self._started = ready
        self._countdown = 1
        self._server.faults.note_start(self._robot.now())
        self._reply(Package.START, bytes([ready]))

    def _on_pause(self, payload: bytes) -> None:
        self._started = False
        self._reply(Package.PAUSE, b"\x01")

    def _on_data(self, payload: bytes) -> None:
        recipe = self._inputs.get(payload[0]) if payload else None
        if recipe is None:
            self._complain("data package with an unknown recipe id")
            return
        try:
            values = recipe.layout.unpack(payload[1:])
        except ValueError as exc:
            self._complain(f"data package of input recipe {payload[0]}: {exc}")
            return
        self._robot.inputs.write(dict(zip(recipe.names, values, strict=True)), self._robot.now())
