"""Behaviour trees from XML in BehaviorTree.CPP's formats 3 and 4, as Nav2's own files have it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import count
from pathlib import Path

from mazebot.common.config import ConfigError
from mazebot.common.files.limits import MAX_TEXT_BYTES, MAX_TREE_ELEMENTS
from mazebot.common.files.reading import NotReadableError, read_limited, reason
from mazebot.navigation.behavior.engine.blackboard import Blackboard
from mazebot.navigation.behavior.engine.ports import READERS, Port
from mazebot.navigation.behavior.engine.tree import (
    AFTER,
    BEFORE,
    BehaviorTree,
    Node,
    NodePlace,
    TreeRun,
    is_key,
)
from mazebot.navigation.behavior.engine.xml_elements import DEEPEST, Element, parse
from mazebot.navigation.behavior.nodes.node_kinds import (
    NODE_KINDS,
    RENAMED_KINDS,
    RENAMED_PORTS,
    UNSUPPORTED,
    checked_node,
    is_own,
    node_class,
)
from mazebot.navigation.own_class import OwnClass

TREES = Path(__file__).parents[1] / "trees"
"""The trees that come with navigation."""
DEFAULT_NAV_TO_POSE = TREES / "navigate_to_pose_w_replanning_and_recovery.xml"
DEFAULT_NAV_THROUGH_POSES = TREES / "navigate_through_poses_w_replanning_and_recovery.xml"

_EXPLICIT = {"Action", "Condition", "Control", "Decorator"}
"""Tags that name their kind in the attribute ID."""
_RESERVED = {"name", "ID", "_description", "_uid", "_fullpath"}
"""Attributes that are no ports; the last ones are Groot's."""
_PORTS = {"input_port", "output_port", "inout_port"}
_SCRIPTS = {*BEFORE, *AFTER}
MAX_TREE_FILES = 100
"""The file of a tree, and all that it includes."""
_SHARED = ("_autoremap", "__autoremap", "__shared_blackboard")
"""Attributes of a SubTree by which all keys are those of the tree above; the last two are those of
format 3."""


@dataclass(frozen=True)
class TreeFile:
    """Trees that have been read and checked."""

    source: str
    main_id: str
    trees: dict[str, Element]
    """Root node of each tree, by its ID."""
    warnings: tuple[str, ...]
    """One line each: what is ignored."""
    unsupported: tuple[str, ...]
    """One line each: nodes that Nav2 has and that do not run here."""

    def kinds(self) -> set[str]:
        """Node kinds used."""
        return {_kind(one) for root in self.trees.values() for one in root.walk()}

    def build(self, run: TreeRun, blackboard: Blackboard | None = None) -> BehaviorTree:
        """A tree that can be ticked. Raises ConfigError where a node is not supported."""
        if self.unsupported:
            raise ConfigError("; ".join(self.unsupported))
        board = blackboard or Blackboard()
        return BehaviorTree(
            self.main_id, _Builder(self, run).tree(self.main_id, board, False), board, run
        )


def read_tree_file(path: Path) -> TreeFile:
    """Read a file, with those that it includes. Raises ConfigError, in one line."""
    return read_tree(_text_of(path, str(path)), str(path), path)


def _text_of(path: Path, at: str) -> bytes:
    """The text of a file, or ConfigError that begins with `at`."""
    try:
        return read_limited(path, MAX_TEXT_BYTES)
    except (OSError, NotReadableError) as error:
        raise ConfigError(f"{at}: {reason(error)}") from None


def read_tree(text: str | bytes, source: str, path: Path | None = None) -> TreeFile:
    """Read and check trees.

    Args:
        text: the XML.
        source: what messages name as its place.
        path: the file that it comes from, whose folder the paths of its `<include>` start at;
            without one, nothing can be included.

    Raises ConfigError, in one line that names the source, its line, the node and the port. Unknown
    ports are warnings; nodes of Nav2 that do not run here are listed as unsupported.
    """
    root = parse(text, source)
    found = _Trees()
    found.add(root, path)
    main = _main_id(root, found.trees)
    found.fill_in_models()
    checker = _Checker(source, found.trees)
    checker.check_kinds()
    for tree in found.trees.values():
        checker.check(tree)
    checker.check_subtrees(main, ())
    warnings = (*found.warnings, *checker.warnings)
    return TreeFile(source, main, found.trees, warnings, tuple(checker.unsupported))


class _Trees:
    """The trees of a file, and of those that it includes."""

    def __init__(self) -> None:
        self.trees: dict[str, Element] = {}
        self.warnings: list[str] = []
        self._files: set[Path] = set()
        self._elements = 0
        self._models: dict[str, dict[str, str]] = {}
        """Of trees that have one: their ports, with the defaults; empty: a port must be given."""

    def fill_in_models(self) -> None:
        """Give each SubTree the defaults of its tree's model, as BehaviorTree.CPP does from 4.6.

        Raises ConfigError where a port has none, and is not given.
        """
        for tree in self.trees.values():
            for element in tree.walk():
                name = element.attributes.get("ID", "")
                if element.tag != "SubTree" or _shares_keys(element):
                    continue
                for port, default in self._models.get(name, {}).items():
                    if not element.attributes.setdefault(port, default):
                        raise ConfigError(
                            f"{element.at}: SubTree {name!r:.60}: port {port!r:.60} is missing: "
                            "its model in <TreeNodesModel> has no default"
                        )

    def _add_models(self, element: Element) -> None:
        for model in element.children:
            if model.tag == "SubTree":
                self._models[model.attributes.get("ID", "")] = {
                    port.attributes["name"]: port.attributes.get("default", "")
                    for port in model.children
                    if port.tag in _PORTS and "name" in port.attributes
                }

    def add(self, root: Element, path: Path | None) -> None:
        """Take the trees of a document. Raises ConfigError."""
        if root.tag != "root":
            raise ConfigError(f"{root.at}: the first element is <{root.tag}>: must be <root>")
        if path is not None:
            self._files.add(path.resolve())
        form = root.attributes.get("BTCPP_format")
        if form in (None, "3"):
            given = "BTCPP_format 3" if form else "no BTCPP_format"
            self.warnings.append(
                f"{root.at}: {given}: read as format 4, but each attribute of a SubTree as a key"
            )
        elif form != "4":
            raise ConfigError(f"{root.at}: BTCPP_format is {form!r:.20}: must be 3 or 4")
        for element in root.walk():
            self._elements += 1
            _of_today(element, form != "4")
        if self._elements > MAX_TREE_ELEMENTS:
            raise ConfigError(
                f"{root.at}: must have at most {MAX_TREE_ELEMENTS} elements, with all that is "
                "included"
            )
        for element in root.children:
            if element.tag == "BehaviorTree":
                self._add_tree(element, root)
            elif element.tag == "include":
                self._include(element, path)
            elif element.tag == "TreeNodesModel":
                if form == "4":
                    self._add_models(element)
            else:
                raise ConfigError(
                    f"{element.at}: <{element.tag}> in <root>: must be <BehaviorTree>"
                )

    def _add_tree(self, element: Element, root: Element) -> None:
        name = element.attributes.get("ID")
        if not name:
            trees = [one for one in root.children if one.tag == "BehaviorTree"]
            if len(trees) > 1 or "main_tree_to_execute" in root.attributes:
                raise ConfigError(f"{element.at}: <BehaviorTree> has no ID")
            name = f"BehaviorTree_{len(self.trees)}"
        if name in self.trees:
            raise ConfigError(f"{element.at}: duplicate tree ID {name!r:.60}")
        if len(element.children) != 1:
            raise ConfigError(
                f"{element.at}: tree {name!r:.60} has {len(element.children)} root nodes: must be "
                "one"
            )
        self.trees[name] = element.children[0]

    def _include(self, element: Element, path: Path | None) -> None:
        at = f"{element.at}: <include>"
        if "ros_pkg" in element.attributes:
            raise ConfigError(f"{at}: ros_pkg: there are no packages here: must be a path alone")
        given = element.attributes.get("path")
        if not given:
            raise ConfigError(f"{at}: path is missing")
        if path is None:
            raise ConfigError(f"{at}: must be in a file: its path starts at the file's folder")
        included = path.parent / given
        if included.resolve() in self._files:
            return
        if len(self._files) >= MAX_TREE_FILES:
            raise ConfigError(f"{at}: a tree must be of at most {MAX_TREE_FILES} files")
        text = _text_of(included, f"{at}: {given!r:.120}")
        self.add(parse(text, str(included)), included)


def _of_today(element: Element, format_3: bool) -> None:
    """Give an element its name in format 4, without the ports that Groot saves as empty texts
    because they are not set.
    """
    for name, text in element.attributes.items():
        if is_key(text):
            element.attributes[name] = text.strip()
    if format_3 and element.tag == "SubTree":
        # There a SubTree's attribute is a key, and only a SubTreePlus has braces for one.
        for name, text in element.attributes.items():
            if name not in _RESERVED and not name.startswith("_") and text and text[0] != "{":
                element.attributes[name] = f"{{{text}}}"
    element.tag = RENAMED_KINDS.get(element.tag, element.tag)
    kind = element.attributes.get("ID", "")
    if element.tag in _EXPLICIT and kind in RENAMED_KINDS:
        element.attributes["ID"] = RENAMED_KINDS[kind]
    for name in [name for name, text in element.attributes.items() if not text]:
        # A value for the blackboard may be empty.
        if (element.tag, name) != ("SetBlackboard", "value") and name != "ID":
            del element.attributes[name]


def _main_id(root: Element, trees: dict[str, Element]) -> str:
    if not trees:
        raise ConfigError(f"{root.at}: no <BehaviorTree> found")
    main = root.attributes.get("main_tree_to_execute")
    if main is None:
        if len(trees) > 1:
            raise ConfigError(
                f"{root.at}: main_tree_to_execute is missing: must be one of "
                f"{', '.join(sorted(trees))}"
            )
        return next(iter(trees))
    if main not in trees:
        raise ConfigError(
            f"{root.at}: main_tree_to_execute is {main!r:.60}: must be one of "
            f"{', '.join(sorted(trees))}"
        )
    return main


def _kind(element: Element) -> str:
    return element.attributes.get("ID", "") if element.tag in _EXPLICIT else element.tag


class _Checker:
    """Checks elements, and collects what is ignored and what does not run."""

    def __init__(self, source: str, trees: dict[str, Element]) -> None:
        self.source = source
        self._trees = trees
        self._sizes: dict[str, int] = {}
        self.warnings: list[str] = []
        self.unsupported: list[str] = []

    def check_kinds(self) -> None:
        """Refuse nodes that are not known, all of them in one line."""
        unknown = []
        for element in (one for root in self._trees.values() for one in root.walk()):
            kind = _kind(element)
            at = f"{element.at}: {kind or element.tag}"
            if element.tag != "SubTree" and kind not in UNSUPPORTED and not self._class(at, kind):
                meant = _meant(kind, [*NODE_KINDS, *UNSUPPORTED])
                unknown.append(f"{at} is not a known node{meant}")
        if unknown:
            raise ConfigError("; ".join(unknown))

    def check(self, element: Element) -> None:
        """Check a node and those below it."""
        kind = _kind(element)
        at = f"{element.at}: {kind or element.tag}"
        for name in _SCRIPTS & set(element.attributes):
            if element.tag == "SubTree":
                raise ConfigError(
                    f"{at}, attribute {name!r}: must be at the first node of the tree instead"
                )
            _check_text(at, Port(name, "script"), element.attributes[name])
        if element.tag == "SubTree":
            self._check_subtree(element)
            return
        if kind in UNSUPPORTED:
            self.unsupported.append(f"{at} is not supported: {UNSUPPORTED[kind]}")
        else:
            node = self._class(at, kind)
            assert node is not None, kind
            self._check_known(at, node, element)
        for child in element.children:
            self.check(child)

    def _class(self, at: str, kind: str) -> type[Node] | None:
        try:
            return node_class(kind)
        except ConfigError as error:
            raise ConfigError(f"{at}: {error}") from error

    def _check_known(self, at: str, node: type[Node], element: Element) -> None:
        found, fewest, most = len(element.children), node.fewest_children, node.most_children
        if found < fewest or (most is not None and found > most):
            wanted = f"{fewest}" if fewest == most else f"at least {fewest}"
            if most is not None and fewest < most:
                wanted = f"{fewest} to {most}"
            raise ConfigError(f"{at} has {found} children: must have {wanted}")
        ports = {port.name: port for port in node.ports}
        given = {RENAMED_PORTS.get(name, name): text for name, text in element.attributes.items()}
        for name, text in given.items():
            if name in ports:
                _check_text(at, ports[name], text)
                if ports[name].no_effect and text not in ports[name].unless:
                    self.warnings.append(
                        f"{at}, port {name!r}: {text!r:.60}: {ports[name].no_effect}"
                    )
            elif name not in _RESERVED | _SCRIPTS:
                self.warnings.append(
                    f"{at}, port {name!r:.60}: ignored: no such port{_meant(name, ports)}"
                )
        for port in ports.values():
            if port.required and port.name not in given:
                raise ConfigError(f"{at}, port {port.name!r}: is missing")

    def _check_subtree(self, element: Element) -> None:
        at = f"{element.at}: SubTree"
        name = element.attributes.get("ID", "")
        if name not in self._trees:
            raise ConfigError(f"{at}: no tree with ID {name!r:.60}{_meant(name, self._trees)}")
        if element.children:
            raise ConfigError(f"{at} {name!r:.60} has children: must have none")

    def check_subtrees(self, name: str, above: tuple[str, ...]) -> int:
        """The number of elements of a tree, each subtree counted wherever it is used.

        Refuses trees that contain themselves, and too many elements.
        """
        if name in self._sizes:
            return self._sizes[name]
        if name in above:
            way = " in ".join((*above[above.index(name) :], name)[::-1])
            raise ConfigError(f"{self.source}: a tree contains itself: {way}")
        if len(above) >= DEEPEST:
            raise ConfigError(f"{self.source}: subtrees are nested more than {DEEPEST} deep")
        size = 0
        for element in self._trees[name].walk():
            size += 1
            if element.tag == "SubTree":
                size += self.check_subtrees(element.attributes["ID"], (*above, name))
        if size > MAX_TREE_ELEMENTS:
            raise ConfigError(
                f"{self.source}: tree {name!r:.60} has {size} elements with its subtrees, must "
                f"have at most {MAX_TREE_ELEMENTS}"
            )
        self._sizes[name] = size
        return size


def _check_text(at: str, port: Port, text: str) -> None:
    if is_key(text):
        return
    if port.output:
        # Nav2 takes an output that is not connected as a name without effect.
        return
    try:
        READERS[port.type](text)
    except ValueError as error:
        raise ConfigError(f"{at}, port {port.name!r}: {error}") from None


def _meant(name: str, known: Iterable[str]) -> str:
    close = difflib.get_close_matches(name, list(known), n=1)
    return f"; did you mean {close[0]}?" if close else ""


class _Builder:
    """Makes nodes of elements, numbered in the order of the text."""

    def __init__(self, file: TreeFile, run: TreeRun) -> None:
        self._file = file
        self._run = run
        self._numbers = count(1)

    def tree(self, name: str, board: Blackboard, in_recovery: bool) -> Node:
        return self._node(self._file.trees[name], board, in_recovery)

    def _node(self, element: Element, board: Blackboard, in_recovery: bool) -> Node:
        if element.tag == "SubTree":
            return self.tree(element.attributes["ID"], _board_below(element, board), in_recovery)
        kind = _kind(element)
        place = NodePlace(
            next(self._numbers),
            kind,
            element.attributes.get("name", kind),
            {
                RENAMED_PORTS.get(key, key): text
                for key, text in element.attributes.items()
                if key not in _RESERVED
            },
            board,
            self._run,
            in_recovery,
            element.line,
        )
        children = [
            self._node(child, board, in_recovery or (kind == "RecoveryNode" and index == 1))
            for index, child in enumerate(element.children)
        ]
        found = node_class(kind)
        assert found is not None, kind
        if not is_own(kind):
            return found(place, children)
        with OwnClass("behavior tree node", kind, found).calling("__init__"):
            return checked_node(kind, found(place, children))


def _shares_keys(element: Element) -> bool:
    """Whether all keys of a SubTree are those of the tree above."""
    given = [element.attributes.get(name, "").strip().lower() for name in _SHARED]
    return "true" in given or "1" in given


def _board_below(element: Element, board: Blackboard) -> Blackboard:
    """The blackboard of a SubTree: its attributes remap keys, or give values."""
    remapped, values = {}, {}
    for key, text in element.attributes.items():
        if key in _RESERVED or key.startswith("_"):
            continue
        if is_key(text):
            inner = text[1:-1].strip()
            remapped[key] = key if inner == "=" else inner
        else:
            values[key] = text
    below = Blackboard(board, remapped, _shares_keys(element))
    for key, text in values.items():
        below.hold(key, text)
    return below
