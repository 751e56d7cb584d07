"""Mazebot: the TurtleBot house maze with no ROS and no Gazebo.

    from mazebot import Session, topics

    with Session("enhanced", seed=7) as session:
        result = session.goal(0.5, -0.9)
        print(result.error_code, session.latest(topics.SCAN))

What a program imports is here, each name loaded when it is first used; `mazebot.plugins` has what
controllers, planners and behaviour tree nodes of your own are made of. docs/api.md describes both.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mazebot.commander.navigator import Navigator, TaskResult
    from mazebot.common.config import ConfigError
    from mazebot.common.messages import documents, messages, topics
    from mazebot.common.messages.action_documents import WaypointTask
    from mazebot.embedded.session import RefusedError, Session
    from mazebot.navigation.control.controller import Controller
    from mazebot.navigation.planning.interface import GlobalPlanner

__all__ = [
    "ConfigError",
    "Controller",
    "GlobalPlanner",
    "Navigator",
    "RefusedError",
    "Session",
    "TaskResult",
    "WaypointTask",
    "documents",
    "messages",
    "topics",
]

_MODULES = {
    "ConfigError": "mazebot.common.config",
    "Controller": "mazebot.navigation.control.controller",
    "GlobalPlanner": "mazebot.navigation.planning.interface",
    "Navigator": "mazebot.commander.navigator",
    "RefusedError": "mazebot.embedded.session",
    "Session": "mazebot.embedded.session",
    "TaskResult": "mazebot.commander.navigator",
    "WaypointTask": "mazebot.common.messages.action_documents",
    "documents": "mazebot.common.messages",
    "messages": "mazebot.common.messages",
    "topics": "mazebot.common.messages",
}


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = import_module(_MODULES[name])
    value = getattr(module, name, None) or import_module(f"{_MODULES[name]}.{name}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
