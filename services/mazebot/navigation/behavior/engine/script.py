"""The scripts of BehaviorTree.CPP 4: assignments and conditions over the blackboard."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from mazebot.navigation.behavior.engine.blackboard import Blackboard

Value = float | str
Term = Callable[[Blackboard], Value]
Comparison = Callable[[Value, Value], bool]

_TOKEN = re.compile(
    r"\s*(?:(?P<number>0[xX][0-9a-fA-F]+|(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
    r"|(?P<text>'[^']*')|(?P<name>[A-Za-z_@][\w@]*)"
    r"|(?P<sign>:=|\+=|-=|\*=|/=|==|!=|<=|>=|&&|\|\||\.\.|[-+*/<>=!~&|^?:();]))"
)
_ASSIGN = {":=", "=", "+=", "-=", "*=", "/="}
_DEEPEST = 50


class ScriptError(ValueError):
    """What is wrong with a script, in one line."""


@dataclass(frozen=True)
class Script:
    """A script that has been read; its value is that of its last statement."""

    statements: tuple[Term, ...]

    def run(self, board: Blackboard) -> Value:
        """Run it. Raises ScriptError where a name has no value, or one of the wrong kind."""
        value: Value = 0.0
        for statement in self.statements:
            value = statement(board)
        return value

    def holds(self, board: Blackboard) -> bool:
        """Run it, and whether its value is true. Raises ScriptError."""
        return _truth(self.run(board))


def read_script(text: object) -> Script:
    """Read a script, `x := 1; y = x > 0 ? 'a' : 'b'`. Raises ScriptError."""
    return _Parser(str(text)).script()


class _Parser:
    """Recursive descent, from the operators that bind least to those that bind most."""

    def __init__(self, text: str) -> None:
        self._tokens: list[tuple[str, str]] = []
        at, end = 0, len(text.rstrip())
        while at < end:
            found = _TOKEN.match(text, at)
            if found is None:
                raise ScriptError(f"cannot be read at {text[at:].strip()!r:.30}")
            kind = str(found.lastgroup)
            self._tokens.append((kind, found[kind]))
            at = found.end()
        self._at = self._depth = 0

    def script(self) -> Script:
        statements = []
        while self._at < len(self._tokens):
            if not self._take(";"):
                statements.append(self._statement())
                if self._at < len(self._tokens) and not self._take(";"):
                    raise self._unexpected()
        if not statements:
            raise ScriptError("is empty")
        return Script(tuple(statements))

    def _statement(self) -> Term:
        kind, name = self._next()
        sign = self._tokens[self._at + 1][1] if self._at + 1 < len(self._tokens) else ""
        if kind != "name" or sign not in _ASSIGN:
            return self._choice()
        self._at += 2
        return partial(_assign, name, sign, self._choice())

    def _choice(self) -> Term:
        condition = self._logical()
        if not self._take("?"):
            return condition
        yes = self._choice()
        self._must(":")
        no = self._choice()
        return lambda board: yes(board) if _truth(condition(board)) else no(board)

    def _logical(self) -> Term:
        left = self._comparison()
        while (sign := self._sign()) in _LOGICAL:
            self._at += 1
            left = partial(_LOGICAL[sign], left, self._comparison())
        return left

    def _comparison(self) -> Term:
        first, others = self._binary(0), []
        while (sign := self._sign()) in _COMPARISONS:
            self._at += 1
            others.append((_COMPARISONS[sign], self._binary(0)))
        return partial(_compared, first, others) if others else first

    def _binary(self, level: int) -> Term:
        if level == len(_LEVELS):
            return self._unary()
        left = self._binary(level + 1)
        while (sign := self._sign()) in _LEVELS[level]:
            self._at += 1
            left = partial(_apply, _LEVELS[level][sign], left, self._binary(level + 1))
        return left

    def _unary(self) -> Term:
        self._depth += 1
        if self._depth > _DEEPEST:
            raise ScriptError(f"is nested more than {_DEEPEST} deep")
        try:
            return self._operand()
        finally:
            self._depth -= 1

    def _operand(self) -> Term:
        if self._take("!"):
            inner = self._unary()
            return lambda board: float(not _truth(inner(board)))
        if self._take("-"):
            inner = self._unary()
            return lambda board: -_number(inner(board))
        if self._take("~"):
            inner = self._unary()
            return lambda board: float(~_integer(inner(board)))
        if self._take("("):
            inside = self._choice()
            self._must(")")
            return inside
        kind, word = self._next()
        if kind not in ("number", "text", "name"):
            raise self._unexpected()
        self._at += 1
        if kind == "name":
            constant = {"true": 1.0, "false": 0.0}.get(word)
            return partial(_read, word) if constant is None else lambda _: constant
        value: Value = word[1:-1]
        if kind == "number":
            value = float(int(word, 16)) if word[:2].lower() == "0x" else float(word)
        return lambda _: value

    def _next(self) -> tuple[str, str]:
        return self._tokens[self._at] if self._at < len(self._tokens) else ("", "")

    def _sign(self) -> str:
        """The next token if it is a sign, else nothing."""
        kind, word = self._next()
        return word if kind == "sign" else ""

    def _take(self, sign: str) -> bool:
        found = self._next() == ("sign", sign)
        self._at += found
        return found

    def _must(self, sign: str) -> None:
        if not self._take(sign):
            raise ScriptError(f"must have {sign!r} {self._where()}")

    def _unexpected(self) -> ScriptError:
        return ScriptError(f"cannot be read {self._where()}")

    def _where(self) -> str:
        word = self._next()[1]
        return f"at {word!r:.30}" if word else "at its end"


def _read(name: str, board: Blackboard) -> Value:
    value = board.get(name)
    if value is None:
        raise ScriptError(f"{name!r:.60} is not on the blackboard")
    if isinstance(value, int | float):
        return float(value)
    if isinstance(value, str):
        return value
    raise ScriptError(f"{name!r:.60} is neither a number nor a text")


def _assign(name: str, sign: str, term: Term, board: Blackboard) -> Value:
    value = term(board)
    if sign == "=" and name not in board:
        raise ScriptError(f"{name!r:.60} is not on the blackboard: must be given by := first")
    if sign not in (":=", "="):
        value = _SUMS[sign[0]](_read(name, board), value)
    board.set(name, value)
    return value


def _apply(work: Callable[[Value, Value], Value], left: Term, right: Term, board: Blackboard,
           ) -> Value:  # fmt: skip
    return work(left(board), right(board))


def _either(left: Term, right: Term, board: Blackboard) -> Value:
    return float(_truth(left(board)) or _truth(right(board)))


def _both(left: Term, right: Term, board: Blackboard) -> Value:
    return float(_truth(left(board)) and _truth(right(board)))


def _number(value: Value) -> float:
    try:
        return float(value)
    except ValueError:
        raise ScriptError(f"{value!r:.40} is no number") from None


def _integer(value: Value) -> int:
    number = _number(value)
    if not number.is_integer():
        raise ScriptError(f"{number:g} is no integer")
    return int(number)


def _truth(value: Value) -> bool:
    if isinstance(value, str) and value.lower() in ("true", "false"):
        return value.lower() == "true"
    return _number(value) != 0.0


def _divide(left: Value, right: Value) -> Value:
    if _number(right) == 0.0:
        raise ScriptError("divides by 0")
    return _number(left) / _number(right)


def _compared(first: Term, others: Sequence[tuple[Comparison, Term]], board: Blackboard) -> Value:
    """Whether each comparison of neighbours holds, as in `0 < x < 5`."""
    left = first(board)
    for compare, term in others:
        right = term(board)
        if not compare(left, right):
            return 0.0
        left = right
    return 1.0


def _same(left: Value, right: Value) -> bool:
    if isinstance(left, str) and isinstance(right, str):
        return left == right
    try:
        one, other = _number(left), _number(right)
    except ScriptError:
        return False
    return one == other or abs(one - other) <= _SAME


def _ordered(compare: Callable[[Any, Any], bool]) -> Comparison:
    def work(left: Value, right: Value) -> bool:
        if isinstance(left, str) and isinstance(right, str):
            return compare(left, right)
        return compare(_number(left), _number(right))

    return work


def _sum(left: Value, right: Value) -> Value:
    if isinstance(left, str) and isinstance(right, str):
        return left + right
    return _number(left) + _number(right)


def _numbers(work: Callable[[float, float], float]) -> Callable[[Value, Value], Value]:
    return lambda left, right: work(_number(left), _number(right))


def _bits(work: Callable[[int, int], int]) -> Callable[[Value, Value], Value]:
    return lambda left, right: float(work(_integer(left), _integer(right)))


def as_text(value: object) -> str:
    """A value as a text; a whole number without its point."""
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return str(value)


_SUMS: Mapping[str, Callable[[Value, Value], Value]] = {
    "+": _sum,
    "-": _numbers(operator.sub),
    "*": _numbers(operator.mul),
    "/": _divide,
}
_SAME = 1.0 / (1 << 23)
"""Numbers that differ by no more are equal: float's epsilon, as in BehaviorTree.CPP."""
_COMPARISONS: Mapping[str, Comparison] = {
    "==": _same,
    "!=": lambda left, right: not _same(left, right),
    "<=": _ordered(operator.le),
    ">=": _ordered(operator.ge),
    "<": _ordered(operator.lt),
    ">": _ordered(operator.gt),
}
_LOGICAL = {"||": _either, "&&": _both}
"""On one level, from left to right, as in BehaviorTree.CPP."""
_LEVELS: tuple[Mapping[str, Callable[[Value, Value], Value]], ...] = (
    {"|": _bits(operator.or_), "^": _bits(operator.xor), "&": _bits(operator.and_)},
    {"..": lambda left, right: as_text(left) + as_text(right)},
    {sign: _SUMS[sign] for sign in "+-"},
    {sign: _SUMS[sign] for sign in "*/"},
)
"""Operators that bind more than a comparison, those that bind least first."""
