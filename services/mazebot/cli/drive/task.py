"""Runs one of Nav2's actions on a running stack: request, progress, result; Ctrl-C cancels it."""

from __future__ import annotations

import contextlib
import math
import queue
import sys
import time
import uuid
from collections.abc import Callable
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self, TypeVar

from mazebot.cli.drive.progress import ProgressLine
from mazebot.cli.parsing.options import print_json
from mazebot.cli.session import ask, connected
from mazebot.cli.sim import PAUSED, stats_now
from mazebot.common.bus.liveliness import alive_key, service_and_source, wait_until_alive
from mazebot.common.bus.subscriber import subscribed
from mazebot.common.config import ConfigError
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import wire
from mazebot.common.messages.documents import CancelGoal, CancelGoalReply
from mazebot.common.messages.error_codes import code_name
from mazebot.common.messages.topics import (
    ACTION_FEEDBACK,
    ACTION_RESULT,
    CANCEL_GOAL,
    SEND_GOAL,
    Topic,
)

if TYPE_CHECKING:
    import zenoh

M = TypeVar("M")

PATIENCE_S = 5.0
"""Time to wait for a navigation service, and for its reply."""
EXIT_FAILED = 1
_TICK_S = 0.2
"""Waiting in short intervals lets Ctrl-C through."""


class ServiceGoneError(ConfigError):
    """The service that runs the task has ended."""


class Inlet:
    """Messages of some topics, in the order in which they come."""

    def __init__(
        self, session: zenoh.Session, *topics: Topic[Any], service: str = "navigation"
    ) -> None:
        """Subscribe to the topics, which come from a service."""
        self._service = service
        self._source = _sources(session, service)
        self._session = session
        self._waiting: queue.SimpleQueue[tuple[Topic[Any], bytes]] = queue.SimpleQueue()
        self._subscriptions = contextlib.ExitStack()
        for topic in topics:
            self._subscriptions.enter_context(subscribed(session, topic, self._receiver(topic)))
        self._heard_s = time.monotonic()

    def _receiver(self, topic: Topic[Any]) -> Callable[[bytes, object], None]:
        return lambda payload, _: self._waiting.put((topic, payload))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._subscriptions.close()

    def next(self, timeout_s: float) -> tuple[Topic[Any], Any] | None:
        """The next message with its topic; None if there is none in time.

        Raises ServiceGoneError where the service has ended, or was restarted: it has no task then.
        """
        try:
            topic, data = self._waiting.get(timeout=max(timeout_s, 0.0))
            self._heard_s = time.monotonic()
            return topic, wire.decode(topic, data)
        except wire.WireError:
            return None
        except queue.Empty:
            if time.monotonic() - self._heard_s > PATIENCE_S:
                self._heard_s = time.monotonic()
                now = _sources(self._session, self._service)
                self._source = self._source or now
                if not now & self._source:
                    what = "was restarted" if now else "has ended"
                    raise ServiceGoneError(f"the {self._service} service {what}") from None
            return None


def _sources(session: zenoh.Session, service: str) -> set[str]:
    """The processes of a service that are running."""
    replies = session.liveliness().get(alive_key(service, "*"), timeout=1.0)
    return {service_and_source(reply.ok.key_expr)[1] for reply in replies if reply.ok is not None}


def ready(session: zenoh.Session, who: str) -> int:
    """The simulation's time in ns. Raises ConfigError where navigation cannot take a goal."""
    await_navigation(session, who)
    now = stats_now(session, who)
    if now.paused:
        raise ConfigError(f"{who}: {PAUSED}")
    return round(now.sim_time_s * 1e9)


def await_navigation(session: zenoh.Session, who: str) -> None:
    """Raises ConfigError where no navigation service is running."""
    if not wait_until_alive(session, "navigation", PATIENCE_S):
        raise ConfigError(f"{who}: no navigation service is running")


def cancel(session: zenoh.Session, **which: Any) -> CancelGoalReply:
    """Cancel the goal with a `goal_id` or `goal_stamp_ns`, or any."""
    return ask(session, CANCEL_GOAL, CancelGoal(**which), PATIENCE_S)


def run_task(
    endpoint: str,
    who: str,
    goal_of: act.ActionGoal | Callable[[zenoh.Session], act.ActionGoal],
    begin: str,
    timeout_s: float | None,
    as_json: bool,
    watch: tuple[Topic[Any], ...] = (),
    took: Callable[[Topic[Any], Any], str] | None = None,
    meanwhile: Callable[[zenoh.Session], None] = lambda _: None,
) -> int:
    """Run an action to its end; returns 0 where it succeeded, else 1.

    Ctrl-C, and the end of `timeout_s` of wall time, cancel it: the robot stops.

    Args:
        endpoint: of the stack's router.
        who: the command's name, for errors.
        goal_of: the action, or what makes it of the session.
        begin: a line to print once it is accepted.
        timeout_s: wall time; None: no limit.
        as_json: print the result as JSON and nothing else.
        watch: further topics to hear while it runs.
        took: called with their messages; returns a line to print, or "".
        meanwhile: called every now and then while it runs.

    Raises ConfigError where navigation is not running, or the time is over.
    """
    goal_id = f"cli-{uuid.uuid4().hex[:12]}"
    with (
        connected(endpoint) as session,
        ProgressLine(not as_json) as line,
        contextlib.ExitStack() as stack,
    ):
        ready(session, who)
        goal = goal_of(session) if callable(goal_of) else goal_of
        inlet = stack.enter_context(Inlet(session, ACTION_FEEDBACK, ACTION_RESULT, *watch))
        try:
            reply = ask(session, SEND_GOAL, act.SendGoal(goal_id=goal_id, goal=goal), PATIENCE_S)
            if not reply.accepted:
                return _refused(who, reply, as_json)
            line.say(begin)
            end_s = math.inf if timeout_s is None else time.monotonic() + timeout_s
            result: act.ActionResult | None = None
            while result is None and (left_s := end_s - time.monotonic()) > 0.0:
                result = _taken(inlet.next(min(left_s, _TICK_S)), goal_id, line, took)
                meanwhile(session)
        except KeyboardInterrupt:
            cancel(session, goal_id=goal_id)
            line.show("")
            sys.stderr.write("canceled: the robot stops\n")
            raise
        except ServiceGoneError:
            raise
        except ConfigError:
            with contextlib.suppress(ConfigError):
                cancel(session, goal_id=goal_id)
            raise
        if result is None:
            cancel(session, goal_id=goal_id)
            raise ConfigError(f"{who}: --timeout: {timeout_s:g} s: not done by then: canceled")
    return _ended(who, result, as_json)


def _taken(
    come: tuple[Topic[Any], Any] | None,
    goal_id: str,
    line: ProgressLine,
    took: Callable[[Topic[Any], Any], str] | None,
) -> act.ActionResult | None:
    """The result of the goal with this id, if it is what has come; all else is shown."""
    topic, message = come or (None, None)
    if isinstance(message, act.ActionResult):
        return message if message.goal_id == goal_id else None
    if isinstance(message, act.ActionFeedback):
        if message.goal_id == goal_id:
            line.show(progress(message))
    elif topic is not None and took is not None:
        said = took(topic, message)
        if said:
            line.say(said)
    return None


def progress(feedback: act.ActionFeedback) -> str:
    """Feedback in one line: time, what is left, recoveries."""
    parts = [f"{feedback.navigation_time_s:.1f} s"]
    if feedback.current_waypoint is not None:
        parts.append(f"waypoint {feedback.current_waypoint}")
    if feedback.number_of_poses_remaining is not None:
        parts.append(f"{feedback.number_of_poses_remaining} to go")
    if feedback.distance_remaining_m is not None:
        parts.append(f"{feedback.distance_remaining_m:.2f} m left")
    if feedback.estimated_time_remaining_s is not None:
        parts.append(f"about {feedback.estimated_time_remaining_s:.0f} s left")
    if feedback.angular_distance_traveled_rad is not None:
        parts.append(f"turned {feedback.angular_distance_traveled_rad:.2f} rad")
    if feedback.distance_traveled_m is not None:
        parts.append(f"driven {feedback.distance_traveled_m:.2f} m")
    if feedback.docking_state is not None:
        parts.append(feedback.docking_state.replace("_", " "))
    if feedback.num_retries:
        parts.append(f"{feedback.num_retries} retries")
    if feedback.number_of_recoveries is not None:
        parts.append(f"{feedback.number_of_recoveries} recoveries")
    if feedback.paused:
        parts.append("paused")
    return ", ".join(parts)


def failure(who: str, action: str, code: int, text: str) -> int:
    """Print the line of an action that failed; returns the exit code."""
    name = code_name("".join(part.title() for part in action.split("_")), code)
    sys.stderr.write(f"error: {who}: {' '.join(text.split())} (error code {code}, {name})\n")
    return EXIT_FAILED


def _refused(who: str, reply: act.SendGoalReply, as_json: bool) -> int:
    if as_json:
        print_json(reply.model_dump(mode="json"))
        return EXIT_FAILED
    near, text = reply.nearest_free, reply.error_msg
    if near is not None and "nearest" not in text:
        text += f"; the nearest free pose is ({near.x_m:.2f}, {near.y_m:.2f}, {near.yaw_rad:.2f})"
    return failure(who, "", reply.error_code, text)


def _ended(who: str, result: act.ActionResult, as_json: bool) -> int:
    if as_json:
        print_json(result.model_dump(mode="json"))
        return 0 if result.status == "succeeded" else EXIT_FAILED
    for one in result.waypoints:
        if one.error_code:
            name = code_name("NavigateToPose", one.error_code)
            sys.stdout.write(
                f"waypoint {one.index} {one.status}: {one.error_msg} "
                f"(error code {one.error_code}, {name})\n"
            )
    if result.status != "succeeded":
        return failure(who, result.action, result.error_code, result.error_msg)
    recoveries = result.number_of_recoveries
    also = f", {recoveries} recoveries" if recoveries else ""
    sys.stdout.write(f"done after {result.end_time_s - result.start_time_s:.1f} s{also}\n")
    return 0
