"""What the action nodes of a tree share: they report error codes on the blackboard."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

from mazebot.navigation.behavior.engine.ports import Port, out
from mazebot.navigation.behavior.engine.tree import Node, NodeStatus
from mazebot.navigation.errors import NavigationError

SERVER_PORTS = (Port("server_name"), Port("server_timeout", "number"))
"""Ports of Nav2's action nodes that have no meaning within one process."""
ERROR_PORTS = (out("error_code_id", "integer"), out("error_msg", "text"))
ACTION_PORTS = (*SERVER_PORTS, *ERROR_PORTS)


class ActionNode(Node):
    """An action: it starts, runs in each tick, and reports why it failed."""

    action: ClassVar[str]
    """Nav2's name of the action, to which its codes belong."""

    def _tick(self, now_ns: int) -> NodeStatus:
        try:
            if self.status is not NodeStatus.RUNNING:
                self._begin(now_ns)
            status = self._on_running(now_ns)
        except NavigationError as error:
            self._fail(int(error.code), error.message)
            return NodeStatus.FAILURE
        if status is NodeStatus.SUCCESS:
            self.put("error_code_id", 0)
            self.put("error_msg", "")
        return status

    def _halt(self) -> None:
        self.put("error_code_id", 0)
        self.put("error_msg", "")
        self._cancel()

    def _fail(self, code: int, message: str) -> None:
        self._cancel()
        self.put("error_code_id", code)
        self.put("error_msg", message)
        self.place.run.failed(self.action, code, message)

    def _begin(self, now_ns: int) -> None:
        """Begin the action. May raise NavigationError."""

    @abstractmethod
    def _on_running(self, now_ns: int) -> NodeStatus:
        """Work for one tick: RUNNING or SUCCESS. May raise NavigationError."""

    def _cancel(self) -> None:
        """End what the action has started: it has failed, or is halted."""

    def where(self) -> str:
        """Where the robot is, as the end of a message; empty while that is not known."""
        try:
            pose = self.context.pose()
        except NavigationError:
            return ""
        return f" at ({pose.x_m:.2f}, {pose.y_m:.2f})"
