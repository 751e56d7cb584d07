"""What a user's planner, controller and nodes are given is their own, and what they answer is
checked before anybody drives by it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2
from mazebot.navigation.behavior.nodes.xml_loader import read_tree
from mazebot.navigation.control.collision import Surroundings, Velocity
from mazebot.navigation.control.controller import (
    Control,
    Controller,
    ControllerParams,
    PathlessController,
    Robot,
)
from mazebot.navigation.costmap.layered_costmap import Costmap
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.own_class import OwnController
from mazebot.navigation.planners import make_planner
from mazebot.navigation.planning.path import PlannedPath, path_through
from mazebot.plugins import Node, NodeStatus, Port
from tests.navigation.behavior.nav2_usage import document
from tests.navigation.behavior.scripted_tree import run_over
from tests.navigation.planning.grids import PARAMS, costmap_of

START, GOAL = SE2(0.5, 0.5, 0.0), SE2(2.5, 0.5, 1.0)
STRAIGHT = path_through(np.linspace(START[:2], GOAL[:2], 41), GOAL.yaw_rad)
SPEED = Velocity(0.1, 0.0)


def hall() -> Costmap:
    """Three metres square, with a wall at its upper end."""
    solid = np.zeros((60, 60), bool)
    solid[-4:] = True
    return costmap_of(solid, 0.15)


def spoil(*arrays: Any) -> None:
    for array in arrays:
        array[:] = 7


class Spoils(PathlessController):
    """Writes into everything that it is given."""

    def command(self, around: Surroundings) -> Velocity:
        assert self.path is not None
        spoil(around.costmap.costs, around.costmap.distance_m, around.echoes_m)
        spoil(around.forbidden, around.footprint.points_m)
        spoil(self.path.points_m, self.path.yaws_rad, self.path.along_m)
        return SPEED


class SpoilingPlanner:
    """Makes the costmap free, in place."""

    def __init__(self, params: object) -> None:
        pass

    def plan(
        self, costmap: Costmap, start: SE2, goal: SE2, tolerance_m: float = 0.0
    ) -> PlannedPath:
        spoil(costmap.costs, costmap.distance_m)
        return STRAIGHT


def own(controller: Controller) -> OwnController:
    return OwnController("mine.py:Mine", controller)


def made(kind: type[PathlessController]) -> PathlessController:
    return kind(ControllerParams(), Robot(), np.random.default_rng(0))


def test_what_a_controller_writes_into_what_it_is_given_blinds_nobody() -> None:
    echoes_m, forbidden = np.ones((3, 2)), np.zeros((60, 60), bool)
    around = Surroundings(START, hall(), echoes_m, forbidden=forbidden)
    footprint_m = around.footprint.points_m.copy()
    path = path_through(STRAIGHT.points_m.copy(), 1.0)
    controller = own(made(Spoils))
    controller.set_path(path, False)
    assert controller.step(0.05, around).velocity == pytest.approx((0.05, 0.0))
    assert (echoes_m == 1.0).all()
    assert not forbidden.any()
    assert (around.footprint.points_m == footprint_m).all()
    assert (around.costmap.costs == hall().costs).all()
    assert (around.costmap.distance_m == hall().distance_m).all()
    assert path.points_m.tolist() == STRAIGHT.points_m.tolist()
    assert path.along_m.tolist() == STRAIGHT.along_m.tolist()


def test_what_a_planner_writes_into_the_costmap_frees_no_way() -> None:
    costmap = hall()
    make_planner(f"{__name__}:SpoilingPlanner", PARAMS).plan(costmap, START, GOAL)
    assert (costmap.costs == hall().costs).all()
    assert (costmap.distance_m == hall().distance_m).all()


class Answers:
    """A planner that answers, or raises, what a test has written down."""

    answer: Any = None

    def __init__(self, params: object) -> None:
        pass

    def plan(
        self, costmap: Costmap, start: SE2, goal: SE2, tolerance_m: float = 0.0
    ) -> PlannedPath:
        if isinstance(self.answer, Exception):
            raise self.answer
        found: PlannedPath = self.answer
        return found


def planned(answer: object, monkeypatch: pytest.MonkeyPatch) -> PlannedPath:
    monkeypatch.setattr(Answers, "answer", answer)
    return make_planner(f"{__name__}:Answers", PARAMS).plan(hall(), START, GOAL)


def parts(path: PlannedPath) -> list[Any]:
    return [path.points_m, path.yaws_rad, path.along_m]


def between(start: tuple[float, float], goal: tuple[float, float]) -> PlannedPath:
    return path_through(np.linspace(start, goal, 41), 0.0)


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (between((0.5, 0.5), (1.5, 0.5)), "ends at (1.50, 0.50): must be one that ends at (2.50"),
        (between((1.5, 0.5), (2.5, 0.5)), "begins at (1.50, 0.50): must be one that begins at"),
        (between(GOAL[:2], START[:2]), "a path that begins at (2.50, 0.50)"),
        (replace(STRAIGHT, along_m=np.zeros(41)), "along_m that is not right: must be the"),
        (replace(STRAIGHT, cost_m=np.nan), "a number that is not finite"),
        (NavigationError("no way", "none"), "raised NavigationError with the code 'no way'"),  # type: ignore[arg-type]
        # It would be read as success.
        (NavigationError(0, "none"), "with the code 0: must be a number above 0"),  # type: ignore[arg-type]
    ],
)
def test_a_path_that_leads_elsewhere_is_refused(
    answer: object, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(
        ConfigError, match=r"tests/navigation/test_own_calls\.py:\d+: plan\(\) "
    ) as no:
        planned(answer, monkeypatch)
    assert said in str(no.value)
    assert "\n" not in str(no.value)


def test_a_path_of_lists_is_taken_and_made_dense(monkeypatch: pytest.MonkeyPatch) -> None:
    sparse = path_through(np.array([START[:2], GOAL[:2]]), GOAL.yaw_rad)
    path = planned(PlannedPath(*(part.tolist() for part in parts(sparse))), monkeypatch)
    assert path.points_m.shape == (21, 2)
    assert path.goal == GOAL


def test_a_path_within_the_tolerance_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    near = between((0.5, 0.9), (2.5, 0.57))
    assert planned(near, monkeypatch).points_m.tolist() == near.points_m.tolist()


class Steps(PathlessController):
    """Answers what a test has written down."""

    answer: Any = None
    wanted: Any = SPEED

    def command(self, around: Surroundings) -> Velocity:
        found: Velocity = self.wanted
        return found

    def step(self, elapsed_s: float, around: Surroundings) -> Control:
        found: Control = self.answer or super().step(elapsed_s, around)
        return found


def stepped(**answer: object) -> Control:
    inner = made(type("Steps", (Steps,), {**answer, "__module__": __name__}))
    controller = own(inner)
    controller.set_path(STRAIGHT, False)
    control = controller.step(0.05, Surroundings(START, hall(), np.empty((0, 2))))
    assert type(controller.velocity) is Velocity
    return control


@pytest.mark.parametrize("wanted", [(0.01, 0.0), Velocity(np.float32(0.01), np.int64(0))])  # type: ignore[arg-type]
def test_two_numbers_are_a_velocity(wanted: Any) -> None:
    for control in (
        stepped(wanted=wanted),
        stepped(answer=Control(wanted, np.bool_(False), False, np.float64(1.0))),  # type: ignore[arg-type]
    ):
        assert type(control.velocity) is Velocity
        assert control.velocity == pytest.approx((0.01, 0.0))
        assert [type(value) for value in control.velocity] == [float, float]
        assert control.reached is False


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (Control(SPEED, "no", False, 1.0), "a Control with reached 'no': must be True or False"),  # type: ignore[arg-type]
        (Control(SPEED, False, None, 1.0), "a Control with blocked None: must be True or False"),  # type: ignore[arg-type]
        (Control(SPEED, False, False, float("nan")), "distance_remaining_m nan: must be a finite"),
        (Control(SPEED, False, False, float("inf")), "distance_remaining_m inf: must be a finite"),
        (Control(SPEED, False, False, -3.0), "distance_remaining_m -3.0: must be a finite"),
        (Control(SPEED, False, False, None), "distance_remaining_m None: must be a finite"),  # type: ignore[arg-type]
    ],
)
def test_a_control_of_something_else_is_refused(answer: Control, said: str) -> None:
    with pytest.raises(ConfigError, match=r"controller mine\.py:Mine: .* step\(\) returned") as no:
        stepped(answer=answer)
    assert said in str(no.value)
    assert "\n" not in str(no.value)


class Own(Node):
    """A node of one's own."""

    def _tick(self, now_ns: int) -> NodeStatus:
        return NodeStatus.SUCCESS


class OnePort(Own):
    ports = Port("share", "number")  # type: ignore[assignment]


class Names(Own):
    ports = ("share",)  # type: ignore[assignment]


class Typed(Own):
    ports = (Port("share", "float"),)  # type: ignore[arg-type]


class TypedByList(Own):
    ports = (Port("share", ["number"]),)  # type: ignore[arg-type]


class Empty(Own):
    def __init__(self, place: object, children: object = ()) -> None:
        pass


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("OnePort", "ports: Port(name='share', type='number'"),
        ("Names", "ports: 'share': must be a Port"),
        ("Typed", "ports: share: type 'float': must be one of text, number"),
        ("TypedByList", "ports: share: type ['number']: must be one of text, number"),
        (
            "Empty",
            "__init__() made no whole node: must be one that calls super().__init__(",
        ),
    ],
)
def test_a_node_that_is_none_is_refused_in_one_line(kind: str, said: str) -> None:
    text = document(f'<Action ID="{__name__}:{kind}" share="0.5"/>')
    with pytest.raises(ConfigError) as no:
        read_tree(text, "t.xml").build(run_over()).tick(0)
    assert said in str(no.value)
    assert "\n" not in str(no.value)
    assert len(str(no.value)) < 400
