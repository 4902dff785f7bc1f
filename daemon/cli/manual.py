"""``cellward man``: the manual page, made of what ``--help`` says."""

import re
from collections.abc import Iterator
from typing import Any

import typer

from cell.version import software
from daemon.cli.output import out

# Every exit code of the program; the text of '--help' has them too.
_EXITS = (
    (0, "everything is well"),
    (1, "the verdict is fail, or the job did not complete"),
    (2, "bad input: the message names file, field and correction"),
    (3, "a device or the daemon cannot be reached"),
    (4, "refused: the request can be repeated when the condition is gone"),
    (5, "internal error"),
)


def man(context: typer.Context) -> None:
    """Print the manual page: 'cellward man | man -l -' shows it."""
    out(man_page(context.find_root().command))


def man_page(program: Any) -> str:
    """The page in roff for section 1: every command of ``program`` (a click group) with its options."""
    lines = [
        f'.TH CELLWARD 1 "" "{software()}" "Cellward"',
        ".SH NAME",
        r"cellward \- supervises a robot cell",
        ".SH SYNOPSIS",
        r".B cellward",
        r"COMMAND [\fIoptions\fR] [\fIarguments\fR]",
        ".SH DESCRIPTION",
        *_text(program.help),
        "It is no safety function.",
        ".SH COMMANDS",
    ]
    for name, command in _commands(program):
        lines += [f".SS {_escaped(name)}", *_text(command.help)]
        for parameter in command.params:
            lines += _parameter(parameter)
    lines.append(".SH EXIT STATUS")
    for code, meaning in _EXITS:
        lines += [".TP", f".B {code}", _escaped(meaning)]
    lines += [
        ".SH FILES",
        ".TP",
        ".I /etc/cellward/cell.toml",
        "The cell's configuration; another one is named by --config or CELLWARD_CONFIG.",
        ".TP",
        ".I /var/lib/cellward",
        "Runs and results, unless the configuration names another folder.",
    ]
    return "\n".join(lines)


def _commands(group: Any, before: str = "") -> Iterator[tuple[str, Any]]:
    for name, command in sorted(group.commands.items()):
        if getattr(command, "commands", None):
            yield from _commands(command, f"{before}{name} ")
        elif not command.hidden:
            yield f"{before}{name}", command


def _parameter(parameter: Any) -> list[str]:
    if parameter.param_type_name == "argument":
        named = rf"\fI{_escaped(str(parameter.name).upper())}\fR"
    elif parameter.name == "help" or getattr(parameter, "hidden", False):
        return []
    else:
        named = ", ".join(rf"\fB{_escaped(word)}\fR" for word in (*parameter.opts, *parameter.secondary_opts))
    return [".TP", named, *(_text(getattr(parameter, "help", None)) or [""])]


def _text(text: str | None) -> list[str]:
    """Paragraphs as roff; a line that began a request would vanish. Brackets need no escape here."""
    text = (text or "").replace(r"\[", "[")
    paragraphs = [" ".join(part.split()) for part in re.split(r"\n\s*\n", text) if part.strip()]
    lines = []
    for k, paragraph in enumerate(paragraphs):
        lines += [".PP"] * (k > 0) + [_escaped(paragraph)]
    return lines


def _escaped(text: str) -> str:
    safe = text.replace("\\", r"\e").replace("-", r"\-")
    return rf"\&{safe}" if safe.startswith((".", "'")) else safe
