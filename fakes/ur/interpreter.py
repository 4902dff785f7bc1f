"""Runs the URScript subset on the arm, one control cycle per step."""

import ast
import inspect
import math
import operator
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from fakes.ur.runtime import ScriptError, Steps
from fakes.ur.script_functions import ScriptFunctions
from fakes.ur.script_values import Pose, Value, copied, is_number, truth
from fakes.ur.urscript import (
    Assign,
    Define,
    Do,
    If,
    Leave,
    ParsedProgram,
    Statement,
    While,
    expressions,
    walk,
)

if TYPE_CHECKING:
    from fakes.ur.robot import Robot

TAKES_TIME = frozenset(
    {"movej", "movel", "movep", "servoj", "servoc", "speedj", "speedl", "stopj", "stopl", "sleep", "sync"}
)
DEEPEST_CALL = 40
_CONSTANTS: dict[str, Value] = {"pi": math.pi}
_BINARY: dict[type[ast.operator], Callable[[Any, Any], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: operator.mod,
}
_ORDER: dict[type[ast.cmpop], Callable[[Any, Any], bool]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}


class _HaltError(Exception):
    """``halt`` ends the whole program, from whichever function."""


Evaluation = Generator[None, None, Value]
Execution = Generator[None, None, Leave | None]


@dataclass
class Scope:
    """Variables of the program, and of the function that runs."""

    shared: dict[str, Value] = field(default_factory=dict)
    local: dict[str, Value] | None = None
    depth: int = 0

    def get(self, name: str) -> Value:
        if self.local is not None and name in self.local:
            return self.local[name]
        if name in self.shared:
            return self.shared[name]
        if name in _CONSTANTS:
            return _CONSTANTS[name]
        raise ScriptError(f"the variable {name} has no value yet")

    def set(self, name: str, value: Value, shared: bool) -> None:
        target = self.shared if shared or self.local is None or name in self.shared else self.local
        target[name] = copied(value)


class Interpreter:
    """Statements to steps. ``hooks`` are functions that the surrounding program adds, by name."""

    def __init__(self, robot: "Robot", hooks: Mapping[str, Callable[[float], None]] | None = None) -> None:
        self._robot = robot
        self._hooks = hooks or {}
        self._functions = ScriptFunctions(robot)
        self._defined: dict[str, Define] = {}

    def unknown(self, statements: Sequence[Statement]) -> tuple[int, int, str] | None:
        """Line, column and name of the first name that is unknown; None when all are known."""
        every = list(walk(statements))
        variables = set(_CONSTANTS) | {s.name for s in every if isinstance(s, Assign)}
        functions = set(self._hooks)
        for statement in every:
            if isinstance(statement, Define):
                functions.add(statement.name)
                variables.update(statement.parameters)
        for statement in every:
            for expression in expressions(statement):
                for name, called in _names(expression):
                    known = name.id in functions or self._functions.knows(name.id)
                    if not (known if called else name.id in variables):
                        return name.lineno, name.col_offset + 1, name.id
        return None

    def run(self, statements: Sequence[Statement]) -> Steps:
        """The statements' steps."""
        self._defined = {s.name: s for s in statements if isinstance(s, Define)}
        try:
            yield from self._block(statements, Scope())
        except _HaltError:
            return
        except RecursionError:
            raise ScriptError("an expression is too deep") from None

    # -- statements

    def _block(self, statements: Sequence[Statement], scope: Scope) -> Execution:
        for statement in statements:
            self._robot.script_line = statement.line
            try:
                left = yield from self._statement(statement, scope)
            except ScriptError as exc:
                if exc.placed:
                    raise
                raise ScriptError(exc.text, statement.line, placed=True) from exc
            if left is not None:
                return left
        return None

    def _statement(self, statement: Statement, scope: Scope) -> Execution:
        match statement:
            case Do(value=value):
                yield from self._evaluate(value, scope)
            case Assign():
                yield from self._assign(statement, scope)
            case If(branches=branches):
                for condition, body in branches:
                    if condition is None or truth((yield from self._evaluate(condition, scope))):
                        return (yield from self._block(body, scope))
            case While():
                return (yield from self._loop(statement, scope))
            case Leave(how="halt"):
                raise _HaltError
            case Leave():
                return statement
        return None

    def _assign(self, statement: Assign, scope: Scope) -> Steps:
        value = yield from self._evaluate(statement.value, scope)
        if statement.index is not None:
            place = yield from self._evaluate(statement.index, scope)
            items, index = _indexed(scope.get(statement.name), place)
            items[index] = value
            whole = scope.get(statement.name)
            value = Pose(tuple(_plain_number(x) for x in items)) if isinstance(whole, Pose) else items
        scope.set(statement.name, value, statement.shared)

    def _loop(self, loop: While, scope: Scope) -> Execution:
        while truth((yield from self._evaluate(loop.condition, scope))):
            left = yield from self._block(loop.body, scope)
            if left is not None and left.how == "break":
                return None
            if left is not None and left.how != "continue":
                return left
            yield  # a loop without commands that take time must not stop the controller's clock
        return None

    # -- expressions

    def _evaluate(self, node: ast.expr, scope: Scope) -> Evaluation:
        match node:
            case ast.Constant(value=bool() | int() | float() | str() as value):
                return value
            case ast.Name(id=name):
                return scope.get(name)
            case ast.List(elts=items):
                return (yield from self._all(items, scope))
            case ast.Subscript(value=ast.Name(id="p"), slice=ast.Tuple(elts=items)):
                values = yield from self._all(items, scope)
                return Pose(tuple(_plain_number(v) for v in values))
            case ast.Subscript(value=whole, slice=place):
                found = yield from self._evaluate(whole, scope)
                values, index = _indexed(found, (yield from self._evaluate(place, scope)))
                return values[index]
            case ast.Call(func=ast.Name(id=name)):
                return (yield from self._call(name, node, scope))
            case ast.BoolOp(op=op, values=parts):
                return (yield from self._logic(isinstance(op, ast.And), parts, scope))
            case ast.UnaryOp(op=op, operand=inner):
                operand = yield from self._evaluate(inner, scope)
                return not truth(operand) if isinstance(op, ast.Not) else _signed(op, operand)
            case ast.BinOp(left=left, op=op, right=right):
                a = yield from self._evaluate(left, scope)
                return _computed(op, a, (yield from self._evaluate(right, scope)))
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                a = yield from self._evaluate(left, scope)
                return _compared(op, a, (yield from self._evaluate(right, scope)))
        raise ScriptError(f"the twin cannot evaluate {ast.unparse(node)[:60]!r}")

    def _all(self, nodes: Sequence[ast.expr], scope: Scope) -> Generator[None, None, list[Value]]:
        values: list[Value] = []
        for node in nodes:
            values.append((yield from self._evaluate(node, scope)))
        return values

    def _logic(self, every: bool, parts: Sequence[ast.expr], scope: Scope) -> Evaluation:
        for part in parts:
            if truth((yield from self._evaluate(part, scope))) is not every:
                return not every
        return every

    def _call(self, name: str, node: ast.Call, scope: Scope) -> Evaluation:
        positional = yield from self._all(node.args, scope)
        named: dict[str, Value] = {}
        for keyword in node.keywords:
            if keyword.arg is not None:
                named[keyword.arg] = yield from self._evaluate(keyword.value, scope)
        if name in self._defined:
            return (yield from self._call_own(self._defined[name], positional, named, scope))
        if name in self._hooks:
            self._hooks[name](_plain_number(positional[0] if positional else 0))
            return None
        return (yield from _invoke(name, self._functions.find(name), positional, named))

    def _call_own(
        self, function: Define, positional: list[Value], named: dict[str, Value], scope: Scope
    ) -> Evaluation:
        given = dict(zip(function.parameters, positional, strict=False)) | named
        if len(positional) > len(function.parameters) or set(given) != set(function.parameters):
            raise ScriptError(f"{function.name} takes {len(function.parameters)} arguments")
        if scope.depth >= DEEPEST_CALL:
            raise ScriptError(f"{function.name}: too many calls in each other")
        inner = Scope(scope.shared, {k: copied(v) for k, v in given.items()}, scope.depth + 1)
        left = yield from self._block(function.body, inner)
        if left is None or left.value is None:
            return None
        return (yield from self._evaluate(left.value, inner))


def secondary_steps(robot: "Robot", source: ParsedProgram) -> Steps:
    """A secondary program: it runs beside the main one and must not take physical time."""
    for statement in walk(source.statements):
        waits = isinstance(statement, While) or any(
            called and name.id in TAKES_TIME
            for expression in expressions(statement)
            for name, called in _names(expression)
        )
        if waits:
            raise ScriptError("a secondary program must not take physical time", statement.line)
    yield from Interpreter(robot).run(source.statements)


def _invoke(
    name: str, function: Callable[..., Any], positional: list[Value], named: dict[str, Value]
) -> Evaluation:
    try:
        inspect.signature(function).bind(*positional, **named)
    except TypeError as exc:
        raise ScriptError(f"{name}: {exc}") from None
    try:
        result = function(*positional, **named)
        if inspect.isgenerator(result):
            result = yield from result
    except (ValueError, OverflowError, TypeError) as exc:
        raise ScriptError(f"{name}: {exc}") from None
    value: Value = result
    return value


def _names(expression: ast.expr) -> list[tuple[ast.Name, bool]]:
    """Every name in an expression, and whether it is called."""
    called = [n.func for n in ast.walk(expression) if isinstance(n, ast.Call)]
    literals = [
        n.value
        for n in ast.walk(expression)
        if isinstance(n, ast.Subscript) and isinstance(n.slice, ast.Tuple)
    ]
    return [
        (n, any(n is f for f in called))
        for n in ast.walk(expression)
        if isinstance(n, ast.Name) and not (n.id == "p" and any(n is x for x in literals))
    ]


def _indexed(whole: Value, place: Value) -> tuple[list[Value], int]:
    """The items of a list or pose, and an index that is in it."""
    items: list[Value] = list(whole.values) if isinstance(whole, Pose) else whole  # type: ignore[assignment]
    if not isinstance(items, list):
        raise ScriptError("only lists and poses have items")
    if not is_number(place) or not 0 <= _plain_number(place) < len(items):
        raise ScriptError(f"there is no item {place} of {len(items)}")
    return items.copy(), int(_plain_number(place))


def _plain_number(value: Value) -> float:
    if not is_number(value):
        raise ScriptError(f"a number was expected, not {value!r}")
    return value  # type: ignore[return-value]


def _signed(op: ast.unaryop, value: Value) -> Value:
    if isinstance(op, ast.USub | ast.UAdd):
        return -_plain_number(value) if isinstance(op, ast.USub) else _plain_number(value)
    raise ScriptError("the twin knows only 'not' and a sign before a value")


def _computed(op: ast.operator, a: Value, b: Value) -> Value:
    function = _BINARY.get(type(op))
    if function is None:
        raise ScriptError("the twin knows + - * / and % only")
    try:
        result = function(_plain_number(a), _plain_number(b))
    except ZeroDivisionError:
        raise ScriptError("division by zero") from None
    if isinstance(result, int) and not -(2**31) <= result < 2**31:
        raise ScriptError(f"{result} is no integer of 32 bits")
    return result


def _compared(op: ast.cmpop, a: Value, b: Value) -> Value:
    if isinstance(op, ast.Eq | ast.NotEq):
        return (a == b) is isinstance(op, ast.Eq)
    function = _ORDER.get(type(op))
    if function is None:
        raise ScriptError("the twin knows == != < <= > and >= only")
    return function(_plain_number(a), _plain_number(b))
