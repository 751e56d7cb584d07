"""Zones of the collision monitor: their form is that of the file, or the file is refused."""

from typing import Any

import numpy as np
import pytest

from mazebot.navigation.control.collision import STOP, Velocity
from mazebot.navigation.control.safety.collision_monitor import (
    CollisionMonitor,
    SourcePoints,
)
from tests.common.nav2_params.files import config_of, refused, row_of, told

AHEAD = "[[0.3, 0.3], [0.3, -0.3], [0.0, -0.3], [0.0, 0.3]]"
ZONE = {"type": "polygon", "action_type": "stop", "points": AHEAD}
SLOW = Velocity(0.2, 0.0)


def monitor(*listed: str, **zones: dict[str, Any]) -> dict[str, Any]:
    return {"polygons": list(listed or zones), **zones}


def passed(values: dict[str, Any], wall_x_m: float) -> Velocity:
    """What the monitor of a file lets pass of a slow drive towards a wall."""
    watcher = CollisionMonitor(
        config_of(told("collision_monitor", values)).collision_monitor, sources=()
    )
    wall_m = np.column_stack([np.full(20, wall_x_m), np.linspace(-0.1, 0.1, 20)])
    return watcher.step(10**9, SLOW, SLOW, {"scan": SourcePoints(10**9, wall_m)}).velocity


def test_a_zone_ahead_of_the_robot_is_as_large_as_in_the_file() -> None:
    for wall_x_m in (0.29, 0.2, 0.12):
        assert passed(monitor(Stop=ZONE), wall_x_m) == STOP
    assert passed(monitor(Stop=ZONE), 0.31) == SLOW
    beside = {**ZONE, "action_type": "limit", "linear_limit": 0.1,
              "points": "[[0.5, 0.3], [0.5, 0.1], [0.2, 0.3], [0.2, 0.1]]"}  # fmt: skip
    assert passed(monitor(Beside=beside), 0.3) == SLOW
    slower = {**ZONE, "action_type": "slowdown", "slowdown_ratio": 0.5}
    assert passed(monitor(Slow=slower), 0.2) == Velocity(0.1, 0.0)


@pytest.mark.parametrize(
    ("zone", "words"),
    [
        ({**ZONE, "action_type": "approach"},
         f"my.yaml:8: collision_monitor.Z.points: {AHEAD!r}: must enclose base_footprint, "
         "the point [0, 0], for an approach"),
        ({**ZONE, "points": "[[0.1, 0.1], [0.2, 0.2], [0.3, 0.3]]"},
         "my.yaml:8: collision_monitor.Z.points: '[[0.1, 0.1], [0.2, 0.2], [0.3, 0.3]]': must be "
         "at least 3 points that enclose an area"),
        ({**ZONE, "points": "[]"},
         'my.yaml:6: collision_monitor.Z.points: is missing: must be "[[x, y], [x, y], [x, y]]"'),
        ({"type": "polygon", "action_type": "slowdown", "polygon_sub_topic": "/zone"},
         "collision_monitor.Z.points: is missing: must be"),
        ({"type": "circle", "action_type": "stop"},
         "my.yaml:6: collision_monitor.Z.radius: is missing: must be in metres"),
        ({"action_type": "stop", "radius": 0.4},
         "collision_monitor.Z.type: is missing: must be polygon, circle or velocity_polygon"),
        ({"type": "circle", "radius": 0.4},
         "collision_monitor.Z.action_type: is missing: must be stop, slowdown, limit, approach"),
        ({"type": "circle", "radius": "$(var r)", "action_type": "stop"},
         "collision_monitor.Z.radius: is missing"),
        ({"type": "velocity_polygon", "action_type": "stop", "velocity_polygons": []},
         "my.yaml:8: collision_monitor.Z.velocity_polygons: []: must name at least one"),
        ({"type": "velocity_polygon", "action_type": "stop", "velocity_polygons": ["a"],
          "a": {"points": AHEAD, "linear_min": 0.0, "linear_max": 1.0, "theta_max": 1.0}},
         "collision_monitor.Z.a.theta_min: is missing: must be a speed"),
        ({"type": "velocity_polygon", "action_type": "approach", "velocity_polygons": ["a"],
          "a": {"points": AHEAD, "linear_min": 0.0, "linear_max": 1.0, "theta_min": -1.0,
                "theta_max": 1.0}},
         f"my.yaml:11: collision_monitor.Z.a.points: {AHEAD!r}: must enclose base_footprint"),
    ],
)  # fmt: skip
def test_a_zone_that_would_be_another_one_is_refused(zone: dict[str, Any], words: str) -> None:
    assert words in refused("collision_monitor", monitor(Z=zone))


def test_a_listed_zone_that_the_file_does_not_have_is_refused() -> None:
    assert refused("collision_monitor", monitor("Gone")).startswith(
        "my.yaml:4: collision_monitor.Gone.type: is missing: must be polygon"
    )


def test_an_approach_without_points_is_of_the_footprint() -> None:
    zone = {"type": "polygon", "action_type": "approach", "footprint_topic": "/footprint"}
    config = config_of(told("collision_monitor", monitor(Z=zone))).collision_monitor
    assert config.polygons["Z"].points == ()


def test_an_empty_list_leaves_no_zone() -> None:
    values = {"polygons": [], "FootprintApproach": {"type": "polygon", "action_type": "approach"}}
    found = told("collision_monitor", values)
    assert config_of(found).collision_monitor.polygons == {}
    row = row_of(found, "polygons")
    assert (row.status, row.setting) == ("mapped", "navigation.collision_monitor.polygons")
    assert row.note == "there are none then, nor those by default here"


def test_zones_that_are_not_listed_leave_those_by_default() -> None:
    found = told("collision_monitor", {"Z": ZONE})
    assert list(config_of(found).collision_monitor.polygons) == ["FootprintApproach"]


def test_nothing_of_the_monitor_is_off_because_a_launch_file_may_switch_it_off() -> None:
    values = {"enabled": "$(var on)", **monitor(Z={**ZONE, "enabled": "$(var on)"})}
    config = config_of(told("collision_monitor", values)).collision_monitor
    assert (config.enabled, config.polygons["Z"].enabled) == (True, True)
    listed = {**monitor(Z=ZONE), "polygons": ["$(var zone)", "Z"]}
    assert list(config_of(told("collision_monitor", listed)).collision_monitor.polygons) == ["Z"]


def test_velocity_polygons_are_those_of_the_file_in_the_order_of_its_list() -> None:
    bounds = {"linear_max": 1.0, "theta_min": -1.0, "theta_max": 1.0}
    near = "[[0.15, 0.2], [0.15, -0.2], [-0.2, -0.2], [-0.2, 0.2]]"
    zone = {
        "type": "velocity_polygon", "action_type": "stop", "min_points": 4, "holonomic": False,
        "velocity_polygons": ["fast", "slow"],
        "slow": {**bounds, "linear_min": 0.0, "points": near, "direction_start_angle": -1.0},
        "fast": {**bounds, "linear_min": 0.15, "points": AHEAD},
    }  # fmt: skip
    found = told("collision_monitor", monitor(Z=zone))
    polygons = config_of(found).collision_monitor.polygons["Z"].velocity_polygons
    assert list(polygons) == ["fast", "slow"]
    assert row_of(found, "Z.fast.points").status == "used"
    # The command is 0.2 m/s: both cover it.
    assert passed(monitor(Z=zone), 0.25) == STOP
    assert passed(monitor(Z={**zone, "velocity_polygons": ["slow"]}), 0.25) == SLOW


def test_what_a_source_or_a_zone_cannot_have_of_its_own_is_told() -> None:
    zone = {**ZONE, "sources_names": ["cloud"]}
    scan = {"type": "scan", "topic": "scan", "source_timeout": 0.2}
    found = told("collision_monitor",
                 {**monitor(Stop=zone), "observation_sources": ["scan"], "scan": scan})  # fmt: skip
    assert "the source of every zone" in row_of(found, "Stop.sources_names").note
    assert "the collision monitor itself" in row_of(found, "scan.source_timeout").note
