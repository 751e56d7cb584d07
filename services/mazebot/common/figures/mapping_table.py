"""The figures of a map that the robot has made, the same in the terminal and in the viewer."""

from __future__ import annotations

import math

from mazebot.common.figures.goal_table import NOT_MEASURED, measured
from mazebot.common.messages.documents import MapEvaluation, TrajectoryError


def mapping_rows(mapping: MapEvaluation) -> list[tuple[str, str]]:
    """Each figure's name, and the figure in words."""
    markers, relative_rad = mapping.markers, mapping.relative_error_rad.rmse
    turned_deg = None if relative_rad is None else math.degrees(relative_rad)
    time_s = "" if mapping.explored_s is None else f" in {mapping.explored_s:.0f} s"
    driven_m = "" if mapping.driven_m is None else f", {mapping.driven_m:.1f} m driven"
    covered = share(mapping.coverage_share)
    if mapping.coverage_share is None and mapping.free_m2 is not None:
        covered = f"{mapping.free_m2:.0f} m2 of a floor without an edge"
    rows = [("floor mapped", f"{covered}{time_s}{driven_m}")]
    if mapping.milestones:
        when = (
            f"{step.coverage_share:.0%} at {step.time_s:.0f} s and {step.driven_m:.1f} m"
            for step in mapping.milestones
        )
        rows.append(("", ", ".join(dict.fromkeys(when))))
    rows += [
        ("walls found", f"{share(mapping.walls_found_share)} within 0.10 m"),
        ("walls true", f"{share(mapping.walls_true_share)} of the occupied cells"),
        ("wrongly free", f"{share(mapping.free_wrong_share, 2)} of the free cells"),
        ("path error", _metres(mapping.trajectory_error_m)),
        ("", f"{_metres(mapping.aligned_error_m)} after alignment with the true path"),
        (
            "over 1 m",
            f"rmse {measured(mapping.relative_error_m.rmse, 3)} m, {measured(turned_deg, 2)} deg",
        ),
        (
            "graph",
            f"{mapping.keyframes} keyframes, {mapping.loops} loops closed, "
            f"{mapping.false_loops} of them wrong, {mapping.loops_rejected} rejected",
        ),
    ]
    if markers.found or markers.missing or markers.false:
        p95_rad = markers.error_rad.p95
        p95_deg = None if p95_rad is None else math.degrees(p95_rad)
        rows.append(
            (
                "markers",
                f"{markers.found} found, {markers.missing} missing, {markers.false} false, "
                f"p95 {measured(markers.error_m.p95, 3)} m, {measured(p95_deg, 1)} deg",
            )
        )
    return rows


def share(value: float | None, digits: int = 1) -> str:
    """A share of 0 to 1 in percent, or a dash where nothing was measured."""
    return NOT_MEASURED if value is None else f"{value:.{digits}%}"


def _metres(error: TrajectoryError) -> str:
    return (
        f"rmse {measured(error.rmse, 3)} m, p95 {measured(error.p95, 3)} m, "
        f"max {measured(error.max, 3)} m"
    )
