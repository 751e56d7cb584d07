"""The views that layouts are made of, each with what it shows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from mazebot.common.maths.frames import MAP_FRAME
from mazebot.recorder.drawing.picture_drawing import CAMERA_ENTITY, DEPTH_FRAME, IMAGE_FRAME
from mazebot.recorder.drawing.scenery import Extent
from mazebot.recorder.stream.live_feed import TIMELINE

_BACKGROUND = (24, 27, 33)
_ELEVATION_RAD = math.radians(58.0)
_FROM_ABOVE_RAD = math.radians(88.5)
"""Straight down except for a small tilt, which gives the viewer the up direction; much steeper than
this, it picks the wrong one.
"""
_COSTMAP_OPACITY = {"Maze": 0.22, "Map": 0.5}
"""Translucent, so that the map or the floor stays visible below it."""
_ROBOT = [
    "+ /amcl_pose/**",
    "+ /ground_truth/**",
    "+ /tf/**",
    "+ /tf_static/**",
    "+ /joint_states/**",
]
_PLACES = [
    "+ /world/zones/**",
    "+ /world/rooms",
    "+ /world/rooms/names",
    "+ /world/locations/**",
]


@dataclass(frozen=True)
class Scene:
    """What layouts depend on in a run."""

    extent: Extent | None
    """Of the world; None: not known, the viewer chooses where to look from."""
    slam: bool = False
    """Whether the robot makes the map."""

    def properties(self) -> dict[str, str]:
        """As text, to be kept in a recording."""
        if self.extent is None:
            return {}
        return {
            "extent_m": " ".join(f"{value:.3f}" for value in np.concatenate(self.extent)),
            "slam": str(self.slam),
        }

    @classmethod
    def from_properties(cls, properties: Mapping[str, str]) -> Scene:
        """Of a recording; one without them gets the layouts of any world."""
        try:
            values = np.array([float(word) for word in properties["extent_m"].split()])
            low, high = values.reshape(2, 2)
        except (KeyError, ValueError):
            return cls(None)
        return cls((low, high), properties.get("slam") == "True")


def maze_view(scene: Scene) -> rrb.Spatial3DView:
    """Everything in the world, obliquely from above."""
    return _spatial(
        "Maze",
        scene,
        _ELEVATION_RAD,
        [
            "+ /**",
            "- /world/walls_above/**",
            "- /world/bodies_above/**",
            "- /world/ceiling/**",
            "- /map/**",
            "- /mapping/**",
            "- /pose_graph/**",
            f"- /{CAMERA_ENTITY}/**",
            "- /aruco/detections/outline/**",
        ],
    )


def map_view(scene: Scene) -> rrb.Spatial3DView:
    """The map with costmaps, plans and particles from straight above, as in RViz."""
    return _spatial(
        "Map",
        scene,
        _FROM_ABOVE_RAD,
        [
            "+ /map/**",
            "+ /global_costmap/**",
            "+ /local_costmap/**",
            "+ /keepout_filter_mask/**",
            "+ /speed_filter_mask/**",
            *_PLACES,
            "+ /entities/**",
            "+ /scan/**",
            "+ /camera/depth/scan/**",
            "+ /plan/**",
            "+ /trajectories/**",
            "+ /particle_cloud/**",
            "+ /initialpose/**",
            "+ /goal_pose/**",
            "+ /goal_update/**",
            "+ /aruco/markers",
            "+ /aruco/detections_map/**",
            "+ /contacts/**",
            *_ROBOT,
        ],
    )


def markers_view(scene: Scene) -> rrb.Spatial3DView:
    """The markers by their state, and where the robot sees them from, from above."""
    return _spatial(
        "Markers",
        scene,
        _FROM_ABOVE_RAD,
        [
            "+ /map/**",
            *_PLACES,
            "+ /entities/**",
            "+ /aruco/**",
            "- /aruco/detections/outline/**",
            "+ /camera/color/camera_info",
            *_ROBOT,
        ],
    )


def mapping_view(scene: Scene) -> rrb.Spatial3DView:
    """The map as it grows, beside the true walls, with the pose graph, from above."""
    return _spatial(
        "mapping",
        scene,
        _FROM_ABOVE_RAD,
        [
            "+ /map/**",
            "+ /mapping/true_walls",
            "+ /pose_graph/**",
            "+ /explore/**",
            "+ /scan/**",
            "+ /camera/depth/scan/**",
            "+ /plan/**",
            "+ /goal_pose/**",
            "+ /goal_update/**",
            "+ /contacts/**",
            *_ROBOT,
        ],
    )


def camera_view() -> rrb.Spatial2DView:
    """The camera's picture with the outlines of the markers in it."""
    return rrb.Spatial2DView(
        name="Camera",
        origin=f"/{CAMERA_ENTITY}",
        contents=[f"+ /{CAMERA_ENTITY}/**", "+ /aruco/detections/outline/**"],
        background=_BACKGROUND,
        spatial_information=rrb.SpatialInformation(target_frame=IMAGE_FRAME),
    )


def depth_view() -> rrb.Spatial2DView:
    """The depth camera's picture."""
    return rrb.Spatial2DView(
        name="Depth",
        origin="/camera/depth/image_rect_raw",
        contents=["+ /camera/depth/image_rect_raw/**"],
        background=_BACKGROUND,
        spatial_information=rrb.SpatialInformation(target_frame=DEPTH_FRAME),
    )


def photo_view() -> rrb.Spatial2DView:
    """The newest picture taken at a waypoint."""
    return rrb.Spatial2DView(
        name="Photo", origin="/waypoint_photo", contents=["+ /waypoint_photo"],
        background=_BACKGROUND,
    )  # fmt: skip


def states_view(name: str = "States") -> rrb.StateTimelineView:
    """The states of services, of navigation and of its behaviour tree over time."""
    return rrb.StateTimelineView(
        name=name,
        contents=[
            "/localization/status/state",
            "/navigation/status/state",
            "/navigation/feedback/action",
            "/behavior_tree/running",
            "/collision_monitor_state",
            "/explore/status/state",
            "/diagnostics/**",
        ],
        time_view=WHOLE_RUN,
    )


def tree_states_view() -> rrb.StateTimelineView:
    """What the behaviour tree does over time, beside navigation's own state."""
    return rrb.StateTimelineView(
        name="Behavior",
        contents=[
            "/navigation/feedback/action",
            "/navigation/status/state",
            "/behavior_tree/running",
            "/collision_monitor_state",
            "/localization/status/state",
            "/explore/status/state",
        ],
        time_view=WHOLE_RUN,
    )


def events_view() -> rrb.TextLogView:
    """What to jump to: goals, contacts, recoveries, new markers, faults."""
    return _log("Events", ["/events/**"])


def log_view() -> rrb.TextLogView:
    """What the services print."""
    return _log("Log", ["+ /**", "- /events/**"])


def tree_view() -> rrb.TextDocumentView:
    """The behaviour tree as it ticks."""
    return rrb.TextDocumentView(name="Behavior tree", origin="/behavior_tree")


def results_view() -> rrb.TextDocumentView:
    """The table of goals, or the map's figures."""
    return rrb.TextDocumentView(name="Results", origin="/evaluation")


def parameters_view(service: str) -> rrb.TextDocumentView:
    """A service's configuration."""
    return rrb.TextDocumentView(name=f"{service} parameters", origin=f"/parameters/{service}")


WHOLE_RUN = rrb.TimeAxis(
    view_range=rr.TimeRange(
        start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite()
    )
)


def blueprint(root: rrb.Container) -> rrb.Blueprint:
    """A layout of these views, with the panels around them closed."""
    return rrb.Blueprint(
        root,
        rrb.TimePanel(timeline=TIMELINE, state="collapsed", play_state="following"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
    )


def _log(name: str, contents: list[str]) -> rrb.TextLogView:
    return rrb.TextLogView(
        name=name,
        contents=contents,
        columns=rrb.TextLogColumns(
            timeline_columns=[TIMELINE], text_log_columns=["LogLevel", "Body"]
        ),
    )


def _spatial(
    name: str, scene: Scene, elevation_rad: float, contents: list[str]
) -> rrb.Spatial3DView:
    opacity = _COSTMAP_OPACITY.get(name)
    return rrb.Spatial3DView(
        name=name,
        origin="/",
        contents=contents,
        overrides={"/camera/depth": rrb.EntityBehavior(visible=False)},
        defaults=[] if opacity is None else [rr.GridMap.from_fields(opacity=opacity)],
        background=_BACKGROUND,
        line_grid=False,
        spatial_information=rrb.SpatialInformation(target_frame=MAP_FRAME),
        eye_controls=None if scene.extent is None else _eye(scene.extent, elevation_rad),
    )


def _eye(extent: Extent, elevation_rad: float) -> rrb.EyeControls3D:
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
