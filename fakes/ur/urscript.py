"""A small, honest subset of URScript: straight-line calls, ``while True`` and nothing else.

Enough for stop scripts, simple moves and the paths that clients inject. What the subset does not know is
reported, never guessed: such a program is shown as running until somebody stops it.
"""

import ast
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

LINE_LIMIT = 2000
_HEADER = re.compile(r"^(def|sec)\s+([A-Za-z_]\w*)\s*\(\s*\)\s*:\s*$")
_FOREVER = re.compile(r"^while\s*\(?\s*True\s*\)?\s*:\s*$")
_CONSTANTS = {"pi": 3.141592653589793}


@dataclass(frozen=True)
class Pose:
    """``p[x, y, z, rx, ry, rz]``; told from a list of joints by its type."""

    values: tuple[float, ...]


Argument = float | bool | str | Pose | list["Argument"]


@dataclass(frozen=True)
class Call:
    """``function(arguments)`` in line ``line`` of the program, counted from 1."""

    line: int
    function: str
    positional: tuple[Argument, ...]
    named: dict[str, Argument] = field(default_factory=dict)


@dataclass(frozen=True)
class Forever:
    """``while True`` around a body."""

    line: int
    body: tuple["Statement", ...]


Statement = Call | Forever


@dataclass(frozen=True)
class Source:
    """A program as it was read. ``unknown`` is the first line that is outside the subset, and why."""

    name: str
    secondary: bool
    statements: tuple[Statement, ...]
    unknown: tuple[int, str] | None = None


class NotInSubsetError(ValueError):
    """A line that this subset does not know."""

    def __init__(self, line: int, why: str) -> None:
        super().__init__(f"line {line}: {why}")
        self.line, self.why = line, why


def read_program(text: str) -> Source:
    """Read a ``def`` or ``sec`` program, or bare lines as the controller wraps them."""
    lines = list(enumerate(text.splitlines(), start=1))
    meaningful = [(n, line) for n, line in lines if line.split("#")[0].strip()]
    header = _HEADER.match(meaningful[0][1].strip()) if meaningful else None
    name, secondary = "unnamed", False
    if header is not None:
        name, secondary = header.group(2), header.group(1) == "sec"
        meaningful = meaningful[1:-1]
    try:
        return Source(name, secondary, read_statements(meaningful))
    except NotInSubsetError as exc:
        return Source(name, secondary, (), (exc.line, exc.why))


def read_statements(lines: Iterable[tuple[int, str]]) -> tuple[Statement, ...]:
    """Statements from numbered lines; blocks end with ``end``. Raises :class:`NotInSubsetError`."""
    stack: list[tuple[int, list[Statement]]] = [(0, [])]
    for number, raw in lines:
        line = raw.split("#")[0].strip()
        if not line:
            continue
        if _FOREVER.match(line):
            stack.append((number, []))
        elif line == "end":
            if len(stack) == 1:
                raise NotInSubsetError(number, "'end' without a block")
            start, body = stack.pop()
            stack[-1][1].append(Forever(start, tuple(body)))
        else:
            stack[-1][1].append(_read_call(number, line))
    if len(stack) > 1:
        raise NotInSubsetError(stack[-1][0], "block without 'end'")
    return tuple(stack[0][1])


def _read_call(number: int, line: str) -> Call:
    if len(line) > LINE_LIMIT:
        raise NotInSubsetError(number, "line too long")
    try:
        node = ast.parse(line, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise NotInSubsetError(number, f"cannot read {line[:60]!r}") from None
    if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Name):
        raise NotInSubsetError(number, f"only calls are known, not {line[:60]!r}")
    named = {k.arg: _value(k.value, number) for k in node.keywords if k.arg is not None}
    return Call(number, node.func.id, tuple(_value(a, number) for a in node.args), named)


def _value(node: ast.expr, line: int) -> Argument:
    match node:
        case ast.Constant(value=bool() | int() | float() | str() as value):
            return value
        case ast.Name(id=name) if name in _CONSTANTS:
            return _CONSTANTS[name]
        case ast.List(elts=items):
            return [_value(item, line) for item in items]
        case ast.Subscript(value=ast.Name(id="p"), slice=ast.Tuple(elts=items)):
            return Pose(tuple(_number(item, line) for item in items))
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return -_number(inner, line)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return _number(left, line) + _number(right, line)
        case _:
            raise NotInSubsetError(line, f"cannot read the value {ast.unparse(node)[:60]!r}")


def _number(node: ast.expr, line: int) -> float:
    value = _value(node, line)
    if isinstance(value, int | float):
        return float(value)
    raise NotInSubsetError(line, "a number was expected")


def six_numbers(value: Argument) -> Sequence[float] | None:
    """The six numbers of a pose or of a list, or None."""
    items = value.values if isinstance(value, Pose) else value
    if isinstance(items, list | tuple) and len(items) == 6:
        numbers = [float(x) for x in items if isinstance(x, int | float)]
        return numbers if len(numbers) == 6 else None
    return None
