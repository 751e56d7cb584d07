"""Layout of a run in the viewer."""

from __future__ import annotations

import math

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from services.common.frames import MAP_FRAME
from services.recorder.drawing.picture_drawing import DEPTH_FRAME, IMAGE_FRAME
from services.recorder.drawing.scenery import Extent
from services.recorder.stream.live_feed import TIMELINE

_BACKGROUND = (24, 27, 33)
_ELEVATION_RAD = math.radians(58.0)
_FROM_ABOVE_RAD = math.radians(88.5)
"""Straight down except for a small tilt, which gives the viewer the up direction; much steeper than
this, it picks the wrong one.
"""
_COSTMAP_OPACITY = {"Maze": 0.22, "Map": 0.5}
"""Translucent, so that the map or the floor stays visible below it."""
_WHOLE_RUN = rrb.TimeAxis(
    view_range=rr.TimeRange(
        start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite()
    )
)


def run_blueprint(extent: Extent, slam: bool = False) -> rrb.Blueprint:
    """The maze from above, the camera image with its markers, plots, states and the log; with
    `slam`, the growing map and its graph in front, and how much of the world it holds.
    """
    maze = rrb.Spatial3DView(
        name="Maze",
        origin="/",
        contents=[
            "+ /**",
            "- /world/walls_above/**",
            "- /world/bodies_above/**",
            "- /world/ceiling/**",
            "- /map/**",
            "- /mapping/**",
            "- /pose_graph/**",
            "- /camera/color/image_raw/**",
            "- /aruco/detections/outline/**",
        ],
        overrides={"/camera/depth": rrb.EntityBehavior(visible=False)},
        defaults=[rr.GridMap.from_fields(opacity=_COSTMAP_OPACITY["Maze"])],
        background=_BACKGROUND,
        line_grid=False,
        spatial_information=rrb.SpatialInformation(target_frame=MAP_FRAME),
        eye_controls=_eye(extent),
    )
    plan = rrb.Spatial3DView(
        name="Map",
        origin="/",
        contents=[
            "+ /map/**",
            "+ /global_costmap/**",
            "+ /keepout_filter_mask/**",
            "+ /speed_filter_mask/**",
            "+ /world/zones/**",
            "+ /world/rooms",
            "+ /world/rooms/names",
            "+ /world/locations/**",
            "+ /entities/**",
            "+ /scan/**",
            "+ /plan/**",
            "+ /trajectories/**",
            "+ /particle_cloud/**",
            "+ /amcl_pose/**",
            "+ /initialpose/**",
            "+ /goal_pose/**",
            "+ /ground_truth/**",
            "+ /aruco/detections_map/**",
            "+ /contacts/**",
            "+ /tf/**",
            "+ /tf_static/**",
            "+ /joint_states/**",
        ],
        defaults=[rr.GridMap.from_fields(opacity=_COSTMAP_OPACITY["Map"])],
        background=_BACKGROUND,
        line_grid=False,
        spatial_information=rrb.SpatialInformation(target_frame=MAP_FRAME),
        eye_controls=_eye(extent, _FROM_ABOVE_RAD),
    )
    camera = rrb.Spatial2DView(
        name="Camera",
        origin="/camera/color/image_raw",
        contents=["+ /camera/color/image_raw/**", "+ /aruco/detections/outline/**"],
        background=_BACKGROUND,
        spatial_information=rrb.SpatialInformation(target_frame=IMAGE_FRAME),
    )
    depth = rrb.Spatial2DView(
        name="Depth",
        origin="/camera/depth/image_rect_raw",
        contents=["+ /camera/depth/image_rect_raw/**"],
        background=_BACKGROUND,
        spatial_information=rrb.SpatialInformation(target_frame=DEPTH_FRAME),
    )
    plots = rrb.Tabs(
        *(_mapping_plots() if slam else ()),
        _plot("Error (m)", ["/error/localisation_m", "/error/marker_m"]),
        _plot("Heading error (deg)", ["/error/localisation_deg"]),
        _plot("Odometry drift (m)", ["/error/odometry_m"]),
        _plot("IMU", ["/imu/**"]),
        _plot("Wheels (rad/s)", ["/joint_states/left_rad_s", "/joint_states/right_rad_s"]),
        _plot("Real time factor", ["/clock/real_time_factor"]),
        active_tab=0,
    )
    speeds = rrb.Tabs(
        _plot(
            "Speed (m/s)",
            ["/cmd_vel/linear_m_s", "/odom/linear_m_s", "/ground_truth/odom/linear_m_s"],
        ),
        _plot(
            "Turn rate (rad/s)",
            ["/cmd_vel/angular_rad_s", "/odom/angular_rad_s", "/ground_truth/odom/angular_rad_s"],
        ),
        _plot("Distance to goal (m)", ["/navigation/status/distance_remaining_m"]),
        active_tab=0,
    )
    states = rrb.StateTimelineView(
        name="States",
        contents=[
            *("/localization/status/**", "/navigation/status/**", "/diagnostics/**"),
            *(["/explore/status/state"] if slam else []),
        ],
        time_view=_WHOLE_RUN,
    )
    log = rrb.TextLogView(
        name="Log",
        contents=["/**"],
        columns=rrb.TextLogColumns(
            timeline_columns=[TIMELINE], text_log_columns=["LogLevel", "Body"]
        ),
    )
    tree = rrb.TextDocumentView(name="Behavior tree", origin="/behavior_tree")
    results = rrb.TextDocumentView(name="Results", origin="/evaluation")
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                rrb.Tabs(
                    *([_mapping_view(extent)] if slam else []),
                    *(maze, plan, tree, results),
                    active_tab=0,
                ),
                rrb.Tabs(log, states, active_tab=0),
                row_shares=[4, 1],
            ),
            rrb.Vertical(
                rrb.Tabs(camera, depth, active_tab=0), plots, speeds, row_shares=[5, 3, 3]
            ),
            column_shares=[5, 3],
        ),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed", play_state="following"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )


def _mapping_view(extent: Extent) -> rrb.Spatial3DView:
    """The map as it grows, beside the true walls, with the pose graph, from above."""
    return rrb.Spatial3DView(
        name="mapping",
        origin="/",
        contents=[
            "+ /map/**",
            "+ /mapping/true_walls",
            "+ /pose_graph/**",
            "+ /explore/**",
            "+ /scan/**",
            "+ /plan/**",
            "+ /amcl_pose/**",
            "+ /goal_pose/**",
            "+ /ground_truth/**",
            "+ /contacts/**",
            "+ /tf/**",
            "+ /tf_static/**",
            "+ /joint_states/**",
        ],
        background=_BACKGROUND,
        line_grid=False,
        spatial_information=rrb.SpatialInformation(target_frame=MAP_FRAME),
        eye_controls=_eye(extent, _FROM_ABOVE_RAD),
    )


def _mapping_plots() -> list[rrb.TimeSeriesView]:
    shares = ("coverage", "walls_found", "walls_true")
    return [
        _plot(
            "Mapped (%)",
            [*(f"/mapping/{name}_percent" for name in shares), "/explore/status/seen_percent"],
            rrb.Corner2D.RightBottom,
        ),
        _plot(
            "Frontiers",
            [f"/explore/status/{name}" for name in ("frontiers", "reachable", "set_aside")],
        ),
        _plot("Pose graph", ["/mapping/keyframes", "/mapping/loops"]),
    ]


def _plot(
    name: str, contents: list[str], legend: rrb.Corner2D = rrb.Corner2D.RightTop
) -> rrb.TimeSeriesView:
    """A plot of the whole run; of one longer than a minute the viewer shows half a minute."""
    return rrb.TimeSeriesView(
        name=name,
        contents=contents,
        axis_x=_WHOLE_RUN,
        plot_legend=rrb.PlotLegend(legend),
    )


def _eye(extent: Extent, elevation_rad: float = _ELEVATION_RAD) -> rrb.EyeControls3D:
    """View of the middle of the world from the south, far enough away to show all of it: x to the
    right, y up.
    """
    low, high = extent
    middle, span_m = (low + high) / 2.0, float(np.linalg.norm(high - low))
    distance_m = 0.86 * max(span_m, 2.0)
    # In an oblique view, near objects fill more of the picture than far ones.
    nearer_m = 0.057 * distance_m * math.cos(elevation_rad)
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=(
            middle[0],
            middle[1] - distance_m * math.cos(elevation_rad),
            distance_m * math.sin(elevation_rad),
        ),
        look_target=(middle[0], middle[1] - nearer_m, 0.0),
        eye_up=(0.0, 0.0, 1.0),
    )
