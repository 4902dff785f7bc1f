"""``docs/registers.md``: the register map and how to use it."""

from collections.abc import Mapping

from cell.procedure import Procedure
from daemon.docs.job_arguments import argument_lines
from daemon.docs.page import page
from daemon.modbus.table import Register, RegisterTable

HEAD = """
# Modbus registers

Source: `daemon/modbus/registers.toml`. Addresses are those of the protocol, from 0; in the older way of
counting, holding register 0 is 40001 and input register 0 is 30001. Any unit id is answered. 32-bit values
take two registers, high word first unless `[modbus] word_order` says otherwise. Quantities are SI.

Holding registers 0 to {command_last} are the command block, which the PLC writes. Input registers 0 to
{status_last} are the status block and up to {last} the committed block, which it reads; holding registers
from {mirror} mirror both for a PLC that knows only function 3. Discrete inputs 0 to 15 are the status bits,
16 to 31 the warning bits.

Functions: 2, 3, 4, 6, 16, 22, 23, and 43/14, which names maker, product and version.

This face supervises. It is no safety function: an emergency stop is a wire.

## Who may write

No client, until `[modbus] allow_write = true` and the client is in `allow_clients`. Every write is audited.
Exception 2: not writable, or not by you. Exception 3: a value that has no meaning. *Not possible now* is no
exception but a result code.

## How to give a command

[Function blocks](plc.md) in Structured Text do what follows.

1. Read `acknowledged_sequence`. A PLC that starts goes on from there.
2. Write command, job and arguments, and the next sequence last or in the same request (function 16).
3. Wait until `acknowledged_sequence` is that sequence, then read `result_code`.

A start must find 0 in `flags`, in control bit 1 and in the arguments that the job does not take: a start
that sets one of them is refused with 6103. What it takes is below (*Arguments of jobs*); a number out of
bounds is refused with 4005, and nothing is started. Commands other than 1, 8, 10 and 11 do not look at the
arguments. A refusal is 0x8000 plus the error's number, so 6001 (a job is running) is 0x9771;
[errors.md](errors.md) lists them.

The same sequence again does nothing, so a lost reply may be retried. A start whose sequence cannot be written
to disk within 1 s is refused with 2102: after a restart the same request would start the job again. What
stands in the block when the daemon starts is no command. Abort and halt withdraw commands before them that
are still under way. Completion is not success: read the status bits; the verdict belongs to `run_id`. Once
`plc_heartbeat` has been seen, its silence holds the job, and only abort and halt are taken.

*No new picks* is a level: while it is set, `belt-tracking` waits above the belt in Suspended, and what passes
is counted as missed. It belongs to no run: one that starts while the bit is set waits, too, whoever started
it, and its journal names the client that set it. A restart of the daemon clears it with all other control
bits.

## What the status says

| bit | set while |
|---|---|
| `ready` | no job runs, motion is not locked, and the arm is connected and shows no fault |
| `busy` | a job runs, from its start until its end is written |
| `done` | the last run came to its end, whatever its verdict; until acknowledged, reset, or the next start |
| `fault` | the last run ended by the error in `error_code`, or motion is locked |
| `warning` | the last run's verdict is *warn*; until it is acknowledged or the next one starts |
| `result valid` | the last run has an answer and its verdict is *pass* or *warn*; as long as *warning* |
| `arm ok`, `camera ok`, `encoder ok`, `beams ok`, `tracker ok` | that device is connected and can be used |
| `PLC heartbeat ok` | `plc_heartbeat` has been seen and moves |
| `protective or emergency stop` | the arm shows one, or the last run ended by one; until the reset |
| `twin` | the cell is a simulated one |

`ready` and `fault` may stand together: after a device was lost, say, a start needs no reset, and takes the
fault back. Where motion is locked, as after a protective stop, `ready` stays 0 until command 7. `result_code`
reads 1 when the command was taken, and 2 from then on while `done` is set: after a start, once its job has
come to its end. `packml_state` stays where the last run ended until the next start or a reset.

The progress of a job in percent is 100 * `step` / `steps`; with `steps` 0 it is not known yet. The crossed
beams count ways there and back, of the most that their plan has, in all scans that they expect to make.

## What was put into effect

A robot program needs the new TCP as numbers: registers 82 to 93 always have the tool's pose in effect, and 65
to 81 the calibration that changed last, by a commit or a rollback, whoever decided it. Poses are metres and a
rotation vector, as the arm's own. Read the block when `change_count` is another one than that of your last
reading. One request is answered from one state of the cell, so registers 64 to 95 read together belong
together. A PLC that needs several requests reads register 95 last and begins again where it is not equal to
64. Committed is not passed on: the robot program that takes the numbers over is yours.
"""


def registers_page(table: RegisterTable, jobs: Mapping[str, type[Procedure]]) -> str:
    """The text of ``docs/registers.md``."""
    head = HEAD.format(
        command_last=table.command_size - 1,
        status_last=table.status_size - 1,
        last=table.readable_size - 1,
        mirror=table.mirror,
    )
    lines = ["## Command block (holding registers)", "", *_register_table(table.command), ""]
    lines += argument_lines(jobs)
    lines += [f"## Status block (input registers; holding registers from {table.mirror})", ""]
    lines += [*_register_table(table.status), ""]
    lines += [
        f"## Committed block (input registers; holding registers from {table.mirror + table.status_size})",
        "",
    ]
    lines += [*_register_table(table.committed), ""]
    for register in (*table.command, *table.readable):
        lines += _meanings(register)
    return page(head, lines)


def _register_table(registers: tuple[Register, ...]) -> list[str]:
    rows = ["| register | name | type | unit | meaning |", "|---|---|---|---|---|"]
    for r in registers:
        where = str(r.address) if r.words == 1 else f"{r.address}-{r.address + 1}"
        rows.append(f"| {where} | `{r.name}` | {r.type} | {r.unit} | {r.meaning} |")
    return rows


def _meanings(register: Register) -> list[str]:
    if register.values:
        rows = [f"| {number} | {text} |" for number, text in register.values.items()]
        if register.reserved:
            rows.append(
                f"| {', '.join(map(str, register.reserved))} | reserved: a start is refused with 6003 |"
            )
        return [f"### `{register.name}`", "", "| value | meaning |", "|---|---|", *rows, ""]
    if register.bits:
        rows = [f"| {bit} | {text} |" for bit, text in enumerate(register.bits)]
        return [f"### Bits of `{register.name}`", "", "| bit | meaning |", "|---|---|", *rows, ""]
    return []
