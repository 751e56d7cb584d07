"""Parameters of the velocity smoother and of the collision monitor.

Defaults are those of Nav2's code (nav2_velocity_smoother, nav2_collision_monitor), version 1.5.
"""

from __future__ import annotations

from mazebot.common.nav2_params.parameter import Group, namespace

VELOCITY_SMOOTHER = namespace(
    "navigation.velocity_smoother",
    """
smoothing_frequency double 20.0 >0 !20.0
feedback string OPEN_LOOP {OPEN_LOOP,CLOSED_LOOP}
scale_velocities bool false *
max_velocity planar:3 [0.5,0.0,2.5] >=0 =:most_velocity
min_velocity planar:3 [-0.5,0.0,-2.5] <=0 =:least_velocity
max_accel planar:3 [2.5,0.0,3.2] >=0 =:most_accel
max_decel planar:3 [-2.5,0.0,-3.2] <=0 =:least_accel
odom_topic string odom * !odom
deadband_velocity planar:3 [0.0,0.0,0.0] >=0
velocity_timeout double 1.0 >=0 =:no_limit
- odom_duration use_realtime_priority stamp_smoothed_velocity_with_smoothing_time
""",
)

_ZONE = """
type string - {polygon,circle,velocity_polygon}
action_type string - {stop,slowdown,limit,approach,none}
min_points int 4 >=1
trigger_consecutive_points int 1 >=1
release_consecutive_points int 1 >=1
slowdown_ratio double 0.5 0..1
linear_limit double 0.5 >=0
angular_limit double 0.5 >=0
time_before_collision double 2.0 >=0
enabled bool true *
- sources_names # the lidar is the source of every zone
- simulation_time_step footprint_topic polygon_sub_topic polygon_pub_topic visualize
"""
_AREA = namespace("polygons.*", f"{_ZONE}points polygon [] *\nradius double - >0\n", whole=True)
_VELOCITY = namespace(
    "velocity_polygons.*",
    """
points polygon [] *
linear_min double - *
linear_max double - *
theta_min double - *
theta_max double - *
- direction_start_angle direction_end_angle # the robot cannot move sideways
""",
    whole=True,
)
_VELOCITY_AREA = namespace(
    "polygons.*",
    f"""{_ZONE}
velocity_polygons strings [] * =-
holonomic bool false * =- !false
- points radius # each velocity polygon has its own
""",
    [Group("velocity_polygons", {"": _VELOCITY}, key="", mapping="velocity_polygons")],
    whole=True,
)

_SOURCE = namespace(
    "source",
    """
type string scan {scan,pointcloud,range,polygon,costmap} =- !scan
topic string scan * =- !scan
enabled bool true * =- !true
- min_height max_height # the lidar scans one plane
- source_timeout # that of the collision monitor itself counts
- min_range obstacles_angle sampling_distance transport_type
""",
)

COLLISION_MONITOR = namespace(
    "navigation.collision_monitor",
    """
enabled bool true *
source_timeout double 2.0 >=0 =:no_limit
stop_pub_timeout double 1.0 >=0 =:no_limit
base_frame_id string base_footprint * !base_footprint|base_link
odom_frame_id string odom * !odom
cmd_vel_out_topic string cmd_vel * !cmd_vel
polygons strings - * =-
observation_sources strings - * =-
- cmd_vel_in_topic state_topic transform_tolerance base_shift_correction use_realtime_priority
""",
    [
        Group(
            "polygons",
            {"polygon": _AREA, "circle": _AREA, "velocity_polygon": _VELOCITY_AREA, "": _AREA},
            key="type",
            mapping="polygons",
        ),
        Group("observation_sources", {"": _SOURCE}, key=""),
    ],
)

COLLISION_DETECTOR = namespace(
    "collision_detector",
    """
polygons strings - * =-
observation_sources strings - * =-
- frequency base_frame_id odom_frame_id transform_tolerance source_timeout base_shift_correction
""",
    COLLISION_MONITOR.groups,
    note="the collision monitor reports detections; there is no separate detector",
)
