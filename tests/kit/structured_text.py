"""Structured Text (IEC 61131-3) run as a PLC runs it: read by blark's grammar, a call a cycle.

Only what the shipped function blocks use: assignments, IF, CASE, calls of function blocks and of the
standard's conversions. Types are kept: a value that its variable cannot hold, a BOOL where a number belongs,
and an array index outside its bounds are errors, as a PLC's compiler or its runtime would have them.
"""

from collections.abc import Callable
from copy import deepcopy
from functools import cache
from typing import Any

import blark.transform as st
from blark.parse import parse_source_code

BITS = {"WORD": 16, "UINT": 16, "DWORD": 32, "UDINT": 32}
LIMITS = {name: (0, 2**bits - 1) for name, bits in BITS.items()} | {"INT": (-(2**15), 2**15 - 1)}
OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
    "+": lambda a, b: a + b, "-": lambda a, b: a - b, "*": lambda a, b: a * b, "/": lambda a, b: a // b,
    "MOD": lambda a, b: a % b, "=": lambda a, b: a == b, "<>": lambda a, b: a != b, "<": lambda a, b: a < b,
    ">": lambda a, b: a > b, "<=": lambda a, b: a <= b, ">=": lambda a, b: a >= b,
}  # fmt: skip


class Timer:
    """TON: Q when IN has been true for PT."""

    def __init__(self) -> None:
        self.values: dict[str, Any] = {"IN": False, "PT": 0.0, "Q": False}
        self._since: float | None = None

    def cycle(self, now: float) -> None:
        """One call at the time ``now``, s."""
        if not self.values["IN"]:
            self._since = None
        elif self._since is None:
            self._since = now
        self.values["Q"] = self._since is not None and now - self._since >= self.values["PT"]


class Block:
    """An instance of a function block: ``values`` of its variables, and a call a cycle."""

    def __init__(self, blocks: dict[str, st.FunctionBlock], name: str) -> None:
        self._body = blocks[name].body
        self.values: dict[str, Any] = {}
        self._types: dict[str, str] = {}
        for declaration in (d for group in blocks[name].declarations for d in group.items):
            for declared in declaration.variables:
                self._declare(blocks, str(declared.variable.name), declaration.init)

    def cycle(self, now: float) -> None:
        """One call at the time ``now``, s."""
        self._now = now
        self._run(self._body)

    def set(self, name: str, value: Any) -> None:
        """Give an input or a variable its value."""
        self.values[name] = (
            [self._fit(self._types[name], v) for v in value]
            if isinstance(value, list)
            else self._fit(self._types[name], value)
        )

    def _declare(self, blocks: dict[str, st.FunctionBlock], name: str, init: Any) -> None:
        if isinstance(init, st.ArrayTypeInitialization):
            (bounds,) = init.spec.subranges
            self._types[name] = str(init.spec.type.type_name)
            assert self._value(bounds.start) == 0
            self.values[name] = [0] * (self._value(bounds.stop) + 1)
            return
        kind = str(init.spec.type)
        self._types[name] = kind
        if kind == "TON":
            self.values[name] = Timer()
        elif kind in blocks:
            self.values[name] = Block(blocks, kind)
        else:
            start: Any = {"BOOL": False, "TIME": 0.0}.get(kind, 0)
            self.set(name, start if init.value is None else self._value(init.value))

    @staticmethod
    def _fit(kind: str, value: Any) -> Any:
        if kind == "BOOL":
            assert isinstance(value, bool), f"{value!r} is no BOOL"
        elif kind == "TIME":
            assert isinstance(value, float), f"{value!r} is no TIME"
        elif kind in LIMITS:
            low, high = LIMITS[kind]
            assert not isinstance(value, bool), f"a BOOL is no {kind}"
            assert low <= value <= high, f"{value} does not fit in {kind}"
        return value

    def _run(self, statements: st.StatementList | None) -> None:
        for statement in statements.statements if statements else ():
            match statement:
                case st.AssignmentStatement(variables=(target,), expression=expression):
                    self._assign(target, self._value(expression))
                case st.IfStatement():
                    self._run(self._branch(statement))
                case st.CaseStatement():
                    self._run(self._case(statement))
                case st.FunctionCallStatement():
                    self._call(statement)
                case _:
                    raise TypeError(f"not understood: {statement}")

    def _branch(self, statement: st.IfStatement) -> st.StatementList | None:
        for test, statements in (
            (statement.if_expression, statement.statements),
            *((other.if_expression, other.statements) for other in statement.else_ifs),
        ):
            if self._fit("BOOL", self._value(test)):
                return statements
        return statement.else_clause.statements if statement.else_clause else None

    def _case(self, statement: st.CaseStatement) -> st.StatementList | None:
        value = self._value(statement.expression)
        for case in statement.cases:
            if value in [self._value(match) for match in case.matches]:
                return case.statements
        return statement.else_clause.statements if statement.else_clause else None

    def _call(self, statement: st.FunctionCallStatement) -> None:
        called = self.values[str(statement.name.name)]
        for given in statement.parameters:
            name, value = str(given.name.name), self._value(given.value)
            if isinstance(called, Block):
                called.set(name, deepcopy(value))
            else:
                assert name in called.values
                called.values[name] = value
        called.cycle(self._now)

    def _assign(self, target: Any, value: Any) -> None:
        if isinstance(target, st.MultiElementVariable):
            (index,) = target.elements
            array = self.values[str(target.name.name)]
            array[self._index(index, array)] = self._fit(self._types[str(target.name.name)], value)
        else:
            assert str(target.name) in self._types, f"{target.name} is not declared"
            self.set(str(target.name), deepcopy(value))

    def _index(self, subscripts: st.SubscriptList, array: list[int]) -> int:
        (subscript,) = subscripts.subscripts
        index: int = self._value(subscript)
        assert 0 <= index < len(array), f"index {index} is outside the array"
        return index

    def _value(self, node: Any) -> Any:
        match node:
            case st.Boolean():
                return str(node.value).upper() == "TRUE"
            case st.HexInteger():
                return int(str(node.value).replace("_", ""), 16)
            case st.Integer():
                return int(str(node.value))
            case st.Duration():
                return (
                    60.0 * float(node.minutes or 0)
                    + float(node.seconds or 0)
                    + 1e-3 * float(node.milliseconds or 0)
                )
            case st.ParenthesizedExpression():
                return self._value(node.expr)
            case st.UnaryOperation():
                assert str(node.op).upper() == "NOT"
                return not self._fit("BOOL", self._value(node.expr))
            case st.BinaryOperation():
                return self._operation(str(node.op).upper(), self._value(node.left), self._value(node.right))
            case st.FunctionCall():
                return self._function(str(node.name.name), [self._value(p.value) for p in node.parameters])
            case st.MultiElementVariable(elements=(st.FieldSelector(field=field),)):
                return self.values[str(node.name.name)].values[str(field.name)]
            case st.MultiElementVariable(elements=(subscripts,)):
                array = self.values[str(node.name.name)]
                return array[self._index(subscripts, array)]
            case st.SimpleVariable():
                return self.values[str(node.name)]
            case _:
                raise TypeError(f"not understood: {node}")

    @staticmethod
    def _operation(op: str, left: Any, right: Any) -> Any:
        assert isinstance(left, bool) == isinstance(right, bool), f"{left!r} {op} {right!r}"
        if op in ("AND", "OR"):  # of BOOLs and of bit strings alike
            return left & right if op == "AND" else left | right
        return OPERATORS[op](left, right)

    @staticmethod
    def _function(name: str, arguments: list[Any]) -> Any:
        if name == "SHR":
            return arguments[0] >> arguments[1]
        source, to, target = name.partition("_TO_")
        assert to, f"{name} is no conversion of the standard"
        assert source in BITS, f"{name} is not one of the conversions that are used"
        (value,) = arguments
        return value % 2 ** BITS[target]


def function_block(text: str, name: str) -> Block:
    """A fresh instance of the function block ``name`` of the source ``text``."""
    return Block(read_blocks(text), name)


@cache  # the grammar takes seconds
def read_blocks(text: str) -> dict[str, st.FunctionBlock]:
    """The function blocks of ``text`` by their names, in the text's order."""
    return {str(item.name): item for item in parse_source_code(text).transform().items}
