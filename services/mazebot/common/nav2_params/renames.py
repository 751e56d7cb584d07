"""Names of parameters that changed between the distributions of ROS 2, as a table.

Sources: Nav2's migration guides (docs.nav2.org, Foxy to Kilted), its parameter files of Humble to
Lyrical, and the pull requests that the notes name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from mazebot.common.nav2_params.parameter import Value

UNCHANGED = object()
"""What a conversion returns where the old name or value means the same today."""

Conversion = Callable[[Value], Value]


@dataclass(frozen=True)
class Rename:
    """A parameter that had another name, or other values."""

    node: str
    """"" is any node."""
    plugin: str
    """The class of the namespace in which it stands; "" is the node's own."""
    old: str
    """`publish_*`: all with this beginning; `*.old`: in any namespace of the node."""
    new: str
    """"" where it is gone. It begins with `/` where it stands at the node or in another
    namespace; classes in braces are the namespace of the plugin of one of these classes."""
    until: str
    """The last distribution with the old name."""
    note: str = ""
    convert: str = ""


NODE_RENAMES: Mapping[str, tuple[str, str]] = MappingProxyType(
    {"recoveries_server": ("behavior_server", "Galactic")}
)
"""The new name of a node, and the last distribution with the old one."""

CLASS_RENAMES: Mapping[str, str] = MappingProxyType(
    {"nav2_recoveries::": "nav2_behaviors::", "smac_planner::": "nav2_smac_planner::"}
)
"""Packages of plugins, by their old names."""

_PATH_HANDLER = (
    "max_robot_pose_search_dist", "transform_tolerance", "prune_distance",
    "enforce_path_inversion", "inversion_xy_tolerance", "inversion_yaw_tolerance",
)  # fmt: skip
_HANDLED = "the path is cut by the controller server's path handler (PR 5446)"
_COSTMAPS = ("local_costmap", "global_costmap")

RENAMES: tuple[Rename, ...] = (
    Rename("amcl", "", "robot_model_type", "robot_model_type", "Galactic", convert="motion_model"),
    Rename(
        "controller_server", "", "progress_checker_plugin", "progress_checker_plugins", "Humble",
        "a list since (PR 3555)", "as_list",
    ),
    Rename(
        "controller_server", "", "goal_checker_plugin", "goal_checker_plugins", "Foxy",
        "a list since", "as_list",
    ),
    Rename("behavior_server", "", "recovery_plugins", "behavior_plugins", "Galactic"),
    Rename("behavior_server", "", "costmap_topic", "local_costmap_topic", "Humble"),
    Rename("behavior_server", "", "footprint_topic", "local_footprint_topic", "Humble"),
    Rename(
        "behavior_server", "", "global_frame", "local_frame", "Humble",
        "global_frame means map since", "only_odom",
    ),
    Rename("bt_navigator", "", "plugin_lib_names", "", "Iron", "built-in nodes need no list"),
    Rename("bt_navigator", "", "default_bt_xml_filename", "default_nav_to_pose_bt_xml", "Foxy"),
    Rename(
        "bt_navigator", "", "error_code_names", "error_code_name_prefixes", "Jazzy",
        "later versions of Nav2 refuse to start with the old name (PR 4459)", "prefixes",
    ),
    Rename(
        "bt_navigator", "", "goal_blackboard_id", "/{NavigateToPoseNavigator}.goal_blackboard_id",
        "Kilted", "moved below the navigator (PR 5466)",
    ),
    Rename(
        "bt_navigator", "", "path_blackboard_id", "/{NavigateToPoseNavigator}.path_blackboard_id",
        "Kilted", "moved below the navigator (PR 5466)",
    ),
    Rename(
        "bt_navigator", "", "goals_blackboard_id",
        "/{NavigateThroughPosesNavigator}.goals_blackboard_id",
        "Kilted", "moved below the navigator (PR 5466)",
    ),
    Rename(
        "bt_navigator", "", "waypoint_statuses_blackboard_id",
        "/{NavigateThroughPosesNavigator}.waypoint_statuses_blackboard_id",
        "Kilted", "moved below the navigator (PR 5466)",
    ),
    Rename(
        "bt_navigator", "", "enable_groot_monitoring",
        "/{NavigateToPoseNavigator}.enable_groot_monitoring", "Galactic",
        "moved below the navigator",
    ),
    Rename("bt_navigator", "", "groot_zmq_*", "", "Galactic"),
    Rename("", "", "action_server_result_timeout", "", "Jazzy"),
    Rename("", "", "service_introspection_mode", "introspection_mode", "Kilted"),
    Rename(
        "collision_monitor", "", "*.max_points", "*.min_points", "Humble",
        "min_points = max_points + 1 (PR 3513)", "plus_one",
    ),
    *(
        rename
        for node in _COSTMAPS
        for rename in (
            Rename(
                node, "", "map_topic", "/{StaticLayer}.map_topic", "Jazzy",
                "moved to the static layer (PR 4715)",
            ),
            Rename(node, "", "*.obstacle_range", "*.obstacle_max_range", "Foxy"),
            Rename(node, "", "*.raytrace_range", "*.raytrace_max_range", "Foxy"),
        )
    ),
    Rename(
        "docking_server", "", "dock_backwards",
        "/{SimpleChargingDock,SimpleNonChargingDock}.dock_direction", "Jazzy",
        "each dock plugin has its direction (PR 5079)", "direction",
    ),
    *(
        Rename(
            "controller_server", "MPPIController", old, f"/{{FeasiblePathHandler}}.{old}",
            "Kilted", _HANDLED,
        )
        for old in _PATH_HANDLER
    ),
    Rename(
        "controller_server", "MPPIController", "motion_model", "motion_model", "Kilted",
        convert="motion_model",
    ),
    Rename(
        "controller_server", "MPPIController", "publish_critics_stats", "", "Kilted",
        "published with visualize (PR 6036)",
    ),
    Rename(
        "controller_server", "MPPIController", "TrajectoryVisualizer.publish_critics_stats", "",
        "Kilted", "published with visualize (PR 6036)",
    ),
    Rename(
        "controller_server", "MPPIController", "PathAngleCritic.forward_preference",
        "PathAngleCritic.mode", "Iron", "0 prefers driving forward, 1 no direction", "mode",
    ),
    Rename(
        "controller_server", "RegulatedPurePursuitController", "desired_linear_vel",
        "max_linear_vel", "Kilted",
    ),
    Rename(
        "controller_server", "RegulatedPurePursuitController", "stateful", "", "Kilted",
        "replaced by the goal checker's stateful (PR 6071)",
    ),
    Rename(
        "controller_server", "RegulatedPurePursuitController", "use_interpolation", "", "Iron",
        "the carrot is always interpolated",
    ),
    Rename(
        "controller_server", "RegulatedPurePursuitController", "goal_dist_tol", "", "Humble",
        "replaced by the goal checker's tolerance",
    ),
    *(
        Rename(
            "controller_server", plugin, old, f"/{{FeasiblePathHandler}}.{old}", "Kilted", _HANDLED
        )
        for plugin in ("RegulatedPurePursuitController", "GracefulController")
        for old in ("transform_tolerance", "max_robot_pose_search_dist")
    ),
    Rename(
        "controller_server", "GracefulController", "motion_target_dist", "max_lookahead", "Jazzy",
        "a range min_lookahead to max_lookahead since (PR 4795)",
    ),
    Rename(
        "controller_server", "GracefulController", "final_rotation", "prefer_final_rotation",
        "Jazzy", "(PR 4795)",
    ),
    *(
        Rename("controller_server", "DWBLocalPlanner", old, "", "Kilted", _HANDLED)
        for old in (
            "prune_plan", "shorten_transformed_plan", "prune_distance", "forward_prune_distance",
            "publish_*",
        )
    ),
)  # fmt: skip


def convert(name: str, value: Value) -> Value:
    """The value under the new name; UNCHANGED where old name and value are those of today."""
    return _CONVERSIONS[name](value) if name else value


def _chosen(values: Mapping[str, str]) -> Conversion:
    return lambda value: values.get(value, UNCHANGED) if isinstance(value, str) else UNCHANGED


_CONVERSIONS: Mapping[str, Conversion] = MappingProxyType(
    {
        "as_list": lambda value: [value] if isinstance(value, str) else value,
        "plus_one": lambda value: value + 1 if type(value) is int else value,
        "direction": lambda value: (
            {True: "backward", False: "forward"}.get(value, value)
            if isinstance(value, bool)
            else value
        ),
        "mode": lambda value: int(not value) if isinstance(value, bool) else value,
        "only_odom": lambda value: value if value == "odom" else UNCHANGED,
        "prefixes": lambda value: (
            [str(one).removesuffix("_error_code") for one in value]
            if isinstance(value, list)
            else value
        ),
        "motion_model": _chosen(
            {
                "DiffDrive": "diff_drive",
                "Omni": "omni",
                "Ackermann": "ackermann",
                "differential": "nav2_amcl::DifferentialMotionModel",
                "omnidirectional": "nav2_amcl::OmniMotionModel",
            }
        ),
    }
)
