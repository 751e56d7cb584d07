"""The plots that layouts are made of."""

from __future__ import annotations

import rerun.blueprint as rrb

from mazebot.recorder.drawing.layouts.views import WHOLE_RUN


def _plot(
    name: str, contents: list[str], legend: rrb.Corner2D = rrb.Corner2D.RightTop
) -> rrb.TimeSeriesView:
    """A plot of the whole run; of one longer than a minute the viewer shows half a minute."""
    return rrb.TimeSeriesView(
        name=name,
        contents=contents,
        axis_x=WHOLE_RUN,
        plot_legend=rrb.PlotLegend(legend),
    )


def error_plot() -> rrb.TimeSeriesView:
    """Errors of position."""
    return _plot("Error (m)", ["/error/localisation_m", "/error/marker_m"])


def heading_error_plot() -> rrb.TimeSeriesView:
    """Error of the heading."""
    return _plot("Heading error (deg)", ["/error/localisation_deg"])


def drift_plot() -> rrb.TimeSeriesView:
    """Drift of wheel odometry alone."""
    return _plot("Odometry drift (m)", ["/error/odometry_m"])


def quality_plot() -> rrb.TimeSeriesView:
    """How well the scans match the map."""
    return _plot("Localisation quality", ["/localization/status/quality"])


def marker_plots() -> list[rrb.TimeSeriesView]:
    """Markers in view, and the error of their poses."""
    return [
        _plot("Markers in view", ["/aruco/detections/count"]),
        _plot("Marker error (m)", ["/error/marker_m"]),
    ]


def sensor_plots() -> list[rrb.TimeSeriesView]:
    """IMU, wheels and battery."""
    return [
        _plot("IMU", ["/imu/**"]),
        _plot("Wheels (rad/s)", ["/joint_states/left_rad_s", "/joint_states/right_rad_s"]),
        _plot("Battery (0 to 1)", ["/battery/percentage"]),
    ]


def speed_plots() -> list[rrb.TimeSeriesView]:
    """Commanded, measured and true velocities."""
    sources = ("cmd_vel", "odom", "ground_truth/odom", "cmd_vel_teleop")
    return [
        _plot("Speed (m/s)", [f"/{source}/linear_m_s" for source in sources]),
        _plot("Turn rate (rad/s)", [f"/{source}/angular_rad_s" for source in sources]),
    ]


def goal_plots() -> list[rrb.TimeSeriesView]:
    """The way that is left, and the recoveries."""
    return [
        _plot("Distance to goal (m)", ["/navigation/status/distance_remaining_m"]),
        _plot("Recoveries", ["/navigation/status/number_of_recoveries"]),
    ]


def factor_plot() -> rrb.TimeSeriesView:
    """How much faster than real time the simulation runs."""
    return _plot("Real time factor", ["/clock/real_time_factor"])


def step_time_plot() -> rrb.TimeSeriesView:
    """How long the steps of each service take."""
    return _plot("Step time, p99 (ms)", ["/performance/step_time_p99_ms/**"])


def rate_plot() -> rrb.TimeSeriesView:
    """How often each periodic topic is published."""
    return _plot("Rates (Hz)", ["/performance/rate_hz/**"])


def loss_plots() -> list[rrb.TimeSeriesView]:
    """What went missing, by service: all are at 0 in a good run."""
    return [
        _plot("Lost messages", ["/performance/lost/**"]),
        _plot("Rejected messages", ["/performance/rejected/**"]),
        _plot("Missed periods", ["/performance/missed_periods/**"]),
        _plot("Watchdog stops", ["/simulation/stats/watchdog_stops"]),
    ]


def mapping_plots() -> list[rrb.TimeSeriesView]:
    """How much of the world the map holds, and what is left to explore."""
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
