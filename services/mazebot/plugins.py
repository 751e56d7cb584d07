"""What controllers, planners and behaviour tree nodes of your own are made of.

docs/controllers.md, docs/planning.md and docs/behavior-trees.md explain how each is written.
"""

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.engine.ports import Port
from mazebot.navigation.behavior.engine.tree import Node, NodeStatus
from mazebot.navigation.control.collision import Surroundings, Velocity
from mazebot.navigation.control.controller import (
    Control,
    Controller,
    ControllerParams,
    PathlessController,
    Robot,
)
from mazebot.navigation.control.path_follower import PathFollower
from mazebot.navigation.costmap.costmap import Costmap
from mazebot.navigation.errors import NavigationError
from mazebot.navigation.planning.interface import GlobalPlanner, PlannerParams
from mazebot.navigation.planning.path import PlannedPath, path_through, resample

__all__ = [
    "SE2",
    "Control",
    "Controller",
    "ControllerParams",
    "Costmap",
    "ErrorCode",
    "GlobalPlanner",
    "NavigationError",
    "Node",
    "NodeStatus",
    "PathFollower",
    "PathlessController",
    "PlannedPath",
    "PlannerParams",
    "Port",
    "Robot",
    "Surroundings",
    "Velocity",
    "path_through",
    "resample",
]
