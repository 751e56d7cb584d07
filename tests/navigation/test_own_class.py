"""A class of a user's own: what it does wrong is one line, with its own lines of the traceback."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from mazebot import Session
from mazebot.common.config import ConfigError
from mazebot.embedded.demo import DemoOptions, run
from tests.cli.test_app import mazebot

CONTROLLER = """
from mazebot.plugins import PathlessController, Velocity

print("loaded")


def helper(around):
    return 1 / 0


class Mine(PathlessController):
    def command(self, around):
        print("called")
        return {value}
"""
PLANNER = """
import numpy as np
from mazebot.plugins import path_through, PlannedPath


class Mine:
    def __init__(self, params):
        pass

    def plan(self, costmap, start, goal, tolerance_m=0.0):
        print("called")
        return {value}
"""
NODE = """
from mazebot.plugins import Node, NodeStatus, Port


class Mine(Node):
    ports = (Port("share", "number", "0.5"),)

    def _tick(self, now_ns):
        print("called")
        return {value}
"""
TREE = """<root BTCPP_format="4"><BehaviorTree ID="Main"><Sequence>
  <Action ID="mine.py:Mine" share="0.2"/>
  <Wait wait_duration="0.1"/>
</Sequence></BehaviorTree></root>
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tree.xml").write_text(TREE)
    return tmp_path


CONTROLLERS = {
    "helper(around)": "mine.py:8: command() raised ZeroDivisionError: division by zero",
    "None": "mine.py:12: command() returned None: must be a Velocity",
    "Velocity(float('nan'), 0.0)": "mine.py:12: command() returned Velocity(linear_m_s=nan",
    "(0.1,)": "mine.py:12: command() returned (0.1,): must be a Velocity",
    "0.1": "mine.py:12: command() returned 0.1: must be a Velocity",
}
PLANNERS = {
    "1 / 0": "mine.py:12: plan() raised ZeroDivisionError: division by zero",
    "None": "mine.py:10: plan() returned None: must be a PlannedPath",
    "PlannedPath(np.zeros((3, 3)), np.zeros(3), np.zeros(3))": "plan() returned shapes ((3, 3)",
    "PlannedPath(np.full((3, 2), np.nan), np.zeros(3), np.zeros(3))": "number that is not finite",
}
NODES = {
    "1 / 0": "mine.py:10: _tick() raised ZeroDivisionError: division by zero",
    "None": "mine.py:8: _tick() returned None: must be a NodeStatus",
    "True": "mine.py:8: _tick() returned True: must be a NodeStatus",
}


def refused(**settings: Any) -> ConfigError:
    """The error with which a drive to a goal ends."""
    with Session("original", camera=False, **settings) as session:
        session.run_for(1.0)
        with pytest.raises(ConfigError) as raised:
            session.goal(0.5, -0.9, 0.0)
    error = raised.value
    assert "\n" not in str(error)
    assert len(str(error)) < 400
    return error


@pytest.mark.parametrize("value", CONTROLLERS)
def test_a_controller_that_does_wrong_is_named_with_its_line(folder: Path, value: str) -> None:
    (folder / "mine.py").write_text(CONTROLLER.replace("{value}", value))
    error = refused(controller="mine.py:Mine")
    assert str(error).startswith(f"controller mine.py:Mine: {CONTROLLERS[value]}")


@pytest.mark.parametrize("value", PLANNERS)
def test_a_planner_that_does_wrong_is_named_with_its_line(folder: Path, value: str) -> None:
    (folder / "mine.py").write_text(PLANNER.replace("{value}", value))
    (folder / "mine.yaml").write_text("navigation: {planner_server: {planner: 'mine.py:Mine'}}")
    error = refused(settings=folder / "mine.yaml")
    assert str(error).startswith("planner mine.py:Mine: mine.py:1")
    assert PLANNERS[value] in str(error)


@pytest.mark.parametrize("value", NODES)
def test_a_node_that_does_wrong_is_named_with_its_line(folder: Path, value: str) -> None:
    (folder / "mine.py").write_text(NODE.replace("{value}", value))
    trees = "bt_navigator: {default_nav_to_pose_bt_xml: tree.xml}"
    (folder / "mine.yaml").write_text(f"navigation: {{{trees}}}")
    error = refused(settings=folder / "mine.yaml")
    assert str(error).startswith(f"behavior tree node mine.py:Mine: {NODES[value]}")


def test_a_node_of_ones_own_is_ticked(folder: Path) -> None:
    (folder / "mine.py").write_text(NODE.replace("{value}", "NodeStatus.SUCCESS"))
    trees = "bt_navigator: {default_nav_to_pose_bt_xml: tree.xml}"
    (folder / "mine.yaml").write_text(f"navigation: {{{trees}}}")
    with Session("original", camera=False, settings=folder / "mine.yaml") as session:
        session.run_for(1.0)
        result = session.goal(0.5, -0.9, 0.0)
    assert result.error_code == 0


def test_its_frames_alone_follow_the_line(folder: Path) -> None:
    (folder / "mine.py").write_text(CONTROLLER.replace("{value}", "helper(around)"))
    ended = mazebot(
        "demo", "--world", "original", "--controller", "mine.py:Mine", "--no-record",
        "--no-camera", "--out", "run",
    )  # fmt: skip
    assert ended.returncode == 2
    lines = ended.stderr.splitlines()
    assert lines[0].startswith("error: controller mine.py:Mine: mine.py:8: command() raised")
    frames = [line for line in lines[1:] if line.lstrip().startswith("File ")]
    assert len(frames) == 2
    assert all("mine.py" in line for line in frames)


def test_it_is_called_in_the_run_alone(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "mine.py").write_text(CONTROLLER.replace("{value}", "Velocity(0.0, 0.0)"))
    with Session("original", camera=False, controller="mine.py:Mine") as session:
        session.run_for(1.0)
        assert capsys.readouterr().out == "loaded\n"


@pytest.mark.parametrize(
    ("kind", "text", "said"),
    [
        ("controller", CONTROLLER.replace("def command", "def comand"), "must have command"),
        (
            "controller",
            CONTROLLER.replace("{value}", "0\n    def set_path(self, path):\n        pass"),
            "set_path of line 15: (self, path): must take (self, path, same_goal)",
        ),
        ("planner", PLANNER.replace(", goal, tolerance_m=0.0", ""), "must take (self, costmap"),
        ("node", NODE.replace("_tick", "_tock"), "must have _tick"),
        ("node", NODE.replace("(Node)", ""), "must have"),
    ],
    ids=["controller", "arguments", "planner", "node", "no node"],
)
def test_what_lacks_a_method_is_refused_before_the_run(
    folder: Path, kind: str, text: str, said: str
) -> None:
    (folder / "mine.py").write_text(text.replace("{value}", "None"))
    settings = {
        "controller": "controller_server: {controller: 'mine.py:Mine'}",
        "planner": "planner_server: {planner: 'mine.py:Mine'}",
        "node": "bt_navigator: {default_nav_to_pose_bt_xml: tree.xml}",
    }
    (folder / "mine.yaml").write_text(f"navigation: {{{settings[kind]}}}")
    with pytest.raises(ConfigError, match=r"mine\.py:Mine") as raised:
        run(DemoOptions(world_name="original", settings=folder / "mine.yaml", record=False))
    assert said in str(raised.value)
