"""Loads YAML of other people: plain values only, within limits of depth, number and length."""

from __future__ import annotations

from typing import Any

import yaml

from mazebot.common.config import ConfigError
from mazebot.common.files.limits import (
    MAX_NUMBER_CHARACTERS,
    MAX_STRING_CHARACTERS,
    MAX_YAML_DEPTH,
    MAX_YAML_VALUES,
)
from mazebot.common.files.yaml_words import line_and_words

# PyYAML does not catch errors of the types that it converts to.
ERRORS = (
    yaml.YAMLError, ValueError, LookupError, ArithmeticError, TypeError, AttributeError,
    RecursionError,
)  # fmt: skip
"""What loading may raise."""


class BoundedLoader(yaml.composer.Composer, yaml.CSafeLoader):
    """libyaml's scanner under a composer with limits.

    libyaml's own composer overflows the stack on deep nesting.
    """

    max_string = MAX_STRING_CHARACTERS
    may_recur = False
    """Whether a value may contain itself by an alias."""

    def __init__(self, text: str) -> None:
        yaml.CSafeLoader.__init__(self, text)
        yaml.composer.Composer.__init__(self)
        self._values = self._depth = 0
        self._sizes: dict[str, int] = {}
        """Values below each anchor, aliases in it counted in full."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """PyYAML's hook for each value. Raises ComposerError beyond a limit."""
        event: Any = self.peek_event()
        if isinstance(event, yaml.AliasEvent):
            self._count(self._alias(event), event)
            return super().compose_node(parent, index)
        if isinstance(event, yaml.ScalarEvent):
            most = MAX_NUMBER_CHARACTERS if event.implicit[0] else self.max_string
            if len(event.value) > most:
                raise error_at(f"must have values of at most {most} characters", event)
        before = self._values
        self._count(1, event)
        self._depth += 1
        if self._depth > MAX_YAML_DEPTH:
            raise error_at(f"must be at most {MAX_YAML_DEPTH} levels deep", event)
        if event.anchor is not None:
            self._sizes.pop(event.anchor, None)
        node = super().compose_node(parent, index)
        self._depth -= 1
        if event.anchor is not None:
            self._sizes[event.anchor] = self._values - before
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        """PyYAML's hook for each value. Raises YAMLError, with its line, for what is none of its
        type, such as a number with too many digits.
        """
        try:
            return super().construct_object(node, deep)
        except (ValueError, ArithmeticError, LookupError, AttributeError) as error:
            words = " ".join(str(error).split())
            raise error_at(f"an invalid value: {words:.200}", node) from error

    def _alias(self, event: Any) -> int:
        """How many values an alias stands for; libyaml's words for an unknown one come later."""
        within = event.anchor in self.anchors and event.anchor not in self._sizes
        if within and not self.may_recur:
            raise error_at(f"an alias (*{event.anchor:.40}) within its own value", event)
        return self._sizes.get(event.anchor, 1)

    def _count(self, values: int, event: Any) -> None:
        self._values += values
        if self._values > MAX_YAML_VALUES:
            raise error_at(f"must contain at most {MAX_YAML_VALUES} values", event)


def error_at(what: str, event: Any) -> yaml.composer.ComposerError:
    """An error at the place of an event or a node."""
    return yaml.composer.ComposerError(None, None, what, event.start_mark)


def compose(text: str) -> yaml.Node | None:
    """The tree of nodes of a document; by aliases, a node may contain itself. Raises one of
    `ERRORS`.
    """
    loader = BoundedLoader(text)
    loader.may_recur = True
    return loader.get_single_node()


def load(text: str) -> Any:
    """The value of a document, as of yaml.safe_load. Raises one of `ERRORS`."""
    return BoundedLoader(text).get_single_data()


def not_yaml(name: str, error: Exception) -> ConfigError:
    """The line to tell one of `ERRORS`. `name` is the file's."""
    line, reason = line_and_words(error)
    return ConfigError(f"{name}{f':{line}' if line else ''}: not YAML: {reason}")
