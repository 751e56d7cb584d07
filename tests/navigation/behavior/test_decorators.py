from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2
from mazebot.navigation.behavior.engine.blackboard import Blackboard
from mazebot.navigation.behavior.engine.script import ScriptError, read_script
from mazebot.navigation.behavior.engine.tree import TreeError
from mazebot.navigation.behavior.nodes.goals import REQUESTED
from mazebot.navigation.behavior.nodes.xml_loader import read_tree
from mazebot.navigation.control.collision import Velocity
from mazebot.navigation.planning.path import PlannedPath, path_through
from tests.navigation.behavior.nav2_usage import document
from tests.navigation.behavior.scripted_tree import Ticked, run_over
from tests.navigation.behavior.simulated_robot import SimulatedRobot


@pytest.mark.parametrize(
    ("kind", "script", "ports", "answers", "ticked"),
    [
        ("Inverter", "RSF", {}, "RFS", 3),
        ("ForceSuccess", "RFS", {}, "RSS", 3),
        ("ForceFailure", "RFS", {}, "RFF", 3),
        ("KeepRunningUntilFailure", "SRSF", {}, "RRRF", 4),
        ("Repeat", "S", {"num_cycles": "3"}, "S", 3),
        ("Repeat", "SRSF", {"num_cycles": "3"}, "RF", 4),
        ("Repeat", "S", {"num_cycles": "-1"}, "RRR", 3),
        ("RetryUntilSuccessful", "FFS", {"num_attempts": "3"}, "S", 3),
        ("RetryUntilSuccessful", "F", {"num_attempts": "2"}, "F", 2),
        ("RetryUntilSuccessful", "FFS", {"num_attempts": "-1"}, "RRS", 3),
        ("SingleTrigger", "RSS", {}, "RSF", 2),
        ("Timeout", "R", {"msec": "100"}, "RRF", 2),
        ("Timeout", "RRRS", {"msec": "0"}, "RRRS", 4),
    ],
)
def test_a_decorator_turns_its_childs_answers(
    kind: str, script: str, ports: dict[str, str], answers: str, ticked: int
) -> None:
    tree = Ticked(kind, script, robot=None, **ports)
    assert tree.ticks(len(answers)) == answers
    assert tree.ticked() == [ticked]


def test_a_rate_controller_ticks_at_once_then_by_its_rate() -> None:
    tree = Ticked("RateController", "S", hz="5.0")
    # Every 50 ms; the period is 200 ms.
    assert tree.ticks(9) == "SRRRSRRRS"
    assert tree.ticked() == [3]


def test_a_rate_controller_stays_with_a_child_that_runs() -> None:
    tree = Ticked("RateController", "RRS", hz="1.0")
    assert tree.ticks(4) == "RRSR"
    assert tree.ticked() == [3]


def test_a_rate_controller_that_was_halted_ticks_at_once() -> None:
    tree = Ticked("RateController", "S", hz="1.0")
    tree.ticks(3)
    tree.node.halt()
    assert tree.tick() == "S"


def test_a_distance_controller_ticks_after_each_metre() -> None:
    robot = SimulatedRobot()
    tree = Ticked("DistanceController", "S", robot=robot, distance="1.0")
    answers = ""
    for step in range(25):
        robot.robot.map_from_base = SE2(0.1 * step, 0.0, 0.0)
        answers += tree.tick()
    assert [i for i, one in enumerate(answers) if one == "S"] == [0, 10, 20]


def test_a_speed_controller_plans_more_often_when_it_is_fast() -> None:
    counts = []
    for speed in (0.0, 0.4):
        robot = SimulatedRobot()
        robot.robot.velocity = Velocity(speed, 0.0)
        tree = Ticked(
            "SpeedController", "S", robot=robot, min_rate="0.5", max_rate="2.0", max_speed="0.4"
        )
        tree.ticks(200)
        counts.append(tree.ticked()[0])
    assert counts == [5, pytest.approx(20, abs=1)]


def test_a_speed_controller_ticks_at_once_for_a_new_goal() -> None:
    tree = Ticked("SpeedController", "S", robot=SimulatedRobot())
    tree.blackboard.set(REQUESTED, (SE2(1.0, 0.0, 0.0),))
    assert tree.ticks(3) == "SRR"
    tree.blackboard.set(REQUESTED, (SE2(2.0, 0.0, 0.0),))
    assert tree.ticks(3) == "SRR"


@pytest.mark.parametrize(
    ("kind", "port", "value", "must"),
    [
        ("Repeat", "num_cycles", "-5", "at least 0, or -1 for without end"),
        ("RetryUntilSuccessful", "num_attempts", "-2", "at least 0, or -1 for without end"),
        ("Timeout", "msec", "-1", "at least 0"),
        ("Delay", "delay_msec", "-5", "at least 0"),
        ("Sleep", "msec", "-5", "at least 0"),
    ],
)
def test_a_count_below_0_is_refused(kind: str, port: str, value: str, must: str) -> None:
    child = "" if kind == "Sleep" else "<AlwaysSuccess/>"
    with pytest.raises(ConfigError) as refused:
        read_tree(document(f'<{kind} {port}="{value}">{child}</{kind}>'), "t.xml")
    said = f"{kind}, port '{port}': must be {must} (got '{value}')"
    assert str(refused.value) == f"t.xml:1: {said}"
    # Also where only the blackboard has it.
    tree = read_tree(document(f'<{kind} {port}="{{n}}">{child}</{kind}>'), "t.xml").build(
        run_over()
    )
    tree.blackboard.set("n", float(value))
    with pytest.raises(TreeError, match=f"port '{port}': must be {must} "):
        tree.tick(0)


def test_a_goal_updated_controller_ticks_for_each_new_goal() -> None:
    tree = Ticked("GoalUpdatedController", "S")
    tree.blackboard.set(REQUESTED, (SE2(1.0, 0.0, 0.0),))
    assert tree.ticks(3) == "SRR"
    tree.blackboard.set(REQUESTED, (SE2(2.0, 0.0, 0.0),))
    assert tree.ticks(3) == "SRR"


def test_a_goal_updater_takes_the_goal_from_the_topic_when_there_is_one() -> None:
    robot = SimulatedRobot()
    tree = Ticked(
        "GoalUpdater", "S", robot=robot, input_goal="{goal}", output_goal="{updated_goal}"
    )
    tree.blackboard.set("goal", SE2(1.0, 0.0, 0.0))
    tree.tick()
    assert tree.blackboard.get("updated_goal") == SE2(1.0, 0.0, 0.0)
    robot.goal_update = SE2(3.0, 0.0, 0.0)
    tree.tick()
    assert tree.blackboard.get("updated_goal") == SE2(3.0, 0.0, 0.0)


def straight(length_m: float, bend_m: float = 0.0) -> PlannedPath:
    """A path to (2, 0) whose length is set by a detour."""
    points = np.array([[2.0 - length_m, 0.0], [1.0, bend_m], [2.0, 0.0]])
    return path_through(points, 0.0)


def test_a_much_longer_path_near_the_goal_is_noticed_once() -> None:
    robot = SimulatedRobot()
    tree = Ticked("PathLongerOnApproach", "RS", robot=robot, path="{path}")
    tree.blackboard.set("path", straight(2.0))
    assert tree.ticks(2) == "SS"
    assert tree.ticked() == [0]
    tree.blackboard.set("path", straight(2.0, bend_m=3.0))
    assert tree.ticks(3) == "RSS"
    assert tree.ticked() == [2]


def test_a_longer_path_to_a_far_or_another_goal_is_driven() -> None:
    robot = SimulatedRobot()
    tree = Ticked("PathLongerOnApproach", "R", robot=robot, path="{path}", prox_len="1.0")
    tree.blackboard.set("path", straight(2.0))
    tree.tick()
    tree.blackboard.set("path", straight(2.0, bend_m=3.0))
    assert tree.tick() == "S"


def test_a_delay_ticks_its_child_later() -> None:
    tree = Ticked("Delay", "RS", delay_msec="100")
    assert tree.ticks(4) == "RRRS"
    assert tree.ticked() == [2]
    assert tree.ticks(2) == "RR"


def test_run_once_runs_once() -> None:
    tree = Ticked("RunOnce", "RF")
    assert tree.ticks(2) == "RF"
    tree.node.halt()
    assert tree.ticks(2) == "KK"
    assert Ticked("RunOnce", "F", then_skip="false").ticks(3) == "FFF"


def test_a_precondition_is_asked_until_its_child_runs() -> None:
    # Names that Python has for itself.
    ports: Any = {"if": "level >= 0.5 && name == 'den'", "else": "RUNNING"}
    tree = Ticked("Precondition", "RRS", **ports)
    tree.blackboard.set("level", "0.2")
    tree.blackboard.set("name", "den")
    assert tree.ticks(2) == "RR"
    assert tree.ticked() == [0]
    tree.blackboard.set("level", 0.6)
    assert tree.tick() == "R"
    tree.blackboard.set("level", 0.1)
    assert tree.ticks(2) == "RS"
    never: Any = {"if": "1 > 2"}
    assert Ticked("Precondition", "S", **never).tick() == "F"


@pytest.mark.parametrize(
    ("code", "value"),
    [
        ("1 + 2 * 3", 7.0),
        ("(1 + 2) * -3", -9.0),
        ("a := 4; a -= 1; a", 3.0),
        ("'x' .. 2 .. 0.5", "x20.5"),
        ("1 < 2 && !(3 == 4) || false", 1.0),
        ("text == '7' ? 'yes' : 'no'", "yes"),
        ("text == 7", 1.0),
        ("flag != false", 1.0),
        ("0x10 | 1 ^ 3", 18.0),
        ("~0 & 6", 6.0),
        ("'a' != 1", 1.0),
        ("@root := 3; @root", 3.0),
        ("1e3 / 4", 250.0),
        # A comparison compares neighbours.
        ("0 < 7 < 5", 0.0),
        ("10 > 7 > 5", 1.0),
        ("1 == 1 < 2 != 3", 1.0),
        ("3 == 3 == 3", 1.0),
        # On one level, from left to right.
        ("true || false && false", 0.0),
        ("false && true || true", 1.0),
        ("0.1 + 0.2 == 0.3", 1.0),
        ("0.1 + 0.2 != 0.3", 0.0),
        ("0.3001 == 0.3", 0.0),
        ("'a' + 'b'", "ab"),
        ("'1' + '2'", "12"),
        ("t := 'a'; t += 'b'; t + 'c'", "abc"),
    ],
)
def test_scripts_are_those_of_behaviortree_cpp(code: str, value: float | str) -> None:
    board = Blackboard()
    board.set("text", "7")
    board.set("flag", True)
    assert read_script(code).run(board) == value


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("", "is empty"),
        ("a = ", "cannot be read at its end"),
        ("1 2", "cannot be read at '2'"),
        ("a ? 1", "must have ':' at its end"),
        ("'open", 'cannot be read at "\'open"'),
        ("gone > 1", "'gone' is not on the blackboard"),
        ("gone = 1", "'gone' is not on the blackboard: must be given by := first"),
        ("1 / 0", "divides by 0"),
        ("'a' < 1", "'a' is no number"),
        ("1.5 | 1", "1.5 is no integer"),
        ("(" * 90 + "1" + ")" * 90, "is nested more than 50 deep"),
    ],
)
def test_a_mistake_in_a_script_is_told(code: str, message: str) -> None:
    with pytest.raises(ScriptError) as caught:
        read_script(code).run(Blackboard())
    assert str(caught.value) == message
