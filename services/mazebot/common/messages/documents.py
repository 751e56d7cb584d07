"""Mazebot's own JSON documents, sent in std_msgs/String where ROS has no message type.

Each one is a frozen pydantic model: unknown keys and non-finite numbers are refused.
Lengths are metres, angles radians, times seconds of simulation, in the frame `map` unless a name
says otherwise.
"""

from __future__ import annotations

import hashlib
import json
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    JsonValue,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from mazebot.common.maths.frames import SE2

Rgba = tuple[float, float, float, float]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Point2 = tuple[Finite, Finite]
Vector = tuple[Finite, Finite, Finite]
Quaternion = tuple[Finite, Finite, Finite, Finite]


class Document(BaseModel):
    """A message type of Mazebot."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class WorldRequest(Document):
    """The requested world; `bringup` publishes it latched."""

    world_name: str = Field(description="name of a recipe in worlds/, e.g. `sim_house_enhanced`")
    use_aruco: bool = Field(True, description="keep the recipe's ArUco markers")
    overrides: tuple[str, ...] = Field(
        (), description="`field=value` in YAML, overrides the recipe's value: `maze.seed=3`"
    )
    slam: bool = Field(False, description="`mapping` makes the map and localises the robot in it")
    explore: bool = Field(True, description="with `slam`: `explorer` drives by itself")

    @property
    def explores(self) -> bool:
        """Whether `explorer` drives."""
        return self.slam and self.explore


class WorldStatus(Document):
    """The result of a world request: `error` is empty where the world was loaded."""

    request: WorldRequest
    world_hash: str = Field(
        "", description="hash of the running world, from this request or another one"
    )
    error: str = Field("", description="one line: what is wrong, and what is allowed")


class Planar(Document):
    """A planar pose in the map frame."""

    x_m: Finite = Field(description="m")
    y_m: Finite = Field(description="m")
    yaw_rad: Finite = Field(description="counter-clockwise from x, rad")

    def se2(self) -> SE2:
        """The same pose as a transform, map_from_self."""
        return SE2(self.x_m, self.y_m, self.yaw_rad)


class Location(Planar):
    """A named place to drive to."""

    name: str = Field(description="unique in its world")


class Material(Document):
    """How a surface looks: a texture by content hash, and the colours used where there is none."""

    name: str
    texture_sha256: str = Field("", description="asset of the texture; empty: plain colour")
    texture_name: str = Field("", description="file name of the texture, for people")
    texture_side_m: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = Field(
        1.0,
        description="length on a surface of one tile's side; 0: stretched once over each face, as "
        "Gazebo does. Meshes have texture coordinates of their own.",
    )
    ambient: Rgba = (1.0, 1.0, 1.0, 1.0)
    diffuse: Rgba = (1.0, 1.0, 1.0, 1.0)


class Covering(Document):
    """A section of a wall's face, from the floor to the top, with its own material."""

    side: Literal["left", "right"] = Field(description="as a marker's")
    from_m: Finite = Field(description="along the wall's x axis, from its centre")
    to_m: Finite = Field(description="greater than `from_m`")
    material: str = Field(description="name of a material of the world")


class Wall(Document):
    """An upright box on the floor. Its x axis runs along its length, y across its thickness."""

    name: str
    length_m: Positive
    thickness_m: Positive
    height_m: Positive
    x_m: Finite = Field(description="centre")
    y_m: Finite = Field(description="centre")
    yaw_rad: Finite
    material: str = Field(description="name of a material of the world")
    coverings: tuple[Covering, ...] = Field((), description="none overlap")

    def map_from_wall(self) -> SE2:
        """Pose of the wall's centre."""
        return SE2(self.x_m, self.y_m, self.yaw_rad)


class Marker(Document):
    """An ArUco marker, given by the wall it hangs on. `offset_m` runs along the wall's x axis from
    the wall's centre.
    """

    id: Annotated[int, Field(ge=0, le=100_000)] = Field(description="unique in the world")
    dictionary: str = Field(
        "DICT_4X4_100", description="OpenCV's name, or a file in the folder dictionaries/"
    )
    size_m: Positive = Field(0.3, description="side of the black square")
    quiet_zone_modules: Annotated[int, Field(ge=1, le=16)] = Field(
        1, description="width of the white quiet zone around it, in modules of the marker"
    )
    wall: str = Field(description="name of a wall")
    side: Literal["left", "right"] = Field(
        description="the face towards the wall's +y axis (left) or -y axis (right)"
    )
    offset_m: Finite = Field(0.0, description="along the wall's x axis, from its centre")
    height_m: Finite = Field(description="of the marker's centre above the floor")

    @property
    def name(self) -> str:
        """Name of the entity of a marker that is part of the world."""
        return f"aruco_{self.id}"


class Box(Document):
    """Centred at its origin."""

    kind: Literal["box"] = "box"
    size_m: tuple[Positive, Positive, Positive]


class Cylinder(Document):
    """Along z, centred at its origin."""

    kind: Literal["cylinder"] = "cylinder"
    radius_m: Positive
    length_m: Positive


class Cone(Document):
    """Along z, centred at half its height, its tip at +z."""

    kind: Literal["cone"] = "cone"
    radius_m: Positive
    length_m: Positive


class Capsule(Document):
    """A cylinder along z with a half sphere on either end; `length_m` is the cylinder's."""

    kind: Literal["capsule"] = "capsule"
    radius_m: Positive
    length_m: Positive


class Sphere(Document):
    """Centred at its origin."""

    kind: Literal["sphere"] = "sphere"
    radius_m: Positive


class Ellipsoid(Document):
    """Centred at its origin."""

    kind: Literal["ellipsoid"] = "ellipsoid"
    radii_m: tuple[Positive, Positive, Positive]


class Plane(Document):
    """A flat rectangle at z = 0, visible and solid from +z only."""

    kind: Literal["plane"] = "plane"
    size_m: tuple[Positive, Positive]


class Polyline(Document):
    """Simple polygons in the plane z = 0, raised to `height_m`; one within another is a hole."""

    kind: Literal["polyline"] = "polyline"
    polygons_m: tuple[tuple[Point2, ...], ...]
    height_m: Positive


class Mesh(Document):
    """Triangles from an asset."""

    kind: Literal["mesh"] = "mesh"
    sha256: str = Field(description="asset of the triangles, as geometry.mesh_to_bytes writes them")
    name: str = Field("", description="file, and submesh, that it came from, for people")
    scale: Vector = Field((1.0, 1.0, 1.0), description="none is zero")


Geometry = Annotated[
    Box | Cylinder | Cone | Capsule | Sphere | Ellipsoid | Plane | Polyline | Mesh,
    Field(discriminator="kind"),
]


class Shape(Document):
    """A part of a body: visual, collision geometry, or both."""

    name: str
    geometry: Geometry
    position_m: Vector = Field((0.0, 0.0, 0.0), description="in the body's frame")
    orientation_xyzw: Quaternion = Field((0.0, 0.0, 0.0, 1.0), description="body_from_shape")
    material: str = Field("", description="name of a material of the world; empty: invisible")
    solid: bool = Field(True, description="the robot, the lidar and the map take it into account")


class Body(Document):
    """A rigid body of any shapes. Walls are not bodies."""

    name: str
    position_m: Vector
    orientation_xyzw: Quaternion = (0.0, 0.0, 0.0, 1.0)
    mass_kg: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = Field(
        0.0, description="0: it never moves"
    )
    shapes: tuple[Shape, ...]

    @property
    def moves(self) -> bool:
        """Whether it can ever leave its pose."""
        return self.mass_kg > 0.0


class Room(Document):
    """A named part of the floor."""

    name: str
    polygon_m: tuple[Point2, ...] = Field(description="its corners, in order")
    floor_material: str = Field("", description="empty: the world's")


class KeepoutZone(Document):
    """A part of the floor where the robot must not drive."""

    name: str
    polygon_m: tuple[Point2, ...] = Field(min_length=3, description="its corners, in order")


class SpeedZone(Document):
    """A part of the floor where the robot must be slow: one of the two limits is given."""

    name: str
    polygon_m: tuple[Point2, ...] = Field(min_length=3, description="its corners, in order")
    speed_limit_m_s: Positive | None = None
    percent: Positive | None = Field(None, description="of the controller's highest speed")


class Ceiling(Document):
    """A flat ceiling over all walls."""

    height_m: Positive
    material: str


class PointLight(Document):
    """A lamp. At distance d within `range_m` its light is diffuse / (constant + linear d +
    quadratic d^2), as in SDF; beyond it is 0.
    """

    name: str
    position_m: Vector
    diffuse: Rgba = (1.0, 1.0, 1.0, 1.0)
    range_m: Positive = 10.0
    constant: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 1.0
    linear: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 0.0
    quadratic: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = 0.0


DICTIONARY_FILES = (".yml", ".yaml", ".json", ".xml")
"""Endings of files of custom ArUco dictionaries."""


class MarkerDictionary(Document):
    """The codes of a dictionary of ArUco markers that is not one of OpenCV's."""

    name: str = Field(description="as markers give it: that of its file")
    modules: Annotated[int, Field(ge=2, le=16)] = Field(
        description="along a marker's side, without its border"
    )
    max_correction_bits: Annotated[int, Field(ge=0)] = 0
    codes: tuple[Annotated[str, Field(pattern="^[01]+$")], ...] = Field(
        min_length=1, description="by id: its modules row by row, 0 black, 1 white"
    )

    @model_validator(mode="after")
    def _fits_its_size(self) -> MarkerDictionary:
        digits = self.modules * self.modules
        if any(len(code) != digits for code in self.codes):
            raise ValueError(f"codes: each must have {digits} digits (modules {self.modules})")
        return self


class MappedMarker(Document):
    """A marker as it was found when the map was made."""

    dictionary: str
    marker_id: Annotated[int, Field(ge=0)]
    position_m: Vector
    orientation_xyzw: Quaternion = Field(description="x to its right, y up, z out of its face")


class World(Document):
    """A resolved world: everything it contains, with the hash that identifies it; and how this run
    knows it, which is not part of the hash.
    """

    name: str
    recipe: str = Field(description="file name of the recipe it came from")
    hash: str = Field(description="sha256 of everything else here, first 16 hex digits")
    walls: tuple[Wall, ...]
    materials: tuple[Material, ...]
    markers: tuple[Marker, ...] = ()
    dictionaries: tuple[MarkerDictionary, ...] = Field(
        (), description="those of the markers that are not OpenCV's"
    )
    bodies: tuple[Body, ...] = ()
    rooms: tuple[Room, ...] = ()
    locations: tuple[Location, ...] = ()
    keepout_zones: tuple[KeepoutZone, ...] = ()
    speed_limits: tuple[SpeedZone, ...] = ()
    start: Planar
    map_resolution_m: Positive = 0.05
    map_sha256: str = Field("", description="of a ready map's cells; empty: made from the world")
    floor_material: str = Field("", description="name of a material; empty: plain grey")
    ceiling: Ceiling | None = None
    lights: tuple[PointLight, ...] = ()
    sky: Rgba = (0.7, 0.7, 0.7, 1.0)
    light_direction: tuple[Finite, Finite, Finite] = (-0.5, 0.1, -0.9)
    light_ambient: Finite = 0.8
    light_diffuse: Finite = 0.8
    slam: bool = Field(False, description="the robot gets no map: `mapping` makes one")
    explore: bool = Field(False, description="with `slam`: `explorer` drives by itself")
    mapped_markers: tuple[MappedMarker, ...] | None = Field(
        None, description="the markers that the robot knows; none given: all, where they hang"
    )

    @model_serializer(mode="wrap")
    def _without_empty(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """A world without zones, dictionaries and a map of its own is written, and so hashed, as
        if these did not exist.
        """
        content: dict[str, Any] = handler(self)
        for field in ("keepout_zones", "speed_limits", "dictionaries", "slam", "explore"):
            if not content.get(field, True):
                del content[field]
        if content.get("mapped_markers", ()) is None:
            del content["mapped_markers"]
        return content

    def content_hash(self) -> str:
        """The value that `hash` must have."""
        known = {"hash", "slam", "explore", "mapped_markers"}
        content = json.dumps(self.model_dump(mode="json", exclude=known), sort_keys=True)
        return hashlib.sha256(content.encode()).hexdigest()[:16]


class MarkerEntity(Document):
    """An ArUco marker on its panel. Its pose is that of the panel's centre; its face points along
    +z, with +x to the right and +y up seen from the front.
    """

    name: str
    kind: Literal["marker"] = "marker"
    position_m: Vector
    orientation_xyzw: Quaternion
    panel_side_m: Positive = Field(description="side of the panel, with the quiet zone")
    texture_sha256: str
    marker_id: int
    marker_size_m: Positive = Field(description="side of the black square")
    dictionary: str


MAX_PATH_SPEED_M_S = 5.0


class ScriptedPath(Document):
    """A path that a body follows repeatedly at constant speed, facing forward: from its pose to
    each waypoint in order, then straight back to its pose (`loop`) or back along the same path.
    """

    waypoints_m: tuple[Point2, ...] = Field(min_length=1, max_length=1000)
    speed_m_s: Annotated[float, Field(gt=0.0, le=MAX_PATH_SPEED_M_S, allow_inf_nan=False)]
    loop: bool = False
    yields: bool = Field(True, description="stops while the robot blocks its path")


class BodyEntity(Document):
    """A rigid body of any shapes that was spawned in a world. Its pose is that of its origin."""

    name: str
    kind: Literal["body"] = "body"
    position_m: Vector
    orientation_xyzw: Quaternion = (0.0, 0.0, 0.0, 1.0)
    mass_kg: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = Field(
        0.0, description="0: moved only by its path, if it has one"
    )
    shapes: tuple[Shape, ...] = Field(min_length=1)
    materials: tuple[Material, ...] = Field((), description="the materials that its shapes name")
    path: ScriptedPath | None = Field(None, description="needs mass_kg 0")
    placed: Annotated[int, Field(ge=0)] = Field(
        0,
        description="counts how often it was put at its pose: a new count moves it back to its "
        "pose if it has moved since",
    )

    @property
    def moves(self) -> bool:
        """Whether it can leave its pose without being set to another one."""
        return self.mass_kg > 0.0 or self.path is not None


Entity = Annotated[MarkerEntity | BodyEntity, Field(discriminator="kind")]
Thing = Body | BodyEntity


class Refusal(Document):
    """An entity that was refused, and why."""

    name: str
    reason: str


class Entities(Document):
    """A set of entities of one world: the desired set, or the set that exists."""

    world_hash: str
    revision: Annotated[int, Field(ge=0)] = Field(
        0,
        description="number of the desired set; in the set that exists: number of the desired set "
        "that it answers. 0: the first set of a spawner that has just started. If a set exists "
        "already, it is kept, and only entities that were refused before are tried again",
    )
    entities: tuple[Entity, ...] = ()
    refused: tuple[Refusal, ...] = ()

    @property
    def markers(self) -> tuple[MarkerEntity, ...]:
        """The entities that are markers, in order."""
        return tuple(one for one in self.entities if isinstance(one, MarkerEntity))

    @property
    def bodies(self) -> tuple[BodyEntity, ...]:
        """The entities that are bodies, in order."""
        return tuple(one for one in self.entities if isinstance(one, BodyEntity))


class Contact(Document):
    """A contact of the robot with anything but the floor has begun."""

    time_s: Finite = Field(description="simulation time, s")
    robot_link: str = Field(description="link of the robot")
    body: str = Field(description="name of the wall, body or entity it collided with")
    position_m: tuple[Finite, Finite, Finite] = Field(description="x, y, z in `map`, m")
    impulse_n_s: Finite = Field(description="impulse of the first step, N s")


class SpawnEntity(Document):
    """Requests that an entity be spawned. Repeating the same request changes nothing."""

    entity: Entity
    allow_renaming: bool = Field(
        False,
        description="if the name is taken, use the first free one: `name_1`",
    )
    assets: dict[str, str] = Field(
        default_factory=dict,
        description="textures (PNG) and meshes (npz) of the entity, base64, by their sha256",
    )


class DeleteEntity(Document):
    """Requests that an entity be deleted."""

    name: str


class SetEntityState(Document):
    """Requests that an entity be moved to another pose."""

    name: str
    position_m: Vector
    orientation_xyzw: Quaternion = (0.0, 0.0, 0.0, 1.0)


class EntityReply(Document):
    """The result of an entity request: the entity's pose, or the reason of the failure."""

    error: str = Field("", description="one line; empty: done")
    name: str = Field("", description="name of the entity in the world")
    position_m: Vector = (0.0, 0.0, 0.0)
    orientation_xyzw: Quaternion = (0.0, 0.0, 0.0, 1.0)


class GetEntities(Document):
    """Requests the list of entities in the world."""


MIN_SPEED = 0.01
"""The smallest factor of real time at which simulation time can pass."""


def _as_fast_as_possible_or_a_factor(speed: float) -> float:
    if 0.0 < speed < MIN_SPEED:
        raise ValueError(f"must be 0 (as fast as possible) or at least {MIN_SPEED:g}")
    return speed


Speed = Annotated[
    float,
    Field(ge=0.0, le=1000.0, allow_inf_nan=False),
    AfterValidator(_as_fast_as_possible_or_a_factor),
]
"""Simulated seconds a second; 0: as fast as possible."""


class SimulationControl(Document):
    """Requests a pause, resume or reset of the simulation. Fields that are None change nothing.

    Of several fields in one request, `reset` is done first, then the rest. The reply to `step` and
    `run_until_s` is sent when they are done; both leave the simulation paused.
    """

    pause: bool | None = None
    step: Annotated[int, Field(ge=1, le=10_000_000)] | None = Field(
        None, description="advance by this number of steps"
    )
    run_until_s: Annotated[float, Field(ge=0.0, le=1e9, allow_inf_nan=False)] | None = Field(
        None, description="advance to this simulation time"
    )
    reset: Literal["all", "time"] | None = Field(
        None,
        description="`all`: everything returns to its initial state, at time 0; `time`: only the "
        "clock restarts",
    )
    seed: Annotated[int, Field(ge=0, lt=2**63)] | None = Field(
        None, description="new seed of the random streams; needs `reset: all`"
    )
    speed: Speed | None = Field(
        None, description="simulated seconds a second; 0: as fast as possible"
    )
    robot_pose: Planar | None = Field(
        None,
        description="moves the robot to this pose of base_footprint, at rest, as if it had been "
        "carried there: neither odometry nor navigation is told",
    )


class SimulationStats(Document):
    """What the simulation has done so far. Holds nothing read from a wall clock."""

    world_hash: str
    sim_time_s: Finite
    iterations: int
    step_size_s: Positive
    paused: bool = False
    speed: Annotated[float, Field(ge=0.0, allow_inf_nan=False)] = Field(
        1.0, description="requested simulated seconds a second; 0: as fast as possible"
    )
    seed: int = Field(0, description="seed of the random streams")
    epoch: int = Field(
        0, description="counts the starts: load, reset, and every rebuild of the world"
    )
    entities: int = Field(0, description="number of entities in the world")
    renderer: str = Field(
        description="`cpu_rasterizer`, `moderngl (...)`, `tiny_renderer`, or `none`"
    )
    state_hash: str = Field(
        description="chained hash of the states of robot and bodies after every step of this epoch"
    )
    image_hash: str = Field("", description="chained hash of the camera images of this epoch")
    watchdog_stops: int = Field(0, description="times the velocity watchdog stopped the robot")


class SimulationControlReply(Document):
    """The state of the simulation after a request."""

    error: str = Field("", description="one line; empty: done")
    stats: SimulationStats | None = Field(None, description="None before a world is loaded")


class LocalizationStatus(Document):
    """Whether the robot's pose in the map can be trusted."""

    state: Literal["uninitialized", "searching", "localized", "lost"] = Field(
        description="`uninitialized`: no scan or no initial pose yet; `searching`: global "
        "localisation; `lost`: the scans or the markers contradict the pose"
    )
    quality: Finite = Field(
        description="0 to 1: share of the lidar's returns that the map explains from this pose"
    )
    reason: str = Field("", description="why the pose is not trusted, in one line")
    wants_motion: bool = Field(False, description="the robot must move for the pose to be found")
    epoch: int | None = Field(None, description="the simulation's epoch; null before it is known")


class NavigationStatus(Document):
    """The state of localisation and navigation."""

    localization_active: bool
    navigation_active: bool
    state: Literal["idle", "planning", "controlling", "recovering"] = "idle"
    goal: Planar | None = None
    distance_remaining_m: Finite = 0.0
    number_of_recoveries: int = 0


class NavigationResult(Document):
    """The result of a goal, with Nav2's error codes (0 is success)."""

    goal: Planar
    goal_stamp_ns: int = Field(description="stamp of the goal's message: identifies the goal")
    error_code: int
    error_msg: str = ""
    start_time_s: Finite
    end_time_s: Finite
    number_of_recoveries: int = 0


class CancelGoal(Document):
    """Requests that navigation cancel the current goal: the robot stops."""

    goal_stamp_ns: int | None = Field(
        None, description="stamp of the goal's message: cancel only that goal; None: any"
    )
    goal_id: str | None = Field(None, description="id of an action's goal; None: any")


class CancelGoalReply(Document):
    """The result of a cancel request."""

    error: str = Field("", description="one line; empty: canceled")
    return_code: Literal[0, 2] = Field(
        0, description="as in action_msgs/srv/CancelGoal: 0 canceled, 2 no such goal"
    )
    goal: Planar | None = Field(None, description="the canceled goal")
    goal_stamp_ns: int = Field(0, description="stamp of that goal's message")


class Parameters(Document):
    """The configuration of a running service."""

    service: str
    values: dict[str, JsonValue]
    defaults: dict[str, JsonValue] = Field(
        default_factory=dict, description="the defaults of those that have another value"
    )


class ErrorStatistics(Document):
    """Mean, 95th percentile and maximum of an error; null where there was nothing to measure."""

    mean: Finite | None = Field(None, description="in the unit of the error's name: m or rad")
    p95: Finite | None = Field(None, description="95th percentile, in the same unit")
    max: Finite | None = Field(None, description="in the same unit")


class LocalizationConsistency(Document):
    """Whether the estimated poses are as certain as their covariances say."""

    inside_95_percent: Finite | None = Field(
        None,
        description="share of the estimates, 0 to 1, whose 95 % ellipsoid of x, y and yaw "
        "(chi-square with 3 degrees of freedom: 7.815) holds the true pose: 0.95 is consistent, "
        "less is overconfident; null: there was no estimate",
    )
    estimates: int = Field(0, description="number of estimates that were compared")


class GoalReport(Document):
    """The evaluation of one goal against the ground truth. A task without a goal, such as `spin`,
    is evaluated by where it should have taken the robot from its true pose at the start.
    """

    name: str = Field(
        description="name of the location at this pose; `home`: the start pose; `goal`: any other; "
        "of a task without a goal in the map, its action"
    )
    reached: bool = Field(
        description="navigation reports success, and the robot's true pose, where it is known, is "
        "within 0.25 m and 0.25 rad of the goal, if there is one"
    )
    time_s: Finite = Field(description="simulation time from start to end, s")
    path_length_m: Finite = Field(description="length of the true path, m")
    shortest_path_m: Finite | None = Field(
        description="length of the shortest path for the robot's footprint, m; null: there is "
        "none, or the action is not `navigate_to_pose`"
    )
    goal_error_m: Finite | None = Field(
        description="distance from the true pose at the end to the goal, m; null: the recorder was "
        "restarted at that time, or there is no goal"
    )
    goal_error_rad: Finite | None = Field(description="angle between them, rad; null: likewise")
    recoveries: int = Field(description="number of recovery behaviors")
    error_code: int = Field(description="Nav2's error code; 0: success")
    error_msg: str = Field("", description="the error in words; empty: success")
    goal_stamp_ns: int = Field(
        0, description="stamp of the goal's message, ns of simulation time; 0 if sent as an action"
    )
    action: str = Field("navigate_to_pose", description="what the robot was asked to do")
    goal_id: str = Field("", description="id of a goal sent as an action; empty: by /goal_pose")
    localisation_error_m: Finite | None = Field(
        None,
        description="mean distance between estimated and true pose during the drive, m; null: "
        "there was no estimate",
    )
    contacts: int = Field(0, description="number of contacts during the drive")
    start_time_s: Finite | None = Field(
        None, description="simulation time of the start, s; null: not known"
    )
    goal: Planar | None = Field(
        None, description="where it should have led, in `map`; null: the task says nothing of it"
    )


class TrajectoryError(Document):
    """Root mean square, 95th percentile and maximum of an error; null where none was measured."""

    rmse: Finite | None = Field(None, description="in the unit of the error's name: m or rad")
    p95: Finite | None = Field(None, description="95th percentile, in the same unit")
    max: Finite | None = Field(None, description="in the same unit")


class CoverageStep(Document):
    """How much of the floor was mapped at one time of the exploration."""

    time_s: Finite = Field(description="simulation time, s")
    driven_m: Finite = Field(description="length of the true path until then, m")
    coverage_share: Finite = Field(description="of the reachable floor, 0 to 1")


class MarkersMapped(Document):
    """The markers in the pose graph, compared with those in the world of the same id."""

    found: int = Field(0, description="number of the world's markers in the graph")
    missing: int = Field(0, description="number of the world's markers that are not in the graph")
    false: int = Field(
        0, description="number of markers in the graph without one of their id within 1 m"
    )
    error_m: ErrorStatistics = Field(
        ErrorStatistics(), description="distance between a marker's mapped and true position, m"
    )
    error_rad: ErrorStatistics = Field(
        ErrorStatistics(), description="angle between its mapped and true heading, rad"
    )


class MapEvaluation(Document):
    """The map made so far, its pose graph and the estimated path, against the world. Its walls are
    the faces of everything solid and static on the lidar's level that can be seen, at 10 degrees
    or more, from floor that the robot can reach.
    """

    walls_found_share: Finite | None = Field(
        None,
        description="share of the walls, in points 0.05 m apart, with an occupied cell's centre "
        "within 0.10 m, 0 to 1; null: there is no map, or nothing to see",
    )
    walls_true_share: Finite | None = Field(
        None,
        description="share of the occupied cells with their centres within 0.10 m of something "
        "solid; null: there is none",
    )
    free_wrong_share: Finite | None = Field(
        None,
        description="share of the free cells with their centres inside something solid, deeper "
        "than half a cell; null: there is none",
    )
    coverage_share: Finite | None = Field(
        None,
        description="share of the reachable floor (where the robot's centre can be, with 0.24 m "
        "around it) that is free on the map; null: there is no map, or the floor has no end",
    )
    coverage: tuple[CoverageStep, ...] = Field(
        (), description="the coverage over time, a step for each 0.5 % more, oldest first"
    )
    milestones: tuple[CoverageStep, ...] = Field(
        (), description="when the coverage first was at least 0.90, 0.95 and 0.99"
    )
    trajectory_error_m: TrajectoryError = Field(
        TrajectoryError(),
        description="absolute trajectory error (ATE): distance between estimated and true pose, m",
    )
    aligned_error_m: TrajectoryError = Field(
        TrajectoryError(),
        description="the same after the rotation and shift that fit the path best, m",
    )
    relative_error_m: TrajectoryError = Field(
        TrajectoryError(),
        description="relative pose error (RPE): of the way over 1 m driven, m",
    )
    relative_error_rad: TrajectoryError = Field(
        TrajectoryError(), description="the same of the heading, rad"
    )
    markers: MarkersMapped = Field(
        MarkersMapped(), description="the markers in the pose graph against the world's"
    )
    keyframes: int = Field(0, description="nodes of the pose graph")
    loops: int = Field(0, description="loops closed, as mapping says")
    loops_rejected: int = Field(0, description="loops tried and found wrong, as mapping says")
    false_loops: int = Field(
        0,
        description="loop edges that are more than 0.3 m or 10 degrees off the true poses of their "
        "nodes",
    )
    driven_m: Finite | None = Field(
        None, description="length of the true path, m; null: no ground truth"
    )
    exploration: str = Field(
        "", description="the explorer's state, such as `complete`; empty: nothing explores"
    )
    exploration_reason: str = Field("", description="its reason, in words")
    explored_s: Finite | None = Field(
        None, description="simulation time at which it was complete or had failed, s"
    )


class Evaluation(Document):
    """The evaluation of the run so far against the ground truth."""

    goals: tuple[GoalReport, ...] = Field((), description="the goals that have ended, oldest first")
    contacts: tuple[Contact, ...] = Field((), description="the first 1,000 contacts, oldest first")
    markers_seen: dict[str, int] = Field(
        default_factory=dict,
        description="number of images in which each marker of the world was detected, by its id",
    )
    localisation_error_m: ErrorStatistics = Field(
        ErrorStatistics(), description="distance between estimated and true pose, m"
    )
    localisation_error_rad: ErrorStatistics = Field(
        ErrorStatistics(), description="angle between estimated and true heading, rad"
    )
    localization: LocalizationConsistency = Field(
        LocalizationConsistency(),
        description="whether the estimated poses are as certain as they say",
    )
    marker_error_m: ErrorStatistics = Field(
        ErrorStatistics(), description="distance between a marker's detected and true position, m"
    )
    odometry_drift_m: Finite | None = Field(
        None,
        description="distance between the pose by wheel odometry alone and the true one at the "
        "newest odometry message, m; null: no odometry or no ground truth",
    )
    mapping: MapEvaluation | None = Field(
        None, description="the map that the robot has made; null: it makes none"
    )
    recording: str = Field("", description="folder of the run, as given by the recorder")
