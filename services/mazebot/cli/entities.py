"""`mazebot spawn`, `move`, `remove` and `entities`: the entities of a running stack."""

from __future__ import annotations

import base64
import hashlib
import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import numpy as np
import typer
from pydantic import ValidationError

from mazebot.cli.parsing.number_options import NumbersCommand, numbers
from mazebot.cli.parsing.options import ROUTER, Connect, Json, model_folders, print_json
from mazebot.common.config import ConfigError, one_line
from mazebot.common.maths.frames import (
    Array,
    position_and_quaternion,
    quaternion_from_rotation,
    quaternion_from_yaw,
    rotation_from_quaternion,
    rotation_from_rpy,
    transform_matrix,
    yaw_from_quaternion,
)
from mazebot.common.messages import documents as doc

if TYPE_CHECKING:
    from mazebot.common.client.robot import Robot
    from mazebot.worldgen.models.model_entity import Model

S = TypeVar("S", bound=doc.Document)

_TILTED = 1e-6
"""Sine of the tilt angle from which an entity is not upright."""

Timeout = Annotated[float, typer.Option("--timeout", min=0.1, help="seconds to wait for a reply")]
At = Annotated[str | None, typer.Option("--at", metavar="X Y [Z]", help="metres in the map")]
Yaw = Annotated[float | None, typer.Option(help="heading, rad; for a marker, of its face")]
Rpy = Annotated[
    str | None, typer.Option(metavar="R P Y", help="roll, pitch and yaw, rad, instead of --yaw")
]
Wall = Annotated[str | None, typer.Option(help="wall on which to place the marker")]
Side = Annotated[
    str | None,
    typer.Option(help="left (towards the wall's +y axis) or right [default: left]"),
]
Offset = Annotated[
    float | None,
    typer.Option(help="along the wall's x axis, from its centre, m [default: 0.0]"),
]
Height = Annotated[
    float | None,
    typer.Option(help="of the marker's centre above the floor, m [default: 0.4]"),
]

_NEEDS = {
    "--scale": "--mesh", "--models": "--model", "--size": "--marker", "--dictionary": "--marker",
    "--side": "--wall", "--offset": "--wall", "--height": "--wall",
    "--speed": "--path", "--loop": "--path", "--yield": "--path",
}  # fmt: skip
"""Options that say something only beside another one."""


def spawn(
    name: Annotated[str, typer.Argument(help="name of the entity")],
    box: Annotated[str | None, typer.Option(metavar="X Y Z", help="sides, m")] = None,
    cylinder: Annotated[
        str | None, typer.Option(metavar="R L", help="radius and length, m")
    ] = None,
    sphere: Annotated[str | None, typer.Option(metavar="R", help="radius, m")] = None,
    mesh: Annotated[Path | None, typer.Option(help=".dae, .obj, .stl, .glb or .gltf")] = None,
    scale: Annotated[
        str | None, typer.Option(metavar="S | X Y Z", help="of the mesh [default: 1]")
    ] = None,
    model: Annotated[
        str | None,
        typer.Option(help="folder of a model, its name, or an SDF, URDF or xacro file"),
    ] = None,
    models: Annotated[
        list[Path] | None,
        typer.Option(help="folder of models, as in GZ_SIM_RESOURCE_PATH; repeatable"),
    ] = None,
    marker: Annotated[int | None, typer.Option(min=0, help="id of an ArUco marker")] = None,
    size_m: Annotated[
        float | None, typer.Option("--size", help="side of its black square, m [default: 0.3]")
    ] = None,
    dictionary: Annotated[
        str | None, typer.Option(help="OpenCV's dictionary name [default: DICT_4X4_100]")
    ] = None,
    at: At = None,
    yaw: Yaw = None,
    rpy: Rpy = None,
    wall: Wall = None,
    side: Side = None,
    offset: Offset = None,
    height: Height = None,
    mass: Annotated[
        float | None, typer.Option(help="kg; 0: static [default: 0, or the model's]")
    ] = None,
    colour: Annotated[str | None, typer.Option(metavar="R G B", help="0 to 1 each")] = None,
    texture: Annotated[Path | None, typer.Option(help="PNG, stretched over each face")] = None,
    path: Annotated[
        str | None,
        typer.Option(metavar="X Y X Y ...", help="waypoints of a path to follow repeatedly"),
    ] = None,
    speed: Annotated[
        float | None, typer.Option(help="speed on the path, m/s [default: 0.5]")
    ] = None,
    loop: Annotated[
        bool | None, typer.Option("--loop", help="close the path, instead of going back along it")
    ] = None,
    yields: Annotated[
        bool | None,
        typer.Option(
            "--yield/--no-yield", help="stop while the robot blocks the path [default: yield]"
        ),
    ] = None,
    allow_renaming: Annotated[
        bool, typer.Option("--allow-renaming", help="if the name is in use, use a similar one")
    ] = False,
    timeout_s: Timeout = 10.0,
    as_json: Json = False,
    connect: Connect = ROUTER,
) -> None:
    """Spawn an entity in the world of a running stack, and print its pose."""
    from mazebot.common.client.over_zenoh import ZenohRobot  # noqa: PLC0415 - loads Zenoh

    kinds = {"--box": box, "--cylinder": cylinder, "--sphere": sphere, "--mesh": mesh,
             "--model": model, "--marker": marker}  # fmt: skip
    _check_one(kinds)
    _check_needs(
        {**kinds, "--scale": scale, "--models": models, "--size": size_m, "--path": path,
         "--dictionary": dictionary, "--wall": wall, "--side": side, "--offset": offset,
         "--height": height, "--speed": speed, "--loop": loop, "--yield": yields}
    )  # fmt: skip
    made: Model | None = None
    on_panel = None
    if marker is not None:
        size_m = 0.3 if size_m is None else size_m
        on_panel = _MarkerAsked(marker, size_m, dictionary or "DICT_4X4_100", 1)
    if mesh is not None or model is not None:
        made = _from_files(mesh, scale or "1", model, models)
        if made.marker:
            on_panel = _marker_of_model(made.marker)
    pose = _Pose.of(at, yaw, rpy)
    if on_panel is not None:
        looks = {"--mass": mass, "--colour": colour, "--texture": texture, "--path": path}
        for option, value in looks.items():
            if value is not None:
                raise ConfigError(f"{option}: must not be given for a marker")
        place = _WallPlace.of(wall, side, offset, height)
        on_panel.marker(pose, place)
        with ZenohRobot(connect) as robot:
            panel, assets = on_panel.entity(name, pose, place, robot, timeout_s)
            reply = _ask_spawn(robot, panel, assets, allow_renaming, timeout_s)
            _print_pose(reply, as_json, is_marker=True)
        return
    if wall is not None:
        raise ConfigError("--wall: only for markers: must be --at")
    made = _painted(made or _primitive(box, cylinder, sphere), colour, texture)
    route = None
    if path is not None:
        speed = 0.5 if speed is None else speed
        route = _route(path, speed, bool(loop), yields is not False)
    if mass is not None or route is not None:
        made = replace(made, mass_kg=mass or 0.0)
    entity = _body(name, made, pose, route)
    with ZenohRobot(connect) as robot:
        _print_pose(_ask_spawn(robot, entity, made.assets, allow_renaming, timeout_s), as_json)


def _check_one(kinds: Mapping[str, object]) -> None:
    """Raise ConfigError unless exactly one of these options is given."""
    given = [option for option, value in kinds.items() if value is not None]
    if not given:
        raise ConfigError(f"spawn: must be given one of {', '.join(kinds)}")
    if len(given) > 1:
        raise ConfigError(f"spawn: {' and '.join(given)}: must be given one of them only")


def _check_needs(values: Mapping[str, object]) -> None:
    """Raise ConfigError for an option that is given without the one that it belongs to."""
    for option, needed in _NEEDS.items():
        if values.get(option) is not None and values.get(needed) is None:
            raise ConfigError(f"{option}: must be given only with {needed}")


def move(
    name: str,
    at: At = None,
    yaw: Yaw = None,
    rpy: Rpy = None,
    wall: Wall = None,
    side: Side = None,
    offset: Offset = None,
    height: Height = None,
    timeout_s: Timeout = 10.0,
    as_json: Json = False,
    connect: Connect = ROUTER,
) -> None:
    """Move an entity of a running stack; values that are not given stay as they are."""
    from mazebot.common.client.over_zenoh import ZenohRobot  # noqa: PLC0415 - loads Zenoh
    from mazebot.common.client.subscription import running_world  # noqa: PLC0415
    from mazebot.common.messages.topics import GET_ENTITIES, SET_ENTITY_STATE  # noqa: PLC0415

    pose = _Pose.of(at, yaw, rpy)
    _check_needs({"--wall": wall, "--side": side, "--offset": offset, "--height": height})
    if wall is not None and pose != _Pose():
        raise ConfigError(f"--wall: {wall}: must not be given with a pose")
    if pose == _Pose() and wall is None:
        raise ConfigError("move: must be given --at, --yaw, --rpy or --wall")
    with ZenohRobot(connect) as robot:
        standing = robot.ask(GET_ENTITIES, doc.GetEntities(), timeout_s)
        entity = next((one for one in standing.entities if one.name == name), None)
        if entity is None:
            raise ConfigError(f"name: {name!r:.60}: {_none_of(standing)}")
        if wall is not None:
            if not isinstance(entity, doc.MarkerEntity):
                raise ConfigError("--wall: only for markers: must be --at")
            place = _WallPlace.of(wall, side, offset, height)
            matrix = place.map_from_panel(running_world(robot, timeout_s), entity.marker_size_m)
        else:
            matrix = pose.map_from_thing(entity)
        position_m, orientation_xyzw = position_and_quaternion(matrix)
        state = _document(
            doc.SetEntityState,
            name=name, position_m=position_m, orientation_xyzw=orientation_xyzw,
        )  # fmt: skip
        reply = robot.ask(SET_ENTITY_STATE, state, timeout_s)
        _print_pose(reply, as_json, isinstance(entity, doc.MarkerEntity))


def remove(
    names: Annotated[list[str] | None, typer.Argument(metavar="NAME...")] = None,
    everything: Annotated[
        bool, typer.Option("--all", help="all entities except the world's own markers")
    ] = False,
    timeout_s: Timeout = 10.0,
    connect: Connect = ROUTER,
) -> None:
    """Delete entities from the world of a running stack."""
    from mazebot.common.client.over_zenoh import ZenohRobot  # noqa: PLC0415 - loads Zenoh
    from mazebot.common.client.subscription import running_world  # noqa: PLC0415
    from mazebot.common.messages.topics import DELETE_ENTITY, GET_ENTITIES  # noqa: PLC0415

    if bool(names) == everything:
        raise ConfigError("remove: must be given names, or --all")
    wrong = []
    with ZenohRobot(connect) as robot:
        if everything:
            standing = robot.ask(GET_ENTITIES, doc.GetEntities(), timeout_s)
            own = {one.name for one in running_world(robot, timeout_s).markers}
            names = [one.name for one in standing.entities if one.name not in own]
        for name in names or ():
            reply = robot.ask(DELETE_ENTITY, doc.DeleteEntity(name=name), timeout_s)
            if reply.error:
                wrong.append(reply.error)
            else:
                sys.stdout.write(f"{name}: removed\n")
    if wrong:
        raise ConfigError("; ".join(wrong))


def entities(
    as_json: Json = False,
    timeout_s: Timeout = 10.0,
    connect: Connect = ROUTER,
) -> None:
    """List the entities in the world of a running stack, and those that were rejected."""
    from mazebot.common.client.over_zenoh import ZenohRobot  # noqa: PLC0415 - loads Zenoh
    from mazebot.common.messages.topics import GET_ENTITIES  # noqa: PLC0415

    with ZenohRobot(connect) as robot:
        standing = robot.ask(GET_ENTITIES, doc.GetEntities(), timeout_s)
    if as_json:
        print_json(standing.model_dump(mode="json"))
        return
    rows: list[tuple[str, ...]] = [
        ("name", "kind", "x m", "y m", "z m", "yaw rad", "mass kg", "path")
    ]
    rows += [_row(one) for one in standing.entities]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    for row in rows:
        cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=True)]
        sys.stdout.write("  ".join(cells).rstrip() + "\n")
    for refusal in standing.refused:
        sys.stdout.write(f"rejected: {refusal.name}: {refusal.reason}\n")


def register(app: typer.Typer) -> None:
    """Add this module's commands to the app."""
    for command in (spawn, move, remove, entities):
        app.command(cls=NumbersCommand)(command)


@dataclass(frozen=True)
class _Pose:
    """A pose as given by the user; None: not given."""

    at_m: tuple[float, ...] | None = None
    yaw_rad: float | None = None
    rpy_rad: tuple[float, ...] | None = None

    @classmethod
    def of(cls, at: str | None, yaw: float | None, rpy: str | None) -> _Pose:
        if yaw is not None and rpy is not None:
            raise ConfigError("--yaw: must not be given with --rpy")
        if yaw is not None and not math.isfinite(yaw):
            raise ConfigError(f"--yaw: {yaw}: must be a finite number")
        return cls(
            numbers("--at", at, 2, 3) if at is not None else None,
            yaw,
            numbers("--rpy", rpy, 3) if rpy is not None else None,
        )

    def rotation(self, is_marker: bool) -> Array | None:
        """(3, 3) map_from_thing; None where no rotation is given."""
        if self.rpy_rad is not None:
            return rotation_from_rpy(*self.rpy_rad)
        if self.yaw_rad is None:
            return None
        if not is_marker:
            return rotation_from_quaternion(*quaternion_from_yaw(self.yaw_rad))
        from mazebot.common.world.placement import upright  # noqa: PLC0415

        return upright(self.yaw_rad)

    def map_from_thing(self, entity: doc.Entity) -> Array:
        """(4, 4): as given, the rest from the entity's pose."""
        rotation = self.rotation(isinstance(entity, doc.MarkerEntity))
        if rotation is None:
            rotation = rotation_from_quaternion(*entity.orientation_xyzw)
        x, y, z = (*(self.at_m or ()), *entity.position_m[len(self.at_m or ()) :])
        return transform_matrix(rotation, (x, y, z))


@dataclass(frozen=True)
class _WallPlace:
    """A position on a wall, given as for a recipe's markers."""

    wall: str | None
    side: str
    offset_m: float
    height_m: float

    @classmethod
    def of(
        cls, wall: str | None, side: str | None, offset_m: float | None, height_m: float | None
    ) -> _WallPlace:
        """As given by the user; None: not given."""
        return cls(
            wall,
            "left" if side is None else side,
            0.0 if offset_m is None else offset_m,
            0.4 if height_m is None else height_m,
        )

    def marker(self, id_: int, size_m: float, dictionary: str, quiet_zone: int) -> doc.Marker:
        """The marker there. Raises ConfigError."""
        return _document(
            doc.Marker, id=id_, size_m=size_m, dictionary=dictionary, side=self.side,
            quiet_zone_modules=quiet_zone, wall=self.wall or "", offset_m=self.offset_m,
            height_m=self.height_m,
        )  # fmt: skip

    def map_from_panel(self, world: doc.World, size_m: float) -> Array:
        """(4, 4). Raises ConfigError if the wall does not exist."""
        from mazebot.common.world.marker_entities import PanelStyle  # noqa: PLC0415
        from mazebot.common.world.placement import hang  # noqa: PLC0415

        host = next((one for one in world.walls if one.name == self.wall), None)
        if host is None:
            known = ", ".join(one.name for one in world.walls)
            raise ConfigError(f"--wall: {self.wall!r:.60}: must be one of {known:.300}")
        marker = self.marker(0, size_m, "DICT_4X4_100", 1)
        return hang("", marker, host, size_m, PanelStyle().gap_m).map_from_panel


@dataclass(frozen=True)
class _MarkerAsked:
    """A requested ArUco marker."""

    id: int
    size_m: float
    dictionary: str
    quiet_zone: int

    def marker(self, pose: _Pose, place: _WallPlace) -> doc.Marker:
        """The marker. Raises ConfigError where it does not exist, or its pose is not given."""
        from mazebot.common.world import marker_picture  # noqa: PLC0415

        marker = place.marker(self.id, self.size_m, self.dictionary, self.quiet_zone)
        problem = marker_picture.identity_problem(marker)
        if problem:
            raise ConfigError(f"spawn: {problem}")
        if place.wall is not None:
            if pose != _Pose():
                raise ConfigError(f"--wall: {place.wall}: must not be given with a pose")
        elif pose.at_m is None or len(pose.at_m) != 3 or pose.rotation(is_marker=True) is None:
            raise ConfigError(f"--marker: {self.id}: must be given --wall, or --at X Y Z and --yaw")
        return marker

    def entity(
        self, name: str, pose: _Pose, place: _WallPlace, robot: Robot, timeout_s: float
    ) -> tuple[doc.MarkerEntity, dict[str, bytes]]:
        """The entity and its texture. Raises ConfigError."""
        from mazebot.common.client.subscription import running_world  # noqa: PLC0415
        from mazebot.common.world.marker_entities import drawn_marker  # noqa: PLC0415

        marker = self.marker(pose, place)
        if place.wall is not None:
            matrix = place.map_from_panel(running_world(robot, timeout_s), self.size_m)
        else:
            rotation = pose.rotation(is_marker=True)
            assert rotation is not None
            assert pose.at_m is not None
            x, y, z = pose.at_m
            matrix = transform_matrix(rotation, (x, y, z))
        return drawn_marker(name, marker, matrix)


def _marker_of_model(noted: dict[str, str]) -> _MarkerAsked:
    try:
        return _MarkerAsked(
            int(noted["marker"]),
            float(noted["size_m"]),
            noted["dictionary"],
            int(noted.get("quiet_zone_modules", "1")),
        )
    except (KeyError, ValueError) as error:
        raise ConfigError("--model: is a marker model without its size and id") from error


def _from_files(
    mesh: Path | None, scale: str, model: str | None, models: list[Path] | None
) -> Model:
    from mazebot.worldgen.models.model_entity import find_model, read_mesh, read_model  # noqa: PLC0415

    if mesh is not None:
        factors = numbers("--scale", scale, 1, 3)
        return read_mesh(mesh, factors * 3 if len(factors) == 1 else factors)
    roots = model_folders("--models", models)
    found = read_model(find_model(model or "", roots), roots)
    if found.missing:
        more = f" (and {len(found.missing) - 1} more)" if len(found.missing) > 1 else ""
        sys.stderr.write(f"warning: --model: drawn without {found.missing[0]}{more}\n")
    return found


def _primitive(box: str | None, cylinder: str | None, sphere: str | None) -> Model:
    from mazebot.worldgen.models.model_entity import Model  # noqa: PLC0415

    geometry: doc.Geometry
    if box is not None:
        geometry = _document(doc.Box, "--box", size_m=numbers("--box", box, 3))
    elif cylinder is not None:
        radius_m, length_m = numbers("--cylinder", cylinder, 2)
        geometry = _document(doc.Cylinder, "--cylinder", radius_m=radius_m, length_m=length_m)
    else:
        (radius_m,) = numbers("--sphere", sphere or "", 1)
        geometry = _document(doc.Sphere, "--sphere", radius_m=radius_m)
    shape = doc.Shape(name=geometry.kind, geometry=geometry, material="plain")
    plain = doc.Material(name="plain", ambient=(0.7, 0.7, 0.7, 1.0), diffuse=(0.7, 0.7, 0.7, 1.0))
    return Model((shape,), (plain,), 0.0, {}, {}, {})


def _painted(made: Model, colour: str | None, texture: Path | None) -> Model:
    """The model with one material for all visuals, if a colour or a texture is given."""
    from mazebot.worldgen.models.model_entity import texture_asset  # noqa: PLC0415

    if colour is None and texture is None:
        return made
    red, green, blue = numbers("--colour", colour or "1 1 1", 3)
    if not all(0.0 <= value <= 1.0 for value in (red, green, blue)):
        raise ConfigError(f"--colour: {colour!r:.60}: must be 0 to 1 each")
    files: dict[str, bytes] = {}
    sha256 = ""
    if texture is not None:
        data = texture_asset(texture)
        sha256 = hashlib.sha256(data).hexdigest()
        files[sha256] = data
    rgba = red, green, blue, 1.0
    paint = doc.Material(
        name="paint", texture_sha256=sha256, texture_name=texture.name if texture else "",
        texture_side_m=0.0, ambient=rgba, diffuse=rgba,
    )  # fmt: skip
    shapes = tuple(
        shape.model_copy(update={"material": "paint"}) if shape.material else shape
        for shape in made.shapes
    )
    meshes = {sha: data for sha, data in made.assets.items() if sha in made.meshes}
    return replace(made, shapes=shapes, materials=(paint,), assets=meshes | files)


def _route(path: str, speed: float, loop: bool, yields: bool) -> doc.ScriptedPath:
    values = numbers("--path", path)
    if not values or len(values) % 2:
        raise ConfigError(f"--path: {len(values)} numbers: must be pairs of x and y")
    places = tuple(zip(values[::2], values[1::2], strict=True))
    return _document(
        doc.ScriptedPath, "--path", waypoints_m=places, speed_m_s=speed, loop=loop, yields=yields
    )


def _body(name: str, made: Model, pose: _Pose, route: doc.ScriptedPath | None) -> doc.BodyEntity:
    """The entity, on the floor if no height is given. Raises ConfigError."""
    from mazebot.worldgen.models.model_entity import lowest_m  # noqa: PLC0415

    if pose.at_m is None:
        raise ConfigError("spawn: must be given --at X Y [Z]")
    rotation = pose.rotation(is_marker=False)
    orientation = quaternion_from_rotation(np.eye(3) if rotation is None else rotation)
    x, y = pose.at_m[:2]
    z = pose.at_m[2] if len(pose.at_m) > 2 else -lowest_m(made.shapes, made.meshes, orientation)
    return _document(
        doc.BodyEntity,
        name=name, position_m=(x, y, z), orientation_xyzw=orientation, mass_kg=made.mass_kg,
        shapes=made.shapes, materials=made.materials, path=route,
    )  # fmt: skip


def _document(kind: type[S], option: str = "spawn", **values: Any) -> S:
    """Raises ConfigError, in one line, where a value is wrong."""
    try:
        return kind(**values)
    except ValidationError as error:
        raise ConfigError(f"{option}: {one_line(error)}") from error


def _ask_spawn(
    robot: Robot,
    entity: doc.Entity,
    assets: dict[str, bytes],
    allow_renaming: bool,
    timeout_s: float,
) -> doc.EntityReply:
    from mazebot.common.messages.topics import SPAWN_ENTITY  # noqa: PLC0415

    encoded = {sha256: base64.b64encode(data).decode() for sha256, data in assets.items()}
    request = doc.SpawnEntity(entity=entity, allow_renaming=allow_renaming, assets=encoded)
    return robot.ask(SPAWN_ENTITY, request, timeout_s)


def _none_of(standing: doc.Entities) -> str:
    names = ", ".join(one.name for one in standing.entities)
    return f"no such entity: must be one of {names:.300}" if names else "no entities"


def _heading(orientation_xyzw: doc.Quaternion, is_marker: bool) -> float:
    """Heading of a body's x axis, or of a marker's face, in the map."""
    if is_marker:
        normal = rotation_from_quaternion(*orientation_xyzw)[:, 2]
        return math.atan2(normal[1], normal[0])
    return yaw_from_quaternion(*orientation_xyzw)


def _row(entity: doc.Entity) -> tuple[str, ...]:
    is_marker = isinstance(entity, doc.MarkerEntity)
    yaw_rad = _heading(entity.orientation_xyzw, is_marker)
    what, mass, path = "body", "", ""
    if isinstance(entity, doc.MarkerEntity):
        what = f"marker {entity.marker_id} ({entity.dictionary})"
    else:
        mass = f"{entity.mass_kg:g}"
        if entity.path is not None:
            kind = "loop" if entity.path.loop else "back and forth"
            count = len(entity.path.waypoints_m)
            path = f"{count} waypoint{'s' * (count > 1)}, {entity.path.speed_m_s:g} m/s, {kind}"
    place = map(_short, (*entity.position_m, yaw_rad))
    return (entity.name, what, *place, mass, path)


def _print_pose(reply: doc.EntityReply, as_json: bool, is_marker: bool = False) -> None:
    """Print an entity's pose. Raises ConfigError where the request failed."""
    if reply.error:
        named = reply.error.startswith("name:")
        raise ConfigError(reply.error if named else f"{reply.name}: {reply.error}")
    if as_json:
        print_json(reply.model_dump(mode="json"))
        return
    x, y, z = (_short(value) for value in reply.position_m)
    up = rotation_from_quaternion(*reply.orientation_xyzw)[2]
    turned = f"yaw {_short(_heading(reply.orientation_xyzw, is_marker))} rad"
    if math.hypot(up[0], up[1] - 1.0 if is_marker else up[1]) > _TILTED:
        turned = "quaternion ({:.4f}, {:.4f}, {:.4f}, {:.4f})".format(*reply.orientation_xyzw)
    sys.stdout.write(f"{reply.name}: ({x}, {y}, {z}) m, {turned}\n")


def _short(value: float) -> str:
    """Three decimals, and no -0.000."""
    return f"{round(value, 3) + 0.0:.3f}"
