"""A PLC that speaks to the daemon over Modbus, and knows it only from the register map in the manual."""

import logging
import struct
import time
from types import TracebackType
from typing import Self

from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException

from cell.errors import catalogue, error
from daemon.modbus.table import register_table

COMMAND, SEQUENCE, ARGUMENTS, HEARTBEAT = 0, 1, 4, 10
ENABLE = register_table().bit("control", "enable")
START, FINISH, RESUME, RESET, ACKNOWLEDGE, CONFIRM = 1, 2, 6, 7, 9, 10
READY, BUSY, ARM_OK, CAMERA_OK, BEAMS_OK, ENCODER_OK, TRACKER_OK = (
    register_table().bit("status", name)
    for name in ("ready", "busy", "arm ok", "camera ok", "beams ok", "encoder ok", "tracker ok")
)
COMPLETE, HELD = 17, 11
REFUSED = 0x8000
STATUS_REGISTERS = 64
ANSWER_TIMEOUT_S = 20.0
POLL_S = 0.2


class Status:
    """The status block as it was read."""

    def __init__(self, registers: list[int]) -> None:
        self._r = registers
        self.bits, self.acknowledged, self.result_code = registers[0], registers[1], registers[2]
        self.packml, self.error_code = registers[4], registers[6]
        self.run_id, self.prompt_id = self._uint32(10), self._uint32(14)
        self.step, self.steps = registers[12], registers[13]
        self.picks = self._uint32(20)

    def ready_with(self, needs: int) -> bool:
        """Ready for a command, and the devices with these bits are, too."""
        wanted = READY | needs
        return self.bits & wanted == wanted

    @property
    def busy(self) -> bool:
        return bool(self.bits & BUSY)

    @property
    def held(self) -> bool:
        """Whether the run waits to be resumed, and not for the answer to a prompt."""
        return self.packml == HELD and not self.prompt_id

    def _uint32(self, address: int) -> int:
        return self._r[address] << 16 | self._r[address + 1]


class Plc:
    """One connection. Everything it does also beats: the daemon holds a job whose PLC has gone silent."""

    def __init__(self, host: str, port: int) -> None:
        logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # what it logs is raised here anyway
        self._client = ModbusTcpClient(host, port=port, timeout=3, retries=1)
        self._address = f"{host}:{port}"
        self._beat = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, exc: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._client.close()

    def connect(self) -> bool:
        """Whether the daemon's Modbus server is there."""
        return bool(self._client.connect())

    def poll(self) -> Status:
        """Beat, then read the status block."""
        self._beat = (self._beat + 1) % 0x10000
        self._write(HEARTBEAT, [self._beat, ENABLE])
        try:
            reply = self._client.read_input_registers(0, count=STATUS_REGISTERS)
        except ModbusException as exc:
            raise error("DEVICE_LOST", f"Modbus {self._address}: {exc}") from exc
        if reply.isError():
            raise error("PROTOCOL_VIOLATION", f"Modbus {self._address}: reading the status: {reply}")
        return Status(reply.registers)

    def command(self, code: int, job: int = 0, argument: int = 0) -> Status:
        """Give one command and wait for its answer; a refusal is raised as the error it names."""
        sequence = self.poll().acknowledged % 0xFFFF + 1
        high, low = struct.unpack(">HH", struct.pack(">I", argument))
        self._write(ARGUMENTS, [high, low])
        self._write(COMMAND + 2, [job, 0])
        self._write(COMMAND, [code])
        self._write(SEQUENCE, [sequence])  # last: this is what makes the command valid
        give_up = time.monotonic() + ANSWER_TIMEOUT_S
        while (status := self.poll()).acknowledged != sequence:
            if time.monotonic() > give_up:
                raise error("CALL_TIMEOUT", f"command {code} was not acknowledged in {ANSWER_TIMEOUT_S:g} s")
            time.sleep(POLL_S)
        if status.result_code >= REFUSED:
            raise refusal_of(code, status.result_code - REFUSED, "Modbus")
        return status

    def _write(self, address: int, values: list[int]) -> None:
        try:
            reply = self._client.write_registers(address, values)
        except ModbusException as exc:
            raise error("DEVICE_LOST", f"Modbus {self._address}: {exc}") from exc
        if reply.isError():
            raise error("PROTOCOL_VIOLATION", f"Modbus {self._address}: writing register {address}: {reply}")


def refusal_of(command: int, code: int, way: str) -> Exception:
    """The error that the result code of a refused command names."""
    entry = next((e for e in catalogue().values() if e.code == code), None)
    if entry is None:
        return error("NOT_ALLOWED", f"command {command} was refused with result code {code}")
    return error(entry.name, f"so the daemon answered command {command} over {way}")
