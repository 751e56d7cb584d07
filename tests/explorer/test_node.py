"""The explorer's node against a robot that drives and sees by hand."""

import time

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages import topics as table
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.explorer.config import ExplorerConfig
from mazebot.explorer.exploration import aim, survey
from mazebot.explorer.floor import floor_from
from tests.common.samples import WORLD
from tests.explorer.worlds import RESOLUTION_M, Stage, plan

TWO_ROOMS = plan(
    "##############",
    "#.....#......#",
    "#.....#......#",
    "#............#",
    "#............#",
    "#.....#......#",
    "#.....#......#",
    "#######..#####",
    "######...#...#",
    "######...#...#",
    "##############",
)
HOME = SE2(1.25, 2.25, 0.0)
CONFIG = ExplorerConfig()


def test_it_sees_all_that_can_be_reached_and_drives_home() -> None:
    stage = Stage(TWO_ROOMS, HOME, CONFIG)
    stage.run(120, "complete", "failed")
    assert stage.status.state == "complete"
    assert stage.status.reason == "no reachable frontiers left"
    assert stage.status.reachable == stage.status.set_aside == 0
    assert stage.status.seen_share == 1.0
    assert stage.robot.distance_m(HOME) < 0.1
    assert stage.status.driven_m == pytest.approx(stage.driven_m, abs=0.3)
    # The closed room is no floor for it.
    assert (stage.known[10:28, 102:128] < 0).all()
    reach = floor_from(TWO_ROOMS, RESOLUTION_M, SE2(0.0, 0.0, 0.0), HOME, 0.24, 0.5).reachable
    assert (stage.known[reach[2:-2, 2:-2]] == 0).mean() > 0.999


def test_it_sees_what_lies_behind_a_gap_that_its_outline_fits_through() -> None:
    rooms = TWO_ROOMS.copy()
    # In the wall between the rooms, 0.40 m are left of the door.
    rooms[68:80, 60:70] = 100
    stage = Stage(rooms, HOME, CONFIG)
    stage.run(120, "complete", "failed")
    assert (stage.status.state, stage.status.seen_share) == ("complete", 1.0)
    assert (stage.known[45:95, 75:125] == 0).all()


def test_it_does_not_wait_for_long_for_what_a_view_point_does_not_show() -> None:
    stage = Stage(TWO_ROOMS, HOME, CONFIG)
    stage.run(10, "exploring")
    for _ in range(30):
        stage.step()
    stage.range_m = 0.3
    stage.run(60, "returning", "complete", "failed")
    assert stage.status.state == "returning"


def test_it_never_stops_before_the_end() -> None:
    stage = Stage(TWO_ROOMS, HOME, CONFIG)
    stood = 0
    while not stage.statuses or stage.status.state not in ("returning", "complete"):
        before = stage.robot
        stage.step()
        stood += stage.goals != [] and stage.robot == before
    # 1.5 s until it is sure that nothing is left to see, and a second for the map.
    assert stood <= 30


def test_a_place_that_cannot_be_reached_is_set_aside_and_told() -> None:
    stage = Stage(TWO_ROOMS, HOME, CONFIG)
    stage.refuses = lambda goal: 208 if goal.x_m > 2.6 else 0
    stage.run(200, "complete", "failed")
    assert stage.status.state == "complete"
    assert "could not be reached" in stage.status.reason
    assert stage.status.set_aside > 0
    assert stage.status.seen_share < 1.0
    assert stage.robot.distance_m(HOME) < 0.1
    # Each is tried more than once, but not for ever.
    assert 2 <= sum(goal.x_m > 2.6 for _, goal in stage.goals) < 20


def test_a_place_is_tried_again_when_the_map_there_changes() -> None:
    stage = Stage(TWO_ROOMS, HOME, CONFIG)
    refused: list[SE2] = []

    def once(goal: SE2) -> int:
        if goal.x_m > 3.2 and len(refused) < 1:
            refused.append(goal)
            return 208
        return 0

    stage.refuses = once
    stage.run(200, "complete", "failed")
    assert refused
    assert stage.status.reason == "no reachable frontiers left"
    assert stage.status.seen_share == 1.0


def test_a_robot_that_cannot_move_does_not_try_for_ever() -> None:
    config = CONFIG.model_copy(update={"progress_timeout": 3.0})
    stage = Stage(TWO_ROOMS, HOME, config)
    stage.stuck = True
    stage.run(120, "failed", "complete", "returning")
    assert stage.status.set_aside > 0


def test_it_stops_and_goes_on_when_told_to() -> None:
    stage = Stage(TWO_ROOMS, HOME, CONFIG)
    stage.run(10, "exploring")
    for _ in range(20):
        stage.step()
    stage.say(table.EXPLORE_RESUME, msg.Bool(data=False))
    sent, there = len(stage.goals), stage.robot
    stage.step()
    assert (stage.status.state, stage.goal) == ("paused", None)
    for _ in range(50):
        stage.step()
    assert len(stage.goals) == sent
    assert stage.robot.distance_m(there) < 0.2
    stage.say(table.EXPLORE_RESUME, msg.Bool(data=True))
    stage.run(120, "complete")
    assert stage.status.seen_share == 1.0


def test_it_gives_way_to_a_new_goal_and_goes_on_after_it() -> None:
    stage = Stage(TWO_ROOMS, HOME, CONFIG)
    stage.run(10, "exploring")
    for _ in range(15):
        stage.step()
    assert stage.goal is not None
    theirs, own = HOME, stage.goal
    stage.goal = (1, theirs)
    stage.end(own, ErrorCode.PREEMPTED)
    sent = len(stage.goals)
    while stage.goal is not None:
        stage.step()
    there_ns = stage.now_ns
    assert stage.robot.distance_m(theirs) < 0.2
    assert len(stage.goals) == sent
    stage.run(120, "complete")
    assert stage.status.seen_share == 1.0
    assert stage.status.set_aside == 0
    assert stage.goals[sent][0] - there_ns > 1_500_000_000


def test_it_begins_anew_with_the_simulation() -> None:
    stage = Stage(TWO_ROOMS, HOME, CONFIG)
    stage.run(10, "exploring")
    for _ in range(50):
        stage.step()
    assert stage.status.driven_m > 1.0
    stage.known[:] = -1
    stage.robot, stage.goal = HOME, None
    stage.now_ns = 0
    stage.step()
    assert stage.status.state == "waiting"
    assert stage.status.driven_m == 0.0
    stage.run(120, "complete")
    assert stage.status.seen_share == 1.0


def test_without_slam_or_without_exploring_it_is_silent() -> None:
    for slam, explore in ((False, False), (True, False)):
        world = WORLD.model_copy(update={"slam": slam, "explore": explore})
        stage = Stage(TWO_ROOMS, HOME, CONFIG, world)
        for _ in range(30):
            stage.step()
        assert stage.goals == []
        assert stage.statuses == []
        assert stage.node.waiting_for() is None


def test_it_says_what_it_waits_for() -> None:
    stage = Stage(TWO_ROOMS, HOME, CONFIG)
    stage.step()
    assert stage.node.waiting_for() == "navigation to become active"
    assert stage.status.state == "waiting"
    assert stage.status.reason == "waiting for navigation to become active"


def test_it_tells_where_the_frontiers_are() -> None:
    stage = Stage(TWO_ROOMS, HOME, CONFIG)
    stage.run(10, "exploring")
    told = len(stage.frontiers)
    while len(stage.frontiers) == told:
        stage.step()
    reachable, aside, chosen = stage.frontiers[-1].markers
    assert reachable.ns == "reachable"
    assert len(reachable.points) > 5
    assert not aside.points
    (goal,) = chosen.points
    sent = stage.goals[-1][1]
    assert abs(goal.x - sent.x_m) + abs(goal.y - sent.y_m) < 0.5


def test_a_goal_that_navigation_has_lost_is_sent_again() -> None:
    stage = Stage(TWO_ROOMS, HOME, CONFIG)
    stage.run(10, "exploring")
    for _ in range(5):
        stage.step()
    stage.goal, sent = None, len(stage.goals)
    for _ in range(30):
        stage.step()
    assert len(stage.goals) > sent


def test_it_fails_where_there_is_no_way_home() -> None:
    stage = Stage(TWO_ROOMS, HOME, CONFIG)
    stage.refuses = lambda goal: 208 if goal.distance_m(HOME) < 0.01 else 0
    stage.run(120, "complete", "failed")
    assert stage.status.state == "failed"
    assert stage.status.reason == "failed to return home: error 208: no way"


def test_it_ends_before_a_home_that_it_may_not_drive_to() -> None:
    stage = Stage(TWO_ROOMS, HOME, CONFIG)
    stage.refuses = lambda goal: 206 if goal.distance_m(HOME) < 0.8 else 0
    stage.run(120, "complete", "failed")
    assert stage.status.state == "complete"
    assert stage.status.reason.endswith("could not return home: no way")
    assert 0.7 < stage.robot.distance_m(HOME) < 1.3


def test_it_goes_home_where_the_map_shows_no_floor() -> None:
    stage = Stage(TWO_ROOMS, HOME, CONFIG)
    stage.run(10, "exploring")
    stage.step()
    seen = stage.status.seen_share
    # In the closed room, of which nothing is known.
    stage.robot, stage.stuck = SE2(5.8, 1.0, 0.0), True
    stage.truth = np.full_like(TWO_ROOMS, -1)
    stage.run(60, "returning", "failed")
    assert (stage.status.state, stage.status.seen_share) == ("returning", seen)
    assert stage.status.reason.startswith("stopped at (5.80, 1.00), where the map shows no floor")
    stage.robot, stage.stuck, stage.truth = SE2(2.25, 2.25, 0.0), False, TWO_ROOMS
    stage.run(200, "complete", "failed")
    assert (stage.status.state, stage.status.reason) == ("complete", "no reachable frontiers left")


def test_it_fails_where_the_robot_is_lost() -> None:
    stage = Stage(TWO_ROOMS, HOME, CONFIG)
    stage.refuses = lambda goal: 9002
    stage.run(120, "complete", "failed")
    assert (stage.status.state, stage.status.reason) == ("failed", "no way")


def test_a_choice_is_quick() -> None:
    cells = np.full((200, 200), -1, np.int8)
    cells[10:190, 10:190] = 0
    cells[60, 10:150] = cells[120, 50:190] = 100
    robot = SE2(2.0, 2.0, 0.0)
    taken_s = []
    for _ in range(5):
        begun_s = time.process_time()
        seen = survey(CONFIG, cells, RESOLUTION_M, SE2(0.0, 0.0, 0.0), robot, robot)
        assert aim(CONFIG, seen, robot, None) is not None
        taken_s.append(time.process_time() - begun_s)
    assert min(taken_s) < 0.06


def test_a_robot_that_is_lost_keeps_its_goal_so_that_navigation_searches() -> None:
    stage = Stage(TWO_ROOMS, HOME, CONFIG)
    stage.run(10, "exploring")
    for _ in range(100):
        stage.step()
        if stage.goal is None and stage.goals:
            break
    assert stage.goal is None
    stage.localized, stage.stuck = False, True
    sent = len(stage.goals)
    for _ in range(300):
        stage.step()
    assert stage.goal is not None
    assert len(stage.goals) == sent + 1
    assert stage.status.state == "exploring"
    assert stage.status.set_aside == 0
    assert stage.status.reason == "the robot's pose is not known: it is searched for"
    stage.localized, stage.stuck = True, False
    stage.run(120, "complete", "failed")
    assert (stage.status.state, stage.status.set_aside) == ("complete", 0)
