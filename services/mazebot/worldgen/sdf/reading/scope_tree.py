"""Builds the tree of named elements of a file and its includes: models, links, joints, frames."""

from __future__ import annotations

import itertools
from collections.abc import Callable

from lxml import etree

from mazebot.worldgen.sdf.reading import values
from mazebot.worldgen.sdf.reading.findings import Findings, Place, Source, local_name
from mazebot.worldgen.sdf.reading.frame_graph import Item, Kind, Pose
from mazebot.worldgen.sdf.reading.poses import pose_of, reference_in, still
from mazebot.worldgen.sdf.reading.sources import SourceError, Sources
from mazebot.worldgen.sdf.reading.vocabulary import described, list_unread
from mazebot.worldgen.sdf.reading.world_state import apply_state

MAX_DEPTH = 24
"""Maximum nesting of models."""
MAX_NAME = 256

_TOPS = ("world", "model", "include", "light")
"""Top-level elements of a file, in order of precedence."""
_JOINT_TYPES = (
    *("ball", "continuous", "fixed", "gearbox", "prismatic", "revolute", "revolute2"),
    *("screw", "universal"),
)


class ScopeTree:
    """Builds the tree.

    `lights` are kept separately: the parent of each, its element, and its <include>, if any.
    """

    def __init__(self, sources: Sources, findings: Findings) -> None:
        self._sources = sources
        self._findings = findings
        self._stack: list[Source] = []
        self.lights: list[tuple[Item, Place, Place | None]] = []
        self._light_names: dict[Item, dict[str, Place]] = {}

    def world(self, source: Source) -> Item | None:
        """The world of a file, or one created for its model; None if there is neither."""
        root = Place(source, source.root)
        list_unread(root, self._findings)
        self._stack.append(source)
        found = (source.root.find(tag) for tag in _TOPS)
        first = next((element for element in found if element is not None), None)
        if first is None:
            self._findings.error("ELEMENT_MISSING", root, "<sdf> must have a <world> or a <model>")
            return None
        names: dict[str | None, None] = {}
        for other in source.root:
            if str(other.tag) in _TOPS and str(other.tag) != str(first.tag):
                self._findings.ignore(f"{described(root.at(other))} beside <{first.tag}>", root)
            elif str(other.tag) == "world":
                if other.get("name") in names:
                    self._findings.error(
                        "DUPLICATE_NAME",
                        root.at(other),
                        f"world `{other.get('name')}` must have a unique name in the file",
                    )
                names[other.get("name")] = None
        place = root.at(first)
        tag = str(first.tag)
        name = self._name(place, "world") if tag == "world" else first.get("name")
        world = Item("world", name or "world", still(place), place)
        if tag == "world":
            self._contents(place, world, 0)
            own = [light for holder, light, include in self.lights
                   if holder is world and include is None]  # fmt: skip
            apply_state(world, own, self._findings)
        elif tag == "model":
            self._model(place, world, 0)
        elif tag == "include":
            self._include(place, world, 0)
            world.name = next(iter(world.items), world.name)
        else:
            self._light(place, world)
        return world

    def _contents(self, place: Place, scope: Item, depth: int) -> None:
        """Add the children of a <world> or <model> to its scope."""
        list_unread(place, self._findings)
        readers: dict[str, Callable[[Place, Item], None]] = {
            "link": self._link,
            "joint": self._joint,
            "frame": self._frame,
            "light": self._light,
        }
        if scope.kind == "world":
            del readers["link"]
        for element in place.element:
            tag = str(element.tag)
            if tag == "model":
                self._model(place.at(element), scope, depth + 1)
            elif tag == "include":
                self._include(place.at(element), scope, depth + 1)
            elif tag in readers:
                readers[tag](place.at(element), scope)

    def _link(self, place: Place, scope: Item) -> None:
        self._findings.links += 1
        item = self._named("link", place, scope)
        if item is not None:
            for light in place.element.findall("light"):
                self._light(place.at(light), item)

    def _joint(self, place: Place, scope: Item) -> None:
        list_unread(place, self._findings)
        element = place.element
        joint_type = element.get("type")
        if joint_type is None:
            self._findings.error("ATTRIBUTE_MISSING", place, "<joint> must have a type")
        elif joint_type not in _JOINT_TYPES:
            self._findings.error(
                "ATTRIBUTE_INVALID",
                place,
                f"type `{joint_type[:60]}` of <joint> must be one of {', '.join(_JOINT_TYPES)}",
            )
        ends = {}
        for tag in ("parent", "child"):
            text = (element.findtext(tag) or "").strip()
            ends[tag] = text
            if not text:
                self._findings.error("ELEMENT_MISSING", place, f"<joint> must have a <{tag}>")
        item = self._named("joint", place, scope)
        if item is not None:
            item.joint_type = joint_type or ""
            item.parent, item.child = ends["parent"], ends["child"]

    def _frame(self, place: Place, scope: Item) -> None:
        list_unread(place, self._findings)
        item = self._named("frame", place, scope)
        if item is not None:
            item.attached_to = self._reference(place, "attached_to")

    def _light(self, place: Place, holder: Item, include: Place | None = None) -> None:
        self.lights.append((holder, place, include))
        name = light_name(place, include)
        lights = self._light_names.setdefault(holder, {})
        taken = lights.get(name)
        if taken is None and holder.kind != "link" and place.source.version >= (1, 7):
            other = holder.items.get(name)
            taken = None if other is None else other.place
        if name and taken is not None:
            self._duplicate("light", name, include or place, holder, taken)
        lights.setdefault(name, include or place)

    def _model(self, place: Place, scope: Item, depth: int, include: Place | None = None) -> None:
        self._findings.models += 1
        if depth > MAX_DEPTH:
            self._findings.error(
                "ELEMENT_INVALID", place, f"models must be nested at most {MAX_DEPTH} deep"
            )
            return
        name = None if include is None else (include.element.findtext("name") or "").strip() or None
        item = self._named("model", place, scope, include, name)
        if item is None:
            # Its contents are still counted, and their errors reported.
            item = Item("model", name or "", still(place), place, scope)
        item.element = place
        self._fill_model(item, place, include, depth)

    def _fill_model(self, item: Item, place: Place, include: Place | None, depth: int) -> None:
        element = place.element
        item.canonical_link = self._reference(place, "canonical_link")
        item.placement_frame = self._reference(place, "placement_frame")
        item.static = self._truth(place, "static") or False
        if include is not None:
            static = self._truth(include, "static")
            item.static = item.static if static is None else static
            placement = (include.element.findtext("placement_frame") or "").strip()
            if placement == "__root__":
                self._findings.error(
                    "ELEMENT_INVALID",
                    include,
                    "<placement_frame> must not be `__root__`, which is reserved",
                )
            elif placement:
                item.placement_frame = placement
                if include.element.find("pose") is None:
                    self._findings.error(
                        "MODEL_PLACEMENT_FRAME_INVALID",
                        include,
                        "<include> with a <placement_frame> must have a <pose>",
                    )
        self._contents(place, item, depth)
        held = any(element.find(tag) is not None for tag in ("link", "model", "include"))
        if not held and not item.static:
            self._findings.error(
                "MODEL_WITHOUT_LINK", place, f"model `{item.name}` must have a link"
            )

    def _include(self, place: Place, scope: Item, depth: int) -> None:
        list_unread(place, self._findings)
        element = place.element
        uri = (element.findtext("uri") or "").strip()
        if not uri:
            self._findings.error("ELEMENT_MISSING", place, "<include> must have a <uri>")
            return
        try:
            source = self._sources.included(uri, place.source.file.parent)
        except SourceError as error:
            line = f" (line {error.line})" if error.line else ""
            self._findings.error(error.kind, place, f"{error}{line}")
            return
        if source in self._stack:
            self._findings.error("URI_INVALID", place, f"`{uri}` includes itself")
            return
        if len(self._stack) > MAX_DEPTH:
            self._findings.error(
                "URI_INVALID", place, f"includes must be nested at most {MAX_DEPTH} deep"
            )
            return
        tops = [one for one in source.root if str(one.tag) in ("model", "light", "actor")]
        if not tops:
            self._findings.error(
                "ELEMENT_MISSING", place, f"{source.shown} must have a <model> to be included"
            )
            return
        top = Place(source, tops[0])
        name = (element.findtext("name") or "").strip() or str(tops[0].get("name") or "")
        self._findings.include(uri, name, source.shown)
        self._stack.append(source)
        list_unread(top.at(source.root), self._findings)
        if tops[0].tag == "model":
            if self._merges(place):
                self._merge(top, place, scope, depth)
            else:
                self._model(top, scope, depth, place)
        elif self._merges(place):
            self._findings.error(
                "MERGE_INCLUDE_UNSUPPORTED", place, f"a <{tops[0].tag}> cannot be merged"
            )
        elif tops[0].tag == "light":
            self._light(top, scope, place)
        self._stack.pop()

    def _merges(self, place: Place) -> bool:
        text = place.element.get("merge")
        if text is None:
            return False
        try:
            return values.truth(text)
        except ValueError as error:
            self._findings.error("ATTRIBUTE_INVALID", place, f"merge {error}")
            return False

    def _merge(self, top: Place, include: Place, scope: Item, depth: int) -> None:
        """Add a model's contents to the model that includes it, around a frame at its pose."""
        if scope.kind == "world" and top.element.find("link") is not None:
            self._findings.error(
                "MERGE_INCLUDE_UNSUPPORTED", include, "a <world> cannot merge a model with links"
            )
            return
        inner_name = top.element.get("name") or "model"
        inner = Item("model", inner_name, still(top), top, scope)
        self._fill_model(inner, top, include, depth)
        proxy_name = f"_merged__{inner_name}__model__"
        pose = self.pose(include if include.element.find("pose") is not None else top)
        proxy = Item("frame", proxy_name, pose, include, scope)
        first_link = next(inner.of_kind("link"), None)
        proxy.attached_to = inner.canonical_link or (first_link.name if first_link else "")
        if not pose.relative_to:
            # Otherwise it would be relative to what it is attached to.
            holder = "__model__" if scope.kind == "model" else "world"
            proxy.pose = Pose(pose.matrix, holder, pose.place)
        if inner.placement_frame != "__model__":
            proxy.placement_frame = inner.placement_frame
        self._add(proxy)
        for item in inner.items.values():
            item.scope = scope
            default = {"link": True, "model": True, "frame": not item.attached_to, "joint": False}
            reference = item.pose.relative_to
            if reference == "__model__" or (not reference and default.get(item.kind)):
                item.pose = Pose(item.pose.matrix, proxy_name, item.pose.place)
            if item.kind == "frame" and item.attached_to in ("", "__model__"):
                item.attached_to = proxy_name
            if item.kind == "link":
                item.model_frame = proxy
            if item.parent == "__model__":
                item.parent = proxy_name
            if item.child == "__model__":
                item.child = proxy_name
            self._add(item)

    def _named(
        self,
        kind: Kind,
        place: Place,
        scope: Item,
        include: Place | None = None,
        name: str | None = None,
    ) -> Item | None:
        """A new element in a scope; None if its name is invalid or taken."""
        if name is None:
            name = self._name(place, kind)
        elif not self._allowed(name, kind, include or place):
            name = name[:MAX_NAME]
        if not name:
            return None
        posed = (
            include if include is not None and include.element.find("pose") is not None else place
        )
        item = Item(kind, name, self.pose(posed), include or place, scope)
        if kind != "link" and place.source.version < (1, 7):
            taken = scope.items.get(name)
            if taken is not None and taken.kind != kind:
                # Before 1.7 names only had to be unique within one kind.
                item.name = _another_name(name, kind, place.element, scope)
                self._findings.rename(kind, name, item.name, item.place)
        return item if self._add(item) else None

    def _add(self, item: Item) -> bool:
        scope = item.scope
        assert scope is not None
        taken = scope.items.get(item.name)
        if taken is None:
            light = self._light_names.get(scope, {}).get(item.name)
            if light is not None and item.place.source.version >= (1, 7):
                self._duplicate(item.kind, item.name, item.place, scope, light)
            scope.items[item.name] = item
            return True
        self._duplicate(item.kind, item.name, item.place, scope, taken.place)
        return False

    def _duplicate(self, kind: str, name: str, place: Place, scope: Item, taken: Place) -> None:
        self._findings.error(
            "DUPLICATE_NAME",
            place,
            f"{kind} `{name}` must have a unique name in {scope.kind} `{scope.name}`: "
            f"already used by a {local_name(taken.element.tag)} at {taken}",
        )

    def _name(self, place: Place, kind: str) -> str:
        name: str | None = place.element.get("name")
        if name is None or not name.strip():
            self._findings.error("ATTRIBUTE_MISSING", place, f"<{kind}> must have a name")
            return ""
        self._allowed(name, kind, place)
        return name[:MAX_NAME]

    def _allowed(self, name: str, kind: str, place: Place) -> bool:
        return allowed_name(name, kind, place, self._findings)

    def _reference(self, place: Place, attribute: str) -> str:
        return reference_in(place, attribute, self._findings)

    def _truth(self, place: Place, tag: str) -> bool | None:
        element = place.element.find(tag)
        if element is None or not (element.text or "").strip():
            return None
        try:
            return values.truth(element.text)
        except ValueError as error:
            self._findings.error("ELEMENT_INVALID", place.at(element), f"<{tag}> {error}")
            return None

    def pose(self, place: Place) -> Pose:
        """The <pose> of an element; the identity where there is none."""
        return pose_of(place, self._findings)


def _another_name(name: str, kind: str, element: etree._Element, scope: Item) -> str:
    """`name_kind`, or that with a number, unused in the scope."""
    parent = element.getparent()
    taken = {*scope.items, *(one.get("name") for one in (() if parent is None else parent))}
    tries = (f"{name}_{kind}{number or ''}" for number in itertools.count())
    return next(one for one in tries if one not in taken)


def allowed_name(name: str, kind: str, place: Place, findings: Findings) -> bool:
    """Whether a name is allowed; if not, the error is added to the findings."""
    if len(name) > MAX_NAME:
        findings.error(
            "ATTRIBUTE_INVALID", place, f"name of <{kind}> must have at most {MAX_NAME} characters"
        )
        return False
    reserved = name == "world" or (len(name) >= 4 and name.startswith("__") and name.endswith("__"))
    # Up to 1.7 included models were flattened: their links are named `model::link`.
    flattened = place.source.version < (1, 8)
    if reserved or ("::" in name and not flattened):
        findings.error(
            "RESERVED_NAME",
            place,
            f"name `{name}` of <{kind}> must not be `world`, contain `::`, or start and end with "
            "`__`",
        )
        return False
    return True


def light_name(place: Place, include: Place | None) -> str:
    """The name of a light: that of its <include>, if this has one."""
    name = "" if include is None else (include.element.findtext("name") or "").strip()
    return name or place.element.get("name") or ""
