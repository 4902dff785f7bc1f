"""The CAN face: command frames in, acknowledge, status and heartbeat frames out."""

import asyncio
import logging
from collections.abc import Awaitable, Callable, Coroutine, Mapping, Sequence
from typing import Any

import can

from cell.clock import Clock
from cell.errors import CellError
from daemon.auditor import Audit, Auditor
from daemon.can.frames import ACKNOWLEDGE, BOOT_UP, COMMAND, HEARTBEAT_ID, OPERATIONAL, STATUS
from daemon.config.faces import CanSection
from daemon.modbus.command import ACCEPTED, DONE, REFUSED, STOPPING, Command, CommandChannel, refused
from daemon.modbus.face import DONE_BIT, PLC_OK_BIT, TOGGLE_BIT
from daemon.plc_heartbeat import PlcHeartbeat
from drivers.can_bus.link import CanLink

log = logging.getLogger("cellward.can")

OPEN_TIMEOUT_S = 2.0
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 10.0


class CanFace:
    """Takes the commands of the Modbus face from a bus that encoders may share.

    ``on_command``, ``snapshot``, ``on_plc``, ``audit`` and ``remember`` are as those of the Modbus face; the
    sequence is this channel's own. A bus has no sender identity: whoever is on it may command.
    """

    def __init__(
        self,
        config: CanSection,
        clock: Clock,
        on_command: Callable[[Command], Awaitable[int]],
        snapshot: Callable[[], Mapping[str, Any]],
        *,
        audit: Audit | None = None,
        on_plc: Callable[[bool], None] = lambda alive: None,
        last_sequence: int = 0,
        remember: Callable[[int], None] | None = None,
    ) -> None:
        self._config, self._clock = config, clock
        self._on_command, self._snapshot = on_command, snapshot
        self._client = f"{config.bus} id {config.command_id:#x}"
        self._auditor = Auditor(audit)
        self._channel = CommandChannel(self._carry_out, last_sequence, remember, self._report)
        self._plc = PlcHeartbeat(clock, config.heartbeat_timeout_s, self._auditor.note, on_plc)
        self._link: CanLink | None = None
        self._lost = asyncio.Event()
        self._beats = 0
        self._tasks: set[asyncio.Task[None]] = set()

    @property
    def connected(self) -> bool:
        return self._link is not None

    async def start(self) -> None:
        """Begin to listen, unless ``[can] enabled`` is false; a bus that cannot be opened is tried again."""
        if not self._config.enabled:
            return
        self._auditor.start()
        self._spawn(self._stay_connected(), "CAN trigger")
        self._spawn(self._tell_status(), "CAN heartbeat")
        if self._config.plc_node is not None:
            self._spawn(self._plc.watch(), "CAN heartbeat watch")

    async def stop(self) -> None:
        """Close everything; commands under way are cancelled, audit lines that wait are written."""
        await self._channel.stop()
        tasks = tuple(self._tasks)
        for task in tasks:
            task.cancel()
        if tasks:
            await asyncio.wait(tasks, timeout=2.0)
        link, self._link = self._link, None
        if link is not None:
            await link.close()
        await self._auditor.stop()

    # -- the bus

    def _ids(self) -> list[tuple[int, bool]]:
        """The command's number with 29 bits is heard to be refused."""
        ids = [(self._config.command_id, False), (self._config.command_id, True)]
        node = self._config.plc_node
        return ids if node is None else [*ids, (HEARTBEAT_ID + node, False)]

    async def _stay_connected(self) -> None:
        pause, told = FIRST_PAUSE_S, False
        while True:
            link = CanLink("CAN trigger", self._config.bus, self._ids(), self._take, self._lose, self._clock)
            self._lost.clear()
            try:
                await link.open(OPEN_TIMEOUT_S)
            except CellError as exc:
                if not told:
                    log.warning("%s; it is tried again", exc)
                told = True
                await self._clock.sleep(pause)
                pause = min(2.0 * pause, LONGEST_PAUSE_S)
                continue
            log.info("CAN trigger on %s, commands on %#x", self._config.bus, self._config.command_id)
            pause, told, self._link = FIRST_PAUSE_S, False, link
            await self._send(HEARTBEAT_ID + self._config.node, bytes([BOOT_UP]))
            await self._lost.wait()
            self._link = None
            await link.close()

    def _lose(self, failure: CellError) -> None:
        log.warning("%s: the CAN trigger waits for the bus", failure)
        self._lost.set()

    async def _tell_status(self) -> None:
        config = self._config
        while True:
            await self._clock.sleep(config.heartbeat_s)
            if self._link is None:
                continue
            self._beats += 1
            await self._send(HEARTBEAT_ID + config.node, bytes([OPERATIONAL]))
            values = self._snapshot()
            state, job = int(values.get("packml_state", 0)), int(values.get("active_job", 0))
            prompt = int(values.get("prompt_id", 0))
            await self._send(config.status_id, STATUS.pack(self._status(values), state, job, prompt))

    async def _send(self, identifier: int, data: bytes) -> None:
        """Put a frame on the bus; one that is not taken is not sent again, the PLC asks again."""
        link = self._link
        if link is None:
            return
        try:
            await link.send(identifier, data)
        except CellError as exc:
            log.warning("frame %#x: %s", identifier, exc)

    # -- commands

    def _take(self, messages: Sequence[can.Message], looked: float, now: float) -> None:
        for message in messages:
            data = bytes(message.data)
            if message.arbitration_id != self._config.command_id:
                self._plc.beat(self._client)
            elif fault := _fault_of(message):
                self._refuse(data, fault)
            else:
                self._take_command(*COMMAND.unpack(data))

    def _take_command(self, code: int, job: int, sequence: int, argument: int) -> None:
        args = (argument >> 16, argument & 0xFFFF, 0, 0, 0, 0)
        command = Command(code, sequence, job, 0, args, "can", self._client)
        if sequence == 0:
            self._refuse(COMMAND.pack(code, job, sequence, argument), "sequence 0")
        elif not self._channel.offer(command) and sequence == self._channel.acknowledged:
            self._acknowledge(sequence, self._channel.result)  # the acknowledge got lost; one under way comes

    def _refuse(self, data: bytes, why: str) -> None:
        self._auditor.note(self._client, "command frame", False, f"{why}; data {data.hex(' ') or 'none'}")
        sequence = int.from_bytes(data[2:4], "little") if len(data) >= 4 else 0
        self._acknowledge(sequence, refused("ARGUMENT_INVALID"))

    async def _carry_out(self, command: Command) -> int:
        """The result code of one command; a stop is carried out whatever the heartbeat says."""
        if command.code == 0:
            return refused("ARGUMENT_INVALID")
        if command.code not in STOPPING and self._plc.lost:
            return refused("PLC_SILENT")
        return await self._on_command(command)

    def _report(self, command: Command, result: int) -> None:
        what = f"command {command.code} sequence {command.sequence} job {command.job}"
        argument = f", argument {command.argument_uint32}" if command.argument_uint32 else ""
        self._auditor.note(command.client, what, result < REFUSED, f"result {result:#06x}{argument}")
        self._acknowledge(command.sequence, result)

    def _acknowledge(self, sequence: int, result: int) -> None:
        values = self._snapshot()
        status = self._status(values)
        if result == ACCEPTED and status & DONE_BIT:
            result = DONE
        data = ACKNOWLEDGE.pack(sequence, result, status, int(values.get("error_code", 0)))
        self._spawn(self._send(self._config.acknowledge_id, data), "CAN acknowledge")

    def _status(self, values: Mapping[str, Any]) -> int:
        status = int(values.get("status") or 0) & ~(PLC_OK_BIT | TOGGLE_BIT)
        status |= PLC_OK_BIT if self._plc.alive else 0
        return status | (TOGGLE_BIT if self._beats & 1 else 0)

    def _spawn(self, work: Coroutine[Any, Any, None], name: str) -> None:
        task = asyncio.create_task(work, name=name)
        self._tasks.add(task)
        task.add_done_callback(self._ended)

    def _ended(self, task: asyncio.Task[None]) -> None:
        self._tasks.discard(task)
        if not task.cancelled() and (failure := task.exception()) is not None:
            log.error("%s ended: %r", task.get_name(), failure)


def _fault_of(message: can.Message) -> str:
    """Why a frame with the command's number is no command; empty when it is one."""
    if message.is_extended_id:
        return "an identifier of 29 bits"
    if message.is_remote_frame:
        return "a remote frame"
    return "" if len(message.data) == COMMAND.layout.size else f"{len(message.data)} bytes instead of 8"
