"""One exploration from its start to the robot's return: what to drive to, and when it ends."""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace
from typing import Literal

from mazebot.common.maths.frames import SE2
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.slam_documents import ExplorationStatus, PlaceSetAside
from mazebot.common.world.costmap import Cells
from mazebot.explorer.exploration import Aim, Survey, aim, is_left, still, survey
from mazebot.explorer.frontiers import guessed_m2
from mazebot.explorer.params import ExplorerParams
from mazebot.explorer.paths import way
from mazebot.explorer.set_aside import SetAside
from mazebot.explorer.view_points import nearer

_LOG = logging.getLogger("explorer")

State = Literal["waiting", "exploring", "returning", "complete", "paused", "failed"]

_MOVED_M = 0.25
"""A goal that has moved by less is not sent again."""
_NEARER_M = 0.1
"""Coming nearer by as much is progress."""
_STANDS_M = 0.02
"""Odometry's noise is no way driven."""
_SURE_NS = 1_500_000_000
"""The map must show for so long that nothing is left to see."""
_SEE_NS = 3_000_000_000
"""At a goal, the robot waits so long for the map to show what is seen from there."""
_RESEND_NS = 2_000_000_000
"""A goal that navigation does not know is sent again after this time."""
_TELL_NS = 30_000_000_000
"""Progress is logged so often."""
_HOME_TRIES = 3
_BEFORE_HOME_M = 0.25
"""Where the start may not be driven to, the way home ends so much before it, or twice as much..."""
_REFUSALS = 3
"""A place is set aside when so many goals for it were refused because something stands there."""
_NOT_OUR_FAULT = (ErrorCode.PREEMPTED, ErrorCode.CANCELED, ErrorCode.WORLD_RESTARTED)
"""Results that do not depend on the way to a goal."""


@dataclass(frozen=True, eq=False)
class MapSoFar:
    """A map: (rows, columns) int8, 100 occupied, -1 unknown, and the pose of its corner."""

    cells: Cells
    resolution_m: float
    origin: SE2


@dataclass(frozen=True)
class _Sent:
    """A goal that navigation was given."""

    pose: SE2
    stamp_ns: int
    aim: Aim | None
    """None: home."""


class Explorer:
    """Decides on goals. The caller gives the time, maps, poses, and how goals have ended."""

    def __init__(self, params: ExplorerParams, home: SE2) -> None:
        self._params, self._home = params, home
        self.state: State = "waiting"
        self.reason = ""
        self.is_localized = True
        """Whether the robot knows where it is, as navigation has it."""
        self.is_held = False
        """Whether the robot may not move: the task is paused, or the robot is held or blind."""
        self.driven_m = 0.0
        self.goals = 0
        self.goal_stamp_ns: int | None = None
        """Of the goal that was sent last."""
        self.explored_ns = 0
        """Time of exploring, without that in which the robot was held."""
        self.seen: Survey | None = None
        """The map as it was looked at last."""
        self.aim: Aim | None = None
        self._map: MapSoFar | None = None
        self._robot: SE2 | None = None
        self._sent: _Sent | None = None
        self._own_ns: tuple[int, ...] = ()
        """Stamps of the last two goals: who cancels may have meant the one before."""
        self._busy_ns = 0
        """When navigation was last busy."""
        self._yields = False
        """Whether a goal of somebody else comes first."""
        self._aside = SetAside()
        self._looked_ns: int | None = None
        self._fresh = False
        """Whether the map is newer than the last look."""
        self._nothing_ns: int | None = None
        """Since when nothing is left to see."""
        self._reached_ns: int | None = None
        """When the goal was reached from which nothing was seen yet."""
        self._least_m = float("inf")
        self._progress_ns = 0
        self._stepped_ns: int | None = None
        """When the last step was."""
        self._told_ns = 0
        """When progress was logged last."""
        self._furthest_m = 0.0
        """From the start, where the robot has been."""
        self._home_failures = 0
        self._end_pose = home
        """Where the way home ends."""
        self._not_home = ""
        """Why that is not the start."""
        self._refusals = 0
        """Goals for the current aim at which something stands."""

    def go_on(self, kept: ExplorationStatus) -> None:
        """Go on with the exploration of a process before."""
        if kept.state == "waiting":
            return
        self.state, self.reason = kept.state, kept.reason
        self.driven_m, self.goals = kept.driven_m, kept.goals
        self.goal_stamp_ns = kept.goal_stamp_ns
        self._own_ns = () if kept.goal_stamp_ns is None else (kept.goal_stamp_ns,)
        self.explored_ns = round(kept.explored_s * 1e9)
        self._aside.restore((place.x_m, place.y_m, place.tries) for place in kept.places_set_aside)

    def take_map(self, grid: MapSoFar) -> None:
        """The map as it is now."""
        self._map, self._fresh = grid, True

    def take_pose(self, map_from_base: SE2) -> None:
        """The robot's pose in the map."""
        if self._robot is None:
            self._robot = map_from_base
            return
        moved_m = self._robot.distance_m(map_from_base)
        if moved_m >= _STANDS_M:
            if self.state in ("exploring", "returning"):
                self.driven_m += moved_m
                self._furthest_m = max(self._furthest_m, map_from_base.distance_m(self._home))
            self._robot = map_from_base

    def navigation_is_busy(self, now_ns: int) -> None:
        """Navigation reports that it has a goal, or does something else."""
        self._busy_ns = now_ns

    def pause(self, reason: str = "stopped on request") -> None:
        """Stop, and stay: navigation cancels the goal that was sent last."""
        if self.state in ("exploring", "returning", "waiting"):
            self.state, self.reason = "paused", reason
            self._sent = self.aim = None
            self._own_ns = ()

    def resume(self) -> None:
        """Go on, also after the end: a map may be looked at again."""
        if self.state in ("paused", "failed", "complete"):
            self._begin()

    def _begin(self) -> None:
        self.state, self.reason = "exploring", ""
        self._sent = self.aim = self._nothing_ns = self._reached_ns = self._looked_ns = None
        self.explored_ns = 0
        self._home_failures = 0
        self._end_pose, self._not_home = self._home, ""

    @property
    def reachable(self) -> int:
        """Frontiers that the robot can go and see."""
        if self.seen is None:
            return 0
        return len({part.frontier for point in self.seen.points for part in point.parts})

    @property
    def set_aside(self) -> int:
        """Frontiers that could not be reached."""
        return len(self.seen.aside) if self.seen is not None else 0

    @property
    def left_out(self) -> int:
        """Frontiers beyond the limits of the exploration."""
        return len({*self.seen.open, *self.seen.far}) if self.seen is not None else 0

    def places_set_aside(self) -> tuple[PlaceSetAside, ...]:
        """Where it does not drive to, for now or for ever."""
        return tuple(
            PlaceSetAside(x_m=x_m, y_m=y_m, tries=tries) for x_m, y_m, tries in self._aside.places()
        )

    def free_m2(self) -> float:
        """Floor seen that the robot can reach."""
        return self.seen.floor.reachable_m2 if self.seen is not None else 0.0

    def seen_share(self) -> float:
        """Of the floor that it can reach, seen or guessed behind frontiers."""
        if self.seen is None:
            return 0.0
        no_goals = {*self.seen.unseen, *self.seen.open, *self.seen.far}
        left = [one for i, one in enumerate(self.seen.frontiers) if i not in no_goals]
        free_m2 = self.free_m2()
        whole_m2 = free_m2 + guessed_m2(self.seen.floor, left)
        return free_m2 / whole_m2 if whole_m2 > 0.0 else 0.0

    def step(self, now_ns: int) -> SE2 | None:
        """Advance, once navigation is ready; a goal to send now, if any. Its message must have the
        stamp `now_ns`.
        """
        last_ns = now_ns if self._stepped_ns is None else self._stepped_ns
        self._stepped_ns = now_ns
        if self.is_held:
            self._wait(now_ns - last_ns)
            return None
        if self._map is None or self._robot is None:
            return None
        if self.state == "waiting":
            _LOG.info("exploring from (%.2f, %.2f)", self._robot.x_m, self._robot.y_m)
            self._begin()
            self._told_ns = now_ns
        if self.state not in ("exploring", "returning"):
            return None
        self.explored_ns += now_ns - last_ns
        if self._yields:
            self._progress_ns = now_ns
            if now_ns - self._busy_ns < _RESEND_NS:
                return None
            self._yields, self._sent = False, None
        if not self.is_localized:
            return self._search(now_ns)
        if self._due(now_ns):
            self._look(now_ns)
        if self.state == "returning":
            return self._send(now_ns, self._end_pose, None)
        if self.state != "exploring" or self.aim is None:
            return None
        return self._send(now_ns, self.aim.pose, self.aim)

    def _wait(self, held_ns: int) -> None:
        """Time in which the robot may not move is none without progress."""
        self._progress_ns += held_ns
        if self._nothing_ns is not None:
            self._nothing_ns += held_ns
        if self._reached_ns is not None:
            self._reached_ns += held_ns

    def _due(self, now_ns: int) -> bool:
        period_ns = int(1e9 / self._params.planner_frequency)
        if self._looked_ns is None:
            return True
        since_ns = now_ns - self._looked_ns
        return since_ns >= period_ns or (self._fresh and 2 * since_ns >= period_ns)

    def _look(self, now_ns: int) -> None:
        """Look at the map, and choose."""
        grid, robot, params = self._map, self._robot, self._params
        assert grid is not None
        assert robot is not None
        self._looked_ns, self._fresh = now_ns, False
        aside = self._aside
        args = (params, grid.cells, grid.resolution_m, grid.origin, robot, self._home)
        seen = survey(*args, self.seen, aside.targets_m())
        if aside.look(seen.floor):
            seen = survey(*args, self.seen, aside.targets_m())
        if seen.robot is None:
            self._wait_for_floor(now_ns)
            return
        self.seen = seen
        if self._is_enough():
            return
        current = self.aim
        if params.choice == "nearest" and current is not None and self._reached_ns is None:
            chosen: Aim | None = still(seen, current)
        else:
            chosen = aim(params, seen, self._home, current)
        if chosen is None:
            self.aim = None
            self._end_if_sure(now_ns)
            return
        self._nothing_ns = None
        self._tell(now_ns)
        if self.state == "returning":
            _LOG.info("found another frontier; continuing the exploration")
            self.state = "exploring"
        if current is None or chosen.is_for_another(current):
            self._least_m, self._progress_ns = float("inf"), now_ns
            self._reached_ns = None
            self._refusals = 0
        self.aim = chosen
        if chosen.way_m < self._least_m - _NEARER_M:
            self._least_m, self._progress_ns = chosen.way_m, now_ns
        if self._reached_ns is not None and now_ns >= self._reached_ns + _SEE_NS:
            self._come_nearer(now_ns, chosen)
        elif now_ns - self._progress_ns > params.progress_timeout * 1e9:
            self._set_aside(now_ns, f"no progress for {params.progress_timeout:.0f} s")

    def _come_nearer(self, now_ns: int, current: Aim) -> None:
        """Look from nearer at what the view point has not shown; else set it aside."""
        grid, robot, seen = self._map, self._robot, self.seen
        assert grid is not None
        assert robot is not None
        assert seen is not None
        args = (self._params, grid.cells, grid.resolution_m, grid.origin, robot, self._home)
        reach_m = float("inf")
        while True:
            vain = nearer(seen.vain, current.target_m, robot[:2])
            if vain[-1].reach_m >= reach_m:
                break
            reach_m = vain[-1].reach_m
            seen = survey(*args, replace(seen, vain=vain), self._aside.targets_m())
            following = (
                aim(self._params, seen, self._home, current) if is_left(seen, current) else None
            )
            if following is None:
                break
            if following.pose.distance_m(current.pose) >= _MOVED_M:
                self.seen, self.aim = seen, following
                return
        self._set_aside(now_ns, "not visible from its view point")

    def _tell(self, now_ns: int) -> None:
        if now_ns - self._told_ns >= _TELL_NS:
            self._told_ns = now_ns
            _LOG.info(
                "%.0f %% seen, %.0f m2; %.1f m driven; %s to see", 100.0 * self.seen_share(),
                self.free_m2(), self.driven_m, _counted(self.reachable),
            )  # fmt: skip

    def _is_enough(self) -> bool:
        """End the exploration at a limit that the user has set; whether it has ended."""
        params = self._params
        if 0.0 < params.time_allowance <= self.explored_ns * 1e-9:
            limit = f"time_allowance: {params.time_allowance:g} s"
        elif 0.0 < params.max_area <= self.free_m2():
            limit = f"max_area: {params.max_area:g} m2"
        else:
            return False
        if self.state == "exploring":
            self.aim = None
            self._end(f"stopped at {limit}, {_counted(self.reachable)} left")
        return True

    def _wait_for_floor(self, now_ns: int) -> None:
        """Where the map shows no floor, go on to the goal; then home, or where it is known."""
        if self.state == "returning":
            return
        if self._nothing_ns is None:
            self._nothing_ns = now_ns
        elif now_ns - self._nothing_ns > self._params.progress_timeout * 1e9:
            assert self._robot is not None
            at = f"({self._robot.x_m:.2f}, {self._robot.y_m:.2f})"
            reason = f"stopped at {at}, where the map shows no floor that the robot fits on"
            if self.seen is None or not self._params.return_to_init:
                self._finish("failed", reason)
                return
            if self.aim is not None:
                self._set_aside(now_ns, reason)
            self._nothing_ns = None
            self._end(reason)

    def _end_if_sure(self, now_ns: int) -> None:
        """Nothing is left to see: after a while, drive home."""
        if self.state == "returning":
            return
        if self._nothing_ns is None:
            self._nothing_ns = now_ns
        if now_ns - self._nothing_ns < _SURE_NS:
            return
        if self._aside.open_untried():
            _LOG.info("retrying the frontiers that were set aside")
            self._nothing_ns = self._looked_ns = None
            return
        self._end(self._verdict())

    def _end(self, verdict: str) -> None:
        _LOG.info("%s, after %.1f m", verdict, self.driven_m)
        if self._params.return_to_init:
            self.state, self._sent, self.reason = "returning", None, verdict
        else:
            self._finish("complete", verdict)

    def _verdict(self) -> str:
        found = []
        if self.set_aside:
            found.append(f"{_counted(self.set_aside)} could not be reached")
        if self.seen is not None and self.seen.far:
            limit = f"max_distance: {self._params.max_distance:g} m"
            found.append(f"{_counted(len(self.seen.far))} beyond {limit}")
        if self.seen is not None and self.seen.open:
            limit = f"open_distance: {self._params.open_distance:g} m"
            found.append(
                f"the open floor goes on beyond {limit}, {self.free_m2():.0f} m2 of it seen, "
                f"up to {self._furthest_m:.1f} m from the start"
            )
        return "; ".join(found) or "no reachable frontiers left"

    def _set_aside(self, now_ns: int, why: str) -> None:
        target, self.aim = self.aim, None
        assert target is not None
        assert self.seen is not None
        _LOG.warning("frontier at (%.2f, %.2f) set aside: %s", *target.target_m, why)
        self._aside.add(self.seen.floor, target.target_m)
        self._sent = self._reached_ns = self._looked_ns = None
        self._progress_ns = now_ns

    def _search(self, now_ns: int) -> SE2 | None:
        """The goal as it is: while navigation has one, it searches for a robot that is lost."""
        self._progress_ns = now_ns
        self._reached_ns = self._nothing_ns = None
        return self._send(now_ns, self._home if self.aim is None else self.aim.pose, self.aim)

    def _send(self, now_ns: int, pose: SE2, what_for: Aim | None) -> SE2 | None:
        sent = self._sent
        if self._reached_ns is not None and sent is not None:
            # It is there, and the map will show what it sees.
            if sent.pose.distance_m(pose) < _MOVED_M:
                return None
        elif sent is not None and sent.pose.distance_m(pose) < _MOVED_M:
            unknown_ns = now_ns - max(self._busy_ns, sent.stamp_ns)
            if (sent.aim is None) == (what_for is None) and unknown_ns < _RESEND_NS:
                return None
        self._reached_ns = None
        self._sent = _Sent(pose, now_ns, what_for)
        self.goal_stamp_ns = now_ns
        self._own_ns = (*self._own_ns[-1:], now_ns)
        if what_for is not None:
            self.goals += 1
        return pose

    def ended(self, now_ns: int, stamp_ns: int, error_code: int, error_msg: str) -> None:
        """Navigation has ended the goal with this stamp."""
        if error_code == ErrorCode.CANCELED and stamp_ns in self._own_ns:
            _LOG.warning("the goal was canceled: the exploration is paused")
            self.pause("its goal was canceled")
            return
        sent = self._sent
        if sent is None or sent.stamp_ns != stamp_ns or self.state == "paused":
            return
        if error_code == ErrorCode.PREEMPTED:
            _LOG.info("another goal comes first: the exploration goes on when it has ended")
            self._yields, self._busy_ns = True, now_ns
        if error_code in _NOT_OUR_FAULT:
            return
        if error_code == ErrorCode.TF_ERROR:
            # Without a pose no other goal is reached either.
            self._finish("failed", error_msg)
        elif sent.aim is None:
            self._came_home(error_code, error_msg)
        elif error_code == ErrorCode.NONE:
            self._reached_ns, self._looked_ns = now_ns, None
        elif error_code == ErrorCode.GOAL_REJECTED or self.aim is None:
            return
        elif error_code == ErrorCode.GOAL_OCCUPIED and self._refusals + 1 < _REFUSALS:
            # Navigation has seen more than the map shows, which will soon show it too.
            self._refusals += 1
            self._looked_ns = now_ns
        else:
            self._set_aside(now_ns, f"error {error_code}: {error_msg}")

    def _came_home(self, error_code: int, error_msg: str) -> None:
        if self.state != "returning":
            return
        if error_code == ErrorCode.NONE:
            self._finish("complete", "; ".join(filter(None, (self.reason, self._not_home))))
            return
        if error_code == ErrorCode.GOAL_OCCUPIED:
            self._not_home = self._not_home or f"could not return home: {error_msg}"
            before = self._before_home()
            if before is None:
                self._finish("complete", f"{self.reason}; {self._not_home}")
            else:
                self._end_pose, self._sent = before, None
            return
        self._home_failures += 1
        self._sent = None
        if self._home_failures >= _HOME_TRIES:
            self._finish("failed", f"failed to return home: error {error_code}: {error_msg}")

    def _before_home(self) -> SE2 | None:
        """A pose on the way home, before the one that was the end of it."""
        seen = self.seen
        if seen is None or seen.robot is None:
            return None
        index = seen.floor.coarse_index(self._home.x_m, self._home.y_m)
        assert index is not None
        away_m = self._end_pose.distance_m(self._home) + _BEFORE_HOME_M
        for cell in reversed(way(seen.parents, index)):
            x_m, y_m = seen.floor.center(*seen.floor.stand(cell))
            if math.hypot(x_m - self._home.x_m, y_m - self._home.y_m) >= away_m:
                return SE2(x_m, y_m, self._home.yaw_rad)
        return None

    def _finish(self, state: State, reason: str) -> None:
        self.state, self.reason = state, reason
        self.aim = self._sent = None
        share = 100.0 * self.seen_share()
        _LOG.info("%s: %s; %.1f %% seen, %.1f m driven", state, reason, share, self.driven_m)


def _counted(frontiers: int) -> str:
    return f"{frontiers} frontier{'' if frontiers == 1 else 's'}"
