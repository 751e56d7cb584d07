"""`mazebot goal`: one goal, from the request to its result."""

from __future__ import annotations

import math
import queue
import sys
import time

from services.cli.session import connected
from services.cli.sim import PAUSED, stats_now
from services.common import messages as msg
from services.common import wire
from services.common.bus import put_once, subscribe, wait_until_alive
from services.common.config import ConfigError
from services.common.documents import NavigationResult
from services.common.frames import MAP_FRAME, SE2
from services.common.topics import GOAL_POSE, NAVIGATION_RESULT

PATIENCE_S = 5.0
"""Time to wait for a navigation service."""


def send_goal(endpoint: str, x_m: float, y_m: float, yaw_rad: float) -> int:
    """Send a goal and wait until navigation says how it ended; 0 where it was reached.

    Raises ConfigError where a number is not finite or nobody is there to drive.
    """
    for name, value in (("x", x_m), ("y", y_m), ("yaw", yaw_rad)):
        if not math.isfinite(value):
            raise ConfigError(f"goal: {name}: {value} is not a finite number")
    results: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    with connected(endpoint) as session:
        if not wait_until_alive(session, "navigation", PATIENCE_S):
            raise ConfigError("goal: no navigation service is running")
        subscription = subscribe(
            session, NAVIGATION_RESULT, lambda payload, _: results.put(payload)
        )
        now = stats_now(session, "goal")
        if now.paused:
            raise ConfigError(f"goal: {PAUSED}")
        stamp_ns = round(now.sim_time_s * 1e9)
        goal = msg.PoseStamped(
            header=msg.header(stamp_ns, MAP_FRAME), pose=msg.pose_from_se2(SE2(x_m, y_m, yaw_rad))
        )
        put_once(session, GOAL_POSE, goal, stamp_ns)
        sys.stdout.write(f"driving to ({x_m:g}, {y_m:g}, {yaw_rad:g})\n")
        sys.stdout.flush()
        result = _await_result(results, stamp_ns)
        del subscription
    if result.error_code:
        raise ConfigError(f"goal: {result.error_msg} (error code {result.error_code})")
    sys.stdout.write(f"reached after {result.end_time_s - result.start_time_s:.1f} s\n")
    return 0


def _await_result(results: queue.SimpleQueue[bytes], stamp_ns: int) -> NavigationResult:
    while True:
        try:
            result = wire.decode(NAVIGATION_RESULT, results.get(timeout=0.5))
        except (queue.Empty, wire.WireError):
            # Waiting in short turns lets Ctrl-C through.
            time.sleep(0)
            continue
        if result.goal_stamp_ns == stamp_ns:
            return result
