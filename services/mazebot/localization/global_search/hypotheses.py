"""Poses that the robot may have, weighed by what it sees while it moves.

Each hypothesis is carried along by odometry and drawn to the map by scan matching at each keyframe.
Its score is the sum over the last keyframes of how well the scan fits there, beam by beam. A pose
that a later search finds is followed backwards through the same keyframes, so that old and new ones
are weighed by the same evidence. One more hypothesis has no pose: that the robot is not on this
map, where each return is as likely as in any place that no map shows.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable, portable_kernels
from mazebot.common.maths.frames import SE2, Array, wrap_angle
from mazebot.localization.beam_model import (
    NOWHERE_COST,
    RayMap,
    ScanView,
    judge,
    qualities,
)
from mazebot.localization.global_search.global_search import SearchMap, distinct, global_search
from mazebot.localization.global_search.scan_matching import refine
from mazebot.localization.markers.marker_model import Sighting, mixture_likelihood

_KEYFRAMES = 16
"""Keyframes that count: about 4 m of driving."""
_KEYFRAME_M, _KEYFRAME_RAD = 0.2, 0.35
_SEARCH_EACH = 2
"""Keyframes between two searches of the map."""
BEAM_WEIGHT = 0.1
"""Of a beam's log-likelihood: neighbours fail together."""
_WORST = 14.0
"""Hypotheses are dropped when the best one is e^14 times as likely."""
_CANDIDATES = 400
_FOLLOWED_BACK = 64
_SAME_M, _SAME_RAD = 0.12, 0.15
_PLACE_M, _PLACE_RAD = 0.35, 0.3
"""Hypotheses nearer than this to the best one speak for the same pose."""
_AROUND_M, _AROUND_RAD = 1.0, 1.0
"""A robot that was pushed, or has slipped, is within this of where it was."""
_PUSHED = 7.5
"""How much likelier that is than that it was carried to any other one place, as a logarithm: on a
floor of 30 m2, 200 times by the places alone, and people push more often than they carry.
"""
_PUSHED_TRAVEL_M = 4.0
"""It counts from this way on: what can tell two places apart by then has told."""
_DRIFT_M, _DRIFT_RAD = 0.03, 0.02
_DRIFT_PER_WAY, _DRIFT_PER_TURN, _TURN_PER_M = 0.15, 0.15, 0.05
"""Error of odometry between two keyframes: standard deviations per m, per rad, and in rad per m."""
_RETURN_STD_M = 0.12
_NO_MOTION = SE2(0.0, 0.0, 0.0)


@dataclass(frozen=True)
class MarkerSighting:
    """A marker seen at a keyframe, in that keyframe's base frame."""

    map_from_marker: Array
    seen: Sequence[Sighting]
    keyframe_from_base: SE2
    outlier: float
    """Probability that the sighting is wrong."""

    def log_likelihoods(self, poses: Array) -> Array:
        """(n,) of keyframe poses (n, 3)."""
        likelihood = mixture_likelihood(
            poses, self.map_from_marker, self.seen, self.keyframe_from_base
        )
        return portable_kernels.log_each(likelihood + self.outlier)


@dataclass
class _Keyframe:
    odom_from_base: SE2
    view: ScanView
    """Of every second beam: many poses are weighed by it."""
    markers: list[MarkerSighting] = field(default_factory=list)

    def nowhere(self) -> float:
        """Log-likelihood of what is seen at a place that is not on the map."""
        returns = self.view.returns * self.view.likelihood_weight
        wrong = [portable_kernels.log(marker.outlier) for marker in self.markers]
        return sum(wrong, -BEAM_WEIGHT * NOWHERE_COST * returns)


@dataclass(frozen=True)
class Verdict:
    """The verdict of the hypotheses at the last keyframe."""

    pose: SE2
    """The likeliest one."""
    information: Array
    """(3, 3) of its scan match."""
    certainty: float
    """Probability of it and of those around it, if one of all hypotheses is right, or none of them
    and the robot is not on this map.
    """
    quality: float
    """Of the likeliest pose, the mean over the keyframes."""
    last_quality: float
    """Of the same at the last keyframe: one that fits no longer does not fit."""
    travel_m: float
    """Way since the first keyframe, a turn of 1 rad counting 0.25 m."""
    markers: int
    """Sightings of markers that it explains."""
    matches_alone: float
    """Its certainty by what was seen alone, without that it is about where the robot was."""


class Hypotheses:
    """A set of poses, from nothing to one that is certain. Poses are of the last keyframe's time,
    (n, 3) of x, y, yaw in the map.
    """

    def __init__(
        self,
        rays: RayMap,
        table: SearchMap,
        most: int,
        dynamic_share: float,
        min_returns: int,
        before: SE2 | None = None,
    ) -> None:
        """`before`: map_from_odom until the pose was lost, if it had one."""
        self._rays = rays
        self._table = table
        self._most = most
        self._dynamic_share = dynamic_share
        self._min_returns = min_returns
        self._keyframes: deque[_Keyframe] = deque(maxlen=_KEYFRAMES)
        self._poses = np.empty((0, 3))
        self._scores = np.empty((0, 0))
        """(n, keyframes) log-likelihoods; scans' and markers' together."""
        self._qualities = np.empty((0, 0))
        self._information = np.empty((0, 3, 3))
        self._before = before
        self._around = np.empty(0, np.bool_)
        """(n,) whether a pose goes back to about where the robot was before."""
        self._since_search = _SEARCH_EACH
        self._travel_m = 0.0
        self._view: ScanView | None = None
        """The last keyframe's scan, whole."""

    def __len__(self) -> int:
        return len(self._poses)

    @property
    def keyframe_odometry(self) -> SE2 | None:
        """odom_from_base of the last keyframe."""
        return self._keyframes[-1].odom_from_base if self._keyframes else None

    @property
    def travel_m(self) -> float:
        """Way between the keyframes, a turn of 1 rad counting 0.25 m."""
        return self._travel_m

    def weighed(self) -> Array:
        """(n, 4) x, y, yaw and probability at the last keyframe, the likeliest first. What is
        missing to a sum of 1 is the probability that the robot is not on this map.
        """
        weights = self._weights()
        order = np.argsort(-weights, kind="stable")
        return np.ascontiguousarray(
            np.concatenate([self._poses[order], weights[order, None]], axis=1)
        )

    def is_due(self, odom_from_base: SE2) -> bool:
        """Whether the robot moved far enough since the last keyframe for another one."""
        last = self.keyframe_odometry
        return (
            last is None
            or odom_from_base.distance_m(last) >= _KEYFRAME_M
            or abs(wrap_angle(odom_from_base.yaw_rad - last.yaw_rad)) >= _KEYFRAME_RAD
        )

    def add_keyframe(self, odom_from_base: SE2, view: ScanView) -> None:
        """Weigh all by a scan at this odometry; search the map for more where that is due."""
        last = self.keyframe_odometry
        motion = _NO_MOTION if last is None else last.inverse() @ odom_from_base
        self._travel_m += _way_m(motion) + 0.25 * abs(motion.yaw_rad)
        self._poses = _moved(self._poses, motion)
        self._keyframes.append(_Keyframe(odom_from_base, view.halved()))
        self._view = view
        if len(self._poses):
            self._poses, scores, quality, self._information = self._fit(
                self._poses, self._keyframes[-1], motion
            )
            keep = len(self._keyframes) - 1
            self._scores = np.column_stack([self._scores[:, -keep:][:, :keep], scores])
            self._qualities = np.column_stack([self._qualities[:, -keep:][:, :keep], quality])
            self._prune()
        self._since_search += 1
        if self._since_search >= _SEARCH_EACH:
            self.search()

    def search(self) -> None:
        """Search the map for poses of the last keyframe, unless that was done."""
        if not self._keyframes or self._since_search == 0:
            return
        view = self._view
        if view is not None and view.returns >= self._min_returns:
            self._since_search = 0
            poses, _, _ = global_search(self._table, self._rays, view, _CANDIDATES)
            self.add_poses(poses)

    def add_poses(self, poses: Array) -> None:
        """Add poses (n, 3) of the last keyframe's time that are not near to one already here."""
        if not len(poses) or not self._keyframes:
            return
        known = len(self._poses)
        fresh = distinct(np.concatenate([self._poses, poses]), _SAME_M, _SAME_RAD)
        poses = poses[fresh[fresh >= known] - known][: self._most]
        if not len(poses):
            return
        newest = self._keyframes[-1]
        poses, scores, quality, information = self._fit(poses, newest, _NO_MOTION)
        order = np.argsort(-scores, kind="stable")
        order = order[scores[order] >= scores[order[0]] - _WORST]
        if len(self._keyframes) > 1:
            order = order[:_FOLLOWED_BACK]
        poses = poses[order]
        information = information[order]
        columns, rated = scores[order, None], quality[order, None]
        back = poses
        for i in range(len(self._keyframes) - 2, -1, -1):
            earlier, later = self._keyframes[i], self._keyframes[i + 1]
            motion = later.odom_from_base.inverse() @ earlier.odom_from_base
            back, scores, quality, _ = self._fit(_moved(back, motion), earlier, motion)
            columns, rated = np.column_stack([scores, columns]), np.column_stack([quality, rated])
            # What the later keyframes refute need not be followed further.
            totals = columns.sum(axis=1)
            best = float(totals.max())
            if known:
                best = max(best, float(self._scores[:, i:].sum(axis=1).max()))
            alive = totals >= best - _WORST
            back, poses, information = back[alive], poses[alive], information[alive]
            columns, rated = columns[alive], rated[alive]
            if not len(poses):
                return
        new_scores, new_rated = columns, rated
        around = self._is_around(back)
        if not known:
            self._around = around
            self._poses, self._scores, self._qualities = poses, new_scores, new_rated
            self._information = information
        else:
            self._around = np.concatenate([self._around, around])
            self._poses = np.concatenate([self._poses, poses])
            self._scores = np.concatenate([self._scores, new_scores])
            self._qualities = np.concatenate([self._qualities, new_rated])
            self._information = np.concatenate([self._information, information])
        self._prune()

    def add_marker(self, sighting: MarkerSighting, poses: Array) -> None:
        """Weigh all by a marker seen since the last keyframe, and add the poses (n, 3), of that
        keyframe's time, that it gives.
        """
        if not self._keyframes:
            return
        self._keyframes[-1].markers.append(sighting)
        if len(self._poses):
            self._scores[:, -1] += sighting.log_likelihoods(self._poses)
        self.add_poses(poses)

    def verdict(self) -> Verdict | None:
        """The likeliest pose; None where there is none."""
        if not len(self._poses):
            return None
        weights = self._weights()
        best = int(np.argmax(weights))
        pose = self._poses[best]
        apart = self._poses - pose
        turned = np.abs((apart[:, 2] + np.pi) % (2.0 * np.pi) - np.pi)
        near = (apart[:, 0] * apart[:, 0] + apart[:, 1] * apart[:, 1] <= _PLACE_M * _PLACE_M) & (
            turned <= _PLACE_RAD
        )
        explained = 0
        for marker in self._keyframes[-1].markers:
            explained += bool(marker.log_likelihoods(pose[None])[0] > -4.0)
        return Verdict(
            SE2(float(pose[0]), float(pose[1]), float(pose[2])),
            self._information[best],
            float(weights[near].sum()),
            float(self._qualities[best].mean()),
            float(self._qualities[best, -1]),
            self._travel_m,
            explained,
            float(self._weights_by_sight()[near].sum()),
        )

    def _is_around(self, poses: Array) -> NDArray[np.bool_]:
        """(n,) whether poses (n, 3) at the oldest keyframe are about where the robot was."""
        if self._before is None:
            return np.zeros(len(poses), np.bool_)
        x_m, y_m, yaw_rad = self._before @ self._keyframes[0].odom_from_base
        away_m = portable.hypot_each(poses[:, 0] - x_m, poses[:, 1] - y_m)
        turned_rad = np.abs((poses[:, 2] - yaw_rad + np.pi) % (2.0 * np.pi) - np.pi)
        return np.asarray((away_m <= _AROUND_M) & (turned_rad <= _AROUND_RAD))

    def _fit(
        self, poses: Array, keyframe: _Keyframe, motion: SE2
    ) -> tuple[Array, Array, Array, Array]:
        """Poses drawn to the map after a motion, their scores, qualities and information."""
        way_m, turn_rad = _way_m(motion), abs(motion.yaw_rad)
        view = keyframe.view
        poses, information = refine(
            self._rays.field, poses, view.points_m,
            prior_std_m=_DRIFT_M + _DRIFT_PER_WAY * way_m,
            prior_std_rad=_DRIFT_RAD + _DRIFT_PER_TURN * turn_rad + _TURN_PER_M * way_m,
            return_std_m=_RETURN_STD_M, wide=4, narrow=4,
        )  # fmt: skip
        counts, likelihoods = judge(self._rays, poses, view)
        scores = BEAM_WEIGHT * likelihoods
        for marker in keyframe.markers:
            scores = scores + marker.log_likelihoods(poses)
        return poses, scores, qualities(counts, self._dynamic_share), information

    def _totals(self) -> Array:
        return np.asarray(self._scores.sum(axis=1))

    def _weights(self) -> Array:
        """(n,) probabilities."""
        if self._travel_m < _PUSHED_TRAVEL_M or not self._around.any():
            return self._weights_by_sight()
        # That the robot is not on this map becomes no less likely by it.
        return _shares(self._totals() + _PUSHED * self._around, self._nowhere() + _PUSHED)

    def _weights_by_sight(self) -> Array:
        """(n,) the same by what was seen alone."""
        return _shares(self._totals(), self._nowhere())

    def _nowhere(self) -> float:
        return sum(each.nowhere() for each in self._keyframes)

    def _prune(self) -> None:
        totals = self._totals()
        order = np.argsort(-totals, kind="stable")
        order = order[totals[order] >= totals[order[0]] - _WORST][: 4 * self._most]
        order = order[distinct(self._poses[order], _SAME_M, _SAME_RAD)][: self._most]
        self._poses = np.ascontiguousarray(self._poses[order])
        self._scores, self._qualities = self._scores[order], self._qualities[order]
        self._information = self._information[order]
        self._around = self._around[order]


def _shares(totals: Array, nowhere: float) -> Array:
    """(n,) probabilities by (n,) log-likelihoods, and that of what is not among them."""
    highest = max(float(totals.max(initial=nowhere)), nowhere)
    weights = portable_kernels.exp_each(np.append(totals, nowhere) - highest)
    return np.asarray(weights[:-1] / weights.sum())


def _way_m(motion: SE2) -> float:
    return motion.distance_m(_NO_MOTION)


def _moved(poses: Array, motion: SE2) -> Array:
    c, s = portable_kernels.cos_sin_each(poses[:, 2])
    x = poses[:, 0] + c * motion.x_m - s * motion.y_m
    y = poses[:, 1] + s * motion.x_m + c * motion.y_m
    yaw = (poses[:, 2] + motion.yaw_rad + np.pi) % (2.0 * np.pi) - np.pi
    return np.ascontiguousarray(np.stack([x, y, yaw], axis=1))
