"""Joints in the Modbus registers of an arm's controller, and the handshake with its program."""

import asyncio
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from cell.clock import Clock
from cell.devices import Identity
from cell.errors import error
from cell.poses import Array
from drivers.modbus.identify import identify
from drivers.modbus.link import ModbusLink
from drivers.modbus.registers import Span, Table
from drivers.observed_arm.config import HandshakeConfig, ObservedArmConfig
from drivers.observed_arm.joint_source import ObservedJoints

LARGEST_NUMBER = 0xFFFF

Register = tuple[Table, int]


class RegisterSource:
    """``disconnected`` is called once when the controller closes the connection.

    What a poll reads is the number of the pose first: joints that are read after it can only be newer.
    """

    def __init__(
        self, name: str, config: ObservedArmConfig, clock: Clock, disconnected: Callable[[], None]
    ) -> None:
        self._name, self._config, self._clock = name, config, clock
        self._encodings = [joint.encoding for joint in config.joints]
        self._places = [(Table(joint.table), joint.address or 0) for joint in config.joints]
        self._link = ModbusLink(name, config.link, clock, disconnected)
        self._spans = [*self._program_spans(), *self._arm_spans()]
        self._asking = asyncio.Lock()
        self._asked = 0
        self._round_trip_s = 0.0

    async def open(self) -> Identity:
        await self._link.connect()
        found = await identify(self._link, self._config.model, self._config.serial)
        if found.serial:
            return found
        return Identity(found.model, self._config.stated_serial or "", found.version, found.extra)

    async def close(self) -> None:
        await self._link.close()

    async def look(self, tick: int) -> list[ObservedJoints]:
        begin = self._clock.now()
        words: dict[Register, int] = {}
        for span in self._spans:
            for i, word in enumerate(await self._link.read(span)):
                words[span.table, span.start + i] = word
        end = self._clock.now()
        self._round_trip_s = end - begin
        return [
            ObservedJoints(
                self._joints(words),
                t=0.5 * (begin + end) - self._config.time_offset_s,
                dt=0.5 * (end - begin),
                seq=tick,
                moving=self._is_moving(words),
                pose=self._reached(words),
            )
        ]

    async def request(self, number: int, q: Array) -> bool:
        """Write a request; False without handshake or permission. Errors of the link, or 2351.

        The number is set to 0 before and to ``number`` after the joints, which are read back in between: the
        program never finds a number beside joints that do not belong to it. ``NoAnswer`` leaves open how much
        of that was written.
        """
        handshake = self._config.handshake
        if handshake is None or not self._config.allow_requests:
            return False
        words = [] if number == 0 else self._request_words(number, q)
        async with self._asking:
            await self._ask(handshake, number, words)
        return True

    def health(self) -> dict[str, Any]:
        return {"round_trip_s": self._round_trip_s, "asked": self._asked}

    # -- reading

    def _program_spans(self) -> list[Span]:
        handshake = self._config.handshake
        if handshake is None or handshake.reached is None:
            return []
        return [Span(Table.HOLDING, handshake.reached, 1)]

    def _arm_spans(self) -> list[Span]:
        wanted = {
            (table, address + i)
            for (table, address), encoding in zip(self._places, self._encodings, strict=True)
            for i in range(encoding.words)
        }
        if (bit := self._config.moving) is not None:
            wanted.add((Table(bit.table), bit.address))
        return spans(wanted)

    def _joints(self, words: Mapping[Register, int]) -> Array:
        q = np.array(
            [
                encoding.decode([words[table, address + i] for i in range(encoding.words)])
                for (table, address), encoding in zip(self._places, self._encodings, strict=True)
            ]
        )
        if not np.all(np.isfinite(q)):
            joint = int(np.argmin(np.isfinite(q)))
            raise error(
                "PROTOCOL_VIOLATION",
                f"{self._name}: joint {joint + 1} at address {self._places[joint][1]} is no number;"
                " compare address, type and word_order with the controller's manual",
            )
        return q

    def _is_moving(self, words: Mapping[Register, int]) -> bool:
        bit = self._config.moving
        if bit is None:
            return False
        return bool(words[Table(bit.table), bit.address] >> bit.bit & 1) != bit.invert

    def _reached(self, words: Mapping[Register, int]) -> int | None:
        handshake = self._config.handshake
        if handshake is None or handshake.reached is None:
            return None
        return words[Table.HOLDING, handshake.reached] or None

    # -- asking

    def _request_words(self, number: int, q: Array) -> list[list[int]]:
        axes = len(self._encodings)
        try:
            if not 0 < number <= LARGEST_NUMBER:
                raise ValueError(f"its number is not 0 to {LARGEST_NUMBER}")
            if np.shape(q) != (axes,):
                raise ValueError(f"it needs {axes} joints")
            return [e.encode(float(x)) for e, x in zip(self._encodings, q, strict=True)]
        except ValueError as exc:
            raise error("ARGUMENT_INVALID", f"{self._name}: pose {number}: {exc}") from exc

    async def _ask(self, handshake: HandshakeConfig, number: int, words: list[list[int]]) -> None:
        await self._link.write(handshake.number, [0])
        if number == 0:
            return
        wanted = {
            address + i: word
            for address, joint in zip(handshake.targets, words, strict=True)
            for i, word in enumerate(joint)
        }
        runs = spans({(Table.HOLDING, address) for address in wanted})
        for span in runs:
            await self._link.write(span.start, [wanted[span.start + i] for i in range(span.count)])
        for span in runs:
            kept = await self._link.read(span)
            if kept != [wanted[span.start + i] for i in range(span.count)]:
                raise error(
                    "OBSERVED_REQUEST_LOST",
                    f"{self._name}: registers {span.start}.. do not keep the joints of pose {number}",
                )
        await self._link.write(handshake.number, [number])
        self._asked += 1


def spans(registers: Iterable[Register]) -> list[Span]:
    """What to read for these registers: only they, as a controller may refuse those between them."""
    out: list[Span] = []
    for table, address in sorted(registers, key=lambda r: (r[0].value, r[1])):
        last = out[-1] if out else None
        follows = last is not None and (table, address) == (last.table, last.start + last.count)
        if last is not None and follows and last.count < table.most:
            out[-1] = Span(table, last.start, last.count + 1)
        else:
            out.append(Span(table, address, 1))
    return out
