"""The layouts of a run in the viewer, each for one purpose."""

from __future__ import annotations

from collections.abc import Callable

import rerun.blueprint as rrb

from mazebot.recorder.config import LayoutName
from mazebot.recorder.drawing.layouts import plots, views
from mazebot.recorder.drawing.layouts.views import Scene


def run_blueprint(scene: Scene, name: LayoutName = "overview") -> rrb.Blueprint:
    """The layout of that name for a run."""
    return views.blueprint(LAYOUTS[name](scene))


def overview(scene: Scene) -> rrb.Container:
    """A bit of everything; the growing map in front where the robot makes it."""
    mapping = [views.mapping_view(scene)] if scene.slam else []
    return rrb.Horizontal(
        rrb.Vertical(
            rrb.Tabs(
                *mapping,
                views.maze_view(scene),
                views.map_view(scene),
                views.tree_view(),
                views.results_view(),
                active_tab=0,
            ),
            rrb.Tabs(views.events_view(), views.log_view(), views.states_view(), active_tab=0),
            row_shares=[4, 1],
        ),
        rrb.Vertical(
            rrb.Tabs(views.camera_view(), views.depth_view(), active_tab=0),
            rrb.Tabs(
                *(plots.mapping_plots() if scene.slam else ()),
                plots.error_plot(),
                plots.heading_error_plot(),
                plots.drift_plot(),
                *plots.sensor_plots(),
                plots.factor_plot(),
                active_tab=0,
            ),
            rrb.Tabs(*plots.speed_plots(), plots.goal_plots()[0], active_tab=0),
            row_shares=[5, 3, 3],
        ),
        column_shares=[5, 3],
    )


def drive(scene: Scene) -> rrb.Container:
    """Where the robot goes and why: map, plans and costmaps, the behaviour tree, the speeds."""
    return rrb.Horizontal(
        rrb.Vertical(
            rrb.Tabs(views.map_view(scene), views.maze_view(scene), active_tab=0),
            views.tree_states_view(),
            row_shares=[7, 3],
        ),
        rrb.Vertical(
            rrb.Tabs(views.tree_view(), views.camera_view(), views.results_view(), active_tab=0),
            rrb.Tabs(*plots.speed_plots(), active_tab=0),
            rrb.Tabs(*plots.goal_plots(), plots.error_plot(), active_tab=0),
            rrb.Tabs(
                views.events_view(),
                views.log_view(),
                views.parameters_view("navigation"),
                active_tab=0,
            ),
            row_shares=[4, 2, 2, 3],
        ),
        column_shares=[4, 3],
    )


def perception(scene: Scene) -> rrb.Container:
    """What the robot sees: camera and depth, the markers by their state, the errors."""
    return rrb.Horizontal(
        rrb.Vertical(
            rrb.Tabs(views.camera_view(), views.photo_view(), active_tab=0),
            views.depth_view(),
        ),
        rrb.Vertical(
            rrb.Tabs(views.markers_view(scene), views.map_view(scene), active_tab=0),
            rrb.Tabs(
                plots.error_plot(),
                *plots.marker_plots(),
                plots.heading_error_plot(),
                plots.drift_plot(),
                plots.quality_plot(),
                *plots.sensor_plots(),
                active_tab=0,
            ),
            rrb.Tabs(
                views.events_view(),
                views.log_view(),
                views.parameters_view("perception"),
                views.parameters_view("localization"),
                active_tab=0,
            ),
            row_shares=[5, 3, 2],
        ),
        column_shares=[2, 3],
    )


def performance(scene: Scene) -> rrb.Container:
    """Whether everything keeps up: cost, pace, rates and losses of every service."""
    return rrb.Horizontal(
        rrb.Vertical(
            plots.step_time_plot(),
            plots.factor_plot(),
            plots.rate_plot(),
            row_shares=[3, 2, 3],
        ),
        rrb.Vertical(
            views.states_view(),
            rrb.Tabs(*plots.loss_plots(), active_tab=0),
            rrb.Tabs(views.events_view(), views.log_view(), views.maze_view(scene), active_tab=0),
            row_shares=[3, 2, 3],
        ),
        column_shares=[1, 1],
    )


def mapping(scene: Scene) -> rrb.Container:
    """The map that the robot makes against the true walls, its graph, and what is left."""
    return rrb.Horizontal(
        rrb.Vertical(
            rrb.Tabs(views.mapping_view(scene), views.maze_view(scene), active_tab=0),
            rrb.Tabs(views.events_view(), views.log_view(), views.tree_states_view(), active_tab=0),
            row_shares=[4, 1],
        ),
        rrb.Vertical(
            rrb.Tabs(views.results_view(), views.camera_view(), active_tab=0),
            plots.mapping_plots()[0],
            rrb.Tabs(*plots.mapping_plots()[1:], plots.drift_plot(), active_tab=0),
            rrb.Tabs(plots.error_plot(), plots.quality_plot(), active_tab=0),
            row_shares=[3, 2, 2, 2],
        ),
        column_shares=[5, 3],
    )


LAYOUTS: dict[LayoutName, Callable[[Scene], rrb.Container]] = {
    "overview": overview,
    "drive": drive,
    "perception": perception,
    "performance": performance,
    "mapping": mapping,
}
