"""Monte Carlo localisation: the robot's pose in the map, from odometry, lidar scans and markers.

While the pose is known, a particle filter after AMCL tracks it. Each update is valid at its
measurement's stamp and is carried forward by the odometry since. The field is accurate to a
centimetre, so the mean of the particles needs no scan matching after it.

Where the pose is not known, or no longer believed, the whole map is searched, and the poses found
are weighed while the robot moves, until one of them is certain.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mazebot.common.maths import portable, portable_kernels
from mazebot.common.maths.frames import SE2, Array, wrap_angle, wrap_angles
from mazebot.common.maths.odometry_history import OdometryHistory
from mazebot.common.messages.scan import Scan
from mazebot.localization import particle_filter as pf
from mazebot.localization.beam_model import (
    HIT,
    LEAST_BEAMS,
    MISFIT,
    MISS_COST,
    MISSING,
    NOWHERE_COST,
    OPEN,
    SHORT,
    THROUGH,
    UNMAPPED,
    RayMap,
    ScanView,
    consistencies,
    in_wall,
    judge,
    mapped_returns,
    moved_view,
    qualities,
    refutations,
    returned,
    scan_view,
)
from mazebot.localization.candidates import (
    BESIDE_M,
    CERTAIN_QUALITY,
    FOUND_VARIANCES,
    GATE,
    RIVAL,
    WIDE_M,
    Candidates,
    explains_all,
    nowhere,
    poses_beside,
    std_m,
)
from mazebot.localization.global_search.global_search import global_search, search_map
from mazebot.localization.global_search.hypotheses import (
    BEAM_WEIGHT,
    Hypotheses,
    MarkerSighting,
    Verdict,
)
from mazebot.localization.global_search.scan_matching import refine
from mazebot.localization.gone import seen_through, without_gone
from mazebot.localization.likelihood_field import likelihood_field
from mazebot.localization.markers.marker_model import (
    MarkerCandidate,
    MarkerNoise,
    Sighting,
    mixture_likelihood,
    sightings,
)
from mazebot.localization.markers.marker_trust import MarkerKey, MarkerTrust, marker_key
from mazebot.localization.params import LocalizationParams
from mazebot.localization.particle_set import ParticleSet
from mazebot.localization.pose_monitor import PoseMonitor, is_far

__all__ = ["Localization", "LocalizationParams", "LocalizationState", "MarkerCandidate"]

LocalizationState = Literal["uninitialized", "searching", "localized", "lost"]

_FAR_M = 1e3
"""No lidar has a longer range, whatever its message states."""
_UNUSED_S = 5.0
"""Time without a scan that is used before that is a warning."""
_RANDOM_RANGE_M = 3.5
"""Returns from unmapped objects are spread over this range at most."""
_PREDICT_M, _PREDICT_RAD = 0.2, 0.2
"""Odometry is applied in steps no longer than this, though no scan comes."""
_WALL_CLEARANCE_M = 0.05
_SURE_M, _SURE_RAD = 0.08, 0.06
_JUDGED = 32
"""Particles of an uncertain pose that are judged."""
_SEARCH_COUNT = 100
_MARKERS_AGREE = 2
_OPEN_FLOOR = 0.6
"""Least consistency of an initial pose where nothing returns."""
_UNCONTRADICTED = 0.95
"""Consistency of an initial pose that hardly anything speaks against, though things that are not on
the map hide its walls.
"""
_CONFIRMING = 0.4
"""Share of hits that confirms such a pose."""
_ALL_EXPLAINED = 0.8
"""Share of hits at a pose elsewhere that such an initial pose gives way to."""
_VERDICT_SCANS = 5
"""Scans by which an initial pose is confirmed or doubted: the particles need some to converge."""
_NEAR_RIVAL, _NEAR_M = 2.0, 1.0
"""The same for one as near as this, or that a marker shows: of the whole map, few poses are."""
_SPREAD_OUT_M = 3.0
"""From this standard deviation on, and where no scan narrows it, the pose is lost."""
_BORDER_M, _SIGMAS = 0.3, 3.0
"""A return this near to where the map ends, by so many standard deviations, is left out."""
_UNMAPPED_SHARE = 0.5
_UNMAPPED_STD_M = 1.0
"""Where most of what is seen is not mapped, the pose is lost from this spread on."""
_SAME_VARIANCES = (0.0009, 0.0009, 0.0009)
"""Of x, y and yaw of a pose that the walls draw to the estimate: 3 cm, 0.03 rad."""
_AS_GOOD = 0.05
"""Difference of quality below which a scan fits two poses as well."""

_Standing = Literal["agrees", "here", "elsewhere", "open"]
"""Of a marker's sighting: it agrees with the estimate; it does not, and scans decide for the
estimate, or for where the marker has the robot, or not.
"""


class _Given(NamedTuple):
    """An initial pose before the first verdict."""

    map_from_odom: SE2 | None
    """None: the first odometry comes later; it is at that pose."""
    covariance: Array
    scans: int
    """Scans weighed so far."""


class _Fit(NamedTuple):
    """How a scan fits the estimate."""

    quality: float
    consistency: float
    likelihood: float
    """Logarithm, as `judge` gives it."""
    is_of_this_map: bool
    """Whether the returns are likelier there than at a place that is not on the map."""
    is_mapped: bool
    """Whether most returns come from where the map knows something."""
    hit_share: float
    """Of those, the share that end on its walls."""


class _Rival(NamedTuple):
    """A pose that a scan fits better than the estimate."""

    pose: SE2
    quality: float
    hit_share: float
    """Of the beams that can be judged, those that end on the map's walls."""
    is_given: bool
    """Whether the initial pose includes it, by its covariance."""


class Localization:
    """The robot's pose in the map.

    Frames: `map_from_odom` is the correction; `odom_from_base` comes from odometry. Stamps are
    nanoseconds of simulation. The same calls with the same generator give the same bits.
    """

    def __init__(
        self,
        params: LocalizationParams,
        cells: NDArray[np.int8],
        resolution_m: float,
        origin: SE2,
        rng: np.random.Generator,
        unseen: NDArray[np.bool_] | None = None,
    ) -> None:
        """`cells` (rows, columns): 0 free to 100 occupied, -1 unknown, row 0 at the smallest y of
        `origin`, which is map_from_grid. In those that are `unseen` the robot cannot stand, but its
        lidar sees through them.

        Raises ValueError if the map cannot be used.
        """
        self._params = params
        self._marker_noise = MarkerNoise(
            params.marker_std_m,
            params.marker_range_ratio_per_m,
            params.marker_bearing_std_rad,
            params.marker_yaw_std_rad,
        )
        seen = cells if unseen is None else np.where(unseen, np.int8(0), cells)
        self._field = likelihood_field(
            seen,
            resolution_m,
            origin,
            z_hit=params.z_hit,
            z_rand=params.z_rand,
            sigma_hit_m=params.sigma_hit,
            max_distance_m=params.laser_likelihood_max_dist,
            wall_inset_cells=params.wall_inset_cells,
            range_max_m=min(params.laser_max_range, _RANDOM_RANGE_M),
        )
        self._rays = RayMap.of(
            seen,
            resolution_m,
            origin,
            self._field,
            params.wall_inset_cells,
            params.scan_match_tolerance_m,
        )
        self._through = seen_through(self._rays)
        self._table = search_map(cells, resolution_m, self._rays)
        # The error that no number of scans averages out: a face lies anywhere in its cell, and
        # where walls are few, one face alone fixes a coordinate.
        self._raster_covariance = np.diag([1.0, 1.0, 0.0]) * (resolution_m * resolution_m) / 12.0
        self._history = OdometryHistory()
        self._set = ParticleSet(params, rng)
        self._monitor = PoseMonitor(params)
        self._hypotheses: Hypotheses | None = None
        self._state: LocalizationState = "uninitialized"
        self._reasons: tuple[str, ...] = ("no initial pose was given",)
        self._cause = ""
        """Why the pose is sought."""
        self._stamp_ns: int | None = None
        self._odom_from_base: SE2 | None = None
        """Odometry at the estimate's time; None before odometry is received."""
        self._known = False
        """Whether there is an estimate, right or wrong."""
        self._given: _Given | None = None
        """The initial pose until there is a verdict on it."""
        self._match_fast = 1.0
        self._last_scan: tuple[int, SE2] | None = None
        self._last_marker: dict[MarkerKey, tuple[int, SE2]] = {}
        self._markers = MarkerTrust()
        self._view: tuple[SE2, ScanView] | None = None
        """The last scan, and the odometry at its time."""
        self._unused_since_ns: int | None = None
        """Stamp of the first scan since the last one of which the settings left enough."""
        self.warning = ""
        """That the settings leave nothing of the scans, in one line; empty: they do."""

    @property
    def initialized(self) -> bool:
        """Whether there is an estimate of the pose: one was given or found."""
        return self._known

    @property
    def converged(self) -> bool:
        """Whether the particles agree on one pose. It may be a wrong one: see `state`."""
        return self._state == "localized" and self._set.converged

    @property
    def state(self) -> LocalizationState:
        """`uninitialized`: no pose was given and none is sought, or no scan has confirmed the one
        that was given. `localized`: the pose is known, to its covariance. `lost`: it was found
        wrong, and there is no other one yet. `searching`: poses are being weighed, see
        `hypotheses`.
        """
        return self._state

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the state is what it is, in plain words."""
        return self._reasons

    @property
    def quality(self) -> float:
        """How well the scans fit the pose, 0 to 1, as a running mean of half a second.

        The share of the beams that are explained: by the map, or by something before its walls, up
        to `dynamic_share`. A beam through a wall weighs thrice, unless it is gone: see `gone.py`. A
        robot in a wall has quality 0.
        """
        return self._monitor.quality if self._known else 0.0

    @property
    def wants_motion(self) -> bool:
        """Whether the robot should move, so that its pose becomes known."""
        return self._state in ("searching", "lost")

    @property
    def is_suspect(self) -> bool:
        """Whether scans contradict a pose that is trusted still."""
        return self._state == "localized" and self._monitor.is_suspect

    @property
    def scan_match(self) -> float:
        """Fraction of the returns that are the map's walls, 0 to 1, as a running mean.

        Its gain is `recovery_alpha_fast`: half a second of scans. In the house maze it is above
        0.95 all along a drive, above 0.65 with a third of the beams blocked, and below 0.6 one
        second after the robot was moved to another pose.
        """
        return self._match_fast

    @property
    def misplaced(self) -> dict[MarkerKey, Array]:
        """The markers that are not used, because the scans fit poses that they contradict: by their
        place in the map, where each was seen, map_from_marker (4, 4).
        """
        return self._markers.misplaced

    def hypotheses(self) -> Array:
        """(k, 4) poses x, y, yaw in the map at the last update and their weights, the heaviest
        first: those being weighed, or the particles' clusters.
        """
        if self._hypotheses is not None:
            return self._hypotheses.weighed()
        if not self._known:
            return np.empty((0, 4))
        return np.array([(*mean, share) for share, mean, _ in self._set.clusters()])

    def initialize(self, map_from_base: SE2, covariance: Array) -> None:
        """Set the robot's current pose with a (3, 3) covariance of (x, y, yaw). The state is
        `uninitialized` until scans confirm it, which one does as a rule, or doubt it: then the map
        is searched.

        Raises ValueError if either is not finite or the covariance is not valid.
        """
        covariance = np.asarray(covariance, np.float64)
        if covariance.shape != (3, 3) or not np.isfinite(covariance).all():
            raise ValueError(f"covariance: must be 3 x 3 and finite, got {covariance.tolist()}")
        if not all(math.isfinite(value) for value in map_from_base):
            raise ValueError(f"initial pose: must be finite, got {tuple(map_from_base)}")
        self._set.begin(map_from_base, covariance)
        self._known = True
        self._hypotheses = None
        self._state = "uninitialized"
        self._reasons = ("no scan has confirmed the initial pose yet",)
        self._begin_at_latest_odometry()
        before = self._odom_from_base
        map_from_odom = None if before is None else map_from_base @ before.inverse()
        self._given = _Given(map_from_odom, covariance, 0)
        self._match_fast = 1.0

    def global_localization(self) -> None:
        """Forget the pose and search the whole map for it, as AMCL's
        `reinitialize_global_localization`.
        """
        self._known = False
        # It was by this pose that they were judged.
        self._markers = MarkerTrust()
        self._search("searching", "global localization requested")

    def odometry(self, stamp_ns: int, odom_from_base: SE2) -> None:
        """Add odometry; a message that is not later than the last one is ignored."""
        if not self._history.add(stamp_ns, odom_from_base):
            return
        if self._odom_from_base is None:
            self._stamp_ns, self._odom_from_base = stamp_ns, odom_from_base
            if self._given is not None:
                map_from_odom = self._set.pose @ odom_from_base.inverse()
                self._given = self._given._replace(map_from_odom=map_from_odom)
        elif self._known and self._hypotheses is None:
            last = self._odom_from_base
            turned = abs(wrap_angle(odom_from_base.yaw_rad - last.yaw_rad))
            if odom_from_base.distance_m(last) >= _PREDICT_M or turned >= _PREDICT_RAD:
                self._predict(stamp_ns, odom_from_base)
                self._set.measure_spread()

    def correct_odometry(self, odom_from_base: SE2) -> None:
        """Correct the latest odometry, whose last part was not the robot's own motion: what has
        followed it goes back with the next scan.
        """
        self._history.correct(odom_from_base)

    def scan(self, scan: Scan) -> bool:
        """Correct the pose by a scan; True if the scan was used.

        Ranges outside [range_min, range_max) or not finite are no returns. A scan is not used if
        the robot hardly moved since the last one, if it has few returns, if there is no odometry
        for its stamp, or if its description is not valid. Where the pose is sought, it is weighed
        at the poses that it may have.
        """
        odom_from_base = self._history.at(scan.stamp_ns)
        if odom_from_base is None or not self._is_begun:
            return False
        if not (scan.has_angles and scan.has_limits):
            return False
        p = self._params
        limited = replace(
            scan,
            range_min_m=scan.range_min_m if p.laser_min_range < 0.0 else p.laser_min_range,
            range_max_m=min(scan.range_max_m, p.laser_max_range, _FAR_M),
        )
        view = scan_view(limited, p.max_beams)
        self._view = (odom_from_base, view)
        self._note_use(scan, limited, view)
        if self._hypotheses is not None:
            return self._weigh_hypotheses(self._hypotheses, scan.stamp_ns, odom_from_base, view)
        return self._track(scan.stamp_ns, odom_from_base, view)

    def _note_use(self, scan: Scan, limited: Scan, view: ScanView) -> None:
        """Note whether the settings leave enough of a scan: on open floor there is none."""
        least = self._params.min_returns
        if view.returns >= least or np.count_nonzero(returned(scan)) < least:
            self._unused_since_ns, self.warning = None, ""
            return
        if self._unused_since_ns is None:
            self._unused_since_ns = scan.stamp_ns
        unused_s = (scan.stamp_ns - self._unused_since_ns) * 1e-9
        if unused_s >= _UNUSED_S:
            self.warning = (
                f"no scan used for {unused_s:.0f} s: {np.count_nonzero(returned(limited))} of "
                f"{len(scan.ranges_m)} ranges lie within laser_min_range and laser_max_range, and "
                f"min_returns is {least}"
            )

    def marker(
        self,
        stamp_ns: int,
        map_from_marker: Array,
        candidates: Sequence[MarkerCandidate],
        base_from_camera_optical: Array,
    ) -> bool:
        """Correct the pose by a sighting of a marker whose pose, rigid (4, 4), is known.

        The candidates are the solutions of one sighting, of which at most one is right: the filter
        uses them as a mixture, with a probability that none is right. Two sightings that contradict
        the pose and agree on another one, at which the scan fits as well, make the robot lost: the
        poses that they give are among those weighed then. One that contradicts the pose where the
        scan decides for that is left out, and after three of them the marker is: see `misplaced`.
        True if the sighting was used; one of a robot at rest is left out as a scan is.
        """
        odom_from_base = self._history.at(stamp_ns)
        if odom_from_base is None or not self._is_begun:
            return False
        if not np.isfinite(map_from_marker).all():
            return False
        seen = sightings(map_from_marker, candidates, base_from_camera_optical, self._marker_noise)
        if not seen:
            return False
        key = marker_key(map_from_marker)
        standing = self._standing(stamp_ns, odom_from_base, key, seen)
        if standing == "elsewhere":
            self._give_up("two marker detections contradict the pose")
        if not self._is_due(self._last_marker.get(key), stamp_ns, odom_from_base):
            return False
        self._last_marker[key] = (stamp_ns, odom_from_base)
        if standing != "open" and self._hypotheses is None:
            self._note_trust(key, standing, odom_from_base, candidates, base_from_camera_optical)
        if standing == "here" or self._markers.is_misplaced(key):
            return False
        if self._hypotheses is not None:
            return self._weigh_marker(
                self._hypotheses, stamp_ns, odom_from_base, map_from_marker, seen
            )
        self._predict(stamp_ns, odom_from_base)
        assert self._odom_from_base is not None
        # The sighting may be older than the last update.
        now_from_then = self._odom_from_base.inverse() @ odom_from_base
        likelihood = mixture_likelihood(self._set.poses, map_from_marker, seen, now_from_then)
        self._set.weigh(portable_kernels.log_each(likelihood + self._params.marker_outlier))
        return True

    def has_odometry(self, stamp_ns: int) -> bool:
        """Whether there is odometry for a time."""
        return self._history.at(stamp_ns) is not None

    def pose(self, stamp_ns: int | None = None) -> tuple[SE2, Array]:
        """map_from_base at the latest odometry, or at a time for which there is odometry, and its
        (3, 3) covariance of (x, y, yaw).

        While the pose is sought it is that of the likeliest hypothesis, with the spread of all.
        Raises RuntimeError where there is none yet.
        """
        if not self._known:
            raise RuntimeError("the pose is not known: no initial pose was given")
        before_from_then = self._before_from(stamp_ns)
        if before_from_then is None:
            return self._set.pose, self._set.covariance.copy()
        pose = self._set.pose @ before_from_then
        if self._hypotheses is not None and len(self._hypotheses):
            return pose, self._spread_of(self._hypotheses.weighed())
        return pose, self._set.moved_covariance(before_from_then) + self._raster_covariance

    def _before_from(self, stamp_ns: int | None) -> SE2 | None:
        """Where odometry has the robot at a time, or at the latest, from where it was at the last
        update; None: there is no odometry yet.
        """
        if self._odom_from_base is None:
            return None
        at = self._history.latest[1] if stamp_ns is None else self._history.at(stamp_ns)
        if at is None:
            raise RuntimeError(f"there is no odometry for the time {stamp_ns} ns")
        return self._odom_from_base.inverse() @ at

    def map_from_base(self) -> SE2:
        """The pose alone. Raises RuntimeError where there is none yet."""
        if not self._known:
            raise RuntimeError("the pose is not known: no initial pose was given")
        before_from_now = self._before_from(None)
        return self._set.pose if before_from_now is None else self._set.pose @ before_from_now

    def map_from_odom(self) -> SE2:
        """The correction of odometry. Raises RuntimeError where there is no pose yet."""
        if not self._known:
            raise RuntimeError("map from odom is not known: no initial pose was given")
        if self._odom_from_base is None:
            return self._set.pose
        return self._set.pose @ self._odom_from_base.inverse()

    def particles(self) -> Array:
        """(n, 3) particles (x, y, yaw) in the map at the last update; while the pose is sought, the
        poses that are weighed.
        """
        if self._hypotheses is not None:
            return np.ascontiguousarray(self._hypotheses.weighed()[:, :3])
        return self._set.poses.copy()

    # Tracking.

    def _track(self, stamp_ns: int, odom_from_base: SE2, view: ScanView) -> bool:
        used = self._is_due(self._last_scan, stamp_ns, odom_from_base)
        if used:
            self._last_scan = (stamp_ns, odom_from_base)
            self._predict(stamp_ns, odom_from_base)
        assert self._odom_from_base is not None
        # The scan may be older than the last update, or newer.
        if odom_from_base != self._odom_from_base:
            view = moved_view(view, self._odom_from_base.inverse() @ odom_from_base)
        points_m, before_m = self._mapped_points(view)
        enough = len(points_m) >= self._params.min_returns
        if used and enough:
            self._set.weigh(
                pf.scan_log_weights(
                    self._field, self._set.poses, points_m, before_m, self._params.beam_weight
                )
            )
        elif used:
            # On open floor there is only odometry, and the spread grows step by step.
            self._set.measure_spread()
        # NaN, 0 and what else is no measurement tells of no wall, nor of open floor.
        if len(view.ranges_m) >= min(LEAST_BEAMS, self._params.min_returns):
            self._judge(stamp_ns, odom_from_base, view, enough)
        if self._state == "localized" and not enough:
            self._doubt_spread()
        return used and enough

    def _mapped_points(self, view: ScanView) -> tuple[Array, Array]:
        """The ends of the beams, and the points before them, without those from where the map knows
        nothing: such a return is as likely at each particle.
        """
        if not self._table.is_open(self._set.pose):
            return view.points_m, view.before_m
        within_m = max(_BORDER_M, _SIGMAS * std_m(self._set.covariance))
        mapped = mapped_returns(self._rays, self._set.pose, view, within_m)
        return view.points_m[mapped], view.before_m[mapped]

    def _judge(self, stamp_ns: int, odom_from_base: SE2, view: ScanView, enough: bool) -> None:
        here = self._poses_to_judge()
        counts, likelihoods = judge(self._rays, here, view)
        counts, likelihoods = without_gone(self._through, here, view, counts, likelihoods)
        quality, consistency = self._rated(here, counts)
        best = int(np.argmax(quality))
        self._monitor.add(stamp_ns, float(quality[best]), float(consistency.max()))
        if enough:
            near = float(counts[0, HIT]) / view.returns
            self._match_fast += self._params.recovery_alpha_fast * (near - self._match_fast)
        if self._given is not None:
            returns = float(counts[best, [HIT, SHORT, MISFIT, THROUGH]].sum())
            mapped = max(self._params.min_returns, (1.0 - _UNMAPPED_SHARE) * view.returns)
            is_mapped = returns >= mapped
            fit = _Fit(
                float(quality[best]),
                float(consistency.max()),
                float(likelihoods[best]),
                is_mapped and float(likelihoods[best]) >= nowhere(counts[best], view),
                is_mapped,
                float(counts[best, HIT]) / max(returns, 1.0) if is_mapped else 0.0,
            )
            self._judge_given(self._given, view, fit)
        else:
            likelihood = float(likelihoods[0])
            self._doubt(stamp_ns, odom_from_base, view, counts[0], likelihood, enough)
        if self._hypotheses is not None and self._view is not None:
            self._weigh_hypotheses(self._hypotheses, stamp_ns, odom_from_base, self._view[1])

    def _doubt(
        self,
        stamp_ns: int,
        odom_from_base: SE2,
        view: ScanView,
        counts: Array,
        likelihood: float,
        enough: bool,
    ) -> None:
        """Whether a pose that was trusted still is, by the counts (7,) of beams there and the
        log-likelihood of the scan.
        """
        is_mapped = counts[UNMAPPED] <= _UNMAPPED_SHARE * max(view.returns, 1)
        spread_m = std_m(self._set.covariance)
        is_wide = spread_m > WIDE_M
        if not (is_mapped or self._monitor.is_suspect):
            share = f"{100.0 * counts[UNMAPPED] / view.returns:.0f} % of the returns"
            self._reasons = (f"{share} come from where the map shows nothing",)
            if spread_m > _UNMAPPED_STD_M:
                self._give_up(*self._reasons)
            return
        share = f"{100.0 * self._monitor.quality:.0f} % of the beams are explained by the map"
        if not self._monitor.is_suspect:
            fits = self._monitor.quality >= CERTAIN_QUALITY
            self._reasons = ("the scans match the map" if fits else f"{share}, none contradict it",)
        else:
            through = int(counts[THROUGH])
            if through:
                share += f", and {through} of {len(view.ranges_m)} pass through walls"
            self._reasons = (share,)
        if self._monitor.is_hopeless(stamp_ns):
            self._give_up(share)
        elif enough and self._monitor.wants_search(stamp_ns, is_wide):
            # Another one is sought everywhere, a right one where it may be.
            suspect, beside = self._monitor.is_suspect, None
            near_m = BESIDE_M + _SIGMAS * spread_m
            found = self._search_map(view, math.inf if suspect else near_m)
            if suspect or is_wide:
                beside = poses_beside(found, view, self._set.pose, self._set.covariance, likelihood)
            if beside is not None:
                # The particles were too few to be near them.
                self._set.begin_at(beside.poses, beside.weights, np.diag(FOUND_VARIANCES))
                self._trust("the scans match the map beside the estimate", beside.quality)
            elif suspect and self._is_outweighed(odom_from_base, view, counts, found):
                self._give_up(share + "; another pose matches better, or none")
            elif self._monitor.is_poor and explains_all(
                found if suspect else self._search_map(view, math.inf), view, likelihood
            ):
                self._give_up(share + "; another pose explains nearly all")
            else:
                self._doubt_spread()

    def _doubt_spread(self) -> None:
        spread_m = std_m(self._set.covariance)
        if spread_m > _SPREAD_OUT_M:
            self._give_up(f"the estimate's standard deviation is {spread_m:.1f} m")

    def _judge_given(self, given: _Given, view: ScanView, fit: _Fit) -> None:
        """Confirm the initial pose by a scan, or doubt it."""
        self._given = given = given._replace(scans=given.scans + 1)
        if view.returns < self._params.min_returns:
            if fit.consistency >= _OPEN_FLOOR:
                self._trust("no wall is in range, and the initial pose says so", fit.quality)
            elif given.scans >= _VERDICT_SCANS:
                why = "walls that are in range of the initial pose are unseen"
                self._search("searching", why, given.map_from_odom)
            return
        hidden = fit.consistency >= _UNCONTRADICTED
        # Rays that are lost are lost at each pose.
        fits = fit.is_of_this_map and fit.consistency > 0.0
        fits |= hidden and fit.hit_share >= _CONFIRMING
        is_due = given.scans % _VERDICT_SCANS == 0
        if not (fits or is_due):
            return
        rival = self._rival(given, view, fit.likelihood)
        if rival is not None and hidden and rival.hit_share < _ALL_EXPLAINED:
            rival = None
        if fits and rival is None:
            self._trust("the scans match the map", fit.quality)
        elif not is_due:
            return
        elif rival is not None and rival.is_given:
            # The particles were too few to be near it.
            self._set.begin(rival.pose, np.diag(FOUND_VARIANCES))
            self._trust("the scans match the map near the initial pose", rival.quality)
        elif rival is None and hidden and fit.is_mapped:
            # What hides the walls is left behind on the way, or the pose is contradicted there.
            self._state = "searching"
            self._reasons = ("nothing contradicts the initial pose, and hardly a wall confirms it",)
        else:
            share = f"{100.0 * fit.quality:.0f} % of the beams are explained at the initial pose"
            if not fit.is_mapped:
                share = "the initial pose is where the map shows nothing"
            other = "" if rival is None else "; another pose matches better"
            self._search("searching", share + other, given.map_from_odom)

    def _rival(self, given: _Given, view: ScanView, likelihood: float) -> _Rival | None:
        """The best pose on the map for a scan, if it is far likelier than the estimate."""
        assert given.map_from_odom is not None
        assert self._odom_from_base is not None
        poses, counts, likelihoods, quality = self._search_map(view, math.inf)
        off = poses[:, :2] - np.array(self._set.pose[:2])
        near = portable.hypot_each(off[:, 0], off[:, 1]) <= _NEAR_M
        good = quality >= CERTAIN_QUALITY
        good &= BEAM_WEIGHT * (likelihoods - likelihood) >= np.where(near, _NEAR_RIVAL, RIVAL)
        if not good.any():
            return None
        best = int(np.argmax(good))
        expected = given.map_from_odom @ self._odom_from_base
        covariance = given.covariance + np.diag(FOUND_VARIANCES)
        pose = SE2(*poses[best].tolist())
        judged = float(counts[best].sum() - counts[best, OPEN] - counts[best, UNMAPPED])
        return _Rival(
            pose,
            float(quality[best]),
            float(counts[best, HIT]) / max(judged, 1.0),
            pf.squared_mahalanobis(pose, expected, covariance) <= GATE,
        )

    def _trust(self, reason: str, quality: float) -> None:
        self._given = None
        self._state, self._reasons = "localized", (reason,)
        self._monitor.begin(quality)

    def _rated(self, poses: Array, counts: Array) -> tuple[Array, Array]:
        """(n,) qualities and consistencies of poses (n, 3): a robot in a wall has none."""
        inside = in_wall(self._rays, poses, _WALL_CLEARANCE_M)
        quality, consistency = qualities(counts, self._params.dynamic_share), consistencies(counts)
        return np.where(inside, 0.0, quality), np.where(inside, 0.0, consistency)

    def _poses_to_judge(self) -> Array:
        """(n, 3) the estimate, and where it is uncertain some particles, too: that the mean of many
        poses does not match does not rule out each of them.
        """
        mean = np.array([self._set.pose])
        turn_2 = float(self._set.covariance[2, 2])
        if std_m(self._set.covariance) <= _SURE_M and turn_2 <= portable.square(_SURE_RAD):
            return mean
        poses = self._set.poses
        return np.ascontiguousarray(np.concatenate([mean, poses[:: max(1, len(poses) // _JUDGED)]]))

    def _search_map(self, view: ScanView, within_m: float) -> Candidates:
        """The poses on the map that a scan fits best, within a distance of the estimate."""
        where = self._table.around(self._set.pose, within_m)
        poses, counts, likelihoods = global_search(
            self._table, self._rays, view, _SEARCH_COUNT, where
        )
        quality = qualities(counts, self._params.dynamic_share)
        return Candidates(poses, counts, likelihoods, quality)

    def _is_outweighed(
        self, odom_from_base: SE2, view: ScanView, mine: Array, found: Candidates
    ) -> bool:
        """Whether a pose elsewhere matches a scan, or none does, and what contradicts the estimate,
        by the counts (7,) of beams there and on the way since it is suspect, outweighs that hardly
        any robot is carried away.
        """
        # Rays that are lost are lost at a place that is not on the map, too.
        echoes = mine.copy()
        echoes[MISSING] = 0.0
        against, against_echoes = refutations(np.array([mine, echoes]), view.likelihood_weight)
        on_no_map = against_echoes - NOWHERE_COST * view.returns * view.likelihood_weight
        # At the other pose, what ends before the map's walls counts against it. So it does here,
        # but for no more than what else is against this pose: alone, it is things beside the robot.
        hidden = min(against, MISS_COST * float(mine[SHORT]) * view.likelihood_weight)
        needed = max(self._monitor.quality + self._params.lost_margin, CERTAIN_QUALITY)
        others = found.likelihoods[found.quality >= needed]
        advantage = (against + hidden + others).max(initial=max(0.0, on_no_map))
        return self._monitor.outweighs(odom_from_base, BEAM_WEIGHT * float(advantage))

    def _standing(
        self, stamp_ns: int, odom_from_base: SE2, key: MarkerKey, seen: Sequence[Sighting]
    ) -> _Standing:
        """What a marker's sighting says of the estimate, and the last scan of both."""
        if self._hypotheses is not None:
            return "open"
        assert self._odom_from_base is not None
        pose = self._set.pose @ (self._odom_from_base.inverse() @ odom_from_base)
        covariance = self._set.covariance + self._raster_covariance
        is_misplaced = self._markers.is_misplaced(key)
        if not is_far(seen, pose, covariance):
            if not is_misplaced:
                self._monitor.agree()
            return "agrees"
        fits = self._fitting(odom_from_base, pose, covariance, seen)
        if is_misplaced:
            return "here" if fits == "here" else "open"
        if self._monitor.contradict(stamp_ns, seen, odom_from_base) and fits == "elsewhere":
            return "elsewhere"
        return "here" if fits == "here" else "open"

    def _fitting(
        self, odom_from_base: SE2, pose: SE2, covariance: Array, seen: Sequence[Sighting]
    ) -> _Standing:
        """Whether the last scan fits where a marker's sighting has the robot, or the estimate."""
        if self._view is None:
            return "elsewhere"
        then_from_scan_base = odom_from_base.inverse() @ self._view[0]
        mine = pose @ then_from_scan_base
        others = np.array([s.map_from_base @ then_from_scan_base for s in seen])
        view = self._view[1]
        # The marker's own error would let the scan fail there: it may draw the pose to the walls.
        others, _ = refine(
            self._field, others, view.points_m, prior_std_m=0.2, prior_std_rad=0.1,
            return_std_m=0.2,
        )  # fmt: skip
        poses = np.concatenate([np.array([mine]), others])
        counts, likelihoods = judge(self._rays, poses, view)
        quality = qualities(counts, self._params.dynamic_share)
        as_good = quality >= quality[0] - _AS_GOOD
        as_good &= BEAM_WEIGHT * (likelihoods[0] - likelihoods) <= _NEAR_RIVAL
        # A pose that the walls draw to the estimate is no other one.
        same = covariance + np.diag(_SAME_VARIANCES)
        away = [pf.squared_mahalanobis(SE2(*p), mine, same) > GATE for p in poses.tolist()]
        if bool(as_good[away].any()):
            return "elsewhere"
        is_best = quality[0] >= max(CERTAIN_QUALITY, float(quality.max()) - _AS_GOOD)
        return "here" if is_best and self._state == "localized" else "open"

    def _note_trust(
        self,
        key: MarkerKey,
        standing: _Standing,
        odom_from_base: SE2,
        candidates: Sequence[MarkerCandidate],
        base_from_camera: Array,
    ) -> None:
        """Count what a sighting says of its marker."""
        assert self._odom_from_base is not None
        pose = self._set.pose @ (self._odom_from_base.inverse() @ odom_from_base)
        if standing == "here":
            self._markers.contradicted(key, pose, candidates, base_from_camera)
            return
        seen_at = self._markers.seen_at(key)
        if seen_at is None:
            return
        there = sightings(seen_at, candidates, base_from_camera, self._marker_noise)
        # From afar both places agree.
        if is_far(there, pose, self._set.covariance + self._raster_covariance):
            self._markers.confirmed(key)

    def _predict(self, stamp_ns: int, odom_from_base: SE2) -> None:
        assert self._stamp_ns is not None
        assert self._odom_from_base is not None
        if stamp_ns <= self._stamp_ns:
            return
        self._set.predict(self._odom_from_base.inverse() @ odom_from_base)
        self._stamp_ns, self._odom_from_base = stamp_ns, odom_from_base

    def _is_due(self, last: tuple[int, SE2] | None, stamp_ns: int, odom_from_base: SE2) -> bool:
        # At rest the same errors repeat: using each would make the estimate overconfident.
        if last is None:
            return True
        if stamp_ns <= last[0]:
            return False
        turned = abs(wrap_angle(odom_from_base.yaw_rad - last[1].yaw_rad))
        return (
            not (self._set.settled or self._hypotheses is not None)
            or odom_from_base.distance_m(last[1]) >= self._params.update_min_d
            or turned >= self._params.update_min_a
            or stamp_ns - last[0] >= self._params.still_update_period_s * 1e9
        )

    # Searching.

    @property
    def _is_begun(self) -> bool:
        """Whether a pose was given or is sought."""
        return self._known or self._hypotheses is not None

    def _give_up(self, reason: str) -> None:
        """Search the map for the pose; a robot whose pose was never trusted is not lost."""
        before = None
        if self._odom_from_base is not None:
            before = self._set.pose @ self._odom_from_base.inverse()
        self._search("lost" if self._state == "localized" else "searching", reason, before)

    def _search(self, state: LocalizationState, reason: str, before: SE2 | None = None) -> None:
        """Search the map. `before`: map_from_odom until now, if there was a pose to be trusted."""
        p = self._params
        self._hypotheses = Hypotheses(
            self._rays, self._table, p.max_hypotheses, p.dynamic_share, p.min_returns, before
        )
        self._given = None
        self._state, self._reasons, self._cause = state, (reason,), reason
        self._last_marker.clear()

    def _weigh_hypotheses(
        self, hypotheses: Hypotheses, stamp_ns: int, odom_from_base: SE2, view: ScanView
    ) -> bool:
        due = hypotheses.is_due(odom_from_base)
        if due:
            hypotheses.add_keyframe(odom_from_base, view)
        self._take_verdict(hypotheses, stamp_ns, odom_from_base)
        return due

    def _weigh_marker(
        self,
        hypotheses: Hypotheses,
        stamp_ns: int,
        odom_from_base: SE2,
        map_from_marker: Array,
        seen: Sequence[Sighting],
    ) -> bool:
        if hypotheses.keyframe_odometry is None and self._view is not None:
            hypotheses.add_keyframe(*self._view)
        keyframe = hypotheses.keyframe_odometry
        if keyframe is None:
            return False
        keyframe_from_base = keyframe.inverse() @ odom_from_base
        base_from_keyframe = keyframe_from_base.inverse()
        poses = np.array([s.map_from_base @ base_from_keyframe for s in seen])
        outlier = self._params.marker_outlier
        hypotheses.add_marker(
            MarkerSighting(map_from_marker, seen, keyframe_from_base, outlier), poses
        )
        self._take_verdict(hypotheses, stamp_ns, odom_from_base)
        return True

    def _take_verdict(self, hypotheses: Hypotheses, stamp_ns: int, odom_from_base: SE2) -> None:
        verdict = hypotheses.verdict()
        if verdict is not None and self._is_certain(verdict):
            # What no search of this scan finds elsewhere, there is not.
            hypotheses.search()
            verdict = hypotheses.verdict()
        if verdict is None:
            why = "no pose on the map matches the scans, or the scans have no returns"
            self._reasons = (self._cause, why)
            return
        keyframe = hypotheses.keyframe_odometry
        assert keyframe is not None
        if self._state == "lost":
            self._state = "searching"
        here = verdict.pose @ (keyframe.inverse() @ odom_from_base)
        self._known = True
        self._set.pose = here
        self._stamp_ns, self._odom_from_base = stamp_ns, odom_from_base
        self._monitor.quality = verdict.quality
        if self._is_certain(verdict):
            self._settle_on(verdict, here)
        else:
            count = len(hypotheses)
            poses = "1 candidate pose" if count == 1 else f"{count} candidate poses"
            self._reasons = (
                self._cause,
                f"{poses}, the most likely with probability {verdict.certainty:.2f} "
                f"and quality {verdict.quality:.2f}",
            )

    def _is_certain(self, verdict: Verdict) -> bool:
        quality = min(verdict.quality, verdict.last_quality)
        if verdict.certainty < self._params.search_certainty or quality < CERTAIN_QUALITY:
            return False
        if verdict.markers >= _MARKERS_AGREE:
            return True
        p = self._params
        is_open = self._table.is_open(verdict.pose)
        least_m = p.search_min_travel_m
        if is_open:
            least_m = max(least_m, p.search_min_travel_open_m)
        return verdict.travel_m >= least_m

    def _settle_on(self, verdict: Verdict, here: SE2) -> None:
        found = portable.inverse(verdict.information)
        self._set.begin(here, (found + found.T) / 2.0 + np.diag(FOUND_VARIANCES))
        self._hypotheses = None
        self._state = "localized"
        why = "no other pose matches"
        if verdict.markers >= _MARKERS_AGREE:
            why = "markers agree"
        elif verdict.matches_alone < self._params.search_certainty:
            why = "of those that match, the one about where the robot was"
        self._reasons = (f"pose found: {why}",)
        self._begin_at_latest_odometry(forget=False)
        self._monitor.begin(verdict.quality)

    def _begin_at_latest_odometry(self, forget: bool = True) -> None:
        if self._history and forget:
            self._stamp_ns, self._odom_from_base = self._history.latest
            # Earlier measurements are from another pose.
            self._history.forget()
        self._last_scan = None
        self._last_marker.clear()
        self._monitor.begin()
        if forget:
            self._view = None

    def _spread_of(self, weighed: Array) -> Array:
        """(3, 3) covariance of all hypotheses (n, 4) about the likeliest one."""
        off = weighed[:, :3] - weighed[0, :3]
        off[:, 2] = wrap_angles(off[:, 2])
        least = np.diag([0.01, 0.01, 0.01])
        share = weighed[:, 3] / max(float(weighed[:, 3].sum()), 1e-12)
        return portable.product(off.T * share, off) + least
