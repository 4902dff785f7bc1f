"""A subset of URScript, read into statements: assignments, calls, functions, ``if`` and ``while``.

Threads, sockets and what else the subset lacks is reported with its line, never guessed. Expressions are
read by Python's own parser, as URScript's are written alike.
"""

import ast
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import TypeVar

Tree = TypeVar("Tree", ast.Module, ast.Expression)

LINE_LIMIT = 2000
DEEPEST_BLOCK = 40
_HEADER = re.compile(r"^(def|sec)\s+([A-Za-z_]\w*)\s*\(\s*\)\s*:\s*$")
_DEFINE = re.compile(r"^def\s+([A-Za-z_]\w*)\s*\(([^()]*)\)\s*:$")
_CONDITION = re.compile(r"^(if|elif|elseif|while)\b(.*):$", re.S)
_RETURN = re.compile(r"^return\b(.*)$")
_SCOPE = re.compile(r"^(global|local)\s+")
_NAME = re.compile(r"^[A-Za-z_]\w*$")
_NO_EFFECT = frozenset({"enter_critical", "exit_critical"})  # there is only one thread


@dataclass(frozen=True)
class Do:
    """An expression for its effect: nearly always a call."""

    line: int
    value: ast.expr


@dataclass(frozen=True)
class Assign:
    """``name = value``, or ``name[index] = value``; ``shared`` when it is global."""

    line: int
    name: str
    index: ast.expr | None
    value: ast.expr
    shared: bool = False


@dataclass(frozen=True)
class If:
    """Branches in order; the one of ``else`` has no condition."""

    line: int
    branches: tuple[tuple[ast.expr | None, tuple["Statement", ...]], ...]


@dataclass(frozen=True)
class While:
    """A loop; each pass takes at least one control cycle."""

    line: int
    condition: ast.expr
    body: tuple["Statement", ...]


@dataclass(frozen=True)
class Leave:
    """``break``, ``continue``, ``halt`` or ``return`` with its value."""

    line: int
    how: str
    value: ast.expr | None = None


@dataclass(frozen=True)
class Define:
    """A function of the program's own."""

    line: int
    name: str
    parameters: tuple[str, ...]
    body: tuple["Statement", ...]


Statement = Do | Assign | If | While | Leave | Define


@dataclass(frozen=True)
class ParsedProgram:
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


@dataclass
class _Block:
    """A block that is being read, and what has been read of it."""

    kind: str
    line: int
    condition: ast.expr | None = None
    name: str = ""
    parameters: tuple[str, ...] = ()
    body: list[Statement] = field(default_factory=list)
    branches: list[tuple[ast.expr | None, tuple[Statement, ...]]] = field(default_factory=list)

    def close(self) -> Statement:
        body = tuple(self.body)
        if self.kind == "while":
            if self.condition is None:
                raise NotInSubsetError(self.line, "a while without its condition")
            return While(self.line, self.condition, body)
        if self.kind == "def":
            return Define(self.line, self.name, self.parameters, body)
        return If(self.line, (*self.branches, (self.condition, body)))


def read_program(text: str) -> ParsedProgram:
    """Read a ``def`` or ``sec`` program, or bare lines as the controller wraps them."""
    lines = [(n, line) for n, line in enumerate(text.splitlines(), start=1) if _code(line)]
    header = _HEADER.match(_code(lines[0][1])) if lines else None
    name, secondary = "unnamed", False
    if header is not None:
        name, secondary = header.group(2), header.group(1) == "sec"
        lines = lines[1:-1]
    try:
        return ParsedProgram(name, secondary, read_statements(lines))
    except NotInSubsetError as exc:
        return ParsedProgram(name, secondary, (), (exc.line, exc.why))


def read_statements(lines: Iterable[tuple[int, str]]) -> tuple[Statement, ...]:
    """Statements from numbered lines; blocks end with ``end``. Raises :class:`NotInSubsetError`."""
    stack = [_Block("program", 0)]
    for number, raw in lines:
        code = _code(raw)
        if not code or code in _NO_EFFECT:
            continue
        if len(code) > LINE_LIMIT:
            raise NotInSubsetError(number, "line too long")
        opened = _opens(number, code, raw, stack[-1])
        if opened is not None:
            stack.append(opened)
            if len(stack) > DEEPEST_BLOCK:
                raise NotInSubsetError(number, "too many blocks in each other")
        elif code == "end":
            if len(stack) == 1:
                raise NotInSubsetError(number, "'end' without a block")
            done = stack.pop()
            stack[-1].body.append(done.close())
        elif not _next_branch(number, code, raw, stack[-1]):
            stack[-1].body.append(_simple(number, code, raw))
    if len(stack) > 1:
        raise NotInSubsetError(stack[-1].line, "block without 'end'")
    return tuple(stack[0].body)


def walk(statements: Iterable[Statement]) -> Iterator[Statement]:
    """Every statement, those in blocks too."""
    for statement in statements:
        yield statement
        if isinstance(statement, If):
            for _, body in statement.branches:
                yield from walk(body)
        elif isinstance(statement, While | Define):
            yield from walk(statement.body)


def expressions(statement: Statement) -> Iterator[ast.expr]:
    """The expressions of one statement, without those of its blocks."""
    match statement:
        case Do(value=value):
            yield value
        case Assign(index=index, value=value):
            yield value
            if index is not None:
                yield index
        case If(branches=branches):
            yield from (condition for condition, _ in branches if condition is not None)
        case While(condition=condition):
            yield condition
        case Leave(value=ast.expr() as value):
            yield value


def _code(raw: str) -> str:
    """The line without its comment; a ``#`` in a string is none."""
    quoted = False
    for place, letter in enumerate(raw):
        if letter == '"':
            quoted = not quoted
        elif letter == "#" and not quoted:
            return raw[:place].strip()
    return raw.strip()


def _opens(number: int, code: str, raw: str, around: _Block) -> _Block | None:
    """The block that a line begins, or None."""
    if code.startswith("thread "):
        raise NotInSubsetError(number, "threads are not known")
    condition = _CONDITION.match(code)
    if condition is not None and condition.group(1) in ("if", "while"):
        return _Block(condition.group(1), number, _expression(number, condition.group(2), raw))
    if code.startswith("def "):
        found = _DEFINE.match(code)
        if found is None or around.kind != "program":
            raise NotInSubsetError(number, f"cannot read the function {code[:60]!r}")
        parameters = tuple(p.strip() for p in found.group(2).split(",") if p.strip())
        if not all(_NAME.match(p) for p in parameters):
            raise NotInSubsetError(number, "parameters are plain names here")
        return _Block("def", number, name=found.group(1), parameters=parameters)
    return None


def _next_branch(number: int, code: str, raw: str, block: _Block) -> bool:
    """Whether the line is ``elif`` or ``else``, which ends one branch of ``block`` and begins another."""
    condition = _CONDITION.match(code)
    if condition is None and code != "else:":
        return False
    if block.kind != "if" or block.condition is None:
        raise NotInSubsetError(number, f"{code[:60]!r} without 'if'")
    block.branches.append((block.condition, tuple(block.body)))
    block.condition = None if condition is None else _expression(number, condition.group(2), raw)
    block.body = []
    return True


def _simple(number: int, code: str, raw: str) -> Statement:
    if code in ("break", "continue", "halt"):
        return Leave(number, code)
    given = _RETURN.match(code)
    if given is not None:
        value = given.group(1).strip()
        return Leave(number, "return", _expression(number, value, raw) if value else None)
    bare = _SCOPE.sub("", code)
    match _parsed(number, bare, ast.parse).body:
        case [ast.Expr(value=value)]:
            return Do(number, _placed(value, number, bare, raw))
        case [ast.Assign(targets=[ast.Name(id=name)], value=value)]:
            placed = _placed(value, number, bare, raw)
            return Assign(number, name, None, placed, shared=code.startswith("global"))
        case [ast.Assign(targets=[ast.Subscript(value=ast.Name(id=name), slice=index)], value=value)]:
            return Assign(number, name, index, _placed(value, number, bare, raw))
    raise NotInSubsetError(number, f"cannot read {code[:60]!r}")


def _expression(number: int, code: str, raw: str) -> ast.expr:
    """An expression in line ``number``."""
    bare = code.strip()
    return _placed(_parsed(number, bare, _parse_expression).body, number, bare, raw)


def _parse_expression(code: str) -> ast.Expression:
    return ast.parse(code, mode="eval")


def _parsed(number: int, code: str, parse: Callable[[str], Tree]) -> Tree:
    try:
        return parse(code)
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise NotInSubsetError(number, f"cannot read {code[:60]!r}") from None


def _placed(node: ast.expr, number: int, code: str, raw: str) -> ast.expr:
    """The expression with the program's own lines and columns in its nodes."""
    shift = max(raw.find(code), 0)
    for inner in ast.walk(node):
        if isinstance(inner, ast.expr):
            inner.lineno, inner.col_offset = number, inner.col_offset + shift
    return node
