"""Fills a trial's row with the metrics of its stretch of the run."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from mazebot.bench.navigation import metrics
from mazebot.bench.navigation.scenario import Row
from mazebot.bench.navigation.surroundings import Surroundings
from mazebot.bench.navigation.witness import Witness
from mazebot.common.maths.frames import SE2, Array, wrap_angle
from mazebot.common.robot.waffle import MAX_LINEAR_M_S
from mazebot.recorder.judging.goals.tolerance import GoalTolerance

ALARM_ERROR_M, ALARM_ERROR_RAD = 0.3, 0.3
"""Poses nearer to the truth than this"""
ALARM_AFTER_S = 1.5
"""for this long are given up in vain."""
_SEARCHES_S = 0.2
"""The last claims before a pose is seen to be given up may be of the search for another one."""
_EVERY = 3
"""Of the true poses, 30 a second, those for clearances and plots"""


class LocalizationStatuses(Protocol):
    """The received states of localisation: see Witness."""

    claims: list[tuple[float, ...]]
    statuses: list[tuple[float, bool, bool]]


class Leg(NamedTuple):
    """One drive to a goal."""

    start_s: float
    end_s: float
    start: SE2
    goal: SE2
    shortest_m: float | None


def fill_in(row: Row, leg: Leg, witness: Witness, around: Surroundings) -> None:
    """Compute a row's figures of a drive."""
    truth = witness.truth_between(leg.start_s, leg.end_s)
    row.time_s, row.shortest_m = leg.end_s - leg.start_s, leg.shortest_m
    if len(truth):
        _of_motion(row, truth, around)
    end = SE2(*truth[-1, 1:4].tolist()) if len(truth) else leg.start
    row.goal_error_m = end.distance_m(leg.goal)
    turn_rad = abs(wrap_angle(end.yaw_rad - leg.goal.yaw_rad))
    near = GoalTolerance().holds(row.goal_error_m, turn_rad)
    row.reached = row.error_code == 0 and near
    contacts = [one for one in witness.contacts if leg.start_s <= one.time_s <= leg.end_s]
    row.contacts_robot = metrics.episodes([one.time_s for one in contacts if one.by_robot])
    row.contacts_other = metrics.episodes([one.time_s for one in contacts if not one.by_robot])
    if contacts:
        row.extra["touched"] = sorted({one.body for one in contacts})
        row.touches = np.array([one.place_m for one in contacts])
    row.spl = metrics.spl(row.reached, row.driven_m, leg.shortest_m)
    clean = row.reached and not contacts
    row.barn = metrics.barn_score(clean, row.time_s, leg.shortest_m, metrics.BARN_SPEED_M_S)
    row.barn_own_speed = metrics.barn_score(clean, row.time_s, leg.shortest_m, MAX_LINEAR_M_S)
    _of_localisation(row, leg, truth, witness)


def _of_motion(row: Row, truth: Array, around: Surroundings) -> None:
    times_s = truth[:, 0]
    row.driven_m = metrics.driven_m(truth[:, 1:3])
    row.jerk_m_s3 = metrics.jerk(times_s, truth[:, 4])
    row.jerk_rad_s3 = metrics.jerk(times_s, truth[:, 5])
    row.irregularity_rad_m = metrics.irregularity(truth[:, 3], row.driven_m)
    clearance_m = around.clearance_m(times_s[::_EVERY], truth[::_EVERY, 1:4])
    row.min_clearance_m = float(clearance_m.min())
    row.clearance_p05_m = metrics.percentile(clearance_m, 5.0)
    row.way = truth[::_EVERY, 1:3]


def _of_localisation(row: Row, leg: Leg, truth: Array, witness: Witness) -> None:
    found = metrics.localisation_errors(witness.claims_between(leg.start_s, leg.end_s), truth)
    row.errors_m, row.errors_rad = found.metres, found.radians
    row.localisation_mean_m = metrics.mean(found.metres)
    row.localisation_p95_m = metrics.percentile(found.metres, 95.0)
    degrees = np.degrees(found.radians)
    row.localisation_mean_deg = metrics.mean(degrees)
    row.localisation_p95_deg = metrics.percentile(degrees, 95.0)
    row.consistency = metrics.mean(found.inside.astype(np.float64))
    row.alarms = alarm_count(leg, truth, witness)


def alarm_count(leg: Leg, truth: Array, witness: LocalizationStatuses) -> int:
    """Times that localisation became inactive although all it had claimed for a while was near the
    truth.
    """
    claims = np.array(witness.claims, np.float64).reshape(-1, 13)
    count, was = 0, None
    for time_s, active, _ in witness.statuses:
        gave_up = was is True and not active
        was = active
        if not gave_up or not leg.start_s <= time_s <= leg.end_s or not len(truth):
            continue
        last_s = time_s - _SEARCHES_S
        before = claims[(claims[:, 0] <= last_s) & (claims[:, 0] > last_s - ALARM_AFTER_S)]
        found = metrics.localisation_errors(before, truth)
        near = (found.metres < ALARM_ERROR_M) & (found.radians < ALARM_ERROR_RAD)
        count += bool(len(near)) and bool(near.all())
    return count
