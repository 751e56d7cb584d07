"""How each topic's messages are drawn: a function per topic, on entities named after the topics."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import rerun as rr

from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import (
    ACTION_FEEDBACK,
    ACTION_RESULT,
    AMCL_POSE,
    ASSETS,
    BATTERY_STATE,
    BEHAVIOR_TREE,
    CAMERA_COMPRESSED,
    CAMERA_IMAGE,
    CAMERA_INFO,
    CLOCK,
    CMD_VEL,
    CMD_VEL_TELEOP,
    COLLISION_MONITOR_STATE,
    CONTACTS,
    CONTROLLER_SELECTOR,
    DEPTH_IMAGE,
    DEPTH_INFO,
    DEPTH_SCAN,
    DESIRED_ENTITIES,
    DETECTIONS,
    DIAGNOSTICS,
    ENTITIES,
    ENTITY_MARKERS,
    EXPLORATION_STATUS,
    EXPLORE_RESUME,
    FRONTIERS,
    GLOBAL_COSTMAP,
    GLOBAL_COSTMAP_UPDATES,
    GLOBAL_LOCALIZATION_REQUEST,
    GOAL_POSE,
    GOAL_UPDATE,
    GROUND_TRUTH_ODOM,
    IMU,
    INITIAL_POSE,
    JOINT_STATES,
    KEEPOUT_FILTER_MASK,
    LOCAL_COSTMAP,
    LOCALIZATION_STATUS,
    MAP,
    MAP_DETECTIONS,
    NAVIGATION_RESULT,
    NAVIGATION_STATUS,
    ODOM,
    PARAMETER_EVENTS,
    PARAMETERS,
    PARTICLE_CLOUD,
    PHOTO,
    PHOTO_REQUEST,
    PLAN,
    PLANNER_SELECTOR,
    POSE_GRAPH,
    PUBLISHED_FOOTPRINT,
    ROBOT_DESCRIPTION,
    ROSOUT,
    SCAN,
    SIMULATION_STATS,
    SPEED_FILTER_MASK,
    SPEED_LIMIT,
    TF,
    TF_STATIC,
    TRAJECTORIES,
    WORLD,
    WORLD_REQUEST,
    WORLD_STATUS,
    Topic,
)
from mazebot.recorder.drawing import palette
from mazebot.recorder.drawing.canvas import LATCH_NS, Canvas
from mazebot.recorder.drawing.mapping_drawing import (
    SLAM_SERIES,
    draw_exploration_status,
    draw_explore_resume,
    draw_frontiers,
    draw_pose_graph,
)
from mazebot.recorder.drawing.navigation_drawing import (
    draw_action_feedback,
    draw_action_result,
    draw_amcl_pose,
    draw_collision_monitor,
    draw_controller_selector,
    draw_detections,
    draw_global_costmap,
    draw_global_localization_request,
    draw_goal_pose,
    draw_goal_update,
    draw_initial_pose,
    draw_keepout_mask,
    draw_local_costmap,
    draw_localization_status,
    draw_map,
    draw_map_detections,
    draw_navigation_result,
    draw_navigation_status,
    draw_particle_cloud,
    draw_photo_request,
    draw_plan,
    draw_planner_selector,
    draw_speed_limit,
    draw_speed_mask,
    draw_trajectories,
)
from mazebot.recorder.drawing.picture_drawing import (
    draw_camera_compressed,
    draw_camera_image,
    draw_camera_info,
    draw_depth_image,
    draw_depth_info,
    draw_photo,
)
from mazebot.recorder.drawing.robot_drawing import (
    draw_battery,
    draw_cmd_vel,
    draw_cmd_vel_teleop,
    draw_contact,
    draw_depth_scan,
    draw_ground_truth_odom,
    draw_imu,
    draw_joint_states,
    draw_odom,
    draw_robot,
    draw_scan,
    draw_tf,
    draw_tf_static,
)
from mazebot.recorder.drawing.service_drawing import draw_diagnostics
from mazebot.recorder.drawing.text_drawing import (
    draw_behavior_tree,
    draw_parameters,
    draw_rosout,
    draw_simulation_stats,
    draw_world_request,
    draw_world_status,
)
from mazebot.recorder.drawing.world_drawing import (
    draw_asset,
    draw_desired_entities,
    draw_entities,
    draw_world,
    place_what_stands,
)

SERIES: dict[str, tuple[str, tuple[int, int, int]]] = {
    "error/localisation_m": ("localisation", palette.ESTIMATE),
    "error/odometry_m": ("odometry drift", palette.SECOND),
    "error/marker_m": ("marker", palette.MARKER),
    "error/localisation_deg": ("heading", palette.ESTIMATE),
    "cmd_vel/linear_m_s": ("commanded", palette.PLAN),
    "odom/linear_m_s": ("odometry", palette.SECOND),
    "ground_truth/odom/linear_m_s": ("true", palette.TRUTH),
    "cmd_vel/angular_rad_s": ("commanded", palette.PLAN),
    "odom/angular_rad_s": ("odometry", palette.SECOND),
    "ground_truth/odom/angular_rad_s": ("true", palette.TRUTH),
    "cmd_vel_teleop/linear_m_s": ("teleoperation command", palette.MARKER),
    "cmd_vel_teleop/angular_rad_s": ("teleoperation command", palette.MARKER),
    "imu/angular_velocity_z_rad_s": ("yaw rate", palette.PLAN),
    "imu/linear_acceleration_x_m_s2": ("forward", palette.ESTIMATE),
    "imu/linear_acceleration_y_m_s2": ("left", palette.TRUTH),
    "joint_states/left_rad_s": ("left wheel", palette.ESTIMATE),
    "joint_states/right_rad_s": ("right wheel", palette.TRUTH),
    "battery/percentage": ("charge", palette.ESTIMATE),
    "clock/real_time_factor": ("real time factor", palette.TRUTH),
    "simulation/stats/watchdog_stops": ("watchdog stops", palette.BAD),
    "localization/status/quality": ("localisation quality", palette.ESTIMATE),
    "navigation/status/distance_remaining_m": ("distance remaining", palette.PLAN),
    "navigation/status/number_of_recoveries": ("recoveries", palette.BAD),
    "aruco/detections/count": ("markers in view", palette.MARKER),
}
"""Entities that are time series, with their name and colour in the plots."""


def draw_start(canvas: Canvas) -> None:
    """Draw what no message carries: the robot, twice, and the styles of the plots and states."""
    log = canvas.recording.log
    draw_robot(canvas)
    for path, (name, color) in (SERIES | (SLAM_SERIES if canvas.world.slam else {})).items():
        log(path, rr.SeriesLines(colors=[color], names=[name], widths=[1.5]), static=True)
    states = rr.StateConfiguration(
        values=list(palette.STATES), colors=list(palette.STATES.values())
    )
    paths = ["navigation/status/state", "localization/status/state", "collision_monitor_state"]
    if canvas.world.slam:
        paths.append("explore/status/state")
    for path in paths:
        log(path, states, static=True)
    tree = palette.TREE_STATES
    log(
        "behavior_tree/running",
        rr.StateConfiguration(values=list(tree), colors=list(tree.values())),
        static=True,
    )


def draw_clock(canvas: Canvas, _: msg.Clock) -> None:
    """Real-time factor, once per second of wall time."""
    now_s = canvas.wall_clock_s()
    if canvas.entities is not None and canvas.due("entities", canvas.now_ns, LATCH_NS):
        place_what_stands(canvas)
    if canvas.real_time is None:
        canvas.real_time = now_s, canvas.now_ns
        return
    wall_s, sim_ns = canvas.real_time
    if now_s - wall_s >= 1.0:
        factor = (canvas.now_ns - sim_ns) * 1e-9 / (now_s - wall_s)
        canvas.real_time = now_s, canvas.now_ns
        canvas.recording.scalar("clock/real_time_factor", factor)


def draw_nothing(_: Canvas, __: Any) -> None:
    """What other viewers draw from this message, this one draws from others."""


DRAW: dict[Topic[Any], Callable[[Canvas, Any], None]] = {
    CLOCK: draw_clock,
    WORLD_REQUEST: draw_world_request,
    WORLD_STATUS: draw_world_status,
    PARAMETERS: draw_parameters,
    PARAMETER_EVENTS: draw_nothing,
    ASSETS: draw_asset,
    WORLD: draw_world,
    MAP: draw_map,
    DESIRED_ENTITIES: draw_desired_entities,
    ENTITIES: draw_entities,
    TF: draw_tf,
    TF_STATIC: draw_tf_static,
    ODOM: draw_odom,
    JOINT_STATES: draw_joint_states,
    BATTERY_STATE: draw_battery,
    IMU: draw_imu,
    SCAN: draw_scan,
    CAMERA_IMAGE: draw_camera_image,
    CAMERA_INFO: draw_camera_info,
    CAMERA_COMPRESSED: draw_camera_compressed,
    DEPTH_IMAGE: draw_depth_image,
    DEPTH_INFO: draw_depth_info,
    DEPTH_SCAN: draw_depth_scan,
    GROUND_TRUTH_ODOM: draw_ground_truth_odom,
    CONTACTS: draw_contact,
    SIMULATION_STATS: draw_simulation_stats,
    DETECTIONS: draw_detections,
    MAP_DETECTIONS: draw_map_detections,
    INITIAL_POSE: draw_initial_pose,
    GOAL_POSE: draw_goal_pose,
    GOAL_UPDATE: draw_goal_update,
    CONTROLLER_SELECTOR: draw_controller_selector,
    PLANNER_SELECTOR: draw_planner_selector,
    SPEED_LIMIT: draw_speed_limit,
    AMCL_POSE: draw_amcl_pose,
    PARTICLE_CLOUD: draw_particle_cloud,
    GLOBAL_LOCALIZATION_REQUEST: draw_global_localization_request,
    POSE_GRAPH: draw_pose_graph,
    EXPLORATION_STATUS: draw_exploration_status,
    FRONTIERS: draw_frontiers,
    EXPLORE_RESUME: draw_explore_resume,
    GLOBAL_COSTMAP: draw_global_costmap,
    KEEPOUT_FILTER_MASK: draw_keepout_mask,
    SPEED_FILTER_MASK: draw_speed_mask,
    LOCAL_COSTMAP: draw_local_costmap,
    PLAN: draw_plan,
    CMD_VEL: draw_cmd_vel,
    CMD_VEL_TELEOP: draw_cmd_vel_teleop,
    BEHAVIOR_TREE: draw_behavior_tree,
    TRAJECTORIES: draw_trajectories,
    COLLISION_MONITOR_STATE: draw_collision_monitor,
    ACTION_FEEDBACK: draw_action_feedback,
    ACTION_RESULT: draw_action_result,
    PHOTO_REQUEST: draw_photo_request,
    PHOTO: draw_photo,
    LOCALIZATION_STATUS: draw_localization_status,
    NAVIGATION_STATUS: draw_navigation_status,
    NAVIGATION_RESULT: draw_navigation_result,
    DIAGNOSTICS: draw_diagnostics,
    ROSOUT: draw_rosout,
    ROBOT_DESCRIPTION: draw_nothing,
    ENTITY_MARKERS: draw_nothing,
    PUBLISHED_FOOTPRINT: draw_nothing,
    GLOBAL_COSTMAP_UPDATES: draw_nothing,
}
