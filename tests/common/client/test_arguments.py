"""The arguments of public methods are checked by their annotations."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from mazebot.common.client.arguments import checks_arguments
from mazebot.common.config import ConfigError
from mazebot.common.messages.documents import Point2, Positive, Steps
from mazebot.common.messages.topics import SCAN, Topic


@checks_arguments(ConfigError)
class Public:
    def number(self, x_m: float) -> object:
        return x_m

    def endless(self, timeout_s: float = math.inf) -> object:
        return timeout_s

    def positive(self, for_s: Positive | None = None) -> object:
        return for_s

    def integer(self, steps: Steps = 1) -> object:
        return steps

    def truth(self, pause: bool) -> object:
        return pause

    def path(self, file: Path) -> object:
        return file

    def choice(self, scope: Literal["all", "time"]) -> object:
        return scope

    def point(self, at_m: Point2) -> object:
        return at_m

    def names(self, names: Sequence[str]) -> object:
        return names

    def topics(self, topics: Iterable[Topic[Any]], then: Callable[[], object] = list) -> object:
        return topics

    @classmethod
    def made(cls, name: str) -> object:
        return name


@pytest.mark.parametrize(("call", "value"), [
    (lambda on: on.number(np.float32(0.2)), 0.2),
    (lambda on: on.number(np.array(3)), 3.0),
    (lambda on: on.number(2), 2.0),
    (lambda on: on.endless(math.inf), math.inf),
    (lambda on: on.endless(), math.inf),
    (lambda on: on.positive(None), None),
    (lambda on: on.integer(np.int8(3)), 3),
    (lambda on: on.integer(3.0), 3),
    (lambda on: on.truth(np.bool_(False)), False),
    (lambda on: on.path("a"), Path("a")),
    (lambda on: on.point(np.array([1.0, 2.0])), (1.0, 2.0)),
    (lambda on: on.topics([SCAN]), (SCAN,)),
    (lambda on: on.made("a"), "a"),
])  # fmt: skip
def test_what_is_meant_is_taken(call: Callable[[Any], object], value: object) -> None:
    taken = call(Public())
    assert taken == value
    assert type(taken) is type(value)


@pytest.mark.parametrize(("call", "line"), [
    (lambda on: on.number("1"), "x_m: must be a number (got '1')"),
    (lambda on: on.number(x_m=None), "x_m: must be a number (got None)"),
    (lambda on: on.number(True), "x_m: must be a number (got True)"),
    (lambda on: on.number(math.nan), "x_m: must be a finite number (got nan)"),
    (lambda on: on.number(math.inf), "x_m: must be a finite number (got inf)"),
    (lambda on: on.number(np.eye(2)), "x_m: must be a number (got array([[1., 0.], [0., 1.]]))"),
    (lambda on: on.endless(math.nan), "timeout_s: must be a finite number (got nan)"),
    (lambda on: on.endless(-math.inf), "timeout_s: must be a finite number (got -inf)"),
    (lambda on: on.positive(0), "for_s: must be greater than 0 (got 0)"),
    (lambda on: on.integer(2.5), "steps: must be an integer (got 2.5)"),
    (lambda on: on.integer(0), "steps: must be greater than or equal to 1 (got 0)"),
    (lambda on: on.truth("False"), "pause: must be True or False (got 'False')"),
    (lambda on: on.truth(0), "pause: must be True or False (got 0)"),
    (lambda on: on.path(3), "file: must be a path (got 3)"),
    (lambda on: on.choice("x"), "scope: must be one of 'all', 'time' (got 'x')"),
    (lambda on: on.point((1.0,)), "at_m: must be a list of 2 (got (1.0,))"),
    (lambda on: on.point((1.0, "2")), "at_m: must be a number (got (1.0, '2'))"),
    (lambda on: on.names("ab"), "names: must be a list (got 'ab')"),
    (lambda on: on.topics([SCAN], None), "then: must be a function (got None)"),
    (lambda on: on.topics(["/scan"]), "topics: must be a Topic (got ['/scan'])"),
    (lambda on: on.made(3), "name: must be a string (got 3)"),
])  # fmt: skip
def test_what_is_not_is_refused_in_one_line(call: Callable[[Any], object], line: str) -> None:
    with pytest.raises(ConfigError) as refused:
        call(Public())
    assert str(refused.value) == line


def test_python_tells_what_is_missing() -> None:
    on: Any = Public()
    with pytest.raises(TypeError, match="x_m"):
        on.number()
