"""Nodes that follow paths, choose plugins and clear costmaps."""

from __future__ import annotations

from typing import ClassVar

from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.context import (
    ClearingArea,
    ClearRequest,
    FollowRequest,
)
from mazebot.navigation.behavior.engine.ports import Port, out
from mazebot.navigation.behavior.engine.tree import Node, NodeStatus
from mazebot.navigation.behavior.nodes.nodes_action import ACTION_PORTS, SERVER_PORTS, ActionNode
from mazebot.navigation.errors import NavigationError

RUNNING, SUCCESS = NodeStatus.RUNNING, NodeStatus.SUCCESS


class FollowPath(ActionNode):
    """Follows the path on the blackboard, and every new one that appears there."""

    action = "FollowPath"
    ports = (
        Port("path", "path", required=True),
        Port("controller_id"),
        Port("goal_checker_id"),
        Port("progress_checker_id"),
        Port("path_handler_id"),
        out("tracking_feedback"),
        *ACTION_PORTS,
    )

    _request: FollowRequest | None = None

    def _begin(self, now_ns: int) -> None:
        self._request = None

    def _on_running(self, now_ns: int) -> NodeStatus:
        path = self.path("path")
        if path is None:
            if self.status is not RUNNING:
                raise NavigationError(ErrorCode.INVALID_PATH, "no path to follow")
            # The planner has found none this time: stand until it gives up or finds one.
            if self._request is not None:
                self._request = None
                self.context.stop()
            return RUNNING
        request = FollowRequest(
            path,
            self.text("controller_id"),
            self.text("goal_checker_id"),
            self.text("progress_checker_id"),
            self.text("path_handler_id"),
        )
        last = self._request
        if last is None or last.path is not path or last != request:
            self.context.follow(request)
            self._request = request
        feedback = self.context.control(now_ns)
        self.place.run.tracking = feedback
        self.put("tracking_feedback", feedback)
        if not feedback.reached:
            self.place.run.commands(self)
            return RUNNING
        self.context.stop()
        return SUCCESS

    def _cancel(self) -> None:
        self.place.run.releases(self)
        self.context.stop()

    def _hand_over(self) -> None:
        # The controller goes over to the other path in motion.
        self.place.run.releases(self)


class Cancel(Node):
    """Ends what runs of an action, whose node then succeeds."""

    ports = SERVER_PORTS
    action: ClassVar[str]

    def _tick(self, now_ns: int) -> NodeStatus:
        self.place.run.actions.cancel(self.action)
        return SUCCESS


def cancels(action: str) -> type[Cancel]:
    """The node that cancels an action."""
    return type(f"Cancel{action}", (Cancel,), {"action": action, "__doc__": f"Cancels {action}."})


class ClearEntireCostmap(ActionNode):
    """Forgets the obstacles of a costmap that the newest scan does not show."""

    action = "ClearEntireCostmap"
    area: ClassVar[ClearingArea] = "entirely"
    ports: ClassVar[tuple[Port, ...]] = (
        Port("service_name", "costmap", required=True),
        Port("server_timeout", "number"),
        Port("plugins", "layers"),
    )

    def _on_running(self, now_ns: int) -> NodeStatus:
        # Those that are valid are all that can be cleared.
        self.layers("plugins")
        self.context.clear_costmap(
            ClearRequest(
                self.costmap("service_name"),
                self.area,
                self.number("reset_distance") if self.get("reset_distance") is not None else 1.0,
                self.pose("pose"),
            )
        )
        return SUCCESS


class ClearCostmapExceptRegion(ClearEntireCostmap):
    """Forgets the obstacles outside a square around the robot."""

    action = "ClearCostmapExceptRegion"
    area = "except_region"
    ports = (*ClearEntireCostmap.ports, Port("reset_distance", "number", "1.0"))


class ClearCostmapAroundRobot(ClearEntireCostmap):
    """Forgets the obstacles within a square around the robot."""

    action = "ClearCostmapAroundRobot"
    area = "around_robot"
    ports = (*ClearEntireCostmap.ports, Port("reset_distance", "number", "1.0"))


class ClearCostmapAroundPose(ClearEntireCostmap):
    """Forgets the obstacles within a square around a pose."""

    action = "ClearCostmapAroundPose"
    area = "around_pose"
    ports = (
        *ClearEntireCostmap.ports,
        Port("pose", "pose", required=True),
        Port("reset_distance", "number", "1.0"),
    )


class Selector(Node):
    """The plugin name last received on a topic, or else the default."""

    what: ClassVar[str]

    def _tick(self, now_ns: int) -> NodeStatus:
        chosen = self.context.selected(self.text("topic_name"))
        self.put(f"selected_{self.what}", chosen or self.text(f"default_{self.what}"))
        return SUCCESS


def selector(kind: str, what: str) -> type[Selector]:
    """The selector node of one kind of plugin."""
    topic = f"{what}_selector"
    ports = (
        Port(
            "topic_name", default=topic, no_effect="nothing is heard there",
            unless=(topic, f"/{topic}"),
        ),
        Port(f"default_{what}"),
        out(f"selected_{what}", "text"),
    )  # fmt: skip
    return type(kind, (Selector,), {"what": what, "ports": ports, "__doc__": f"Selects a {what}."})


class ToggleCollisionMonitor(Node):
    """Switches the collision monitor on or off."""

    ports = (
        Port("enable", "flag", "true"),
        Port("service_name"),
        Port("server_timeout", "number"),
    )

    def _tick(self, now_ns: int) -> NodeStatus:
        self.context.toggle_collision_monitor(self.flag("enable"))
        return SUCCESS


class ReinitializeGlobalLocalization(Node):
    """Begins to search for the robot on the whole map."""

    ports = (Port("service_name"), Port("server_timeout", "number"))

    def _tick(self, now_ns: int) -> NodeStatus:
        self.context.reinitialize_global_localization()
        return SUCCESS
