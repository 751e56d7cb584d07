"""What the action nodes of a tree share: they report error codes on the blackboard."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

from mazebot.common.messages.error_codes import ErrorCode
from mazebot.navigation.behavior.engine.ports import Port, out
from mazebot.navigation.behavior.engine.tree import Node, NodeStatus
from mazebot.navigation.errors import NavigationError

SERVER_PORTS = (Port("server_name"), Port("server_timeout", "number"))
"""Ports of Nav2's action nodes that have no meaning within one process."""
ERROR_PORTS = (out("error_code_id", "integer"), out("error_msg", "text"))
ACTION_PORTS = (*SERVER_PORTS, *ERROR_PORTS)


class ActionNode(Node):
    """An action: it starts, runs in each tick, and reports why it failed. One that was canceled
    succeeds; one that another of its kind has replaced fails.
    """

    action: ClassVar[str]
    """Nav2's name of the action, to which its codes belong."""

    _ended_as: NodeStatus | None = None
    """What it answers in its next tick, since it was canceled or preempted."""

    def _tick(self, now_ns: int) -> NodeStatus:
        try:
            if self.status is not NodeStatus.RUNNING:
                self._ended_as = None
                self.place.run.actions.begin(self.action, self)
                self._begin(now_ns)
            if self._ended_as is NodeStatus.FAILURE:
                raise NavigationError(
                    ErrorCode.PREEMPTED, f"{self}: preempted by another {self.action} of the tree"
                )
            status = self._ended_as or self._on_running(now_ns)
        except NavigationError as error:
            self._fail(int(error.code), error.message)
            return NodeStatus.FAILURE
        if status is NodeStatus.SUCCESS:
            self.place.run.actions.end(self.action, self)
            self.put("error_code_id", 0)
            self.put("error_msg", "")
        return status

    def _halt(self) -> None:
        self.put("error_code_id", 0)
        self.put("error_msg", "")
        self._leave()

    def _fail(self, code: int, message: str) -> None:
        self._leave()
        self.put("error_code_id", code)
        self.put("error_msg", message)
        self.place.run.failed(self.action, code, message)

    def _leave(self) -> None:
        if self.place.run.actions.end(self.action, self):
            self._cancel()

    def cancel(self) -> None:
        """See RunningAction."""
        self._ended_as = NodeStatus.SUCCESS
        self._cancel()

    def preempt(self) -> None:
        """See RunningAction."""
        self._ended_as = NodeStatus.FAILURE
        self._hand_over()

    def _begin(self, now_ns: int) -> None:
        """Begin the action. May raise NavigationError."""

    @abstractmethod
    def _on_running(self, now_ns: int) -> NodeStatus:
        """Work for one tick: RUNNING or SUCCESS. May raise NavigationError."""

    def _cancel(self) -> None:
        """End what the action has started: it has failed, or is halted or canceled."""

    def _hand_over(self) -> None:
        """End what another action of this kind does not go on with."""
        self._cancel()

    def where(self) -> str:
        """Where the robot is, as the end of a message; empty while that is not known."""
        try:
            pose = self.context.pose()
        except NavigationError:
            return ""
        return f" at ({pose.x_m:.2f}, {pose.y_m:.2f})"
