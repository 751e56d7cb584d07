"""Parameters of the nodes of Nav2 that have no counterpart here, so that they are known by name."""

from __future__ import annotations

import dataclasses

from mazebot.common.nav2_params.parameter import Group, namespace

_NONE = "there is no route server"
_ANY_SCORER = namespace(
    "scorer",
    """
weight double 1.0 >=0
speed_tag string speed_limit *
time_tag string abs_time_taken *
penalty_tag string penalty *
max_vel double 0.5 >0
disable_orientation_check bool false *
orientation_weight double 1.0 >=0
use_orientation_threshold bool false *
orientation_tolerance double 1.57 >=0
semantic_classes strings - *
semantic_key string class *
max_cost double 253.0 0..255
use_maximum bool true *
invalid_on_collision bool true *
invalid_off_map bool true *
check_resolution int 1 >=1
costmap_topic string global_costmap/costmap_raw *
""",
    note=_NONE,
)
_ANY_OPERATION = namespace(
    "operation",
    """
speed_limit_topic string speed_limit *
speed_tag string speed_limit *
costmap_topic string local_costmap/costmap_raw *
rate double 1.0 >0
max_cost double 253.0 0..255
max_collision_dist double 5.0 *
check_resolution int 1 >=1
reroute_on_collision bool true *
service_name string - *
time_tag string abs_time_taken *
""",
    note=_NONE,
)

ROUTE_SERVER = namespace(
    "route_server",
    """
base_frame string base_link *
route_frame string map *
graph_filepath string "" *
graph_file_loader string GeoJsonGraphFileLoader *
path_density double 0.05 >0
max_iterations int 0 >=0
max_planning_time double 2.0 >=0
smooth_corners bool false *
smoothing_radius double 1.0 >=0
smoothing_angle_limit double 2.9 >=0
costmap_topic string global_costmap/costmap_raw *
tracker_update_rate double 50.0 >0
aggregate_blocked_ids bool false *
boundary_radius_to_achieve_node double 1.0 >=0
radius_to_achieve_node double 2.0 >=0
prune_goal bool true *
max_prune_dist_from_edge double 8.0 >=0
min_prune_dist_from_goal double 0.15 >=0
min_prune_dist_from_start double 0.1 >=0
enable_nn_search bool true *
max_nn_search_iterations int 10000 >=1
num_nearest_nodes int 5 >=1
operations strings [AdjustSpeedLimit,ReroutingService] *
edge_cost_functions strings [DistanceScorer,DynamicEdgesScorer] *
use_feedback_operations bool false *
""",
    [
        Group(
            "operations",
            {
                name: dataclasses.replace(_ANY_OPERATION, place=name)
                for name in (
                    "AdjustSpeedLimit", "ReroutingService", "CollisionMonitor", "TimeMarker",
                    "TriggerEvent",
                )
            },
            defaults={
                "AdjustSpeedLimit": "AdjustSpeedLimit",
                "ReroutingService": "ReroutingService",
            },
        ),
        Group(
            "edge_cost_functions",
            {
                name: dataclasses.replace(_ANY_SCORER, place=name)
                for name in (
                    "DistanceScorer", "CostmapScorer", "DynamicEdgesScorer", "TimeScorer",
                    "PenaltyScorer", "SemanticScorer", "GoalOrientationScorer",
                    "StartPoseOrientationScorer",
                )
            },
            defaults={
                "DistanceScorer": "DistanceScorer",
                "DynamicEdgesScorer": "DynamicEdgesScorer",
            },
        ),
    ],
    note=_NONE,
)  # fmt: skip

LOOPBACK_SIMULATOR = namespace(
    "loopback_simulator",
    """
base_frame_id string base_footprint *
odom_frame_id string odom *
map_frame_id string map *
scan_frame_id string base_scan *
update_duration double 0.01 >0
scan_publish_dur double 0.1 >0
publish_map_odom_tf bool true *
publish_clock bool true *
publish_scan bool true *
enable_stamped_cmd_vel bool true *
scan_range_min double 0.05 >=0
scan_range_max double 30.0 >0
scan_angle_min double -3.1415926 *
scan_angle_max double 3.1415926 *
scan_angle_increment double 0.0261 >0
scan_use_inf bool true *
scan_noise_std double 0.01 >=0
speed_factor double 1.0 >0
""",
    note="the simulator is Mazebot's own",
)

LIFECYCLE_MANAGER = namespace(
    "lifecycle_manager",
    """
autostart bool false *
node_names strings - *
bond_timeout double 4.0 >=0
bond_respawn_max_duration double 10.0 >=0
attempt_respawn_reconnection bool true *
service_timeout double 5.0 >=0
parallel_state_transitions bool false *
""",
    note="bringup starts the nodes",
)

ROBOT_STATE_PUBLISHER = namespace(
    "robot_state_publisher",
    """
publish_frequency double 20.0 >=0
robot_description string "" *
frame_prefix string "" *
""",
    note="the robot is the TurtleBot3 waffle",
)

NOTHING = namespace("", "", note="the node has no parameters of its own")
"""A node with the parameters that every node has."""
