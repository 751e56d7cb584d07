"""The robot gets out of the way of what comes towards it and does not stop."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pytest
import shapely

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.scan import Scan
from mazebot.navigation.config import CONTROL_PERIOD_NS
from mazebot.navigation.control.collision import Velocity
from mazebot.navigation.control.track import Track
from mazebot.navigation.control.tracking import TrackerParams
from mazebot.navigation.control.yielding.giving_way import GivingWay, GivingWayParams, Scene
from mazebot.navigation.control.yielding.newcomers import Newcomers
from mazebot.navigation.control.yielding.walkers import Walker, ways_of
from mazebot.navigation.costmap.costmap import Costmap, GridFrame
from mazebot.navigation.costmap.footprint import WAFFLE
from mazebot.navigation.costmap.inflation_layer import InflationParams, inflate
from mazebot.navigation.planning.path import PlannedPath
from tests.navigation.driving import Unicycle

CELL_M = 0.05
PERIOD_S = CONTROL_PERIOD_NS * 1e-9
NOWHERE = SE2(0.0, 0.0, 0.0)


def corridor(width_m: float, side_room: bool = False) -> Costmap:
    """A corridor along x from -4 to 4 m about y = 0, with or without a room of 0.9 m at x = -1."""
    frame = GridFrame(CELL_M, -4.0, -2.0, 80, 160)
    lethal = np.zeros((80, 160), np.bool_)
    y_m = -2.0 + (np.arange(80) + 0.5) * CELL_M
    x_m = -4.0 + (np.arange(160) + 0.5) * CELL_M
    lethal[np.abs(y_m) > width_m / 2.0] = True
    if side_room:
        rows, columns = (y_m > 0.0) & (y_m < width_m / 2.0 + 0.9), np.abs(x_m + 1.0) < 0.45
        lethal[np.ix_(rows, columns)] = False
    lethal[:, [0, -1]] = True
    return inflate(frame, lethal, np.zeros_like(lethal), InflationParams())


def straight_path(from_x_m: float, to_x_m: float) -> PlannedPath:
    x_m = np.linspace(from_x_m, to_x_m, 100)
    points = np.stack([x_m, np.zeros(100)], 1)
    return PlannedPath(points, np.zeros(100), x_m - from_x_m)


@dataclass
class Walk:
    """A person at a constant velocity, seen exactly."""

    x_m: float
    y_m: float
    vx_m_s: float
    vy_m_s: float = 0.0
    radius_m: float = 0.25

    def track(self, time_s: float) -> Track:
        x_m, y_m = self.x_m + self.vx_m_s * time_s, self.y_m + self.vy_m_s * time_s
        return Track(1, x_m, y_m, self.vx_m_s, self.vy_m_s, self.radius_m)


@dataclass
class Meeting:
    """What happened: the commands, and how near the robot and the person came."""

    commands: list[Velocity | None] = field(default_factory=list)
    nearest_m: float = math.inf
    pose: SE2 = NOWHERE


def meet(
    costmap: Costmap, walk: Walk, begin: SE2, seconds: float, path: PlannedPath | None,
    params: GivingWayParams | None = None,
) -> Meeting:  # fmt: skip
    """Drive the robot by what giving way commands; where it commands nothing, it stands."""
    robot = Unicycle(begin)
    giving_way = GivingWay(params or GivingWayParams(enabled=True), WAFFLE)
    seen = Meeting()
    for period in range(round(seconds / PERIOD_S)):
        track = walk.track(period * PERIOD_S)
        scene = Scene(robot.map_from_base, robot.velocity, costmap, (track,), path)
        command = giving_way.step(period * CONTROL_PERIOD_NS, scene, in_map=True)
        seen.commands.append(command)
        robot.drive(command or Velocity(0.0, 0.0), PERIOD_S)
        corners = [robot.map_from_base @ SE2(x, y, 0.0) for x, y in WAFFLE.points_m.tolist()]
        outline = shapely.Polygon([corner[:2] for corner in corners])
        away_m = shapely.distance(outline, shapely.Point(track.x_m, track.y_m)) - walk.radius_m
        seen.nearest_m = min(seen.nearest_m, away_m)
    seen.pose = robot.map_from_base
    return seen


MEETINGS = [
    pytest.param(corridor(1.2), Walk(2.5, -0.3, -0.5), id="aside"),
    pytest.param(corridor(1.1, side_room=True), Walk(2.5, 0.0, -0.5), id="side room"),
    pytest.param(corridor(1.5), Walk(2.5, 0.1, -0.4), id="wide"),
]


@pytest.mark.parametrize(("costmap", "walk"), MEETINGS)
def test_a_person_head_on_is_let_past(costmap: Costmap, walk: Walk) -> None:
    path = straight_path(-3.5, 3.5)
    met = meet(costmap, walk, NOWHERE, 11.0, path)
    assert met.nearest_m > 0.0
    assert met.commands[-1] is None, "the person is past, and the robot still gives way"
    off = meet(costmap, walk, NOWHERE, 11.0, path, GivingWayParams(enabled=False))
    assert off.nearest_m <= 0.0, "a robot that stands is not met: the test shows nothing"


def test_retreats_where_there_is_no_room_beside_the_person() -> None:
    met = meet(corridor(1.0), Walk(2.5, 0.0, -0.3), NOWHERE, 8.0, straight_path(-3.5, 3.5))
    assert met.nearest_m > 0.0
    assert met.pose.x_m < -0.8


@pytest.mark.parametrize("heading_rad", [0.0, 1.57, 3.14, -1.57])
def test_a_robot_that_stands_before_a_wall_leaves_the_way_of_a_post(heading_rad: float) -> None:
    begin = SE2(0.0, 0.5, heading_rad)
    walk = Walk(0.05, -0.9, 0.0, 0.3, 0.15)
    met = meet(corridor(1.9), walk, begin, 5.0, None)
    assert met.nearest_m > 0.0


@pytest.mark.parametrize(
    "walk",
    [
        pytest.param(Walk(0.9, -1.5, 0.0, 0.5), id="crosses ahead"),
        pytest.param(Walk(1.0, 0.0, 0.5), id="goes away"),
        pytest.param(Walk(1.0, 0.0, 0.0), id="stands"),
        pytest.param(Walk(3.0, 0.7, -0.5), id="passes beside"),
    ],
)
def test_what_does_not_come_to_the_robot_is_left_alone(walk: Walk) -> None:
    met = meet(corridor(2.4), walk, NOWHERE, 2.0, straight_path(-3.5, 3.5))
    assert set(met.commands) == {None}


def test_a_way_slides_along_a_wall_and_ends_before_one() -> None:
    costmap = corridor(1.2)
    askew, across = Walker(2.0, 0.0, -0.5, 0.15, 0.25), Walker(0.0, -0.3, 0.0, 0.5, 0.25)
    ways = ways_of((askew, across), costmap.distance_m, costmap.frame, 6.0)
    assert ways[0, -1, 0] == pytest.approx(-1.0, abs=0.1)
    assert np.abs(ways[0, :, 1]).max() < 0.45
    assert ways[1, -1, 1] == pytest.approx(0.4, abs=0.06)
    assert ways[1, -1, 0] == pytest.approx(0.0, abs=0.05)


def scan_of_room(pose: SE2, post: tuple[float, float] | None, stamp_ns: int) -> Scan:
    """360 beams in a room of 4 by 3 m, with a post of 0.15 m or without."""
    room = shapely.box(-2.0, -1.5, 2.0, 1.5).exterior
    things = room if post is None else room.union(shapely.Point(post).buffer(0.15).exterior)
    ranges = []
    for i in range(360):
        far = pose @ SE2(6.0 * math.cos(math.radians(i)), 6.0 * math.sin(math.radians(i)), 0.0)
        hit = shapely.intersection(things, shapely.LineString([pose[:2], far[:2]]))
        ranges.append(shapely.distance(hit, shapely.Point(pose[:2])))
    return Scan(np.array(ranges, np.float32), 0.0, math.tau / 360, 0.1, 3.5, NOWHERE, stamp_ns)


@pytest.mark.parametrize("comes", [True, False])
def test_newcomers_are_seen_without_a_map(comes: bool) -> None:
    """While the robot turns and drives; walls and the post that stands are none."""
    newcomers = Newcomers(TrackerParams())
    for i in range(25):
        pose = SE2(0.02 * i, 0.0, 0.08 * i)
        post = (1.5, -1.2 + 0.035 * i) if comes else (1.5, -1.0)
        newcomers.take_scan(scan_of_room(pose, post, i * 100_000_000), pose)
    found = newcomers.moving(2.4)
    assert len(found) == int(comes)
    if comes:
        (track,) = found
        assert math.hypot(track.x_m - 1.5, track.y_m + 0.36) < 0.2
        assert track.velocity_y_m_s == pytest.approx(0.35, abs=0.12)
