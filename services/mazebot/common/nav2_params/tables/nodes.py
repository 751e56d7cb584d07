"""The nodes of Nav2, by name."""

from __future__ import annotations

from collections.abc import Mapping

from mazebot.common.nav2_params.parameter import Namespace
from mazebot.common.nav2_params.tables import behaviors, costmaps, localization, motion, others
from mazebot.common.nav2_params.tables.controllers import CONTROLLER_SERVER
from mazebot.common.nav2_params.tables.planners import PLANNER_SERVER, SMOOTHER_SERVER

NODES: Mapping[str, Namespace] = {
    "amcl": localization.AMCL,
    "map_server": localization.MAP_SERVER,
    "map_saver": localization.MAP_SAVER,
    "keepout_filter_mask_server": localization.KEEPOUT_MASK_SERVER,
    "speed_filter_mask_server": localization.SPEED_MASK_SERVER,
    "filter_mask_server": localization.MASK_SERVER,
    "keepout_costmap_filter_info_server": localization.KEEPOUT_FILTER_INFO,
    "speed_costmap_filter_info_server": localization.SPEED_FILTER_INFO,
    "costmap_filter_info_server": localization.FILTER_INFO,
    "local_costmap": costmaps.LOCAL_COSTMAP,
    "global_costmap": costmaps.GLOBAL_COSTMAP,
    "planner_server": PLANNER_SERVER,
    "smoother_server": SMOOTHER_SERVER,
    "controller_server": CONTROLLER_SERVER,
    "velocity_smoother": motion.VELOCITY_SMOOTHER,
    "collision_monitor": motion.COLLISION_MONITOR,
    "collision_detector": motion.COLLISION_DETECTOR,
    "behavior_server": behaviors.BEHAVIOR_SERVER,
    "bt_navigator": behaviors.BT_NAVIGATOR,
    "waypoint_follower": behaviors.WAYPOINT_FOLLOWER,
    "docking_server": behaviors.DOCKING_SERVER,
    "route_server": others.ROUTE_SERVER,
    "loopback_simulator": others.LOOPBACK_SIMULATOR,
    "lifecycle_manager": others.LIFECYCLE_MANAGER,
    "lifecycle_manager_localization": others.LIFECYCLE_MANAGER,
    "lifecycle_manager_navigation": others.LIFECYCLE_MANAGER,
    "robot_state_publisher": others.ROBOT_STATE_PUBLISHER,
    "amcl_map_client": others.NOTHING,
    "amcl_rclcpp_node": others.NOTHING,
    "bt_navigator_rclcpp_node": others.NOTHING,
    "bt_navigator_navigate_to_pose_rclcpp_node": others.NOTHING,
    "bt_navigator_navigate_through_poses_rclcpp_node": others.NOTHING,
    "controller_server_rclcpp_node": others.NOTHING,
    "planner_server_rclcpp_node": others.NOTHING,
    "local_costmap_client": others.NOTHING,
    "local_costmap_rclcpp_node": others.NOTHING,
    "global_costmap_client": others.NOTHING,
    "global_costmap_rclcpp_node": others.NOTHING,
}
