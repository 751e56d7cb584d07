"""Finds the links merged by fixed joints, and the models made static by their other joints."""

from __future__ import annotations

from collections.abc import Iterable

from mazebot.worldgen.sdf.reading import values
from mazebot.worldgen.sdf.reading.findings import Findings
from mazebot.worldgen.sdf.reading.frame_graph import FrameGraph, Item, lookup


class Joined:
    """The effect of a file's joints on its links."""

    def __init__(self, links: Iterable[Item]) -> None:
        self._order = {link: index for index, link in enumerate(links)}
        self._group = {link: link for link in self._order}
        self._to_world: dict[Item, None] = {}
        self.standing: dict[Item, None] = {}
        """Outermost models with joints that are not simulated."""

    def representative(self, link: Item) -> Item:
        """The first link, in the order of the file, of a link's merged group."""
        while self._group[link] is not link:
            self._group[link] = self._group[self._group[link]]
            link = self._group[link]
        return link

    def join(self, a: Item, b: Item) -> None:
        """Merge two links; merging with the world makes a link static."""
        if "world" in (a.kind, b.kind):
            self._to_world[a if b.kind == "world" else b] = None
            return
        first, second = sorted(
            (self.representative(a), self.representative(b)), key=self._order.__getitem__
        )
        self._group[second] = first

    def static_groups(self, static: Iterable[Item]) -> set[Item]:
        """Representatives of the static links, given those that are static by themselves."""
        return {self.representative(link) for link in (*static, *self._to_world)}


def joined(
    joints: Iterable[Item], links: Iterable[Item], graph: FrameGraph, findings: Findings
) -> Joined:
    """The effect of the joints; invalid ones, and those not simulated, go to the findings."""
    result = Joined(links)
    for joint in joints:
        ends = _ends(joint, graph, findings)
        _check_axes(joint, findings)
        if joint.joint_type != "fixed":
            findings.ignore(
                f"joint {joint.full_name()} ({joint.joint_type or 'no type'}): is held still, "
                "and its model with it",
                joint.place,
            )
            for one in (joint, *(ends or ())):
                model = one.outermost_model()
                if model is not None:
                    result.standing[model] = None
        elif ends is not None:
            result.join(*ends)
    return result


def _ends(joint: Item, graph: FrameGraph, findings: Findings) -> tuple[Item, Item] | None:
    """The parent and the child link of a joint; the parent may be the world."""
    scope = joint.scope
    if scope is None or not joint.parent or not joint.child:
        return None
    found: list[Item | None] = []
    outermost = scope
    while outermost.scope is not None:
        outermost = outermost.scope
    for role, name in (("parent", joint.parent), ("child", joint.child)):
        end: Item | None = None
        if name == "world":
            end = outermost if role == "parent" else None
        elif name != joint.name or role == "child":
            # For a joint that is its own child the graph reports a cycle.
            target = lookup(scope, name)
            end = None if target is None else graph.attached(target)
        if end is None:
            findings.error(
                f"JOINT_{role.upper()}_LINK_INVALID",
                joint.place,
                f"<{role}> `{name}` of joint `{joint.name}` must be the name of a link or frame in "
                f"{scope.kind} `{scope.name}`",
            )
        found.append(end)
    parent, child = found
    if joint.parent == joint.child or (parent is not None and parent is child):
        findings.error(
            "JOINT_PARENT_SAME_AS_CHILD",
            joint.place,
            f"joint `{joint.name}` must have different links for <parent> and <child>",
        )
        return None
    return None if parent is None or child is None else (parent, child)


def _check_axes(joint: Item, findings: Findings) -> None:
    """Report axes without a direction, or with one in an unknown frame."""
    for element in joint.place.element:
        if str(element.tag) not in ("axis", "axis2"):
            continue
        xyz = element.find("xyz")
        if xyz is None:
            continue
        at = joint.place.at(xyz)
        try:
            if (xyz.text or "").strip() and not any(values.vector(xyz.text)):
                raise ValueError("must not be zero")
        except ValueError as error:
            findings.error("ELEMENT_INVALID", at, f"<xyz> {error}")
        frame = xyz.get("expressed_in") or ""
        if frame and (joint.scope is None or lookup(joint.scope, frame) is None):
            findings.error(
                "JOINT_AXIS_EXPRESSED_IN_INVALID",
                at,
                f"expressed_in `{frame}` of joint `{joint.name}` must be the name of a frame, "
                "link, joint or model in the same model or world",
            )
