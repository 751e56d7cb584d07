"""An SDF world after every include, pose and frame has been resolved: plain data, no XML."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict

from mazebot.common.maths.frames import Array
from mazebot.common.messages.documents import Rgba
from mazebot.worldgen.recipe_model import GeometryRecipe

MAZEBOT_NAMESPACE = "https://mazebot.example/sdf"
"""Namespace of data in exports that SDF cannot express; prefix `mazebot`."""


class Ignored(BaseModel):
    """An element of a file that is not simulated."""

    model_config = ConfigDict(frozen=True)

    what: str
    """e.g. `plugin gz-sim-physics-system`, `joint wheel_left (revolute)`, `state`"""
    where: str
    """file:line, and the element's path: `house.sdf:12: world default/model box`"""
    solid: bool = False
    """Whether something that can be hit is missing for that, or has another shape or place."""


class Renamed(BaseModel):
    """An element that was renamed because its name is taken."""

    model_config = ConfigDict(frozen=True)

    kind: str
    """joint, frame, ..."""
    name: str
    """In the file."""
    new_name: str
    where: str
    """As in Ignored."""


class SdfError(BaseModel):
    """An error in a file."""

    model_config = ConfigDict(frozen=True)

    kind: str
    """The specification's name of it, if it has one: DUPLICATE_NAME, RESERVED_NAME,
    ATTRIBUTE_MISSING, ELEMENT_MISSING, MODEL_WITHOUT_LINK, POSE_RELATIVE_TO_INVALID,
    POSE_RELATIVE_TO_CYCLE, URI_LOOKUP, ...
    """
    where: str
    message: str


class Included(BaseModel):
    """A file that was included by an <include>."""

    model_config = ConfigDict(frozen=True)

    uri: str
    name: str
    file: str


class ImportReport(BaseModel):
    """What an import found, included, renamed, ignored and refused."""

    model_config = ConfigDict(frozen=True)

    world: str
    """Name of the world; a model file yields a world of its name."""
    models: int
    """All, including nested and included ones."""
    links: int
    collisions: dict[str, int]
    """Number by type of geometry: box, cylinder, mesh, ..."""
    visuals: dict[str, int]
    materials: tuple[str, ...]
    """Each different material once: `script Gazebo/Wood`, `albedo bricks.png`, `rgba 1 0 0 1`"""
    includes: tuple[Included, ...]
    renamed: tuple[Renamed, ...]
    ignored: tuple[Ignored, ...]
    errors: tuple[SdfError, ...]
    missing: tuple[SdfError, ...] = ()
    """Pictures and meshes of visuals that cannot be had: what collides stands without them."""
    unsolid: tuple[str, ...] = ()
    """Links with visuals and no collision."""
    floor: str = ""
    """What became the floor, and how the world was moved for that; empty: z = 0 is the floor."""
    told: tuple[str, ...] = ()
    """Other warnings."""

    def warnings(self) -> tuple[str, ...]:
        """What the world lacks and runs without, a line each, with numbers and the first names."""
        lines = []
        if self.missing:
            first = self.missing[0]
            count = len(self.missing)
            what = "pictures and meshes of visuals are" if count > 1 else "picture or mesh is"
            lines.append(
                f"{count} {what} missing, and drawn without: {first.where}: {first.message}"
                + (f" (and {count - 1} more)" if count > 1 else "")
            )
        if self.unsolid:
            count, names = len(self.unsolid), ", ".join(self.unsolid[:_NAMED])
            more = f" and {count - _NAMED} more" if count > _NAMED else ""
            lines.append(
                f"{names}{more} {'have' if count > 1 else 'has'} a <visual> and no <collision>: "
                "nothing there can be hit, and the lidar sees nothing"
            )
        solid = [one for one in self.ignored if one.solid]
        if solid:
            told = ", ".join(f"{one.what} ({one.where})" for one in solid[:_NAMED])
            more = f" and {len(solid) - _NAMED} more" if len(solid) > _NAMED else ""
            lines.append(f"collisions are not all as in Gazebo, for want of: {told}{more}")
        return (*lines, *self.told)


_NAMED = 5


@dataclass(frozen=True, eq=False)
class SdfMaterial:
    """The material of a visual."""

    ambient: Rgba | None = None
    diffuse: Rgba | None = None
    script: str = ""
    """Name of a Gazebo material; if known, its colour is in ambient and diffuse."""
    albedo_map: Path | None = None
    """Path of an existing image."""


@dataclass(frozen=True, eq=False)
class SdfShape:
    """A collision or a visual."""

    role: Literal["collision", "visual"]
    name: str
    link_from_shape: Array
    geometry: GeometryRecipe
    """A mesh's `file` is the name alone; see `mesh_file`."""
    mesh_file: Path | None = None
    material: SdfMaterial | None = None
    attributes: dict[str, str] = field(default_factory=dict)
    """Those in the namespace of exports."""


@dataclass(frozen=True, eq=False)
class SdfLink:
    """A link of a model."""

    name: str
    """With its models' names: `outer::inner::link`"""
    model: str
    """`outer::inner`"""
    world_from_link: Array
    static: bool
    """Whether its outermost model is static, or has joints that are not simulated."""
    mass_kg: float
    fixed_to: str
    """Name of the link that fixed joints merge it into; its own name if there are none."""
    shapes: tuple[SdfShape, ...]
    attributes: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class SdfModel:
    """A model."""

    name: str
    """`outer::inner`"""
    static: bool
    world_from_model: Array
    attributes: dict[str, str] = field(default_factory=dict)
    drive: str = ""
    """The plugin that drives it, `plugin gz-sim-diff-drive-system`; empty: none does."""


@dataclass(frozen=True, eq=False)
class SdfLight:
    """A light."""

    kind: Literal["directional", "point", "spot"]
    name: str
    world_from_light: Array
    diffuse: Rgba
    direction: tuple[float, float, float]
    """In the light's frame."""
    range_m: float
    constant: float
    linear: float
    quadratic: float


@dataclass(frozen=True)
class FramePose:
    """The pose of a frame: for `mazebot world show --frames`."""

    kind: Literal["model", "link", "joint", "frame"]
    name: str
    """`outer::inner::frame`"""
    model_from_frame: Array
    """(4, 4) in the model that directly contains it; in the world for the world's children."""
    world_from_frame: Array


@dataclass(frozen=True, eq=False)
class SdfWorld:
    """The resolved content of a file."""

    file: Path
    name: str
    models: tuple[SdfModel, ...]
    links: tuple[SdfLink, ...]
    lights: tuple[SdfLight, ...]
    frames: tuple[FramePose, ...]
    ambient: Rgba | None
    """<scene><ambient>"""
    background: Rgba | None
    attributes: dict[str, str]
    """Texts by name in the world's element of the exports' namespace."""
    report: ImportReport
