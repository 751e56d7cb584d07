"""Notices that the robot was carried off while it makes a map, and finds it on the map again."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from mazebot.common.maths import portable
from mazebot.common.maths.frames import SE2, Array, wrap_angle
from mazebot.mapping.graph.pose_graph import Graph
from mazebot.mapping.loops.loop_closing import LOOSE
from mazebot.mapping.loops.loop_search import LoopMatch, loop_search, search_map
from mazebot.mapping.matching.local_map import compacted, local_map
from mazebot.mapping.matching.occupancy import MapGrid, share_behind_walls
from mazebot.mapping.matching.refine import refine
from mazebot.mapping.matching.scan_points import (
    joined_cloud,
    moved_cloud,
    surface_cloud,
    thinned,
)
from mazebot.mapping.params import SlamParams

_UNFIT, _FALL, _UNFIT_SCANS = 0.5, 0.3, 3
"""A robot whose scans fit no more than this, and by so much less than the one before it, over a
short step and so many times in a row, was carried off: over short steps of its own, the fit falls
by less than 0.05 from one scan to the next in each of the shipped worlds.
"""
_BEHIND = 0.05
"""And so many of its returns come from behind walls: of a robot that things come around, none..."""
_ALL_NEW, _IN_FREE = 0.15, 0.3
"""...or no more than the first is left of what it saw, as things around leave more to be seen, and
at least the second lies where the map is free: at its edge, what is new contradicts nothing.
"""
_NOWHERE = 0.3
"""Of the first scan in a map that was made before, it takes no more than that so little fits: there
is nothing that would hold together what follows and the map.
"""
_FIT, _FIT_SCANS = 0.85, 10
"""It was put back to where the map has it if so many scans in a row fit so well..."""
_BACK_WAY_M = 0.3
"""...before it has moved by more than this: along a corridor, many places fit."""
_STEP_M, _STEP_RAD = 0.1, 0.2
"""A scan this far from the last one kept shows something new."""
_MOST_SCANS = 40
_LEAST_WAY_M, _SEARCH_WAY_M = 1.0, 0.3
"""The map is searched after this way, and again after each of the second: at one place alone, rooms
look alike, and a room that the map does not have yet may look as one that it has.
"""
_RESOLUTION_M = 0.1
_AGREE_M, _AGREE_RAD = 0.2, 0.1
"""What the robot sees next must fit there as well."""
_LEAST_SCORE, _APART = 0.6, 0.16
"""Of the place that is found, and how much lower the second best must be: in 40 explorations of
houses and mazes it was by at most 0.13 where the place was wrong, and by 0.2 where it was right.
"""
_ALL_FIT, _LEAST_APART = 0.97, 0.05
"""In a room that looks nearly the same when it is turned by half, the second best is better. Then
the place is taken where all fits.
"""
_THROUGH = 0.01
"""So small a share of what the robot sees may come from behind walls there: 0.004 at the right
place.
"""


class CarriedOff:
    """Whether the robot was carried off, and where it is since."""

    def __init__(self, params: SlamParams) -> None:
        self._params = params
        self._unfit_scans = 0
        """In a row since the fit fell at once."""
        self._fit_scans = 0
        """In a row since the robot was carried off."""
        self._track: list[_Seen] = []
        self._way_m = 0.0
        self._search_at_m = _LEAST_WAY_M
        self._found: SE2 | None = None
        """map_from_odom by the last search."""

    @property
    def is_possible(self) -> bool:
        """Whether it may have been: nothing that it sees is added to the map."""
        return self._unfit_scans > 0

    @property
    def is_certain(self) -> bool:
        """Whether it was: its pose is unknown until scans fit again."""
        return self._unfit_scans >= _UNFIT_SCANS

    def judge(
        self,
        fit: float,
        before: float | None,
        share_behind: Callable[[], float],
        share_in_free: Callable[[], float],
    ) -> None:
        """Take the share of a scan's returns that fit into account.

        Args:
            fit: that share.
            before: that of the scan before it, over a short step; inf: there was none, the map was
                made before; None: there was none near.
            share_behind: the share of returns that come from behind walls of the map.
            share_in_free: the share of returns where it is free.
        """
        if self.is_certain:
            is_back = fit >= _FIT and self._way_m < _BACK_WAY_M
            self._fit_scans = self._fit_scans + 1 if is_back else 0
            if self._fit_scans >= _FIT_SCANS:
                self._forget()
        elif self.is_possible:
            is_unfit = before is not None and fit <= _UNFIT
            self._unfit_scans = self._unfit_scans + 1 if is_unfit else 0
        elif before is not None and fit <= min(_UNFIT, before - _FALL):
            if before == math.inf:
                nowhere = fit < _NOWHERE
            else:
                nowhere = fit < _ALL_NEW and share_in_free() >= _IN_FREE
            self._unfit_scans = int(nowhere or share_behind() >= _BEHIND)

    def _forget(self) -> None:
        self._unfit_scans = self._fit_scans = 0
        self._track = []
        self._way_m, self._search_at_m = 0.0, _LEAST_WAY_M
        self._found = None

    def see(self, odom_from_base: SE2, returns_m: Array, base_from_scan: SE2) -> None:
        """Keep what the robot, which was carried off, sees now: returns (n, 2) by its axes."""
        if self._track:
            last = self._track[-1].odom_from_base
            far_m = last.distance_m(odom_from_base)
            turned_rad = abs(wrap_angle(odom_from_base.yaw_rad - last.yaw_rad))
            if far_m < _STEP_M and turned_rad < _STEP_RAD:
                return
            self._way_m += far_m
        self._track.append(_Seen(odom_from_base, returns_m, base_from_scan))
        del self._track[:-_MOST_SCANS]

    def find(
        self, graph: Graph, clouds: Sequence[Array], grid: Callable[[], MapGrid], scatter: float
    ) -> SE2 | None:
        """map_from_base of the last scan that was kept, once what the robot has seen since fits one
        place of the map and no other, and what it sees next as well: it is carried off no more.
        None: it is, or not enough is new since the last time.

        Args:
            graph: the map's keyframes.
            clouds: of each, as `local_map` takes them.
            grid: the map.
            scatter: factor of the variances by the parameters, as the scans show it.
        """
        if self._way_m < self._search_at_m:
            return None
        self._search_at_m = self._way_m + _SEARCH_WAY_M
        odom_from_base = self._track[-1].odom_from_base
        cloud = joined_cloud(
            [seen.odom_from_base for seen in self._track],
            [surface_cloud(seen.returns_m, seen.base_from_scan) for seen in self._track],
            odom_from_base,
        )
        known = _Known(graph, clouds, self._params, scatter)
        before, self._found = self._found, None
        if before is not None:
            expected = before @ odom_from_base
            pose = known.fitted(cloud, expected)
            agrees = pose is not None and pose.is_near(expected, _AGREE_M, _AGREE_RAD)
            if pose is not None and agrees and self._is_free(pose, grid()):
                self._forget()
                return pose
        found = known.searched(cloud)
        apart = 0.0 if found is None else found.score - found.elsewhere
        if found is not None and apart >= _LEAST_APART:
            pose = known.fitted(cloud, found.pose, _FIT if apart >= _APART else _ALL_FIT)
            if pose is not None and self._is_free(pose, grid()):
                self._found = pose @ odom_from_base.inverse()
        return None

    def _is_free(self, map_from_base: SE2, grid: MapGrid) -> bool:
        """Whether the way and the beams do not pass through walls, if the robot is at a pose."""
        map_from_odom = map_from_base @ self._track[-1].odom_from_base.inverse()
        through = [
            share_behind_walls(
                grid, map_from_odom @ seen.odom_from_base, seen.returns_m, seen.base_from_scan
            )
            for seen in self._track
        ]
        return math.fsum(through) <= _THROUGH * len(through)


class _Seen(NamedTuple):
    """Where the robot came since it was carried off, by odometry, and what it saw there."""

    odom_from_base: SE2
    returns_m: Array
    base_from_scan: SE2


class _Known(NamedTuple):
    """The map that was made until the robot was carried off."""

    graph: Graph
    clouds: Sequence[Array]
    params: SlamParams
    scatter: float

    def searched(self, seen: Array) -> LoopMatch | None:
        """Where on the whole map a cloud fits best, in whatever direction the robot looks."""
        walls = np.concatenate(
            [moved_cloud(cloud, self.graph.pose(node)) for node, cloud in enumerate(self.clouds)]
        )
        if not len(walls) or not len(seen):
            return None
        walls_m = np.ascontiguousarray(compacted(walls, _RESOLUTION_M / 2.0)[:, :2])
        table = search_map(walls_m, _RESOLUTION_M, _RESOLUTION_M)
        low, high = walls_m.min(axis=0), walls_m.max(axis=0)
        x_m, y_m = ((low + high) / 2.0).tolist()
        points_m = thinned(seen[:, :2], _RESOLUTION_M, 200)
        window_m = float((high - low).max()) / 2.0
        found = None
        for _ in range(2):
            # Where the search begins and ends is one direction: away from what is found.
            yaw_rad = 0.0 if found is None else found.pose.yaw_rad
            found = loop_search(
                table, points_m, SE2(x_m, y_m, yaw_rad), window_m, math.pi, _LEAST_SCORE
            )
            if found is None:
                return None
        return found

    def fitted(self, cloud: Array, start: SE2, least_fit: float = _FIT) -> SE2 | None:
        """Where at least this share of a cloud fits the map around a pose; None: it does not."""
        p = self.params
        places = self.graph.poses
        away_m = portable.hypot_each(places[:, 0] - start.x_m, places[:, 1] - start.y_m)
        near = np.sort(np.argsort(away_m, kind="stable")[: p.scan_buffer_size]).tolist()
        around = local_map(
            [self.graph.pose(node) for node in near],
            [self.clouds[node] for node in near],
            p.line_cell_m,
        )
        fitted = refine(
            around, start, LOOSE, cloud[:, :2], SE2(0.0, 0.0, 0.0),
            p.scan_match_std_m * math.sqrt(self.scatter), views=cloud[:, 2:4],
        )  # fmt: skip
        return None if fitted.fit < least_fit or fitted.open_direction else fitted.map_from_base
