"""Paths of few poses, far from each other, are driven to their ends like those of a planner."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mazebot.common.maths.frames import SE2
from mazebot.common.messages import action_documents as act
from mazebot.common.messages.documents import Planar
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.actions import NavigateToPose, Request, TaskStatus
from mazebot.navigation.behavior.engine.ports import out
from mazebot.navigation.behavior.engine.tree import Node, NodeStatus
from mazebot.navigation.messages import planned_path, request_of
from mazebot.navigation.planning.path import PlannedPath, dense, path_through
from tests.navigation.behavior.nav2_usage import document
from tests.navigation.behavior.simulated_robot import Drive
from tests.navigation.driving import START


def longest_m(path: PlannedPath) -> float:
    return float(np.hypot(*np.diff(path.points_m, axis=0).T).max())


def of(*points: tuple[float, float], yaw_rad: float = 0.0) -> PlannedPath:
    return path_through(np.array(points), yaw_rad)


@pytest.mark.parametrize("seed", range(5))
def test_a_dense_path_keeps_its_points_and_has_no_long_legs(seed: int) -> None:
    random = np.random.default_rng(seed)
    points = np.repeat(random.uniform(-3.0, 3.0, (12, 2)), random.integers(1, 3, 12), axis=0)
    given = path_through(points, 0.7)
    path = dense(given)
    assert longest_m(path) <= 0.1 + 1e-9
    # To the last bit, and in their order.
    made = iter(path.points_m.tolist())
    assert all(point in made for point in points.tolist())
    assert path.goal == given.goal
    assert path.length_m == given.length_m
    steps = np.diff(path.points_m, axis=0)
    assert np.diff(path.along_m) == pytest.approx(np.hypot(*steps.T), abs=1e-9)
    moves = np.hypot(*steps.T) > 1e-9
    headings = np.arctan2(steps[moves, 1], steps[moves, 0])
    assert np.cos(headings - path.yaws_rad[:-1][moves]) == pytest.approx(1.0, abs=1e-9)


def test_a_path_that_is_dense_is_returned_as_it_is() -> None:
    for path in (
        of((0.0, 0.0), (0.1, 0.0), (0.1, 0.0), (0.1, 0.05)),
        path_through(np.linspace((0.0, 0.0), (3.0, 0.0), 31), 0.0),
        of((1.0, 1.0), (1.0, 1.0)),
    ):
        assert dense(path) is path


def test_a_piece_backwards_stays_one() -> None:
    poses = [(0.0, 0.0, 0.1), (-0.6, 0.0, math.pi / 2), (-0.6, 1.0, math.pi / 2)]
    given = tuple(Planar(x_m=x, y_m=y, yaw_rad=yaw) for x, y, yaw in poses)
    path = planned_path(given, ErrorCode.INVALID_PATH)
    assert longest_m(path) <= 0.1 + 1e-9
    assert np.flatnonzero(path.backwards()).tolist() == list(range(6))
    assert path.yaws_rad[:6].tolist() == [0.1] * 6


def test_a_robot_that_looks_along_both_ways_turns_about_between_them() -> None:
    out = [(0.05 * i, 0.0, 0.0) for i in range(12)]
    poses = [*out, *((x, y, math.pi) for x, y, _ in reversed(out[:-1]))]
    given = tuple(Planar(x_m=x, y_m=y, yaw_rad=yaw) for x, y, yaw in poses)
    assert not planned_path(given, ErrorCode.INVALID_PATH).backwards().any()


END = START @ SE2(0.85, -0.85, -math.pi / 4)


class Straight(Node):
    """A node of one's own, that plans a path of two points."""

    ports = (out("path", "path"),)

    def _tick(self, now_ns: int) -> NodeStatus:
        self.put("path", of(self.context.pose()[:2], END[:2], yaw_rad=END.yaw_rad))
        return NodeStatus.SUCCESS


def given(tmp_path: Path) -> Request:
    return request_of(act.FollowPath(path=tuple(Planar(**p._asdict()) for p in (START, END))))


def of_a_node(tmp_path: Path) -> Request:
    tree = f'<Action ID="{__name__}:Straight" path="{{p}}"/><FollowPath path="{{p}}"/>'
    (tmp_path / "tree.xml").write_text(document(f"<Sequence>{tree}</Sequence>"))
    return NavigateToPose(END, str(tmp_path / "tree.xml"))


@pytest.mark.parametrize("request_", [given, of_a_node])
def test_a_path_of_two_poses_is_driven_to_its_end(
    request_: Callable[[Path], Request], tmp_path: Path
) -> None:
    drive = Drive()
    result = drive.until_done(request_(tmp_path))
    assert result.status is TaskStatus.SUCCEEDED
    assert drive.robot.robot.map_from_base.distance_m(END) < 0.1
