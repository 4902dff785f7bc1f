"""``docs/can.md``: the frames of the CAN trigger, and what their numbers mean."""

from daemon.can.frames import FRAMES, HEARTBEAT_ID
from daemon.config.faces import CanSection
from daemon.docs.page import page
from daemon.modbus.table import RegisterTable

HEAD = """
# CAN trigger

Sources: `daemon/can/frames.py` for the frames, `daemon/modbus/registers.toml` for the meanings, which are
those of [the Modbus server](registers.md). It is off until `[can] enabled = true`: a bus has no sender
identity, so whoever is on it may command. This face supervises. It is no safety function: an emergency stop
is a wire.

The bus may be that of an encoder: the same text in `bus` is the same bus, which is then opened once and
loses no frame of either. Identifiers have 11 bits; numbers are little-endian.

## How to give a command

1. Send a command frame with the next sequence. The channel has a sequence of its own, which survives a
   restart.
2. Wait for the acknowledge frame with that sequence; its result is 1 (accepted), 2 (done), or 0x8000 plus
   the number of the error that says why it was refused.
3. No acknowledge in time: send the same frame again. A command is carried out once; the same sequence again
   only has the acknowledge repeated, with the status of that moment. While a command is under way nothing
   is sent for it.

A command frame that has another length, an identifier of 29 bits, sequence 0, or is a remote frame, is
refused with 4005 and audited, as are an unknown command, job, run or prompt with their own numbers. Frames
with other identifiers belong to others. Every command is audited. Command 8 needs `allow_accept` of
`[can]`, not of `[modbus]`. At a start the argument is the job's first one, with the meaning, type and
bounds that [the registers](registers.md#arguments-of-jobs) give it; 0 leaves it as configured.

Our heartbeat has the identifier {heartbeat:#x} + `node` and the data 0 once when the bus is opened, then 5.
With `plc_node` the PLC's heartbeat is watched: once it has been seen, its silence holds the job, and only
abort and halt are taken.
"""


def can_page(table: RegisterTable) -> str:
    """The text of ``docs/can.md``."""
    lines: list[str] = []
    for frame in FRAMES:
        default = CanSection.model_fields[frame.key].default
        lines += [
            f"## Frame `{frame.name}`",
            "",
            f"Sent by {frame.sent_by}; `{frame.key}`, by default {default:#x}.",
            "",
        ]
        lines += ["| bytes | name | type | meaning |", "|---|---|---|---|"]
        at = 0
        for part in frame.parts:
            size = int(part.type[1:]) // 8
            where = f"{at}" if size == 1 else f"{at}-{at + size - 1}"
            lines.append(f"| {where} | {part.name} | {part.type} | {part.meaning} |")
            at += size
        lines.append("")
    for register in table.command:
        if register.name in ("command", "job"):
            lines += [f"## `{register.name}`", "", "| value | meaning |", "|---|---|"]
            lines += [f"| {number} | {text} |" for number, text in register.values.items()]
            lines.append("")
    return page(HEAD.format(heartbeat=HEARTBEAT_ID), lines)
