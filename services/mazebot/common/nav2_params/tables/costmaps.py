"""Parameters of the two costmaps and of their layers and filters.

Defaults are those of Nav2's code (nav2_costmap_2d), version 1.5.
"""

from __future__ import annotations

from mazebot.common.nav2_params.parameter import Group, Namespace, namespace

_OBSERVATION = namespace(
    "scan",
    """
topic string "" * !scan
data_type string LaserScan {LaserScan,PointCloud2} !LaserScan
inf_is_valid bool false *
clearing bool false *
marking bool true *
obstacle_max_range double 2.5 >=0 =:no_limit
obstacle_min_range double 0.0 >=0
raytrace_max_range double 3.0 >=0 =:no_limit
raytrace_min_range double 0.0 >=0
- sensor_frame observation_persistence expected_update_rate min_obstacle_height
- max_obstacle_height transport_type
""",
)

_SOURCES = (Group("observation_sources", {"": _OBSERVATION}, key="", sensors=True),)
_MARKS = """
enabled bool true * =- !true
footprint_clearing_enabled bool true *
observation_sources words "" * =-
- min_obstacle_height max_obstacle_height combination_method tf_filter_tolerance
"""
_ONE_PLANE = "# the lidar scans one plane: voxels are one layer of obstacles"
_VOXELS = "unknown_threshold mark_threshold z_voxels z_resolution origin_z publish_voxel_map"
_OBSTACLE = namespace("obstacle_layer", _MARKS, _SOURCES)
_VOXEL = namespace("obstacle_layer", f"{_MARKS}- {_VOXELS} {_ONE_PLANE}", _SOURCES)

_STATIC = namespace(
    "static_layer",
    """
map_topic string map * !map
map_subscribe_transient_local bool true * !true
enabled bool true * =- !true
- subscribe_to_updates transform_tolerance footprint_clearing_enabled
- restore_cleared_footprint
""",
)

_NO_STATIC = namespace(
    "static_layer",
    """
- map_topic map_subscribe_transient_local enabled subscribe_to_updates transform_tolerance
- footprint_clearing_enabled restore_cleared_footprint
""",
    note="the local costmap is without the map here",
)

_INFLATION = namespace(
    "inflation_layer",
    """
inflation_radius double 0.55 >=0
cost_scaling_factor double 10.0 >=0
inflate_unknown bool false *
enabled bool true * =- !true
- custom_inscribed_radius # the footprint is that of the waffle
- num_threads # one thread
- inflate_around_unknown
""",
)

_DENOISE = namespace(
    "denoise_layer",
    "- enabled minimal_group_size group_connectivity_type",
    note="DenoiseLayer is not supported",
)

_RANGE = namespace(
    "range_sensor_layer",
    """
- enabled topics phi inflate_cone no_readings_timeout clear_threshold mark_threshold
- clear_on_max_reading input_sensor_type
""",
    note="the robot has no range sensors",
)

_FILTER = "enabled bool true * =- !true\n- filter_info_topic transform_tolerance\n"
_KEEPOUT = namespace("keepout_filter", f"{_FILTER}- override_lethal_cost lethal_override_cost")
_SPEED = namespace(
    "speed_filter",
    f"{_FILTER}- speed_limit_topic enable_path_lookahead max_decel min_lookahead max_lookahead",
)
_BINARY = namespace("binary_filter", f"{_FILTER}- default_state binary_state_topic flip_threshold")
_CONTAINER = namespace(
    "plugin_container_layer",
    "- enabled combination_method plugins",
    note="layers cannot be nested",
)

_ALWAYS = (("ObstacleLayer", "VoxelLayer"), ("InflationLayer", "LegacyInflationLayer"))


def _groups(static: Namespace, always: tuple[tuple[str, ...], ...]) -> tuple[Group, ...]:
    return (
        Group(
            "plugins",
            {
                "StaticLayer": static, "ObstacleLayer": _OBSTACLE, "VoxelLayer": _VOXEL,
                "InflationLayer": _INFLATION, "LegacyInflationLayer": _INFLATION,
                "DenoiseLayer": _DENOISE, "RangeSensorLayer": _RANGE,
                "PluginContainerLayer": _CONTAINER,
            },
            defaults={
                "static_layer": "StaticLayer",
                "obstacle_layer": "ObstacleLayer",
                "inflation_layer": "InflationLayer",
            },
            last="InflationLayer",
            always=always,
        ),
        Group(
            "filters", {"KeepoutFilter": _KEEPOUT, "SpeedFilter": _SPEED, "BinaryFilter": _BINARY}
        ),
    )  # fmt: skip


def _costmap(name: str, frame: str, size: str, groups: tuple[Group, ...]) -> Namespace:
    rows = f"""{size}
footprint_padding double 0.01 >=0
footprint polygon [] * =- # the footprint is that of the waffle
global_frame string map * !{frame}
robot_base_frame string base_link * !base_footprint|base_link
plugins strings [static_layer,obstacle_layer,inflation_layer] * =-
filters strings [] * =-
- robot_radius # the footprint is that of the waffle
- update_frequency publish_frequency resolution origin_x origin_y rolling_window
- track_unknown_space transform_tolerance initial_transform_timeout always_send_full_costmap
- lethal_cost_threshold unknown_cost_value trinary_costmap inscribed_obstacle_cost_value
- use_maximum map_vis_z
"""
    return namespace(f"navigation.{name}", rows, groups)


LOCAL_COSTMAP = _costmap(
    "local_costmap", "odom", "width int 5 >=1\nheight int 5 >=1", _groups(_NO_STATIC, _ALWAYS)
)
GLOBAL_COSTMAP = _costmap(
    "global_costmap", "map", "- width height", _groups(_STATIC, (("StaticLayer",), *_ALWAYS))
)
