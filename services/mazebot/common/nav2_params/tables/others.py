"""Parameters of the nodes of Nav2 that have no counterpart here, so that they are known by name."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from mazebot.common.nav2_params.parameter import Group, namespace

_NONE = "there is no route server"
_ANY_SCORER = namespace(
    "scorer",
    """
- weight speed_tag time_tag penalty_tag max_vel disable_orientation_check orientation_weight
- use_orientation_threshold orientation_tolerance semantic_classes semantic_key max_cost
- use_maximum invalid_on_collision invalid_off_map check_resolution costmap_topic
""",
    note=_NONE,
)
_ANY_OPERATION = namespace(
    "operation",
    """
- speed_limit_topic speed_tag costmap_topic rate max_cost max_collision_dist check_resolution
- reroute_on_collision service_name time_tag
""",
    note=_NONE,
)

ROUTE_SERVER = namespace(
    "route_server",
    """
operations strings [AdjustSpeedLimit,ReroutingService] * =-
edge_cost_functions strings [DistanceScorer,DynamicEdgesScorer] * =-
- base_frame route_frame graph_filepath graph_file_loader path_density max_iterations
- max_planning_time smooth_corners smoothing_radius smoothing_angle_limit costmap_topic
- tracker_update_rate aggregate_blocked_ids boundary_radius_to_achieve_node radius_to_achieve_node
- prune_goal max_prune_dist_from_edge min_prune_dist_from_goal min_prune_dist_from_start
- enable_nn_search max_nn_search_iterations num_nearest_nodes use_feedback_operations
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
- base_frame_id odom_frame_id map_frame_id scan_frame_id update_duration scan_publish_dur
- publish_map_odom_tf publish_clock publish_scan enable_stamped_cmd_vel scan_range_min
- scan_range_max scan_angle_min scan_angle_max scan_angle_increment scan_use_inf scan_noise_std
- speed_factor
""",
    note="the simulator is Mazebot's own",
)

LIFECYCLE_MANAGER = namespace(
    "lifecycle_manager",
    """
- autostart node_names bond_timeout bond_respawn_max_duration attempt_respawn_reconnection
- service_timeout parallel_state_transitions
""",
    note="bringup starts the nodes",
)

ROBOT_STATE_PUBLISHER = namespace(
    "robot_state_publisher",
    """
- publish_frequency robot_description frame_prefix
""",
    note="the robot is the TurtleBot3 waffle",
)

NOTHING = namespace("", "", note="the node has no parameters of its own")
"""A node with the parameters that every node has."""

_SLAM_TOOLBOX = "slam_toolbox, whose parameters `mazebot map build --params` takes"
OTHER_PACKAGES: Mapping[str, str] = {
    "slam_toolbox": _SLAM_TOOLBOX,
    "sync_slam_toolbox_node": _SLAM_TOOLBOX,
    "async_slam_toolbox_node": _SLAM_TOOLBOX,
    "ekf_filter_node": "robot_localization",
    "ekf_filter_node_odom": "robot_localization",
    "ekf_filter_node_map": "robot_localization",
    "ukf_filter_node": "robot_localization",
    "navsat_transform": "robot_localization",
    "navsat_transform_node": "robot_localization",
    "explore_node": "explore_lite",
    "twist_mux": "twist_mux",
    "controller_manager": "ros2_control",
    "pointcloud_to_laserscan": "pointcloud_to_laserscan",
    "depthimage_to_laserscan": "depthimage_to_laserscan",
}
"""Nodes of other packages that often stand in a file of Nav2, with their package."""
