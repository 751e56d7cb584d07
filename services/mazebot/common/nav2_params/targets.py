"""Where our settings for Nav2's parameters are, and how Nav2's values become ours."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType, NoneType
from typing import Any, Union, get_args, get_origin

from pydantic import BaseModel, ConfigDict, PydanticUserError, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo

from mazebot.common.config import must
from mazebot.common.nav2_params.parameter import Value
from mazebot.common.nav2_params.tables.mppi import MPPI
from mazebot.common.robot import waffle
from mazebot.common.world.costmap import ROBOT_RADIUS_M

Models = Mapping[str, type[BaseModel]]
"""The configuration of each section of a settings file, such as `navigation`."""

LIDAR_MAX_RANGE_M = 3.5
"""The LDS-01's longest range (ROBOTIS, LDS-01 specifications)."""


def _within(each: Value, most: float, most_turning: float) -> Value:
    """A value for x, y and yaw, within the robot's limits for x and yaw."""
    x, y, yaw = each
    return [min(max(x, -most), most), y, min(max(yaw, -most_turning), most_turning)]


def _below(*spaces: str) -> tuple[str, ...]:
    return tuple(f"navigation.{space}" if space else "navigation" for space in spaces)


def _costmap(costmap: str) -> Mapping[str, tuple[str, ...]]:
    """The places of one of the two costmaps."""
    layers = ("static_layer", "obstacle_layer", "inflation_layer", "denoise_layer")
    filters = ("keepout_filter", "speed_filter", "binary_filter")
    places = {
        f"{costmap}.{layer}": _below(
            f"{costmap}.{layer}", f"costmap.{layer}", layer, costmap, "costmap", ""
        )
        for layer in (*layers, *filters)
    }
    source = f"{costmap}.obstacle_layer.scan"
    obstacles = places[f"{costmap}.obstacle_layer"]
    return {
        costmap: _below(costmap, "costmap", ""),
        **places,
        f"{costmap}.obstacle_layer.source": (*_below(source), *obstacles),
    }


def _controller(name: str, *others: str) -> tuple[str, ...]:
    return _below(f"controller_server.{name}", f"controllers.{name}", name, *others, "")


_MPPI = _controller("mppi", "FollowPath")

PLACES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "amcl": ("localization", "localization.amcl", "navigation.localization"),
        **_costmap("local_costmap"),
        **_costmap("global_costmap"),
        "planner_server": _below("planner_server", ""),
        "planner_server.navfn": _below("planner_server", "planner_params", "planning", ""),
        "planner_server.smac_2d": _below("planner_server", "planner_params", "planning", ""),
        "planner_server.theta_star": _below("planner_server", "planner_params", "planning", ""),
        "smoother_server.simple_smoother": _below("simple_smoother", "smoother"),
        "controller_server": _below("controller_server", ""),
        "controller_server.mppi": _MPPI,
        **{
            f"controller_server.mppi.{critic}": tuple(f"{place}.{critic}" for place in _MPPI[:-1])
            for group in MPPI.groups
            for critic in group.kinds
        },
        "controller_server.dwb": _MPPI,
        "controller_server.regulated_pure_pursuit": _controller("regulated_pure_pursuit"),
        "controller_server.goal_checker": _controller("goal_checker"),
        "controller_server.progress_checker": _controller("progress_checker"),
        "controller_server.path_handler": _controller("path_handler"),
        "filter_mask_server": _below(""),
        "costmap_filter_info_server": _below(""),
        "velocity_smoother": _below("velocity_smoother"),
        "collision_monitor": _below("collision_monitor"),
        "collision_monitor.source": _below("collision_monitor.scan"),
        "collision_monitor.polygon": _below("collision_monitor.polygons.*"),
        "behavior_server": _below("behavior_server", "behaviors", ""),
        "behavior_server.spin": _below("behavior_server.spin", "behaviors.spin", "spin", ""),
        "behavior_server.backup": _below("behavior_server.backup", "behaviors.backup", "backup"),
        "behavior_server.drive_on_heading": _below(
            "behavior_server.drive_on_heading", "behaviors.drive_on_heading", "drive_on_heading"
        ),
        "behavior_server.assisted_teleop": _below(
            "behavior_server.assisted_teleop", "behaviors.assisted_teleop", "assisted_teleop"
        ),
        "bt_navigator": _below("bt_navigator", ""),
        "waypoint_follower": _below("waypoint_follower"),
        "waypoint_follower.wait_at_waypoint": _below(
            "waypoint_follower.wait_at_waypoint", "wait_at_waypoint"
        ),
        "waypoint_follower.photo_at_waypoint": _below(
            "waypoint_follower.photo_at_waypoint", "photo_at_waypoint"
        ),
        "docking_server": _below("docking_server", "docking"),
        "docking_server.dock_plugin": _below(
            "docking_server.dock_plugin", "docking_server.simple_charging_dock",
            "docking.dock_plugin", "docking_server", "docking",
        ),
        "docking_server.dock": _below("docking_server.docks.*", "docking.docks.*"),
    }
)  # fmt: skip
"""For each node and plugin the sections that may hold our settings, the first that has the name
wins. `*` is the name of the instance in the file."""

FLAT = frozenset(
    {
        "controller", "planner", "tolerance", "local_costmap_size", "robot_radius",
        "footprint", "footprint_padding",
        "inflation_radius", "cost_scaling_factor", "obstacle_max_range", "raytrace_max_range",
        "inf_is_valid", "cost_travel_multiplier", "max_planning_iterations", "desired_linear_vel",
        "max_linear_vel", "max_angular_vel", "max_linear_accel", "max_angular_accel",
        "lookahead_time", "min_lookahead_dist", "max_lookahead_dist",
        "regulated_linear_scaling_min_radius", "regulated_linear_scaling_min_speed",
        "cost_scaling_dist", "min_approach_linear_velocity", "rotate_to_heading_angular_vel",
        "rotate_to_heading_min_angle", "max_allowed_time_to_collision_up_to_carrot",
        "xy_goal_tolerance", "yaw_goal_tolerance", "path_length_tolerance",
        "failure_tolerance", "required_movement_radius", "required_movement_angle",
        "movement_time_allowance", "max_rotational_vel", "min_rotational_vel",
        "rotational_acc_lim", "simulate_ahead_time", "controller_frequency",
        "keepout_mask", "speed_mask", "speed_mask_type", "speed_mask_base", "speed_mask_multiplier",
        "default_nav_to_pose_bt_xml", "default_nav_through_poses_bt_xml",
    }
)  # fmt: skip
"""Names with one meaning only, which may stand in the section itself; `tolerance` is the planner's.
"""

# A controller that counts on more than the robot's own limits mistakes where it will be.
CONVERSIONS: Mapping[str, Callable[[Value], Value]] = MappingProxyType(
    {
        # AMCL takes the smaller of the two, and -1 as the range that the scan states.
        "lidar_max_range": lambda range_m: None if range_m < 0 else min(range_m, LIDAR_MAX_RANGE_M),
        "lidar_min_range": lambda range_m: None if range_m < 0 else range_m,
        "robot_radius": lambda radius_m: max(radius_m, ROBOT_RADIUS_M),
        "max_speed": lambda speed: min(speed, waffle.MAX_LINEAR_M_S),
        "min_speed": lambda speed: max(speed, -waffle.MAX_LINEAR_M_S),
        "max_turn": lambda speed: min(speed, waffle.MAX_ANGULAR_RAD_S),
        "max_accel": lambda accel: min(accel, waffle.MAX_LINEAR_ACCELERATION_M_S2),
        "min_accel": lambda accel: max(accel, -waffle.MAX_LINEAR_ACCELERATION_M_S2),
        "max_turn_accel": lambda accel: min(accel, waffle.MAX_ANGULAR_ACCELERATION_RAD_S2),
        "most_velocity": lambda each: _within(
            each, waffle.MAX_LINEAR_M_S, waffle.MAX_ANGULAR_RAD_S
        ),
        "least_velocity": lambda each: _within(
            each, waffle.MAX_LINEAR_M_S, waffle.MAX_ANGULAR_RAD_S
        ),
        "most_accel": lambda each: _within(
            each, waffle.MAX_LINEAR_ACCELERATION_M_S2, waffle.MAX_ANGULAR_ACCELERATION_RAD_S2
        ),
        "least_accel": lambda each: _within(
            each, waffle.MAX_LINEAR_ACCELERATION_M_S2, waffle.MAX_ANGULAR_ACCELERATION_RAD_S2
        ),
    }
)
"""From Nav2's value to ours; None: our default has this meaning."""


def setting(
    place: str, names: tuple[str, ...], instance: str, models: Models
) -> tuple[str, FieldInfo] | None:
    """Our setting for one of these names at a place, with its field; None: there is none."""
    for space in PLACES.get(place, ()):
        where = space.replace("*", instance)
        for name in names:
            if "." not in where and where == "navigation" and name not in FLAT:
                continue
            found = _field(f"{where}.{name}", models)
            if found is not None:
                return f"{where}.{name}", found
    return None


def valid_for(field: FieldInfo, value: Value) -> str:
    """What the field's value must be, where this one is not valid; empty: it is."""
    annotation = field.rebuild_annotation()
    try:
        _adapter(annotation).validate_python(value)
    except ValidationError as error:
        return must(error.errors()[0]["msg"])
    return ""


def _adapter(annotation: Any) -> TypeAdapter[Any]:
    try:
        return TypeAdapter(annotation, config=ConfigDict(allow_inf_nan=False))
    except PydanticUserError:
        # A model has its own configuration.
        return TypeAdapter(annotation)


def _field(path: str, models: Models) -> FieldInfo | None:
    """The field of a dotted name, whose first part is the section."""
    section, *parts = path.split(".")
    owner: type[BaseModel] | None = models.get(section)
    field = None
    at = iter(parts)
    for part in at:
        if owner is None:
            return None
        field = owner.model_fields.get(part)
        if field is None:
            return None
        owner = None
        for kind in _alternatives(field.annotation):
            # Of a mapping, the next part is a key.
            inner = get_args(kind)[1] if get_origin(kind) is dict else kind
            if inner is not kind and next(at, None) is None:
                return field
            if isinstance(inner, type) and issubclass(inner, BaseModel):
                owner = inner
    # A whole section is no setting of one parameter.
    return None if owner is not None else field


def _alternatives(annotation: object) -> Iterator[object]:
    """The types of `X | None`, or the type itself."""
    if get_origin(annotation) is Union or type(annotation).__name__ == "UnionType":
        yield from (one for one in get_args(annotation) if one is not NoneType)
    else:
        yield annotation
