"""Reads an SDF or xacro file, with everything it includes, as resolved plain data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Literal, cast

from mazebot.common.messages.documents import Rgba
from mazebot.worldgen.sdf.model import (
    FramePose,
    SdfLight,
    SdfLink,
    SdfModel,
    SdfShape,
    SdfWorld,
)
from mazebot.worldgen.sdf.reading import values
from mazebot.worldgen.sdf.reading.findings import Findings, Place
from mazebot.worldgen.sdf.reading.frame_graph import FrameGraph, Item
from mazebot.worldgen.sdf.reading.joints import joined
from mazebot.worldgen.sdf.reading.poses import pose_of
from mazebot.worldgen.sdf.reading.scope_tree import ScopeTree, allowed_name, light_name
from mazebot.worldgen.sdf.reading.shapes import LACKING, ShapeReader, volume_m3
from mazebot.worldgen.sdf.reading.sources import SourceError, Sources
from mazebot.worldgen.sdf.reading.vocabulary import (
    drive_of,
    list_unread,
    own_attributes,
    own_texts,
)

DEFAULT_DENSITY_KG_M3 = 1000.0
"""Default of the specification: water's."""
DEFAULT_MASS_KG = 1.0
"""Default of the specification."""

_LIGHT_KINDS = ("directional", "point", "spot")
_WHITE: Rgba = (1.0, 1.0, 1.0, 1.0)


def read_sdf(
    file: Path,
    roots: Sequence[Path] = (),
    arguments: Mapping[str, str] = MappingProxyType({}),
) -> SdfWorld:
    """Read a world or model file, or a model's folder, with everything that it includes.

    Raises nothing for errors in files: all are in `report.errors`, and a file that cannot be read
    at all gives an empty world with that one error. `roots` are folders of models, as in
    GZ_SIM_RESOURCE_PATH. `arguments` are xacro's.
    """
    findings = Findings()
    sources = Sources(file, roots, arguments)
    name = file.name.partition(".")[0] or "world"
    try:
        source = sources.first()
    except SourceError as error:
        where = file.name or str(file)
        # The location already names the file.
        message = str(error).removeprefix(where).lstrip(": ")
        findings.error(error.kind, f"{where}:{error.line}" if error.line else where, message)
        return _empty(file, name, findings)
    tree = ScopeTree(sources, findings)
    world = tree.world(source)
    if world is None:
        return _empty(source.file, name, findings)
    return _Resolver(sources, findings, tree, world).world(source.file)


def _empty(file: Path, name: str, findings: Findings) -> SdfWorld:
    return SdfWorld(
        file=file,
        name=name,
        models=(),
        links=(),
        lights=(),
        frames=(),
        ambient=None,
        background=None,
        attributes={},
        report=findings.report(name),
    )


class _Resolver:
    """Converts a file's tree of named elements to plain data."""

    def __init__(self, sources: Sources, findings: Findings, tree: ScopeTree, world: Item) -> None:
        self._findings = findings
        self._tree = tree
        self._world = world
        self._graph = FrameGraph(findings)
        self._shapes = ShapeReader(findings, sources.locator)

    def world(self, file: Path) -> SdfWorld:
        """The resolved content."""
        tree, graph, world = self._tree, self._graph, self._world
        models = tuple(
            SdfModel(
                name=model.full_name(),
                static=_is_static(model),
                world_from_model=graph.world_from(model),
                attributes=own_attributes(model.element or model.place),
                drive=next((drive for at in _places_of(model) if (drive := drive_of(at))), ""),
            )
            for model in _held(world, "model")
        )
        for model in _held(world, "model"):
            graph.canonical(model)
        for frame in _held(world, "frame"):
            graph.attached(frame)
        links = self._links()
        lights = tuple(
            light for light in (self._light(*one) for one in tree.lights) if light is not None
        )
        ambient, background = self._scene()
        is_world = world.place.element.tag == "world"
        return SdfWorld(
            file=file,
            name=world.name,
            models=models,
            links=links,
            lights=lights,
            frames=tuple(
                FramePose(
                    kind=item.kind,
                    name=item.full_name(),
                    model_from_frame=graph.scope_from(item),
                    world_from_frame=graph.world_from(item),
                )
                for item in _held(world, "")
                if item.kind != "world"
            ),
            ambient=ambient,
            background=background,
            attributes=own_texts(world.place) if is_world else {},
            report=self._findings.report(world.name),
        )

    def _links(self) -> tuple[SdfLink, ...]:
        items = _held(self._world, "link")
        joins = joined(_held(self._world, "joint"), items, self._graph, self._findings)
        still = [
            link for link in items if _is_static(link) or link.outermost_model() in joins.standing
        ]
        static = joins.static_groups(still)
        return tuple(
            self._link(link, joins.representative(link), joins.representative(link) in static)
            for link in items
        )

    def _link(self, link: Item, first: Item, static: bool) -> SdfLink:
        place = link.place
        list_unread(place, self._findings)
        shapes: list[SdfShape] = []
        density: list[tuple[SdfShape, float]] = []
        names: dict[str, dict[str, None]] = {"collision": {}, "visual": {}}
        lacking: list[SdfShape] = []
        for element in place.element:
            tag = str(element.tag)
            if tag not in ("collision", "visual"):
                continue
            at = place.at(element)
            shape = self._shape(at, cast(Literal["collision", "visual"], tag), link, names[tag])
            if shape is not None and shape.geometry is LACKING.geometry:
                lacking.append(shape)
            elif shape is not None:
                shapes.append(shape)
                if tag == "collision":
                    value = self._shapes.optional(at, "density", values.positive, 0.0)
                    density.append((shape, value))
        shapes += _in_place_of(lacking, shapes)
        visible = bool(lacking) or any(shape.role == "visual" for shape in shapes)
        if visible and place.element.find("collision") is None and not _is_noted(link, shapes):
            self._findings.no_collision(link.full_name())
        return SdfLink(
            name=link.full_name(),
            model=link.scope.full_name() if link.scope is not None else "",
            world_from_link=self._graph.world_from(link),
            static=static,
            mass_kg=self._mass(place, density, static),
            fixed_to=first.full_name(),
            shapes=tuple(shapes),
            attributes=own_attributes(place),
        )

    def _shape(
        self,
        at: Place,
        role: Literal["collision", "visual"],
        link: Item,
        names: dict[str, None],
    ) -> SdfShape | None:
        list_unread(at, self._findings)
        name = at.element.get("name") or ""
        if not name.strip():
            self._findings.error("ATTRIBUTE_MISSING", at, f"<{role}> must have a name")
        elif name in names:
            self._findings.error(
                "DUPLICATE_NAME",
                at,
                f"{role} `{name[:100]}` must have a unique name in link `{link.name}`",
            )
        else:
            allowed_name(name, role, at, self._findings)
        names[name] = None
        pose = pose_of(at, self._findings)
        scale = (1.0, 1.0, 1.0) if link.scope is None else link.scope.scale
        read = self._shapes.geometry(at, role, scale)
        material = self._shapes.material(at) if role == "visual" else None
        if read is None:
            return None
        return SdfShape(
            role=role,
            name=name or f"{role}_{len(names)}",
            link_from_shape=self._graph.link_from(link, pose) @ read.shape_from_geometry,
            geometry=read.geometry,
            mesh_file=read.mesh_file,
            material=material,
            attributes=own_attributes(at),
        )

    def _mass(self, place: Place, collisions: list[tuple[SdfShape, float]], static: bool) -> float:
        """Mass of a link: as given, or from its collisions' volumes if it is `auto`."""
        element = place.element.find("inertial")
        if element is None:
            return DEFAULT_MASS_KG
        at = place.at(element)
        list_unread(at, self._findings)
        automatic = False
        if element.get("auto") is not None:
            try:
                automatic = values.truth(element.get("auto"))
            except ValueError as error:
                self._findings.error("ATTRIBUTE_INVALID", at, f"auto {error}")
        mass_element = element.find("mass")
        if mass_element is not None:
            at = at.at(mass_element)
            try:
                mass_kg = values.not_negative(mass_element.text)
                if mass_kg > 0.0:
                    return mass_kg
                if not static:
                    raise ValueError("must be > 0")
                self._findings.ignore("zero mass of a static model", at)
                return DEFAULT_MASS_KG
            except ValueError as error:
                self._findings.error("LINK_INERTIA_INVALID", at, f"<mass> {error}")
                return DEFAULT_MASS_KG
        if not automatic:
            return DEFAULT_MASS_KG
        common = self._shapes.optional(at, "density", values.positive, DEFAULT_DENSITY_KG_M3)
        mass = 0.0
        for shape, density in collisions:
            volume = volume_m3(shape.geometry)
            if volume is None:
                self._findings.ignore(
                    f"automatic mass of a {shape.geometry.kind}: {DEFAULT_MASS_KG:g} kg is used",
                    at,
                )
                mass += DEFAULT_MASS_KG
            else:
                mass += volume * (density or common)
        return mass or DEFAULT_MASS_KG

    def _light(self, holder: Item, at: Place, include: Place | None) -> SdfLight | None:
        list_unread(at, self._findings)
        name = light_name(at, include)
        posed = at
        if include is not None and include.element.find("pose") is not None:
            posed = include
        if not name.strip():
            self._findings.error("ATTRIBUTE_MISSING", at, "<light> must have a name")
        else:
            allowed_name(name, "light", at, self._findings)
        kind = at.element.get("type")
        if kind is None:
            self._findings.error("ATTRIBUTE_MISSING", at, "<light> must have a type")
            return None
        if kind not in _LIGHT_KINDS:
            self._findings.error(
                "ATTRIBUTE_INVALID",
                at,
                f"type `{kind[:60]}` of <light> must be one of {', '.join(_LIGHT_KINDS)}",
            )
            return None
        optional = self._shapes.optional
        x, y, z = optional(at, "direction", values.vector, (0.0, 0.0, -1.0))
        attenuation = at.element.find("attenuation")
        inner = at if attenuation is None else at.at(attenuation)
        if attenuation is not None:
            list_unread(inner, self._findings)
        light = SdfLight(
            kind=cast(Literal["directional", "point", "spot"], kind),
            name=name if holder.kind == "world" else f"{holder.full_name()}::{name}",
            world_from_light=self._graph.placed(holder, pose_of(posed, self._findings)),
            diffuse=optional(at, "diffuse", values.colour, _WHITE),
            direction=(x, y, z),
            range_m=optional(inner, "range", values.positive, 10.0),
            constant=optional(inner, "constant", values.not_negative, 1.0),
            linear=optional(inner, "linear", values.not_negative, 1.0),
            quadratic=optional(inner, "quadratic", values.not_negative, 0.0),
        )
        if not optional(at, "light_on", values.truth, True):
            self._findings.ignore(f"light {name} (it is off)", at)
            return None
        return light

    def _scene(self) -> tuple[Rgba | None, Rgba | None]:
        element = self._world.place.element.find("scene")
        if element is None:
            return None, None
        at = self._world.place.at(element)
        list_unread(at, self._findings)
        return (
            self._shapes.optional(at, "ambient", values.colour, None),
            self._shapes.optional(at, "background", values.colour, None),
        )


def _places_of(model: Item) -> tuple[Place, ...]:
    """A model's element, and its <include>, if there is one."""
    return (model.place,) if model.element is None else (model.element, model.place)


def _is_noted(link: Item, shapes: Sequence[SdfShape]) -> bool:
    """Whether a link is one of an export, which says itself what is not solid."""
    scope = link.scope
    of_model = scope is not None and own_attributes(scope.element or scope.place)
    return bool(of_model or own_attributes(link.place) or any(one.attributes for one in shapes))


def _in_place_of(lacking: Sequence[SdfShape], shapes: Sequence[SdfShape]) -> list[SdfShape]:
    """Visuals of the collision shapes, where meshes were all that could be seen of a link."""
    if not lacking or any(shape.role == "visual" for shape in shapes):
        return []
    return [
        replace(shape, role="visual", name=f"{shape.name}_visual", material=lacking[0].material)
        for shape in shapes
    ]


def _held(scope: Item, kind: str) -> list[Item]:
    """All elements of a kind (empty: all) in a scope and the models in it, in the file's order."""
    found: list[Item] = []
    waiting = [iter(scope.items.values())]
    while waiting:
        item = next(waiting[-1], None)
        if item is None:
            waiting.pop()
            continue
        if not kind or item.kind == kind:
            found.append(item)
        if item.items:
            waiting.append(iter(item.items.values()))
    return found


def _is_static(item: Item) -> bool:
    """Whether the element, or a model that contains it, is static."""
    at: Item | None = item
    while at is not None:
        if at.static:
            return True
        at = at.scope
    return False
