"""An encoder with CANopen's device profile 406."""

import asyncio
import logging
from typing import Any

import can

from cell.clock import Clock
from cell.devices import Encoder, Identity
from cell.errors import CellError, error
from cell.samples import Quality
from drivers.can_encoder.base import CanEncoder
from drivers.can_encoder.config import CanopenEncoderConfig
from drivers.can_encoder.sdo import REPLY_ID, SdoClient
from drivers.can_encoder.setup import NodeSetup, set_up
from drivers.can_encoder.words import emergency_words, state_words

log = logging.getLogger("cellward.devices")

_SYNC_ID, _EMERGENCY_ID, _HEARTBEAT_ID = 0x080, 0x080, 0x700
_SHORT_FRAMES = 3
_BOOT_UP, _OPERATIONAL = 0, 5
_SDO_TIMEOUT_S = 0.2
_MOST_BOOTS = 3  # during one setup
_BEATS_MISSED = 3.0
_SAID_AGAIN_S = 60.0  # a node may change between two emergencies at the rate of the bus
_MOST_SAID = 64
_MANY = f"each is told once in {_SAID_AGAIN_S:g} s"


class CanopenEncoder(CanEncoder):
    """Configures its node at every opening, and again when the node says that it was restarted.

    A restarted node's position has nothing to do with the one before, so the counts begin a new epoch, as
    they do at a reconnection. The link is kept: there are no samples until the node sends again.
    """

    Config = CanopenEncoderConfig
    PLAYS = (Encoder,)

    def __init__(self, name: str, config: CanopenEncoderConfig, clock: Clock) -> None:
        super().__init__(name, config, clock, config.range_counts or 1 << 32)
        self._config = config
        self._setup: NodeSetup | None = None
        self._sdo: SdoClient | None = None
        self._boots = 0
        self._resets = 0
        self._starting: asyncio.Task[None] | None = None
        self._syncing: asyncio.Task[None] | None = None
        self._beat = 0.0
        self._wrong_beats = 0
        self._state = _OPERATIONAL
        self._emergency = ""
        self._said: dict[str, float] = {}
        self._speed: int | None = None

    async def close(self) -> None:
        """End everything; the node goes on sending."""
        tasks = [task for task in (self._starting, self._syncing) if task is not None]
        self._starting = self._syncing = None
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks)
        await super().close()

    def health(self) -> dict[str, Any]:
        """As every encoder's, with the node's resets, emergency in words, and its own speed."""
        return super().health() | {
            "node": self._config.node,
            "resets": self._resets,
            "emergency": self._emergency,
            "speed_raw": self._speed,
            "heartbeat": bool(self._setup and self._setup.heartbeat),
        }

    def _ids(self) -> list[tuple[int, bool]]:
        node = self._config.node
        numbers = (self._config.position_id, REPLY_ID + node, _HEARTBEAT_ID + node, _EMERGENCY_ID + node)
        return [(number, False) for number in numbers]

    async def _begin(self) -> Identity:
        self._emergency, self._quality, self._speed = "", Quality.GOOD, None
        self._setup = None
        link = self._opened(self._link)
        self._sdo = SdoClient(self.name, self._config.node, link.send, _SDO_TIMEOUT_S)
        for _ in range(_MOST_BOOTS):
            boots = self._boots
            setup = await set_up(self.name, self._config, self._sdo, link.send, self._clock)
            if boots == self._boots:
                break
        else:
            raise error("DEVICE_LOST", f"{self.name}: node {self._config.node} restarts again and again")
        self._setup, self.modulus, self._short = setup, setup.modulus, 0
        if setup.by_sync and (self._syncing is None or self._syncing.done()):
            self._syncing = self._spawn(self._send_sync(), "sync")
        self._beat, self._wrong_beats, self._state = self._clock.now(), 0, _OPERATIONAL
        return setup.identity

    def _position(self, message: can.Message) -> int | None:
        if message.arbitration_id != self._config.position_id or message.is_extended_id:
            return None
        setup = self._setup
        if setup is None:
            return None
        if len(message.data) < setup.position.stop:
            self._too_short(message, setup.position.stop)
            return None
        if setup.speed is not None:
            self._speed = int.from_bytes(message.data[setup.speed], "little", signed=True)
        return int.from_bytes(message.data[setup.position], "little")

    def _too_short(self, message: can.Message, needed: int) -> None:
        """Nothing that was mapped by us: somebody changed it, or somebody else sends."""
        self._short += 1
        if self._running and self._short >= _SHORT_FRAMES:
            self._lose(
                error(
                    "PROTOCOL_VIOLATION",
                    f"{self.name}: frames {self._config.position_id:#x} have {len(message.data)} bytes, the "
                    f"position needs {needed}: another device sends with this identifier, or the mapping was "
                    "changed",
                )
            )

    async def _send_sync(self) -> None:
        """For an encoder that sends with SYNC only."""
        link, due = self._opened(self._link), self._clock.now()
        while self._life.good:
            await link.send(_SYNC_ID, b"")
            due = max(due + self.period_s, self._clock.now())
            await self._clock.sleep(due - self._clock.now())

    def _other(self, message: can.Message) -> None:
        number, node, data = message.arbitration_id, self._config.node, bytes(message.data)
        if message.is_extended_id:
            return
        if number == REPLY_ID + node and self._sdo is not None:
            self._sdo.receive(data)
        elif number == _HEARTBEAT_ID + node and data:
            self._heartbeat(data[0] & 0x7F)
        elif number == _EMERGENCY_ID + node and len(data) >= 3:
            self._told(int.from_bytes(data[:2], "little"), data[2])

    # -- the node's state

    def _heartbeat(self, state: int) -> None:
        self._beat, self._state = self._clock.now(), state
        if state == _BOOT_UP:
            self._boots += 1
            if self._running:
                self._restarted()
            return
        wrong = self._running and state != _OPERATIONAL
        self._wrong_beats = self._wrong_beats + 1 if wrong else 0
        if self._wrong_beats >= 2:  # one may have been on its way when we started the node
            self._lose(self._stopped())

    def _stopped(self) -> CellError:
        return error(
            "ENCODER_NOT_OPERATIONAL",
            f"{self.name}: node {self._config.node} is {state_words(self._state)}, and not by us",
        )

    def _silence(self, now: float, why: str) -> CellError:
        return super()._silence(now, why) if self._state == _OPERATIONAL else self._stopped()

    def _restarted(self) -> None:
        self._resets += 1
        self._running = False
        self.counts.new_epoch()
        log.warning("%s: node %d was restarted, it is configured again", self.name, self._config.node)
        self._starting = self._spawn(self._start_again(), "setup")

    async def _start_again(self) -> None:
        begun, before = self._clock.now(), self._identity
        try:
            found = await self._begin()
        except CellError as exc:
            self._lose(exc)
            return
        if before is not None and found != before:
            self._lose(
                error("DEVICE_LOST", f"{self.name}: another device answers as node {self._config.node} now")
            )
            return
        if self._life.good:
            self._start_counting()
            log.info("%s: counts again after %.2f s", self.name, self._clock.now() - begun)

    def _look(self, now: float) -> None:
        limit = max(_BEATS_MISSED * self._config.heartbeat_s, self._config.lost_after_s)
        watched = self._running and self._setup is not None and self._setup.heartbeat
        # Up to the latest position: when positions are missing as well, the adapter is asked for the cause.
        missed = self._heard - self._beat
        if watched and missed > limit:
            self._lose(
                error(
                    "DEVICE_LOST",
                    f"{self.name}: node {self._config.node} sent no heartbeat for {missed:.2f} s",
                )
            )

    def _told(self, code: int, register: int) -> None:
        """An emergency lasts until the node takes it back with code 0."""
        words = emergency_words(code, register) if code or register else ""
        if words == self._emergency:
            return
        if not self._worth_a_line(words):
            if self._worth_a_line(_MANY):
                log.warning("%s: node %d's emergencies change often: %s", self.name, self._config.node, _MANY)
        elif words:
            log.warning("%s: node %d reports %s", self.name, self._config.node, words)
        else:
            log.info("%s: node %d is without error again", self.name, self._config.node)
        self._emergency = words
        self._quality = Quality.DEGRADED if words else Quality.GOOD

    def _worth_a_line(self, words: str) -> bool:
        """Not for what was told within the last minute, nor for ever new codes."""
        now = self._clock.now()
        self._said = {said: t for said, t in self._said.items() if now - t < _SAID_AGAIN_S}
        if words in self._said or (len(self._said) >= _MOST_SAID and words != _MANY):
            return False
        self._said[words] = now
        return True
