"""Parameters of the velocity smoother and of the collision monitor.

Defaults are those of Nav2's code (nav2_velocity_smoother, nav2_collision_monitor), version 1.5.
"""

from __future__ import annotations

from mazebot.common.nav2_params.parameter import Group, namespace

VELOCITY_SMOOTHER = namespace(
    "velocity_smoother",
    """
smoothing_frequency double 20.0 >0 !20.0
feedback string OPEN_LOOP {OPEN_LOOP,CLOSED_LOOP}
scale_velocities bool false *
max_velocity doubles:3 [0.5,0.0,2.5] >=0 =max_velocity:most_velocity
min_velocity doubles:3 [-0.5,0.0,-2.5] <=0 =min_velocity:least_velocity
max_accel doubles:3 [2.5,0.0,3.2] >=0 =max_accel:most_accel
max_decel doubles:3 [-2.5,0.0,-3.2] <=0 =max_decel:least_accel
odom_topic string odom * !odom
odom_duration double 0.1 >=0
deadband_velocity doubles:3 [0.0,0.0,0.0] >=0
velocity_timeout double 1.0 >=0
use_realtime_priority bool false *
stamp_smoothed_velocity_with_smoothing_time bool false *
""",
)

_POLYGON = """
type string - {polygon,circle,velocity_polygon}
points polygon [] *
radius double - >0
action_type string - {stop,slowdown,limit,approach,none}
min_points int 4 >=1
trigger_consecutive_points int 1 >=1
release_consecutive_points int 1 >=1
slowdown_ratio double 0.5 0..1
linear_limit double 0.5 >=0
angular_limit double 0.5 >=0
time_before_collision double 2.0 >=0
simulation_time_step double 0.1 >0
footprint_topic string local_costmap/published_footprint *
polygon_sub_topic string "" *
polygon_pub_topic string - *
sources_names strings - *
visualize bool false *
enabled bool true *
"""

_VELOCITY = namespace(
    "velocity",
    """
points polygon [] *
linear_min double - *
linear_max double - *
theta_min double - *
theta_max double - *
direction_start_angle double -3.141593 *
direction_end_angle double 3.141593 *
""",
)

_AREA = namespace("polygon", _POLYGON)
_VELOCITY_AREA = namespace(
    "polygon",
    f"{_POLYGON}velocity_polygons strings [] * =-\nholonomic bool false * !false\n",
    [Group("velocity_polygons", {"": _VELOCITY}, key="")],
)

_SOURCE = namespace(
    "source",
    """
type string scan {scan,pointcloud,range,polygon,costmap} !scan
topic string scan * !scan
min_height double 0.05 * # the lidar scans one plane
max_height double 0.5 * # the lidar scans one plane
min_range double 0.0 >=0
obstacles_angle double 0.0175 >0
sampling_distance double 0.1 >0
transport_type string raw *
source_timeout double 2.0 >=0
enabled bool true *
""",
)

COLLISION_MONITOR = namespace(
    "collision_monitor",
    """
enabled bool true *
base_frame_id string base_footprint * !base_footprint|base_link
odom_frame_id string odom * !odom
cmd_vel_in_topic string cmd_vel_smoothed *
cmd_vel_out_topic string cmd_vel * !cmd_vel
state_topic string "" *
transform_tolerance double 0.1 >=0
source_timeout double 2.0 >=0
base_shift_correction bool true *
stop_pub_timeout double 1.0 >=0
use_realtime_priority bool false *
polygons strings - * =-
observation_sources strings - * =-
""",
    [
        Group(
            "polygons",
            {"polygon": _AREA, "circle": _AREA, "velocity_polygon": _VELOCITY_AREA, "": _AREA},
            key="type",
        ),
        Group("observation_sources", {"": _SOURCE}, key=""),
    ],
)

COLLISION_DETECTOR = namespace(
    "collision_detector",
    """
frequency double 10.0 >0
base_frame_id string base_footprint *
odom_frame_id string odom *
transform_tolerance double 0.1 >=0
source_timeout double 2.0 >=0
base_shift_correction bool true *
polygons strings - * =-
observation_sources strings - * =-
""",
    COLLISION_MONITOR.groups,
    note="the collision monitor reports detections; there is no separate detector",
)
