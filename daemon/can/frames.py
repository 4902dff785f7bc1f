"""The frames of the CAN trigger, byte by byte; the manual's tables are made of these."""

import struct
from dataclasses import dataclass

HEARTBEAT_ID = 0x700  # plus the node's number, as in CANopen
BOOT_UP, OPERATIONAL = 0x00, 0x05


@dataclass(frozen=True)
class FrameField:
    """One number of a frame; little-endian."""

    name: str
    type: str  # u8, u16 or u32
    meaning: str


@dataclass(frozen=True)
class Frame:
    """A frame of eight bytes: its parts in their order, and the key of ``[can]`` that has its identifier."""

    name: str
    key: str
    sent_by: str
    parts: tuple[FrameField, ...]

    @property
    def layout(self) -> struct.Struct:
        return struct.Struct("<" + "".join({"u8": "B", "u16": "H", "u32": "I"}[p.type] for p in self.parts))

    def pack(self, *values: int) -> bytes:
        return self.layout.pack(*values)

    def unpack(self, data: bytes) -> tuple[int, ...]:
        return self.layout.unpack(data)


COMMAND = Frame(
    "command",
    "command_id",
    "the PLC",
    (
        FrameField("command", "u8", "what is asked for, as register `command`"),
        FrameField("job", "u8", "which job to start, as register `job`"),
        FrameField(
            "sequence",
            "u16",
            "1..65535; a new value carries the command out, the same again repeats the answer",
        ),
        FrameField(
            "argument",
            "u32",
            "as `argument_1`: first argument of a job, run id of command 8, prompt id of commands 10 and 11",
        ),
    ),
)
ACKNOWLEDGE = Frame(
    "acknowledge",
    "acknowledge_id",
    "Cellward, once for each command",
    (
        FrameField("sequence", "u16", "of the command; 0 where the frame was too short to hold one"),
        FrameField("result", "u16", "as register `result_code`"),
        FrameField("status", "u16", "as register `status`"),
        FrameField("error", "u16", "as register `error_code`"),
    ),
)
STATUS = Frame(
    "status",
    "status_id",
    "Cellward, with each heartbeat",
    (
        FrameField("status", "u16", "as register `status`"),
        FrameField("state", "u8", "as register `packml_state`"),
        FrameField("job", "u8", "as register `active_job`"),
        FrameField("prompt", "u32", "as register `prompt_id`"),
    ),
)
FRAMES = (COMMAND, ACKNOWLEDGE, STATUS)
