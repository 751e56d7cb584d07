"""Prints docs/api.md: what a program imports, from the code and its docstrings."""

from __future__ import annotations

import ast
import dataclasses
import enum
import inspect
import itertools
import re
import sys
from collections.abc import Iterator
from types import ModuleType
from typing import ForwardRef

from pydantic import BaseModel

import mazebot
from mazebot import plugins
from mazebot.common.messages import messages

_HEAD = """# Python API

Generated from the docstrings by `make generate`; do not edit.

```python
from mazebot import Session, topics

with Session("original", seed=7, camera=False) as session:
    result = session.goal(0.5, -0.9)
    print("error code", result.error_code, "at", session.ground_truth())
    print("ahead:", session.latest(topics.SCAN).ranges[0], "m")
```

Everything below is typed (`py.typed`), and each name is loaded when it is first used. What is not
here may change from one version to the next. Longer texts: [a session of your
own](own-controller.md), [`Navigator`](navigator.md),
[controllers](controllers.md#a-controller-of-your-own),
[planners](planning.md#a-planner-of-your-own), [behaviour tree
nodes](behavior-trees.md#writing-a-node), [topics](topics.md).
"""

_MODULES_TEXT = """## `from mazebot import topics, messages, documents`

| module | what it holds |
| --- | --- |
| `topics` | a constant for each row of [topics.md](topics.md), such as `topics.SCAN`: what \
`latest`, `watching` and `put` take |
| `messages` | the ROS 2 message types, as dataclasses with ROS's field names: {names} |
| `documents` | the messages and queries of our own, as pydantic models |
"""
_STARS: dict[object, str] = {
    inspect.Parameter.VAR_POSITIONAL: "*",
    inspect.Parameter.VAR_KEYWORD: "**",
}
_ARGUMENT = re.compile(r"    (\w+): (.*)")


def api_page() -> str:
    """Return the text of the page."""
    names = [name for name in mazebot.__all__ if not inspect.ismodule(getattr(mazebot, name))]
    own = [name for name in plugins.__all__ if name not in names]
    messages_told = ", ".join(f"`{name}`" for name in _message_types())
    parts = [
        _HEAD,
        "## `from mazebot import ...`",
        *(_entry(mazebot, name) for name in names),
        _MODULES_TEXT.format(names=messages_told),
        "## `from mazebot.plugins import ...`",
        "Beside `Controller` and `GlobalPlanner`, which are here too:",
        *(_entry(plugins, name) for name in own),
    ]
    return "\n\n".join(part.strip() for part in parts) + "\n"


def _message_types() -> list[str]:
    return sorted(
        name
        for name, value in vars(messages).items()
        if inspect.isclass(value) and hasattr(value, "__msgtype__")
    )


def _entry(module: ModuleType, name: str) -> str:
    """A class or function: its signature, its docstring, and a table of its members."""
    found = getattr(module, name)
    lines = [f"### `{name}`", f"```py\n{_signature(name, found)}\n```", _text(found)]
    if inspect.isclass(found) and not issubclass(found, Exception):
        if issubclass(found, enum.Enum):
            lines.append(", ".join(_value(member) for member in found))
        rows = [*_fields(found), *_members(found)]
        if rows:
            lines.append("| member | what |\n| --- | --- |\n" + "\n".join(rows))
        constructor = vars(found).get("__init__")
        if constructor is not None and constructor.__doc__:
            lines.insert(3, _text(constructor))
    return "\n\n".join(line for line in lines if line)


def _signature(name: str, found: object) -> str:
    """A name with its parameters, annotated as in the code; of a protocol or a model no more than
    the name.
    """
    shown = not inspect.isclass(found) or "__init__" in vars(found) or issubclass(found, tuple)
    if inspect.isclass(found) and (
        not shown
        or issubclass(found, BaseModel | enum.Enum)
        or getattr(found, "_is_protocol", False)
    ):
        return f"class {name}"
    kind = "class " if inspect.isclass(found) else ""
    return f"{kind}{name}{_parameters(found, 100 - len(kind) - len(name))}"


def _parameters(found: object, width: int) -> str:
    """The parameters in brackets, over several lines where they do not fit."""
    assert callable(found)
    signature = inspect.signature(found)
    words: list[str] = []
    star = False
    for parameter in signature.parameters.values():
        if parameter.name == "self":
            continue
        if parameter.kind is parameter.KEYWORD_ONLY and not star:
            words.append("*")
        star = star or parameter.kind in (parameter.KEYWORD_ONLY, parameter.VAR_POSITIONAL)
        word = _STARS.get(parameter.kind, "") + parameter.name
        if parameter.annotation is not parameter.empty:
            word += f": {_type(parameter.annotation)}"
        if parameter.default is not parameter.empty:
            word += f" = {_default(parameter.default)}"
        words.append(word)
    returned = signature.return_annotation
    back = "" if returned in (signature.empty, None, "None") else f" -> {_type(returned)}"
    line = f"({', '.join(words)}){back}"
    if len(line) <= width:
        return line
    return "(\n" + "".join(f"    {word},\n" for word in words) + f"){back}"


def _type(annotation: object) -> str:
    if isinstance(annotation, ForwardRef):
        return annotation.__forward_arg__
    return annotation if isinstance(annotation, str) else getattr(annotation, "__name__", "")


def _default(value: object) -> str:
    """A default as it is written, without addresses and folders of this machine."""
    text = repr(value)
    return "..." if " at 0x" in text or dataclasses.is_dataclass(value) else text


def _text(found: object) -> str:
    """A docstring as Markdown: its examples as code, its arguments as a list."""
    lines: list[str] = []
    code = arguments = False
    for line in (inspect.getdoc(found) or "").splitlines():
        if line == "Args:":
            arguments = True
            continue
        indented = line.startswith("    ")
        if arguments and indented:
            match = _ARGUMENT.match(line)
            lines.append(f"- `{match[1]}`: {match[2]}" if match else f"  {line.strip()}")
            continue
        arguments = arguments and not line
        if indented and not code:
            lines.append("```py")
        if code and not indented and line:
            lines.insert(len(lines) - (lines[-1] == ""), "```")
        code = indented or (code and not line)
        lines.append(line.removeprefix("    ") if code else line)
    if code:
        lines.append("```")
    return "\n".join(lines)


def _fields(found: type) -> Iterator[str]:
    """Rows of the fields of a model or a dataclass that are described."""
    if issubclass(found, BaseModel):
        for name, field in found.model_fields.items():
            yield f"| `{name}` | {field.description or ''} |"
    elif dataclasses.is_dataclass(found):
        yield from (f"| `{name}` | {what} |" for name, what in _described(found))


def _value(member: enum.Enum) -> str:
    number = f" {member.value}" if isinstance(member.value, int) else ""
    return f"`{member.name}`{number}"


def _described(found: type) -> Iterator[tuple[str, str]]:
    """The attributes of a class that a string below describes."""
    (definition,) = ast.parse(inspect.getsource(found)).body
    assert isinstance(definition, ast.ClassDef)
    for field, text in itertools.pairwise(definition.body):
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
            if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
                yield field.target.id, " ".join(str(text.value.value).split())


def _members(found: type) -> Iterator[str]:
    """Rows of the public methods and properties that the class itself defines."""
    for name, member in vars(found).items():
        plain = member.__func__ if isinstance(member, classmethod | staticmethod) else member
        if name.startswith("_") or not (inspect.isfunction(plain) or isinstance(plain, property)):
            continue
        if dataclasses.is_dataclass(found) and not inspect.getdoc(plain):
            continue
        said = inspect.getdoc(plain) or ""
        first = " ".join(said.partition("\n\n")[0].split()).replace("|", "\\|")
        call = "" if isinstance(plain, property) else _call(plain)
        yield f"| `{name}{call}` | {first} |"


def _call(function: object) -> str:
    """The parameters' names with their defaults, in brackets."""
    assert callable(function)
    words = []
    for parameter in inspect.signature(function).parameters.values():
        if parameter.name in ("self", "cls"):
            continue
        default = "" if parameter.default is parameter.empty else f"={_default(parameter.default)}"
        words.append(f"{parameter.name}{default}")
    return f"({', '.join(words)})"


if __name__ == "__main__":
    sys.stdout.write(api_page())
