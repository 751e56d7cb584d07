"""ROS 2's actions of one node on the wire of rmw_zenoh: three services and two topics each."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import zenoh

from mazebot.common.bus.attachment import pack_ros_attachment
from mazebot.common.bus.liveliness import GraphNode
from mazebot.common.bus.publisher import HEARTBEAT_S
from mazebot.common.bus.ros.service_server import Refuse, Respond, declare_service
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import CancelGoal
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.keys import LATCHED_QOS, PUBLISHER, RELIABLE_QOS, Keys
from mazebot.common.messages.topics import ACTION_FEEDBACK, ACTION_RESULT, CANCEL_GOAL
from mazebot.common.node.node import Inbox, Node
from mazebot.common.ros.actions import Action, Ended, GoalError, GoalStatus
from mazebot.common.ros.call import Response
from mazebot.common.ros.interfaces import interfaces

MAX_ENDED = 20
"""Goals of an action that have ended and whose results are kept: the newest ones."""
MAX_WAITING = 100
"""Requests for the result of one goal; further ones are refused."""
_NO_ERROR, _UNKNOWN_GOAL, _GOAL_TERMINATED = 0, 2, 3
_STATUSES = {
    "succeeded": GoalStatus.SUCCEEDED, "canceled": GoalStatus.CANCELED,
    "aborted": GoalStatus.ABORTED,
}  # fmt: skip


@dataclass
class _Goal:
    goal_id: str
    """32 hexadecimal digits."""
    message: Any
    stamp_ns: int
    status: GoalStatus = GoalStatus.ACCEPTED
    result: Response = field(default_factory=dict)
    waiting: list[Respond] = field(default_factory=list)
    """For its result."""

    @property
    def info(self) -> dict[str, Any]:
        """action_msgs/GoalInfo."""
        return {"goal_id": _uuid(self.goal_id), "stamp": msg.time_from_ns(self.stamp_ns)}


class ActionServer:
    """One action of a node. Any thread may call."""

    def __init__(
        self, action: Action, node: Node, inbox: Inbox, keys: Keys, now_ns: Callable[[], int]
    ) -> None:
        """`now_ns`: the time of the simulation, by which goals are stamped."""
        self._now_ns = now_ns
        self._action, self._inbox, self._keys = action, inbox, keys
        self._log = logging.getLogger(node.name)
        self._types = interfaces(keys.distro)
        self._lock = threading.RLock()
        self._goals: dict[str, _Goal] = {}
        self._publish: dict[str, Callable[[Response], None]] = {}

    def declare(self, session: zenoh.Session, graph: GraphNode) -> list[Any]:
        """Declare it on a session; keep the returned objects. Goals outlive the session."""
        handlers = (self._send_goal, self._cancel_goal, self._get_result)
        services = zip(self._action.services.items(), handlers, strict=True)
        topics = zip(self._action.topics.items(), (RELIABLE_QOS, LATCHED_QOS), strict=True)
        kept: list[Any] = [
            declare_service(session, self._keys, graph, name, type_name, handle, self._refused)
            for (name, type_name), handle in services
        ]
        kept += [
            self._publisher(session, graph, name, type_name, qos)
            for (name, type_name), qos in topics
        ]
        with self._lock:
            if self._goals:
                self._tell()
        return kept

    def _publisher(
        self, session: zenoh.Session, graph: GraphNode, name: str, type_name: str, qos: str
    ) -> Any:
        types = self._types
        type_hash = types.hash_of(type_name)
        gid, _ = graph.has(PUBLISHER, name, type_name, type_hash, qos)
        key = self._keys.typed(name, type_name, type_hash)
        encoding = zenoh.Encoding.APPLICATION_CDR
        publisher: Any
        if qos == LATCHED_QOS:
            publisher = zenoh.ext.declare_advanced_publisher(
                session, key, encoding=encoding, cache=zenoh.ext.CacheConfig(max_samples=1),
                sample_miss_detection=zenoh.ext.MissDetectionConfig(
                    heartbeat=HEARTBEAT_S, sporadic_heartbeat=None
                ),
                publisher_detection=True,
            )  # fmt: skip
        else:
            publisher = session.declare_publisher(key, encoding=encoding)
        sent = 0

        def publish(values: Response) -> None:
            nonlocal sent
            attachment = pack_ros_attachment(sent, time.time_ns(), gid)
            with contextlib.suppress(zenoh.ZError):
                publisher.put(types.encode(type_name, values), attachment=attachment)
            sent += 1

        self._publish[name.rpartition("/")[2]] = publish
        return publisher

    def _refused(self, reason: str) -> None:
        self._inbox.refuse(self._action.name, reason)

    def observe(self, message: act.ActionFeedback | act.ActionResult) -> None:
        """Pass on feedback and results of the node's goals, if they are goals of this action."""
        with self._lock:
            goal = self._goals.get(message.goal_id)
            if goal is None or goal.status.is_terminal:
                return
            try:
                self._pass_on(goal, message)
            except Exception:
                # This is within the node's step, which must go on.
                self._log.exception("%s", self._action.name)

    def _pass_on(self, goal: _Goal, message: act.ActionFeedback | act.ActionResult) -> None:
        if isinstance(message, act.ActionFeedback):
            feedback = self._action.feedback(message)
            self._publish["feedback"]({"goal_id": _uuid(goal.goal_id), "feedback": feedback})
            return
        self._end(
            goal, Ended(_STATUSES[message.status], self._action.result(message, goal.message))
        )

    def _send_goal(self, request: Any, respond: Respond, refuse: Refuse) -> None:
        goal_id = request.goal_id.uuid.tobytes().hex()
        goal = _Goal(goal_id, request.goal, self._now_ns())
        with self._lock:
            if goal_id in self._goals:
                respond({"accepted": False})
                return

        def accept(ended: Ended | None) -> None:
            with self._lock:
                if goal_id in self._goals:
                    # Two requests of one id were under way.
                    respond({"accepted": False})
                    return
                self._forget_oldest()
                self._goals[goal_id] = goal
                goal.status = GoalStatus.EXECUTING
                respond({"accepted": True, "stamp": msg.time_from_ns(goal.stamp_ns)})
                self._tell()
                if ended is not None:
                    self._end(goal, ended)

        def fail(error: GoalError) -> None:
            # As in Nav2: a goal is accepted, and what is wrong with it is its result.
            if error.code == ErrorCode.GOAL_REJECTED:
                self._log.error("%s: goal rejected: %s", self._action.name, error)
                respond({"accepted": False})
            else:
                accept(self._action.failed(error.code, str(error)))

        def answered(reply: Any) -> None:
            try:
                accept(self._action.answer(reply))
            except GoalError as error:
                fail(error)

        try:
            query, document = self._action.start(request.goal, goal_id)
        except GoalError as error:
            fail(error)
        except ValueError as error:
            refuse("invalid goal", " ".join(str(error).split()))
        else:
            if not self._inbox.ask(query, document, answered):
                refuse("too many pending requests", "")

    def _cancel_goal(self, request: Any, respond: Respond, _: Refuse) -> None:
        info = request.goal_info
        goal_id = info.goal_id.uuid.tobytes().hex()
        stamp_ns = msg.ns_from_time(info.stamp)
        with self._lock:
            known = self._goals.get(goal_id)
            meant = [goal for goal in self._goals.values() if not goal.status.is_terminal]
            if int(goal_id, 16):
                if known is None:
                    respond({"return_code": _UNKNOWN_GOAL})
                    return
                if known.status.is_terminal:
                    respond({"return_code": _GOAL_TERMINATED})
                    return
                meant = [known]
            elif stamp_ns:
                meant = [goal for goal in meant if goal.stamp_ns <= stamp_ns]
            for goal in meant:
                goal.status = GoalStatus.CANCELING
                # Its result comes as that of any goal.
                self._inbox.ask(CANCEL_GOAL, CancelGoal(goal_id=goal.goal_id), lambda _: None)
            if meant:
                self._tell()
            respond({"return_code": _NO_ERROR, "goals_canceling": [goal.info for goal in meant]})

    def _get_result(self, request: Any, respond: Respond, refuse: Refuse) -> None:
        with self._lock:
            goal = self._goals.get(request.goal_id.uuid.tobytes().hex())
            if goal is None:
                respond({"status": GoalStatus.UNKNOWN})
            elif goal.status.is_terminal:
                respond({"status": goal.status, "result": goal.result})
            elif len(goal.waiting) >= MAX_WAITING:
                refuse("too many pending requests", "")
            else:
                goal.waiting.append(respond)

    def _end(self, goal: _Goal, ended: Ended) -> None:
        goal.status, goal.result = ended
        self._tell()
        for respond in goal.waiting:
            respond({"status": goal.status, "result": goal.result})
        goal.waiting.clear()

    def _tell(self) -> None:
        """Publish the status of all goals."""
        statuses = [
            {"goal_info": goal.info, "status": goal.status} for goal in self._goals.values()
        ]
        self._publish["status"]({"status_list": statuses})

    def _forget_oldest(self) -> None:
        ended = [goal_id for goal_id, goal in self._goals.items() if goal.status.is_terminal]
        for goal_id in ended[: max(0, len(ended) - MAX_ENDED + 1)]:
            del self._goals[goal_id]


def _uuid(goal_id: str) -> dict[str, Any]:
    return {"uuid": np.frombuffer(bytes.fromhex(goal_id), np.uint8)}


OBSERVED = (ACTION_FEEDBACK.name, ACTION_RESULT.name)
"""The topics whose messages an action passes on."""
