"""Combines links to groups, each of which is one body, and their shapes to parts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mazebot.common.maths.frames import Array, inverse_matrix
from mazebot.common.messages import documents as doc
from mazebot.worldgen.recipe_model import GeometryRecipe
from mazebot.worldgen.sdf.model import SdfLink, SdfShape
from mazebot.worldgen.sdf.notes import SAME_DIGITS, TEXT, from_json, noted
from mazebot.worldgen.sdf.writing import SHEET_THICKNESS_M


@dataclass(frozen=True, eq=False)
class Part:
    """A shape of a group of links, with collision and visual combined."""

    name: str
    where: str
    body_from_part: Array
    geometry: GeometryRecipe
    solid: bool
    has_end: bool
    """False for a collision that is a plane, which in SDF is infinite."""
    visual: SdfShape | None
    mesh_file: Path | None
    attributes: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class Group:
    """Links that form one body."""

    name: str
    full_name: str
    """With its model's name, if another group has the name."""
    world_from_body: Array
    static: bool
    mass_kg: float
    links: tuple[SdfLink, ...]
    parts: tuple[Part, ...]
    coverings: tuple[tuple[Array, SdfShape], ...]
    """body_from_covering, and the visual"""


def groups_of(all_links: Sequence[SdfLink], markers: Collection[str]) -> Iterator[Group]:
    """Groups of links connected by fixed joints, in the order of their first links."""
    members: dict[str, list[SdfLink]] = {}
    for link in all_links:
        if link.model not in markers:
            members.setdefault(link.fixed_to, []).append(link)
    links_of_model = Counter(link.model for link in all_links)
    links_of_outermost = Counter(link.model.partition("::")[0] for link in all_links)
    for root_name, links in members.items():
        root = next((link for link in links if link.name == root_name), links[0])
        body_from_world = inverse_matrix(root.world_from_link)
        parts: list[Part] = []
        coverings: list[tuple[Array, SdfShape]] = []
        for link in links:
            body_from_link = np.eye(4) if link is root else body_from_world @ link.world_from_link
            for shape in link.shapes:
                if shape.role == "visual" and "covering" in shape.attributes:
                    coverings.append((body_from_link @ shape.link_from_shape, shape))
            parts += _parts(link, body_from_link)
        short, model = root.name.rpartition("::")[2], root.model.rpartition("::")[2]
        outermost = root.model.partition("::")[0]
        if links_of_outermost[outermost] == 1:
            short = outermost or short
        elif links_of_model[root.model] == 1:
            short = model or short
        noted_name = from_json(root.attributes.get("name"), TEXT)
        yield Group(
            name=noted_name or short,
            full_name=f"{model}.{short}",
            world_from_body=root.world_from_link,
            static=all(link.static for link in links),
            mass_kg=sum(link.mass_kg for link in links),
            links=tuple(links),
            parts=tuple(parts),
            coverings=tuple(coverings),
        )


def _parts(link: SdfLink, body_from_link: Array) -> Iterator[Part]:
    """Collisions, each with its equal visual, and the remaining visuals."""
    visuals = [
        shape
        for shape in link.shapes
        if shape.role == "visual" and not {"covering", "room", "ceiling"} & set(shape.attributes)
    ]
    alike: dict[tuple[object, ...], list[SdfShape]] = {}
    for one in visuals:
        key = _key(one.link_from_shape, one.geometry, one.mesh_file)
        alike.setdefault(key, []).append(one)
    prepared: list[tuple[SdfShape, Array, GeometryRecipe, SdfShape | None]] = []
    matched: set[int] = set()
    for shape in link.shapes:
        if shape.role != "collision":
            continue
        pose, geometry = _solid(shape)
        candidates = alike.get(_key(pose, geometry, shape.mesh_file), [])
        match = next((visual for visual in candidates if _may_be_one(shape, visual)), None)
        if match is not None:
            candidates.remove(match)
            matched.add(id(match))
        prepared.append((shape, pose, geometry, match))
    # In the order of the export, so that a body's shapes keep their order.
    order = {id(shape): index for index, shape in enumerate(link.shapes)}
    alone = [
        (visual, visual.link_from_shape, visual.geometry, visual)
        for visual in visuals
        if id(visual) not in matched
    ]
    for shape, pose, geometry, visual in sorted(
        [*prepared, *alone], key=lambda one: order[id(one[0])]
    ):
        noted_name = from_json(shape.attributes.get("shape"), TEXT)
        yield Part(
            name=noted_name or shape.name,
            where=f"{link.name}::{shape.name}",
            body_from_part=product(body_from_link, pose),
            geometry=geometry,
            solid=shape.role == "collision",
            has_end=not isinstance(shape.geometry, doc.Plane) or shape.role == "visual",
            visual=visual,
            mesh_file=shape.mesh_file,
            attributes=shape.attributes,
        )


def product(a_from_b: Array, b_from_c: Array) -> Array:
    """The product, without rounding if one of the two is the identity."""
    if np.array_equal(a_from_b, np.eye(4)):
        return b_from_c
    return a_from_b if np.array_equal(b_from_c, np.eye(4)) else a_from_b @ b_from_c


def _solid(shape: SdfShape) -> tuple[Array, GeometryRecipe]:
    """Pose and geometry of a collision; a plane that was exported as a box is restored."""
    geometry = shape.geometry
    if shape.attributes.get("geometry") == "plane" and isinstance(geometry, doc.Box):
        pose = shape.link_from_shape.copy()
        top_m = pose[:3, 3] + SHEET_THICKNESS_M / 2.0 * pose[:3, 2]
        pose[:3, 3] = noted(top_m.tolist(), shape.attributes.get("position_m"))
        return pose, doc.Plane(size_m=geometry.size_m[:2])
    return shape.link_from_shape, geometry


def _key(pose: Array, geometry: GeometryRecipe, mesh_file: Path | None) -> tuple[object, ...]:
    """Equal for a collision and a visual of the same shape."""
    # Adding 0.0 turns -0.0 into 0.0.
    place = (np.round(pose, SAME_DIGITS) + 0.0).tobytes()
    return place, repr(_rounded(geometry.model_dump())), mesh_file


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(inner) for inner in value]
    return round(value, SAME_DIGITS) + 0.0 if isinstance(value, float) else value


def _may_be_one(collision: SdfShape, visual: SdfShape) -> bool:
    names = collision.attributes.get("shape"), visual.attributes.get("shape")
    return None in names or names[0] == names[1]
