"""The global planner by its name in the configuration: Mazebot's own, or a user's class."""

from __future__ import annotations

from dataclasses import replace
from typing import Final, cast

from mazebot.common.config import ConfigError
from mazebot.navigation.control.plugins import load_plugin
from mazebot.navigation.own_class import OwnPlanner
from mazebot.navigation.planning.planner import GlobalPlanner, Planner, PlannerParams


class AnyAngle(Planner):
    """Paths with corners anywhere."""

    def __init__(self, params: PlannerParams) -> None:
        super().__init__(replace(params, algorithm="any_angle"))


class AStar(Planner):
    """Paths in the cells' 8 directions, rounded."""

    def __init__(self, params: PlannerParams) -> None:
        super().__init__(replace(params, algorithm="a_star"))


PLANNERS: Final[dict[str, type[GlobalPlanner]]] = {"any_angle": AnyAngle, "a_star": AStar}


def make_planner(name: str, params: PlannerParams) -> GlobalPlanner:
    """A planner: `any_angle`, `a_star`, "my_package.my_module:MyPlanner" or "FILE.py:MyPlanner".

    A class of a user's own is made with the PlannerParams, and its calls are checked. Raises
    ConfigError, in one line.
    """
    found = load_plugin(name, GlobalPlanner, "planner", PLANNERS)
    try:
        made = cast("GlobalPlanner", found(params))
    except Exception as error:
        text = " ".join(str(error).split())
        raise ConfigError(
            f"planner: {name:.120}: cannot be constructed with PlannerParams: "
            f"{type(error).__name__}: {text:.200}"
        ) from error
    return made if name in PLANNERS else OwnPlanner(name, made, params)
