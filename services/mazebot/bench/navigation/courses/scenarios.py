"""The table of scenarios."""

from __future__ import annotations

from mazebot.bench.navigation.courses import (
    bench_worlds,
    docks,
    doors,
    hidden,
    lost,
    moving,
    people,
    through,
    tours,
    trust,
)
from mazebot.bench.navigation.courses.bench_worlds import BenchWorld
from mazebot.bench.navigation.scenario import Scenario

_MAZE = BenchWorld("maze", ("maze.rows=10", "maze.columns=10", "maze.braiding=0.5"))

SCENARIOS: tuple[Scenario, ...] = (
    Scenario(
        "tour_original", "the tour of the original world, by lidar alone",
        tours.tour("original"), 20, 5,
        "all goals, 0 contacts, SPL 0.93, localisation p95 0.03 m and 0.5 degrees",
    ),
    Scenario(
        "tour_enhanced", "the tour of the enhanced world, with camera and two markers",
        tours.tour("enhanced", camera=True), 20, 3,
        "all goals, 0 contacts, SPL 0.93, localisation p95 0.03 m and 0.5 degrees",
    ),
    Scenario(
        "random_goals", "four random goals in each shipped world", tours.random_goals, 20, 2,
        "all goals, 0 contacts",
    ),
    Scenario(
        "through_poses", "through four random poses without a stop, some in dead ends",
        through.through_poses, 20, 4, "20 of 20, 0 contacts",
    ),
    Scenario(
        "mazes", "a maze of 10 x 10 cells with loops, there and back", tours.maze, 20, 4,
        "all goals, 0 contacts",
    ),
    Scenario(
        "dropped_boxes", "a box falls on the path 1.2 m ahead", moving.dropped_boxes, 20, 5,
        "0 contacts of the robot's, 97 % of goals",
    ),
    Scenario(
        "box_removed", "a box in view is taken away", moving.box_removed, 20, 10,
        "gone from the global costmap within 1 s",
    ),
    Scenario(
        "patrols_yielding", "posts cross the path at 0.2 to 0.5 m/s and stop for the robot",
        moving.patrols(yields=True), 20, 3, "0 contacts of the robot's, 97 % of goals",
    ),
    Scenario(
        "patrols", "posts cross the path at 0.2 to 0.5 m/s and do not stop for the robot",
        moving.patrols(yields=False), 20, 3, "0 contacts of the robot's, 97 % of goals",
    ),
    Scenario(
        "patrols_predicted", "the same with MPPI, with prediction of the posts",
        moving.patrols(yields=False, settings=moving.PREDICTED), 20, 2,
        "better than `patrols_unpredicted`",
    ),
    Scenario(
        "patrols_unpredicted", "the same with MPPI, without prediction",
        moving.patrols(yields=False, settings=moving.UNPREDICTED), 20, 2,
        "baseline for `patrols_predicted`",
    ),
    Scenario(
        "head_on", "a person walks to and fro in a corridor of 1 to 1.5 m and stops for nobody",
        people.head_on, 20, 4, "0 contacts of the robot's, all goals",
    ),
    Scenario(
        "crushing_post", "a post drives the robot to a wall, which drives, stands or is lost",
        people.crushing_post, 20, 3, "0 contacts of the robot's, never pinned, all goals",
    ),
    Scenario(
        "unknown_start_markers", "unknown start pose; twelve markers",
        lost.unknown_start(BenchWorld("markers"), True, 20.0), 100, 3, "98 of 100 within 20 s",
    ),
    Scenario(
        "unknown_start_lidar", "unknown start pose; lidar alone",
        lost.unknown_start(BenchWorld("original"), False, 60.0), 100, 5, "92 of 100 within 60 s",
    ),
    Scenario(
        "unknown_start_maze", "unknown start pose in a 10 x 10 maze with loops",
        lost.unknown_start(_MAZE, False, 90.0), 100, 5, "90 of 100 within 90 s",
    ),
    Scenario(
        "kidnap_markers", "carried away in mid-drive; twelve markers",
        lost.kidnap("markers", turned=False, camera=True, within_s=15.0), 100, 3,
        "noticed within 2 s, found within 15 s in 98 of 100",
    ),
    Scenario(
        "kidnap_lidar", "carried away in mid-drive; lidar alone",
        lost.kidnap("original", turned=False, camera=False, within_s=60.0), 100, 6,
        "found within 60 s in 92 of 100",
    ),
    Scenario(
        "kidnap_turned", "turned by 90 to 180 degrees in mid-drive; lidar alone",
        lost.kidnap("original", turned=True, camera=False, within_s=60.0), 100, 6,
        "found within 60 s in 92 of 100",
    ),
    Scenario(
        "kidnap_goal", "carried away in mid-drive, with the same goal; lidar alone",
        lost.kidnap("original", turned=False, camera=False, within_s=60.0, reached_within_s=60.0),
        100, 6, "the goal reached within 60 s in 95 of 100",
    ),
    Scenario(
        "kidnap_mapping", "carried away while it explores a maze of rooms and makes a map",
        lost.kidnap_mapping("maze_rooms", 0.99), 20, 3,
        "20 of 20: no wrong pose trusted, 99 % of the map's walls right",
    ),
    Scenario(
        "beside_boxes", "three boxes around the robot in a hall", trust.beside_boxes, 20, 3,
        "no correct pose is abandoned",
    ),
    Scenario(
        "first_verdict", "an initial pose 0, 0.3, 0.9 or 5 m off, or on another world's map",
        trust.first_verdict, 20, 2, "the first pose called localized is right; on that map, none",
    ),
    Scenario(
        "unmapped_part", "a search in a half of the house that the map does not show",
        trust.unmapped_part, 20, 3, "no wrong pose is trusted",
    ),
    Scenario(
        "false_alarms", "six minutes of random goals among posts", moving.false_alarms, 20, 0,
        "no correct pose is abandoned, in 2 h",
    ),
    *(
        Scenario(
            f"corridors_{round(100 * width_m):03d}", f"a maze with corridors of {width_m} m",
            tours.narrow(width_m), 20, 6, "all goals, 0 contacts",
        )
        for width_m in tours.NARROW_M
    ),
    Scenario(
        "degraded_sensors", "lidar noise x 5, 30 % of rays lost, slip of 10 %, no camera",
        tours.tour("original", **tours.DEGRADED), 20, 5, "95 % of goals, 0 contacts",
    ),
    Scenario(
        "unreachable_goal", "the only door closes: for good, or for 8 s",
        moving.unreachable_goal, 20, 6, "the code and the place within 20 s; arrives if it opens",
    ),
    Scenario(
        "door_closed_15s", "the only door is closed for 15 s", moving.door_closed_15s, 10, 5,
        "waits, then passes, 10 of 10",
    ),
    Scenario(
        "low_boxes", "boxes lower than the lidar's plane on the way, with camera",
        hidden.on_the_way(hidden.low_box, 3), 20, 4, "all goals, 0 contacts",
    ),
    Scenario(
        "sills", "bars of 3 cm across the way, with camera",
        hidden.on_the_way(hidden.sill, 2), 20, 4, "all goals, 0 contacts",
    ),
    Scenario(
        "table_tops", "boards above the lidar's plane on the way, with camera",
        hidden.on_the_way(hidden.table_top, 2), 20, 4, "all goals, 0 contacts",
    ),
    Scenario(
        "panes", "glass in the nearer door: with a rail that the camera sees, or with nothing",
        hidden.panes, 20, 4,
        "with a rail 0 contacts, without at most one, and an end or a way round within 20 s",
    ),
    Scenario(
        "shut_door", "a door on the way is shut, and another way is free", doors.shut_door, 20, 3,
        "40 of 40, 0 contacts",
    ),
    Scenario(
        "narrow_door", "doors too narrow for the robot, with and without another way; wide ones",
        doors.narrow_door, 20, 3,
        "208 with the place and the width, or the other way; 0 contacts",
    ),
    Scenario(
        "start_in_inflation", "a start 1 to 6 cm from a wall", tours.start_in_inflation, 50, 10,
        "all succeed",
    ),
    Scenario(
        "occupied_goals", "goals in walls", moving.occupied_goals, 5, 5,
        "rejected within 100 ms with error code, place and nearest free pose",
    ),
    Scenario(
        "corridor_30x2", "a corridor of 30 x 2 m",
        tours.wide(bench_worlds.corridor_30x2, tours.CORRIDOR_GOALS), 5, 2,
        "all goals, the truth inside the 95 % ellipse for 90 % of the time",
    ),
    Scenario(
        "hall_20m", "an empty hall of 20 m",
        tours.wide(lambda: bench_worlds.hall(pillars=False), tours.HALL_GOALS), 5, 2,
        "all goals, the truth inside the 95 % ellipse for 90 % of the time",
    ),
    Scenario(
        "hall_20m_pillars", "a hall of 20 m with nine pillars",
        tours.wide(lambda: bench_worlds.hall(pillars=True), tours.HALL_GOALS), 5, 2,
        "all goals, the truth inside the 95 % ellipse for 90 % of the time",
    ),
    Scenario(
        "yard", "the yard of 20 m round a house",
        tours.wide(bench_worlds.yard, tours.YARD_GOALS), 5, 2,
        "all goals, the truth inside the 95 % ellipse for 90 % of the time",
    ),
    Scenario(
        "near_things", "goals 0.25 to 0.31 m from obstacles", tours.near_things, 20, 5,
        "60 of 60, at most 5 recoveries",
    ),
    Scenario(
        "docking", "docking at a marker", docks.docking, 60, 3,
        "0.02 m sideways, 0.03 m in all, 1.5 degrees, 60 of 60",
    ),
    Scenario(
        "docking_shipped", "docking at the markers of the shipped worlds",
        docks.docking_shipped, 60, 3, "0.02 m sideways, 0.03 m in all, 1.5 degrees, 60 of 60",
    ),
)  # fmt: skip

BY_NAME = {scenario.name: scenario for scenario in SCENARIOS}
GROUPS = {
    "tours": ("tour_original", "tour_enhanced"),
    "kidnap": ("kidnap_markers", "kidnap_lidar", "kidnap_turned", "kidnap_goal", "kidnap_mapping"),
    "trust": ("beside_boxes", "first_verdict", "unmapped_part"),
    "corridors": ("corridors_050", "corridors_060", "corridors_070"),
    "halls": ("corridor_30x2", "hall_20m", "hall_20m_pillars", "yard"),
    "unknown_start": ("unknown_start_markers", "unknown_start_lidar", "unknown_start_maze"),
    "moving": ("dropped_boxes", "box_removed", "patrols_yielding", "patrols"),
    "hidden": ("low_boxes", "sills", "table_tops", "panes"),
    "doors": ("unreachable_goal", "door_closed_15s", "shut_door", "narrow_door"),
    "people": ("head_on", "crushing_post"),
}
"""Short names of several scenarios"""
