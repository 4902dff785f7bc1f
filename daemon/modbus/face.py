"""The Modbus face: the block that a PLC writes, the block that it reads, and the heartbeats of both."""

import asyncio
import ipaddress
import logging
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any

from cell.clock import Clock
from daemon.auditor import Audit, Auditor
from daemon.config.faces import ModbusSection, split_bind
from daemon.modbus.command import (
    ACCEPTED,
    DONE,
    REFUSED,
    RESET,
    START,
    STOPPING,
    Command,
    CommandChannel,
    refused,
)
from daemon.modbus.pdu import ILLEGAL_ADDRESS, ILLEGAL_VALUE, ModbusError
from daemon.modbus.server import ModbusServer
from daemon.modbus.table import RegisterTable, register_table
from daemon.modbus.tls import tls_context
from daemon.plc_heartbeat import PlcHeartbeat

log = logging.getLogger("cellward.modbus")

PROTOCOL_VERSION = 0x0100
HEARTBEAT_S = 0.1
SNAPSHOT_AGE_S = 0.01
DONE_BIT, PLC_OK_BIT, TOGGLE_BIT = (
    register_table().bit("status", name)
    for name in ("done", "PLC heartbeat ok", "toggles with the heartbeat")
)
ENABLE, RESERVED_CONTROL, NO_NEW_PICKS, FAULT_RESET = (
    register_table().bit("control", name) for name in ("enable", "reserved", "no new picks", "fault reset")
)
COMMAND, SEQUENCE, JOB, FLAGS, ARGUMENTS, BEAT, CONTROL = 0, 1, 2, 3, 4, 10, 11


class ModbusFace:
    """Serves the register table.

    ``on_command`` carries out one command and gives its result code; ``snapshot`` gives the status block by
    register name (what is absent is 0; sequence, result code, heartbeat and the bits PLC heartbeat and
    toggle are this class's own). ``on_plc(alive)`` is called when the PLC's heartbeat is lost and returns,
    ``on_picks(wanted, client)`` when the PLC clears or sets *no new picks*.
    ``audit(who, what, accepted, detail)`` and ``remember(sequence)`` may block; they run in a thread.
    """

    def __init__(
        self,
        config: ModbusSection,
        clock: Clock,
        on_command: Callable[[Command], Awaitable[int]],
        snapshot: Callable[[], Mapping[str, Any]],
        *,
        audit: Audit | None = None,
        on_plc: Callable[[bool], None] = lambda alive: None,
        on_picks: Callable[[bool, str], None] = lambda wanted, client: None,
        last_sequence: int = 0,
        remember: Callable[[int], None] | None = None,
        table: RegisterTable | None = None,
    ) -> None:
        self._config, self._clock = config, clock
        self._on_command, self._snapshot = on_command, snapshot
        self._on_picks = on_picks
        self._table = table or register_table()
        self._low_first = config.word_order == "low-first"
        self._allowed = [ipaddress.ip_network(entry) for entry in config.allow_clients]
        self._auditor = Auditor(audit)
        self._channel = CommandChannel(self._carry_out, last_sequence, remember, self._report)
        self._registers = [0] * self._table.command_size
        # What is found at the start is a level, not an edge; a reset bit in the first control word is, too.
        self._registers[SEQUENCE] = last_sequence
        self._control_seen = False
        self._reset_wanted: set[asyncio.Task[int]] = set()
        self._started = clock.now()
        self._plc = PlcHeartbeat(clock, config.heartbeat_timeout_s, self._auditor.note, on_plc)
        self._cached: tuple[float, Mapping[str, Any]] | None = None
        host, port = split_bind(config.bind)
        self._server = ModbusServer(
            self,
            clock,
            host,
            port,
            config.max_connections,
            config.idle_timeout_s,
            self._may_write,
            tls_context(config),
        )
        self._watch: asyncio.Task[None] | None = None

    # -- for the daemon

    @property
    def address(self) -> tuple[str, int]:
        """Host and port that are served."""
        return self._server.address

    @property
    def control(self) -> int:
        """The control bits as the PLC last wrote them."""
        return self._registers[CONTROL]

    @property
    def plc_heard(self) -> bool:
        """Whether a PLC's heartbeat has been seen since the start."""
        return self._plc.heard

    @property
    def plc_alive(self) -> bool:
        """The PLC's heartbeat has been seen and is not lost."""
        return self._plc.alive

    async def start(self) -> None:
        """Serve, unless ``[modbus] enabled`` is false; ``ADDRESS_NOT_SERVED``."""
        if not self._config.enabled:
            return
        await self._server.start()
        self._auditor.start()
        self._watch = asyncio.create_task(self._plc.watch(), name="modbus heartbeat watch")
        log.info("Modbus on %s:%d, writing %s", *self.address, self._config.allow_write)

    async def stop(self) -> None:
        """Close everything; commands under way are cancelled, audit lines that wait are written."""
        watch, self._watch = self._watch, None
        if watch is not None:
            watch.cancel()
            await asyncio.wait([watch])
        await self._server.stop()
        await self._channel.stop()
        for task in tuple(self._reset_wanted):
            task.cancel()
            await asyncio.wait([task], timeout=2.0)
        await self._auditor.stop()

    # -- what the server asks

    def read_discrete(self, address: int, count: int) -> Sequence[bool]:
        values = self._status_values()
        word = int(values["status"]) | int(values.get("warning_bits", 0)) << 16
        if address + count > 32:
            raise ModbusError(ILLEGAL_ADDRESS)
        return [bool(word >> bit & 1) for bit in range(address, address + count)]

    def read_input(self, address: int, count: int) -> Sequence[int]:
        if address + count > self._table.readable_size:
            raise ModbusError(ILLEGAL_ADDRESS)
        words = self._table.readable_words(self._status_values(), self._low_first)
        return words[address : address + count]

    def read_holding(self, address: int, count: int) -> Sequence[int]:
        if address >= self._table.mirror:
            return self.read_input(address - self._table.mirror, count)
        if address + count > self._table.command_size:
            raise ModbusError(ILLEGAL_ADDRESS)
        return self._registers[address : address + count]

    def write_holding(self, address: int, values: Sequence[int], client: str) -> None:
        """One request of a PLC: checked as a whole, taken as a whole, and only then looked at."""
        what = f"write {address}" + (f"..{address + len(values) - 1}" if len(values) > 1 else "")
        why, code = self._objection(address, values, client)
        if code:
            self._auditor.note(client, what, False, f"{why}; values {_shown(values)}")
            raise ModbusError(code)
        before = list(self._registers)
        self._registers[address : address + len(values)] = values
        changed = [i for i, value in enumerate(before) if self._registers[i] != value]
        if set(changed) - {BEAT} or address > BEAT or address + len(values) <= BEAT:
            self._auditor.note(client, what, True, f"values {_shown(values)}")
        if BEAT in changed:
            self._plc.beat(client)
        if address <= CONTROL < address + len(values):
            self._control_written(before[CONTROL], client)
        if address <= SEQUENCE < address + len(values):
            self._channel.offer(self._command(client))

    def write_coils(self, address: int, client: str) -> None:
        """There are no coils."""
        self._auditor.note(client, f"write coil {address}", False, "outside the command block")
        raise ModbusError(ILLEGAL_ADDRESS)

    # -- inside

    def _objection(self, address: int, values: Sequence[int], client: str) -> tuple[str, int]:
        """Why a write is refused, with its exception code; 0 when it is not."""
        if not self._config.allow_write:
            return "[modbus] allow_write is false", ILLEGAL_ADDRESS
        if not self._may_write(client):
            return "not in [modbus] allow_clients", ILLEGAL_ADDRESS
        if address + len(values) > self._table.command_size:
            return "outside the command block", ILLEGAL_ADDRESS
        for offset, value in enumerate(values):
            if not self._table.value_allowed(address + offset, value):
                return f"{value} is not allowed in {address + offset}", ILLEGAL_VALUE
        return "", 0

    def _may_write(self, client: str) -> bool:
        try:
            address = ipaddress.ip_address(client.partition("%")[0])
        except ValueError:
            return False
        mapped = getattr(address, "ipv4_mapped", None) or address
        return any(mapped in network for network in self._allowed)

    def _command(self, client: str) -> Command:
        words = self._registers
        return Command(
            words[COMMAND],
            words[SEQUENCE],
            words[JOB],
            words[FLAGS],
            tuple(words[ARGUMENTS : ARGUMENTS + 6]),
            "modbus",
            client,
            self._low_first,
        )

    async def _carry_out(self, command: Command) -> int:
        """The result code of one command; a stop is carried out whatever heartbeat and enable bit say."""
        if command.code == 0:
            return refused("ARGUMENT_INVALID")
        if command.code not in STOPPING and self._plc.lost:
            return refused("PLC_SILENT")
        if command.code == START and self._config.require_enable and not self.control & ENABLE:
            return refused("NOT_ENABLED")
        if command.code == START and (asked := self._reserved_asked(command)):
            log.warning("%s: start refused: %s must be 0", command.client, asked)
            return refused("NOT_IN_VERSION")
        return await self._on_command(command)

    def _reserved_asked(self, command: Command) -> str:
        """What a start sets although this version has no use for it; doing less than asked is no start."""
        asked = {"flags": command.flags, "control bit 1": self.control & RESERVED_CONTROL}
        return ", ".join(name for name, value in asked.items() if value)

    def _report(self, command: Command, result: int) -> None:
        self._auditor.note(
            command.client,
            f"command {command.code} sequence {command.sequence} job {command.job}",
            result < REFUSED,
            f"result {result:#06x}",
        )
        self._cached = None  # what the PLC reads with this acknowledgement is not older than it

    def _control_written(self, before: int, client: str) -> None:
        """A rising fault reset bit is command 7; a bit that is up in the first word written is no edge."""
        if (self.control ^ before) & NO_NEW_PICKS:
            self._on_picks(not self.control & NO_NEW_PICKS, client)
        rising = self.control & ~before & FAULT_RESET
        first, self._control_seen = not self._control_seen, True
        if rising and not first:
            task = asyncio.create_task(self._reset(client), name="fault reset bit")
            self._reset_wanted.add(task)
            task.add_done_callback(self._reset_wanted.discard)

    async def _reset(self, client: str) -> int:
        command = Command(RESET, 0, client=client)
        try:
            result = await self._carry_out(command)
        except Exception:
            log.exception("%s: fault reset bit", client)
            result = refused("INTERNAL")
        self._report(command, result)
        return result

    def _status_values(self) -> dict[str, Any]:
        """The snapshot of the engine, with what is this face's own laid over it."""
        now = self._clock.now()
        if self._cached is None or not 0.0 <= now - self._cached[0] < SNAPSHOT_AGE_S:
            self._cached = (now, self._snapshot())
        values = dict(self._cached[1])
        beat = int((now - self._started) / HEARTBEAT_S + 1e-9) & 0xFFFF
        status = int(values.get("status") or 0) & ~(PLC_OK_BIT | TOGGLE_BIT)
        status |= PLC_OK_BIT if self.plc_alive else 0
        status |= TOGGLE_BIT if beat & 1 else 0
        result = self._channel.result
        if result == ACCEPTED and status & DONE_BIT:
            result = DONE
        return values | {
            "status": status,
            "acknowledged_sequence": self._channel.acknowledged,
            "result_code": result,
            "heartbeat": beat,
            "protocol_version": PROTOCOL_VERSION,
        }


def _shown(values: Sequence[int]) -> str:
    text = " ".join(str(value) for value in values[:16])
    return text if len(values) <= 16 else f"{text} and {len(values) - 16} more"
