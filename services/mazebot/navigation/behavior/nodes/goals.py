"""The goal or goals of the running task, as the nodes of a tree find them on the blackboard."""

from __future__ import annotations

from collections.abc import Sequence

from mazebot.common.maths.frames import SE2
from mazebot.navigation.behavior.engine.blackboard import Blackboard

GOAL, GOALS, PATH = "goal", "goals", "path"
"""Nav2's names of these entries (goal_blackboard_id, goals_blackboard_id, path_blackboard_id)."""
WAYPOINT_STATUSES = "waypoint_statuses"
REQUESTED = "_requested_goals"
"""The goals as they were requested: RemovePassedGoals shortens the entry `goals` on the way."""


def goals_on_blackboard(blackboard: Blackboard) -> tuple[SE2, ...]:
    """Goals of the task as they were requested."""
    goals = blackboard.root.get(REQUESTED)
    return tuple(goals) if isinstance(goals, Sequence) else ()
