"""Resolves poses: SDFormat's frame semantics over named elements in nested scopes.

Source of the rules: the specification's "Pose Frame Semantics" (SDFormat 1.7 and 1.8), which also
covers earlier versions.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from mazebot.common.maths.frames import Array
from mazebot.worldgen.sdf.reading.findings import Findings, Place

Kind = Literal["world", "model", "link", "joint", "frame"]


@dataclass(eq=False)
class Pose:
    """A pose as written in the file."""

    matrix: Array
    """(4, 4) reference_from_self"""
    relative_to: str
    """Name of the reference frame; empty: the default of the element."""
    place: Place


@dataclass(eq=False)
class Item:
    """A named element with a frame."""

    kind: Kind
    name: str
    pose: Pose
    place: Place
    scope: Item | None = None
    """The model or world that directly contains it; None: it is the outermost itself."""
    items: dict[str, Item] = field(default_factory=dict)
    """Of a model or world: its direct children, in the order of the file."""
    element: Place | None = None
    """Of a model: its own element; `place` is the <include> if there is one."""
    static: bool = False
    """Of a model."""
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Of a model: of the shapes of its own links along their axes, from a <state>."""
    canonical_link: str = ""
    """Of a model."""
    placement_frame: str = ""
    """Of a model: the frame in it that its pose refers to; empty: its own. Of the frame that
    replaces a merged include's model: the same, among the frames around it.
    """
    model_frame: Item | None = None
    """Of a link of a merged include: the frame that `__model__` means in it; None: its model."""
    attached_to: str = ""
    """Of a frame; empty: its parent element."""
    joint_type: str = ""
    parent: str = ""
    """Of a joint."""
    child: str = ""
    """Of a joint."""

    def of_kind(self, kind: Kind) -> Iterator[Item]:
        """Its direct children of one kind."""
        return (item for item in self.items.values() if item.kind == kind)

    def full_name(self) -> str:
        """With the names of the models that contain it: `outer::inner::self`."""
        names = [self.name]
        scope = self.scope
        while scope is not None and scope.kind != "world":
            names.append(scope.name)
            scope = scope.scope
        return "::".join(reversed(names))

    def outermost_model(self) -> Item | None:
        """The top-level model that it is, or is in; None for other children of the world."""
        item: Item | None = self
        while item is not None and item.scope is not None and item.scope.kind != "world":
            item = item.scope
        return item if item is not None and item.kind == "model" else None


def lookup(scope: Item, name: str) -> Item | None:
    """The element of a name inside a model or the world; None if there is none."""
    if name in scope.items:
        return scope.items[name]
    if name == "world":
        return scope if scope.kind == "world" else None
    if name == "__model__":
        return scope if scope.kind == "model" else None
    *outer, last = name.split("::")
    for one in outer:
        nested = scope.items.get(one)
        if nested is None or nested.kind != "model":
            return None
        scope = nested
    if not outer:
        return None
    return scope if last == "__model__" else scope.items.get(last)


class FrameGraph:
    """Resolves poses and attachments, and reports each unresolved one once."""

    def __init__(self, findings: Findings) -> None:
        self._findings = findings
        self._references: dict[Item, tuple[Item | None, Array]] = {}
        self._world_from: dict[Item, Array] = {}
        self._attached: dict[Item, Item | None] = {}
        self._canonical: dict[Item, Item | None] = {}

    def world_from(self, item: Item) -> Array:
        """(4, 4) pose in the world of any element's frame."""
        while item not in self._world_from:
            path: dict[Item, Array] = {}
            at: Item | None = item
            while at is not None and at not in self._world_from and at not in path:
                reference, matrix = self._reference(at)
                path[at] = matrix
                at = reference
            if at is not None and at in path:
                self._break_cycle(at)
                continue
            world_from = np.eye(4) if at is None else self._world_from[at]
            for one, matrix in reversed(path.items()):
                world_from = world_from @ matrix
                self._world_from[one] = world_from
        return self._world_from[item]

    def scope_from(self, item: Item) -> Array:
        """(4, 4) pose in the model, or world, that directly contains it."""
        if item.scope is None:
            return np.eye(4)
        world_from_item = self.world_from(item)
        reference, matrix = self._reference(item)
        if reference is item.scope:
            return matrix
        return inverse(self.world_from(item.scope)) @ world_from_item

    def link_from(self, link: Item, pose: Pose) -> Array:
        """(4, 4) of an element in a link, whose pose is relative to the link by default."""
        if not pose.relative_to or link.scope is None:
            return pose.matrix
        target = _lookup_from(link, pose.relative_to)
        if target is None:
            self._unknown_reference(pose)
            return pose.matrix
        return inverse(self.world_from(link)) @ self.world_from(target) @ pose.matrix

    def placed(self, holder: Item, pose: Pose) -> Array:
        """(4, 4) pose in the world of an element in a link, model or world."""
        if pose.relative_to:
            target = _lookup_from(holder, pose.relative_to)
            if target is not None:
                return self.world_from(target) @ pose.matrix
            self._unknown_reference(pose)
        return self.world_from(holder) @ pose.matrix

    def attached(self, item: Item) -> Item | None:
        """The link, or the world, that an element moves with; None if there is none."""
        path: dict[Item, None] = {}
        at: Item | None = item
        while at is not None and at not in self._attached and at not in path:
            path[at] = None
            if at.kind in ("link", "world"):
                break
            at = self._attachment(at)
        if at is not None and at in path and at.kind not in ("link", "world"):
            self._findings.error(
                "FRAME_ATTACHED_TO_CYCLE",
                at.place,
                f"{at.kind} `{at.name}` is attached to itself, directly or through other frames",
            )
            at = None
        end = self._attached[at] if at is not None and at in self._attached else at
        for one in path:
            self._attached[one] = end
        return end

    def canonical(self, model: Item) -> Item | None:
        """A model's canonical link: the named one, else its first, else that of its first model."""
        if model not in self._canonical:
            self._canonical[model] = None
            self._canonical[model] = self._find_canonical(model)
        return self._canonical[model]

    def _find_canonical(self, model: Item) -> Item | None:
        if model.canonical_link:
            link = lookup(model, model.canonical_link)
            if link is not None and link.kind == "link":
                return link
            self._findings.error(
                "MODEL_CANONICAL_LINK_INVALID",
                model.place,
                f"canonical_link `{model.canonical_link}` of model `{model.name}` must be the "
                "name of one of its links",
            )
        for link in model.of_kind("link"):
            return link
        for nested in model.of_kind("model"):
            link = self.canonical(nested)
            if link is not None:
                return link
        return None

    def _attachment(self, item: Item) -> Item | None:
        scope = item.scope
        if item.kind == "model":
            return self.canonical(item)
        if scope is None:
            return None
        if item.kind == "joint":
            return lookup(scope, item.child)
        if not item.attached_to:
            return scope
        target = lookup(scope, item.attached_to)
        if target is None:
            self._findings.error(
                "FRAME_ATTACHED_TO_INVALID",
                item.place,
                f"attached_to `{item.attached_to}` of frame `{item.name}` must be the name of a "
                f"frame, link, joint or model in {scope.kind} `{scope.name}`",
            )
        return target

    def _reference(self, item: Item) -> tuple[Item | None, Array]:
        if item not in self._references:
            self._references[item] = self._find_reference(item)
        return self._references[item]

    def _find_reference(self, item: Item) -> tuple[Item | None, Array]:
        scope, matrix = item.scope, item.pose.matrix
        if item.placement_frame:
            matrix = matrix @ inverse(self._model_from_placement(item))
        if scope is None:
            return None, matrix
        if item.pose.relative_to:
            target = lookup(scope, item.pose.relative_to)
            if target is not None:
                return target, matrix
            self._unknown_reference(item.pose)
        elif item.kind == "joint":
            return lookup(scope, item.child) or scope, matrix
        elif item.kind == "frame" and item.attached_to:
            return lookup(scope, item.attached_to) or scope, matrix
        return scope, matrix

    def _model_from_placement(self, model: Item) -> Array:
        scope = model if model.kind == "model" or model.scope is None else model.scope
        frame = lookup(scope, model.placement_frame)
        if frame is None:
            self._findings.error(
                "MODEL_PLACEMENT_FRAME_INVALID",
                model.place,
                f"placement_frame `{model.placement_frame}` must be the name of a frame in model "
                f"`{model.name}`",
            )
            return np.eye(4)
        model_from_frame = np.eye(4)
        seen: dict[Item, None] = {}
        at: Item | None = frame
        while at is not None and at is not model:
            if at in seen:
                self._break_cycle(at)
                return self._model_from_placement(model)
            seen[at] = None
            reference, matrix = self._reference(at)
            model_from_frame = matrix @ model_from_frame
            at = reference
        return model_from_frame

    def _break_cycle(self, item: Item) -> None:
        """Make one of a cycle's poses relative to its parent element."""
        cycle = [item]
        at = self._reference(item)[0]
        while at is not None and at is not item:
            cycle.append(at)
            at = self._reference(at)[0]
        named = next((one for one in cycle if one.pose.relative_to), None)
        if named is not None:
            self._findings.error(
                "POSE_RELATIVE_TO_CYCLE",
                named.pose.place,
                f"the pose of {named.kind} `{named.name}` is relative to itself, through "
                f"`{named.pose.relative_to}`",
            )
        broken = named or item
        self._references[broken] = broken.scope, self._reference(broken)[1]

    def _unknown_reference(self, pose: Pose) -> None:
        self._findings.error(
            "POSE_RELATIVE_TO_INVALID",
            pose.place,
            f"relative_to `{pose.relative_to}` must be the name of a frame, link, joint or model "
            "in the same model or world",
        )


def _lookup_from(holder: Item, name: str) -> Item | None:
    """The element of a name, as seen from inside a link, model or world."""
    if name == "__model__" and holder.model_frame is not None:
        return holder.model_frame
    scope = holder.scope if holder.kind == "link" else holder
    return None if scope is None else lookup(scope, name)


def inverse(a_from_b: Array) -> Array:
    """`b_from_a` of a rigid (4, 4) transform."""
    inverse = np.eye(4)
    inverse[:3, :3] = a_from_b[:3, :3].T
    inverse[:3, 3] = -a_from_b[:3, :3].T @ a_from_b[:3, 3]
    return inverse
