"""Reads a YAML file of ROS 2 parameters into leaves, each with its line."""

from __future__ import annotations

import dataclasses
import itertools
import sys
from collections.abc import Iterator
from dataclasses import dataclass

import yaml

from mazebot.common.config import ConfigError
from mazebot.common.files import bounded_yaml
from mazebot.common.nav2_params.parameter import Value

_PARAMETERS = "ros__parameters"
_WILDCARDS = ("*", "**")
_MOST_LEAVES = 20_000
_DEEPEST = 40
_DEEPEST_LIST = 4
_MERGE = "tag:yaml.org,2002:merge"


@dataclass(frozen=True)
class Leaf:
    """A parameter of a file."""

    node: str
    """The node's own name, without its namespace: `local_costmap` of the doubled costmap nodes.
    Where that is a wildcard, the whole name: `/**`, `/robot1/*`."""
    name: str
    """Below the node, parts with dots between them."""
    value: Value
    line: int
    """From 1."""
    repeated: str = ""
    """Where it stands below a key that is repeated and not the last of these: a note of it."""
    namespace: str = ""
    """That of the node, `/robot1`; of the doubled costmap nodes the one of both."""


def read_leaves(text: str, name: str) -> tuple[list[Leaf], list[Leaf]]:
    """The leaves of a file in its order, and those that a later one of the same name replaces.

    Anchors, aliases and merge keys are resolved; a name with dots is the same as nested names.
    A list is a leaf. `name` is the file's, for errors.

    Raises ConfigError in one line where it is not YAML, or not of the form
    `NODE: {ros__parameters: {...}}`.
    """
    try:
        root = bounded_yaml.compose(text)
    except bounded_yaml.ERRORS as error:
        raise bounded_yaml.not_yaml(name, error) from error
    if root is None:
        raise ConfigError(f"{name}: is empty: must contain NODE: {{{_PARAMETERS}: {{...}}}}")
    last: dict[tuple[str, str], Leaf] = {}
    replaced = []
    try:
        found = list(itertools.islice(_nodes(root, "", name, 0), _MOST_LEAVES + 1))
    except RecursionError as error:
        raise ConfigError(f"{name}: `<<` must not refer to its own mapping") from error
    if len(found) > _MOST_LEAVES:
        raise ConfigError(f"{name}: must contain at most {_MOST_LEAVES} parameters")
    for leaf in found:
        # A later one takes the earlier one's place, as in ROS 2.
        before = last.get((leaf.node, leaf.name))
        if before is not None:
            replaced.append(before)
        last[leaf.node, leaf.name] = leaf
    return list(last.values()), replaced


def is_pattern(node: str) -> bool:
    """Whether the node of a leaf is a name with wildcards."""
    return node.startswith("/")


def _nodes(node: yaml.Node, path: str, name: str, depth: int, repeated: str = "") -> Iterator[Leaf]:
    """The leaves of all nodes below namespaces."""
    if not isinstance(node, yaml.MappingNode) or depth > _DEEPEST:
        line = node.start_mark.line + 1
        where = f"{path.lstrip('/')}: " if path else ""
        reason = f"must be a mapping that contains {_PARAMETERS}"
        raise ConfigError(f"{name}:{line}: {where}{reason}")
    for key, value, again in _noted_pairs(node, name, repeated):
        if key == _PARAMETERS:
            if not path:
                reason = "must be below the name of a node"
                raise ConfigError(f"{name}:{value.start_mark.line + 1}: {_PARAMETERS}: {reason}")
            own = path.rpartition("/")[2]
            owner = path if own in _WILDCARDS else own
            namespace = path.removesuffix(f"/{own}").removesuffix(f"/{own}")
            if not isinstance(value, yaml.MappingNode):
                if _is_nothing(value):
                    continue
                line = value.start_mark.line + 1
                reason = f"{_PARAMETERS}: must be a mapping of names to values"
                raise ConfigError(f"{name}:{line}: {path.lstrip('/')}: {reason}")
            for leaf in _leaves(value, owner, "", name, depth + 1, again):
                yield dataclasses.replace(leaf, namespace=namespace)
        elif _is_nothing(value):
            continue
        else:
            yield from _nodes(value, f"{path}/{key.strip('/')}", name, depth + 1, again)


def _leaves(
    node: yaml.MappingNode, owner: str, prefix: str, name: str, depth: int, repeated: str
) -> Iterator[Leaf]:
    if depth > _DEEPEST:
        reason = f"must be nested at most {_DEEPEST} deep"
        raise ConfigError(f"{name}:{node.start_mark.line + 1}: {owner}.{prefix}: {reason}")
    for key, value, again in _noted_pairs(node, name, repeated):
        if isinstance(value, yaml.MappingNode):
            yield from _leaves(value, owner, f"{prefix}{key}.", name, depth + 1, again)
            continue
        yield Leaf(owner, f"{prefix}{key}", _plain(value), value.start_mark.line + 1, repeated)


def _noted_pairs(
    node: yaml.MappingNode, name: str, repeated: str
) -> Iterator[tuple[str, yaml.Node, str]]:
    """The keys and values of a mapping, each with a note where the key is repeated later."""
    # Of merge keys the mapping's own ones are no repetition.
    lines: dict[str, int] = {}
    for key, value in node.value:
        if isinstance(key, yaml.ScalarNode) and isinstance(value, yaml.MappingNode):
            lines[key.value] = key.start_mark.line + 1
    own = {id(value): key.start_mark.line + 1 for key, value in node.value}
    for key, value in _pairs(node, name):
        note = repeated
        if own.get(id(value), sys.maxsize) < lines.get(key, 0):
            note = (
                f"{key} is repeated in line {lines[key]}: both are read, as ROS 2 does; Nav2's "
                "launch files keep the last one alone"
            )
        yield key, value, note


def _pairs(node: yaml.MappingNode, name: str) -> Iterator[tuple[str, yaml.Node]]:
    """The keys and values of a mapping, those of merge keys first."""
    own = []
    for key, value in node.value:
        if key.tag == _MERGE:
            for merged in value.value if isinstance(value, yaml.SequenceNode) else [value]:
                if not isinstance(merged, yaml.MappingNode) or merged is node:
                    line = key.start_mark.line + 1
                    raise ConfigError(f"{name}:{line}: <<: must be followed by a mapping")
                yield from _pairs(merged, name)
        elif isinstance(key, yaml.ScalarNode):
            own.append((str(key.value), value))
        else:
            line = key.start_mark.line + 1
            raise ConfigError(f"{name}:{line}: a name must be a string, not a list or mapping")
    yield from own


def _is_nothing(node: yaml.Node) -> bool:
    """Whether there is no value, such as where all lines below are comments."""
    return isinstance(node, yaml.ScalarNode) and _plain(node) in {None, ""}


def _plain(node: yaml.Node, depth: int = 0) -> Value:
    """A scalar or a list as Python has it. Values of another kind, such as dates, stay texts."""
    if isinstance(node, yaml.SequenceNode):
        # An alias may stand within its own list.
        return [_plain(one, depth + 1) for one in node.value] if depth < _DEEPEST_LIST else None
    if not isinstance(node, yaml.ScalarNode):
        return None
    try:
        value = yaml.constructor.SafeConstructor().construct_object(node)
    except (yaml.YAMLError, ValueError):
        return str(node.value)
    return value if isinstance(value, bool | int | float | str) or value is None else node.value
