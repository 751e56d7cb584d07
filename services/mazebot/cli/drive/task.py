"""Runs one of Nav2's actions on a running stack: request, progress, result; Ctrl-C cancels it."""

from __future__ import annotations

import contextlib
import math
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

from mazebot.cli.drive.progress import ProgressLine
from mazebot.cli.output import OutputError
from mazebot.cli.parsing.options import print_json
from mazebot.cli.sim import PAUSED, stats_now
from mazebot.common.client.actions import ActionClient, cancel_goal, rejection_text
from mazebot.common.client.over_zenoh import ZenohRobot
from mazebot.common.client.robot import Robot, UnreachableError
from mazebot.common.client.service_watch import ServiceGoneError, wait_until_alive
from mazebot.common.config import ConfigError
from mazebot.common.messages import action_documents as act
from mazebot.common.messages.documents import CancelGoal, NavigationResult
from mazebot.common.messages.error_codes import code_name
from mazebot.common.messages.topics import ACTION_RESULT, Topic

R = TypeVar("R", act.ActionResult, NavigationResult)

PATIENCE_S = 5.0
"""Time to wait for a navigation service, and for its reply."""
EXIT_FAILED = 1
_TICK_S = 0.2
"""Waiting in short intervals lets Ctrl-C through."""


def ready(robot: Robot, who: str) -> int:
    """The simulation's time in ns. Raises ConfigError where navigation cannot take a goal."""
    await_navigation(robot, who)
    now = stats_now(robot, who)
    if now.paused:
        raise ConfigError(f"{who}: {PAUSED}")
    return round(now.sim_time_s * 1e9)


def await_navigation(robot: Robot, who: str) -> None:
    """Raises ConfigError where no navigation service is running."""
    if not wait_until_alive(robot, "navigation", PATIENCE_S):
        raise ConfigError(f"{who}: no navigation service is running{robot.elsewhere('navigation')}")


def run_task(
    endpoint: str,
    who: str,
    goal_of: act.ActionGoal | Callable[[Robot], act.ActionGoal],
    begin: str,
    timeout_s: float | None,
    as_json: bool,
    watch: tuple[Topic[Any], ...] = (),
    on_message: Callable[[Topic[Any], Any], str] = lambda _, __: "",
    meanwhile: Callable[[Robot], None] = lambda _: None,
) -> int:
    """Run an action to its end; returns 0 where it succeeded, and no waypoint was missed, else 1.

    Ctrl-C, and the end of `timeout_s` of wall time, cancel it: the robot stops.

    Args:
        endpoint: of the stack's router.
        who: the command's name, for errors.
        goal_of: the action, or a function that makes it for the robot.
        begin: a line to print when it is accepted.
        timeout_s: wall time; None: no limit.
        as_json: print the result as JSON and nothing else.
        watch: further topics to subscribe to while it runs.
        on_message: called with their messages; returns a line to print, or "".
        meanwhile: called in each interval while it runs.

    Raises ConfigError where navigation is not running.
    """
    goal_id = f"cli-{uuid.uuid4().hex[:12]}"
    goal_request = CancelGoal(goal_id=goal_id)
    with ZenohRobot(endpoint) as robot, ProgressLine(not as_json) as line:
        ready(robot, who)
        goal = goal_of(robot) if callable(goal_of) else goal_of
        with (
            ActionClient(robot, ACTION_RESULT, *watch) as client,
            canceled_on_error(robot, goal_request, line),
        ):
            reply = client.send(goal_id, goal, PATIENCE_S)
            if not reply.accepted:
                return _rejected(who, reply, as_json)
            line.say(begin)
            result = followed(client, line, timeout_s, on_message, lambda: meanwhile(robot))
            holds = client.holds
        if result is None:
            return timed_out(robot, goal_request, who, timeout_s, holds)
    return _ended(who, goal, result, as_json)


@contextlib.contextmanager
def canceled_on_error(robot: Robot, goal: CancelGoal, line: ProgressLine) -> Iterator[None]:
    """Cancels a goal where Ctrl-C or an error ends the context: the robot stops.

    Raises OutputError where nobody reads standard output any more: a task that was canceled for
    that has not succeeded.
    """
    try:
        yield
    except KeyboardInterrupt:
        cancel_goal(robot, goal, PATIENCE_S)
        line.show("")
        sys.stderr.write("canceled: the robot stops\n")
        raise
    except (ServiceGoneError, UnreachableError):
        raise
    except BaseException as error:
        with contextlib.suppress(ConfigError):
            cancel_goal(robot, goal, PATIENCE_S)
        if isinstance(error, BrokenPipeError):
            raise OutputError("standard output: nobody reads it: the task is canceled") from error
        raise


def followed(
    client: ActionClient[R],
    line: ProgressLine,
    timeout_s: float | None,
    on_message: Callable[[Topic[Any], Any], str] = lambda _, __: "",
    meanwhile: Callable[[], None] = lambda: None,
) -> R | None:
    """The result of a goal, with its progress on a line; None after `timeout_s` of wall time.

    Raises ServiceGoneError where navigation has ended or was restarted, UnreachableError where the
    router is lost.
    """
    end_s = math.inf if timeout_s is None else time.monotonic() + timeout_s
    while client.result is None and (left_s := end_s - time.monotonic()) > 0.0:
        for topic, message in client.update(min(left_s, _TICK_S)):
            text = on_message(topic, message)
            if text:
                line.say(text)
        feedback = client.feedback
        told = [] if feedback is None else [progress(feedback)]
        told += [f"held: {holds}"] if (holds := client.holds) else []
        if told:
            line.show(", ".join(told))
        meanwhile()
    return client.result


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


def timed_out(robot: Robot, goal: CancelGoal, who: str, timeout_s: float | None, holds: str) -> int:
    """Cancel a goal that took too long, and print why; returns the exit code. `holds`: what has
    held the robot at last.
    """
    cancel_goal(robot, goal, PATIENCE_S)
    held = f"; held at last: {holds}" if holds else ""
    sys.stderr.write(f"error: {who}: --timeout: {timeout_s:g} s: timed out: canceled{held}\n")
    return EXIT_FAILED


def failure(who: str, action: str, code: int, text: str) -> int:
    """Print the error of an action that failed; returns the exit code."""
    name = code_name("".join(part.title() for part in action.split("_")), code)
    sys.stderr.write(f"error: {who}: {' '.join(text.split())} (error code {code}, {name})\n")
    return EXIT_FAILED


def _status(status: str, error_msg: str) -> str:
    """How a task has ended, and why, where that says more."""
    return status if error_msg in ("", status) else f"{status}: {error_msg}"


def _rejected(who: str, reply: act.SendGoalReply, as_json: bool) -> int:
    if as_json:
        print_json(reply.model_dump(mode="json"))
        return EXIT_FAILED
    return failure(who, "", reply.error_code, rejection_text(reply))


def _ended(who: str, goal: act.ActionGoal, result: act.ActionResult, as_json: bool) -> int:
    missed = len(result.waypoints) if isinstance(goal, act.FollowWaypoints) else 0
    succeeded = result.status == "succeeded"
    if as_json:
        print_json(result.model_dump(mode="json"))
        return 0 if succeeded and not missed else EXIT_FAILED
    for one in result.waypoints:
        if one.error_code:
            name = code_name("NavigateToPose", one.error_code)
            sys.stdout.write(
                f"waypoint {one.index} {_status(one.status, one.error_msg)} "
                f"(error code {one.error_code}, {name})\n"
            )
    if not succeeded:
        return failure(who, result.action, result.error_code, result.error_msg)
    recoveries = result.number_of_recoveries
    also = f", {recoveries} recoveries" if recoveries else ""
    taken = f"after {result.end_time_s - result.start_time_s:.1f} s{also}"
    if not isinstance(goal, act.FollowWaypoints):
        sys.stdout.write(f"done {taken}\n")
        return 0
    count = len(goal.poses) * (goal.number_of_loops + 1)
    reached = f"reached {count - missed} of {count} waypoints {taken}"
    if missed:
        sys.stderr.write(f"error: {who}: {reached}\n")
        return EXIT_FAILED
    sys.stdout.write(f"{reached}\n")
    return 0
