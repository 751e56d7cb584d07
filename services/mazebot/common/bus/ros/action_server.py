"""ROS 2's actions of one node on the wire of rmw_zenoh: three services and two topics each."""

from __future__ import annotations

import contextlib
import logging
import re
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
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import CancelGoalReply
from mazebot.common.messages.keys import LATCHED_QOS, PUBLISHER, RELIABLE_QOS, Keys
from mazebot.common.messages.topics import Topic
from mazebot.common.node.node import Inbox, Node
from mazebot.common.ros.action import (
    Action,
    Course,
    Ended,
    Feedback,
    GoalError,
    GoalRejectedError,
    GoalStatus,
    Running,
    TakenUp,
)
from mazebot.common.ros.call import Response
from mazebot.common.ros.interfaces import interfaces

MAX_ENDED = 20
"""Goals of an action that have ended and whose results are kept: the newest ones."""
MAX_WAITING = 100
"""Requests for the result of one goal; further ones are refused."""
_GOAL_ID = re.compile(r"[0-9a-f]{32}")
_NO_ID = "0" * 32
_NO_ERROR, _UNKNOWN_GOAL, _GOAL_TERMINATED = 0, 2, 3


@dataclass
class _Goal:
    goal_id: str
    """32 hexadecimal digits."""
    stamp_ns: int = 0
    """When it was accepted."""
    heard: Callable[[Any], Feedback | Ended | None] = lambda _: None
    status: GoalStatus = GoalStatus.ACCEPTED
    result: Response = field(default_factory=dict)
    waiting: list[Respond] = field(default_factory=list)
    """For its result."""

    @property
    def info(self) -> dict[str, Any]:
        """action_msgs/GoalInfo."""
        return _info(self.goal_id, self.stamp_ns)


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
        self._early: list[tuple[Any, Respond, Refuse]] | None = None
        """Requests for results of goals that may be taken up yet; None: it is known which are."""
        if action.checkpoint is not None:
            self._early = []

    def declare(self, session: zenoh.Session, graph: GraphNode) -> list[Any]:
        """Declare it on a session; keep the returned objects. Goals outlive the session."""
        handlers = (self._send_goal, self._cancel_goal, self._get_result)
        services = zip(self._action.services.items(), handlers, strict=True)
        topics = zip(self._action.topics.items(), (RELIABLE_QOS, LATCHED_QOS), strict=True)
        kept: list[Any] = [
            declare_service(
                session, self._keys, graph, name, self._types, type_name, handle, self._refused
            )
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

    def observe(self, topic: Topic[Any], message: object) -> None:
        """Pass on what a message that the node sends says of goals of this action."""
        if topic is self._action.checkpoint:
            self._take_up(self._action.taken_up(message))
        if not self._goals or topic not in self._action.observes:
            return
        with self._lock:
            for goal in list(self._goals.values()):
                if goal.status.is_terminal:
                    continue
                try:
                    self._pass_on(goal, goal.heard(message))
                except Exception:
                    # This is within the node's step, which must go on.
                    self._log.exception("%s", self._action.name)

    def _take_up(self, told: TakenUp | None) -> None:
        """Go on with a goal that runs and is not known here: a process before had accepted it, or
        it did not come as one of ROS 2.
        """
        with self._lock:
            if told and told.goal_id not in self._goals and _GOAL_ID.fullmatch(told.goal_id):
                self._forget_oldest()
                self._goals[told.goal_id] = _Goal(*told, status=GoalStatus.EXECUTING)
                self._tell()
            early, self._early = self._early or (), None
            for request, respond, refuse in early:
                self._get_result(request, respond, refuse)

    def _pass_on(self, goal: _Goal, told: Feedback | Ended | None) -> None:
        if isinstance(told, Ended):
            self._end(goal, told)
        elif told is not None:
            values = {"goal_id": _uuid(goal.goal_id), "feedback": told.values}
            self._publish["feedback"](values)

    def _send_goal(self, request: Any, respond: Respond, refuse: Refuse) -> None:
        goal_id = request.goal_id.uuid.tobytes().hex()
        with self._lock:
            if goal_id in self._goals:
                respond({"accepted": False})
                return
        goal = _Goal(goal_id)
        course = self._action.run(request.goal, goal_id)
        self._go_on(goal, course, None, respond, refuse)

    def _go_on(
        self, goal: _Goal, course: Course, reply: Any, respond: Respond, refuse: Refuse
    ) -> None:
        """Let a goal take its course until it waits for a reply, or is to hear how it goes on."""
        with self._lock:
            if reply is not None and goal.status.is_terminal:
                return
            try:
                while True:
                    part, reply = course.send(reply), None
                    if isinstance(part, Feedback):
                        self._pass_on(goal, part)
                    elif isinstance(part, Running):
                        goal.heard = part.heard
                        if not self._accept(goal, respond):
                            course.close()
                            return
                    elif self._inbox.ask(
                        *part, lambda answer: self._go_on(goal, course, answer, respond, refuse)
                    ):
                        return
                    else:
                        self._give_up(goal, refuse, "too many pending requests")
                        return
            except StopIteration as end:
                if end.value is not None and self._accept(goal, respond):
                    self._end(goal, end.value)
            except GoalRejectedError as error:
                self._log.error("%s: goal rejected: %s", self._action.name, error)
                respond({"accepted": False})
            except GoalError as error:
                # As in Nav2: a goal is accepted, and what is wrong with it is its result.
                if self._accept(goal, respond):
                    self._fail(goal, error.code, str(error))
            except ValueError as error:
                self._give_up(goal, refuse, "invalid goal", " ".join(str(error).split()))
            except Exception:
                # It may run within the node's step, which must go on.
                self._log.exception("%s", self._action.name)
                self._give_up(goal, refuse, "internal error", "see the log of the service")

    def _accept(self, goal: _Goal, respond: Respond) -> bool:
        """Take a goal in, if it is not yet; False: another one has its id."""
        known = self._goals.get(goal.goal_id)
        if known is not None:
            if known is not goal:
                # Two requests of one id were under way.
                respond({"accepted": False})
            return known is goal
        self._forget_oldest()
        self._goals[goal.goal_id] = goal
        goal.status, goal.stamp_ns = GoalStatus.EXECUTING, self._now_ns()
        respond({"accepted": True, "stamp": msg.time_from_ns(goal.stamp_ns)})
        self._tell()
        return True

    def _give_up(self, goal: _Goal, refuse: Refuse, reason: str, detail: str = "") -> None:
        """Refuse a goal, or end it where it is accepted already."""
        if goal.status is GoalStatus.ACCEPTED:
            refuse(reason, detail)
        else:
            self._fail(goal, None, f"{reason}{detail and f': {detail}'}")

    def _fail(self, goal: _Goal, code: int | None, message: str) -> None:
        canceled = goal.status is GoalStatus.CANCELING
        status = GoalStatus.CANCELED if canceled else GoalStatus.ABORTED
        self._end(goal, Ended(status, self._action.failed(code, message)))

    def _cancel_goal(self, request: Any, respond: Respond, refuse: Refuse) -> None:
        info = request.goal_info
        named = info.goal_id.uuid.tobytes().hex()
        goal_id = None if named == _NO_ID else named
        until_ns = msg.ns_from_time(info.stamp) or None
        with self._lock:
            known = self._goals.get(named)
            meant = [goal for goal in self._goals.values() if not goal.status.is_terminal]
            if known is not None:
                if known.status.is_terminal:
                    respond({"return_code": _GOAL_TERMINATED})
                    return
                meant = [known]
            elif goal_id is not None:
                meant = []
            elif until_ns is not None:
                meant = [goal for goal in meant if goal.stamp_ns <= until_ns]
            for goal in meant:
                goal.status = GoalStatus.CANCELING
                # Its result comes as that of any goal.
                self._inbox.ask(*self._action.cancel(goal.goal_id), lambda _: None)
            if meant:
                self._tell()
            canceling = [goal.info for goal in meant]

        def answer(other: CancelGoalReply | None = None) -> None:
            if other is not None and not other.return_code:
                is_id = _GOAL_ID.fullmatch(other.goal_id)
                canceling.append(_info(other.goal_id if is_id else _NO_ID, other.accepted_ns))
            code = _UNKNOWN_GOAL if goal_id is not None and not canceling else _NO_ERROR
            respond({"return_code": code, "goals_canceling": canceling})

        if known is not None or self._action.cancel_other is None:
            answer()
        elif not self._inbox.ask(*self._action.cancel_other(goal_id, until_ns), answer):
            refuse("too many pending requests", "")

    def _get_result(self, request: Any, respond: Respond, refuse: Refuse) -> None:
        with self._lock:
            goal = self._goals.get(request.goal_id.uuid.tobytes().hex())
            waiting = self._early if goal is None else goal.waiting
            if waiting is not None and len(waiting) >= MAX_WAITING:
                refuse("too many pending requests", "")
            elif goal is None and self._early is not None:
                self._early.append((request, respond, refuse))
            elif goal is None:
                # The code of ROS 2 would be that of a success.
                result = self._action.failed(None, "goal_id: no goal with this id is known")
                respond({"status": GoalStatus.UNKNOWN, "result": result})
            elif goal.status.is_terminal:
                respond({"status": goal.status, "result": goal.result})
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


def _info(goal_id: str, stamp_ns: int) -> dict[str, Any]:
    return {"goal_id": _uuid(goal_id), "stamp": msg.time_from_ns(stamp_ns)}


def _uuid(goal_id: str) -> dict[str, Any]:
    return {"uuid": np.frombuffer(bytes.fromhex(goal_id), np.uint8)}
