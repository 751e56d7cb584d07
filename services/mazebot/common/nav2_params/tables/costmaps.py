"""Parameters of the two costmaps and of their layers and filters.

Defaults are those of Nav2's code (nav2_costmap_2d), version 1.5.
"""

from __future__ import annotations

from mazebot.common.nav2_params.parameter import Group, Namespace, joined, namespace

_OBSERVATION = namespace(
    "source",
    """
topic string "" * !scan
sensor_frame string "" *
data_type string LaserScan {LaserScan,PointCloud2} !LaserScan
observation_persistence double 0.0 >=0
expected_update_rate double 0.0 >=0
min_obstacle_height double 0.0 *
max_obstacle_height double 0.0 *
inf_is_valid bool false *
marking bool true *
clearing bool false *
obstacle_max_range double 2.5 >=0
obstacle_min_range double 0.0 >=0
raytrace_max_range double 3.0 >=0
raytrace_min_range double 0.0 >=0
transport_type string raw *
""",
)

_SOURCES = (Group("observation_sources", {"": _OBSERVATION}, key=""),)

_OBSTACLE = namespace(
    "obstacle_layer",
    """
enabled bool true *
footprint_clearing_enabled bool true *
min_obstacle_height double 0.0 *
max_obstacle_height double 2.0 *
combination_method int 1 {0,1,2}
observation_sources words "" * =-
tf_filter_tolerance double 0.05 >=0
""",
    _SOURCES,
)

_VOXEL = joined(
    _OBSTACLE,
    namespace(
        "obstacle_layer",
        """
unknown_threshold int 15 >=0 =- # the lidar scans one plane: voxels are one layer of obstacles
mark_threshold int 0 >=0 =- # the lidar scans one plane: voxels are one layer of obstacles
z_voxels int 10 1..16 =- # the lidar scans one plane: voxels are one layer of obstacles
z_resolution double 0.2 >0 =- # the lidar scans one plane: voxels are one layer of obstacles
origin_z double 0.0 * =- # the lidar scans one plane: voxels are one layer of obstacles
publish_voxel_map bool false * =- # the lidar scans one plane: voxels are one layer of obstacles
""",
    ),
)

_STATIC = namespace(
    "static_layer",
    """
enabled bool true *
map_topic string map * !map
subscribe_to_updates bool false *
map_subscribe_transient_local bool true * !true
transform_tolerance double 0.0 >=0
footprint_clearing_enabled bool false *
restore_cleared_footprint bool true *
""",
)

_INFLATION = namespace(
    "inflation_layer",
    """
enabled bool true *
inflation_radius double 0.55 >=0
cost_scaling_factor double 10.0 >=0
inflate_unknown bool false *
inflate_around_unknown bool false *
custom_inscribed_radius double -1.0 *
num_threads int -1 >=-1 # one thread
""",
)

_DENOISE = namespace(
    "denoise_layer",
    """
enabled bool true *
minimal_group_size int 2 >=1
group_connectivity_type int 8 {4,8}
""",
)

_RANGE = namespace(
    "range_sensor_layer",
    """
enabled bool true *
topics strings [] *
phi double 1.2 *
inflate_cone double 1.0 0..1
no_readings_timeout double 0.0 >=0
clear_threshold double 0.2 0..1
mark_threshold double 0.8 0..1
clear_on_max_reading bool false *
input_sensor_type string ALL {ALL,VARIABLE,FIXED}
""",
    note="the robot has no range sensors",
)

_FILTER = """
enabled bool true *
filter_info_topic string - *
transform_tolerance double 0.1 >=0
"""

_KEEPOUT = namespace(
    "keepout_filter",
    f"{_FILTER}override_lethal_cost bool false *\nlethal_override_cost int 252 0..255\n",
)
_SPEED = namespace(
    "speed_filter",
    f"""{_FILTER}speed_limit_topic string speed_limit *
enable_path_lookahead bool false *
max_decel double -0.5 *
min_lookahead double 0.3 >=0
max_lookahead double 5.0 >=0
""",
)
_BINARY = namespace(
    "binary_filter",
    f"""{_FILTER}default_state bool false *
binary_state_topic string binary_state *
flip_threshold double 50.0 0..100
""",
)
_CONTAINER = namespace(
    "plugin_container_layer",
    """
enabled bool true *
combination_method int 1 {0,1,2}
plugins strings [] *
""",
    note="layers cannot be nested",
)

_LAYERS = {
    "StaticLayer": _STATIC, "ObstacleLayer": _OBSTACLE, "VoxelLayer": _VOXEL,
    "InflationLayer": _INFLATION, "LegacyInflationLayer": _INFLATION, "DenoiseLayer": _DENOISE,
    "RangeSensorLayer": _RANGE, "PluginContainerLayer": _CONTAINER,
}  # fmt: skip
_FILTERS = {"KeepoutFilter": _KEEPOUT, "SpeedFilter": _SPEED, "BinaryFilter": _BINARY}
_GROUPS = (
    Group(
        "plugins",
        _LAYERS,
        defaults={
            "static_layer": "StaticLayer",
            "obstacle_layer": "ObstacleLayer",
            "inflation_layer": "InflationLayer",
        },
    ),
    Group("filters", _FILTERS),
)

_COSTMAP = """
update_frequency double 5.0 >=0
publish_frequency double 1.0 *
resolution double 0.1 >0
origin_x double 0.0 *
origin_y double 0.0 *
rolling_window bool false *
track_unknown_space bool false *
robot_radius double 0.1 >=0 =robot_radius:robot_radius # the footprint is that of the waffle
footprint polygon [] * # the footprint is that of the waffle
footprint_padding double 0.01 >=0
robot_base_frame string base_link * !base_footprint|base_link
transform_tolerance double 0.3 >=0
initial_transform_timeout double 60.0 >=0
always_send_full_costmap bool false *
lethal_cost_threshold int 100 0..100
unknown_cost_value int 255 0..255
trinary_costmap bool true *
inscribed_obstacle_cost_value int 99 0..100
use_maximum bool false *
map_vis_z double 0.0 *
plugins strings [static_layer,obstacle_layer,inflation_layer] * =-
filters strings [] * =-
"""


def _costmap(place: str, frame: str, size: str) -> Namespace:
    rows = f"""{_COSTMAP}global_frame string map * !{frame}
width int 5 >=1 =width,{size}
height int 5 >=1 =height,{size}
"""
    return namespace(place, rows, _GROUPS)


LOCAL_COSTMAP = _costmap("local_costmap", "odom", "local_costmap_size")
GLOBAL_COSTMAP = _costmap("global_costmap", "map", "global_costmap_size")
