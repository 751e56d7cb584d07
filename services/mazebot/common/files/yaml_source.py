"""Reads YAML strictly, with the line of every value.

1e-3 is a number, a duplicate key an error, aliases are refused; size and depth are limited.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from mazebot.common.files.bounded_yaml import ERRORS, BoundedLoader, error_at
from mazebot.common.files.limits import MAX_NUMBER_CHARACTERS, MAX_TEXT_BYTES
from mazebot.common.files.reading import NotReadableError, read_limited
from mazebot.common.files.yaml_words import line_and_words
from mazebot.common.problems import Location, Problem, WorldError, shown_value, words


@dataclass(frozen=True)
class Source:
    """The content of a file, and the lines of its values."""

    file: str
    """As displayed."""
    content: Mapping[Any, Any]
    _root: yaml.Node | None = dataclasses.field(default=None, repr=False)

    def depth_of(self, location: Location) -> int:
        """How many steps of a location exist in the file."""
        here: Any = self.content
        for depth, part in enumerate(location):
            try:
                here = here[part]
            except (LookupError, TypeError):
                return depth
        return len(location)

    def line_of(self, location: Location) -> int:
        """From 1, of a location or of its longest prefix in the file; 0: unknown."""
        node, line = self._root, 0
        for part in location:
            if isinstance(node, yaml.MappingNode):
                found = [pair for pair in node.value if _is_key(pair[0], part)]
                if not found:
                    break
                key, node = found[-1]
                line = key.start_mark.line + 1
            elif isinstance(node, yaml.SequenceNode) and isinstance(part, int):
                if not 0 <= part < len(node.value):
                    break
                node = node.value[part]
                line = node.start_mark.line + 1
            else:
                break
        return line


def read_source(path: Path, shown: str) -> Source:
    """Read a YAML file that contains a mapping.

    Raises WorldError with one problem if it is invalid.
    """
    try:
        data = read_limited(path, MAX_TEXT_BYTES)
    except NotReadableError as error:
        raise _problem(shown, str(error)) from error
    except OSError as error:
        raise _problem(shown, f"cannot be read: {error.strerror}") from error
    root, content = _load(data, shown)
    must = "must be a mapping of fields to values"
    if content is None:
        raise _problem(shown, must, 1, value="is empty")
    if not isinstance(content, dict):
        raise _problem(shown, must, 1, value=shown_value(content))
    return Source(shown, content, root)


def parse_value(text: str, shown: str) -> Any:
    """A value, as parsed in a recipe. Raises WorldError."""
    return _load(text.encode(errors="replace"), shown)[1]


class _Loader(BoundedLoader):
    """Of recipes: without aliases and duplicate keys."""

    max_string = MAX_NUMBER_CHARACTERS

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """As the base's; an alias is an error."""
        event: Any = self.peek_event()
        if isinstance(event, yaml.AliasEvent):
            raise error_at("an alias (*name): must be written out", event)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    raise error_at(f"key {key.value!r:.60} is a duplicate", key)
                seen.add(key.value)
        return super().construct_mapping(node, deep)


def _construct_tuple(loader: _Loader, node: yaml.Node) -> tuple[Any, ...]:
    if not isinstance(node, yaml.SequenceNode):
        raise error_at("must be a list", node)
    return tuple(loader.construct_sequence(node, deep=True))


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"),
    list("-+0123456789"),
)
# Strict validation accepts only tuples for tuples, not lists.
_Loader.add_constructor("tag:yaml.org,2002:seq", _construct_tuple)


def _load(data: bytes, shown: str) -> tuple[yaml.Node | None, Any]:
    """The node tree, and its value. Raises WorldError."""
    try:
        loader = _Loader(data.decode("utf-8-sig"))
        root = loader.get_single_node()
        return root, None if root is None else loader.construct_document(root)
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise _problem(shown, "must be UTF-8", line, "not YAML") from error
    except ERRORS as error:
        line, reason = line_and_words(error)
        raise _problem(shown, words(reason), line, "not YAML") from error


def _problem(shown: str, must: str, line: int = 0, field: str = "", value: str = "") -> WorldError:
    return WorldError([Problem(file=shown, line=line, field=field, value=value, must=must)])


def _is_key(node: yaml.Node, part: str | int) -> bool:
    return isinstance(node, yaml.ScalarNode) and node.value == str(part)
