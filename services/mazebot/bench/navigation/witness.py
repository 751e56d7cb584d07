"""Collects what the ground truth says about a run, and what localisation claimed."""

from __future__ import annotations

from contextlib import ExitStack
from typing import NamedTuple

import numpy as np

from mazebot.bench.navigation.metrics import MOVES_M_S
from mazebot.bench.navigation.surroundings import Surroundings
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import Contact, NavigationResult
from mazebot.common.messages.topics import (
    AMCL_POSE,
    CONTACTS,
    GROUND_TRUTH_ODOM,
    NAVIGATION_RESULT,
    NAVIGATION_STATUS,
    ODOM,
    TF,
)
from mazebot.embedded.session import Session

_BEFORE_S = 0.1
"""How far back the robot's own motion before a contact is followed."""
_PUSHES_M = 0.01
"""A post as near as this touches the robot."""


class ContactSeen(NamedTuple):
    """A contact, and whether the robot moved into the thing."""

    time_s: float
    body: str
    robot_link: str
    by_robot: bool
    place_m: tuple[float, float]


class Witness:
    """The true poses, contacts, claims and results of a run so far."""

    def __init__(self, session: Session, around: Surroundings, stack: ExitStack) -> None:
        self._session, self._around = session, around
        watch = stack.enter_context
        self._truths = watch(session.watching(GROUND_TRUTH_ODOM))
        self._contacts = watch(session.watching(CONTACTS))
        self._claims = watch(session.watching(AMCL_POSE))
        self._ended = watch(session.watching(NAVIGATION_RESULT))
        self._frames = watch(session.watching(TF))
        self._wheels = watch(session.watching(ODOM))
        self._wheels_m_s = (0.0, 0.0)
        """Forward and turning speed by the wheels, newest"""
        self._statuses = watch(session.watching(NAVIGATION_STATUS))
        self.truth: list[tuple[float, ...]] = []
        """Time, x, y, yaw, forward speed, turning speed; 30 a second"""
        self.claims: list[tuple[float, ...]] = []
        """Time, x, y, yaw, and the nine elements of their covariance"""
        self.statuses: list[tuple[float, bool, bool]] = []
        """Time, localisation active, navigation active; at each change and twice a second"""
        self.contacts: list[ContactSeen] = []
        self.results: dict[int, NavigationResult] = {}
        """By the stamp of the goal"""

    def take(self) -> None:
        """Take in the messages since the last call."""
        for odometry in self._truths:
            pose, twist = msg.se2_from_pose(odometry.pose.pose), odometry.twist.twist
            stamp_s = msg.ns_from_time(odometry.header.stamp) * 1e-9
            self.truth.append((stamp_s, *pose, twist.linear.x, twist.angular.z))
        for claim in self._claims:
            pose = msg.se2_from_pose(claim.pose.pose)
            index = np.ix_([0, 1, 5], [0, 1, 5])
            covariance = np.array(claim.pose.covariance, np.float64).reshape(6, 6)[index]
            stamp_s = msg.ns_from_time(claim.header.stamp) * 1e-9
            self.claims.append((stamp_s, *pose, *covariance.ravel().tolist()))
        for result in self._ended:
            self.results[result.goal_stamp_ns] = result
        for wheels in self._wheels[-1:]:
            self._wheels_m_s = wheels.twist.twist.linear.x, wheels.twist.twist.angular.z
        for status in self._statuses:
            both = status.localization_active, status.navigation_active
            self.statuses.append((self._session.now_s, *both))
        for tree in self._frames:
            self._take_frames(tree)
        for contact in self._contacts:
            self.contacts.append(self._attributed(contact))
        for seen in (
            self._truths, self._claims, self._ended, self._frames, self._wheels, self._statuses
        ):  # fmt: skip
            seen.clear()
        self._contacts.clear()

    def truth_between(self, start_s: float, end_s: float) -> Array:
        """(n, 6) true rows of a stretch of time."""
        rows = np.array(self.truth, np.float64).reshape(-1, 6)
        return rows[(rows[:, 0] >= start_s) & (rows[:, 0] <= end_s)]

    def claims_between(self, start_s: float, end_s: float) -> Array:
        """(n, 13) claims of a stretch of time."""
        rows = np.array(self.claims, np.float64).reshape(-1, 13)
        return rows[(rows[:, 0] >= start_s) & (rows[:, 0] <= end_s)]

    def claimed(self) -> SE2 | None:
        """The pose last claimed."""
        return SE2(*self.claims[-1][1:4]) if self.claims else None

    def _take_frames(self, tree: msg.TFMessage) -> None:
        for frame in tree.transforms:
            post = self._around.posts.get(frame.child_frame_id)
            if post is not None:
                at = frame.transform.translation
                post.times_s.append(msg.ns_from_time(frame.header.stamp) * 1e-9)
                post.places_m.append((at.x, at.y))

    def _attributed(self, contact: Contact) -> ContactSeen:
        """By who moved into whom. Of a post it is the robot's if it came nearer by its own motion
        alone: the post is held where it was at the contact, and the robot's outline is followed
        back. Of a thing that stands it is the robot's, too, unless a post pushes the robot: then
        its own motion is that of its wheels.
        """
        time_s = contact.time_s
        rows = [row for row in self.truth[-60:] if row[0] < time_s]
        by_robot = False
        if rows:
            stamp_s, x, y, yaw, v, w = rows[-1]
            last = SE2(x, y, yaw)
            here = _moved(last, v, w, time_s - stamp_s)
            posts = self._around.posts
            touching = [
                name
                for name in posts
                if self._around.distance_to_m(name, time_s, np.array([here]))[0] <= _PUSHES_M
            ]
            if touching and contact.body not in posts:
                v, w = self._wheels_m_s
            poses = np.array([here, _moved(here, v, w, -_BEFORE_S)])
            near_m, before_m = self._around.distance_to_m(contact.body, time_s, poses)
            stands = contact.body not in posts and not touching
            by_robot = stands or bool((before_m - near_m) / _BEFORE_S > MOVES_M_S)
        place_m = contact.position_m[:2]
        return ContactSeen(time_s, contact.body, contact.robot_link, by_robot, place_m)


def _moved(pose: SE2, v: float, w: float, dt: float) -> SE2:
    half = w * dt / 2.0
    return pose @ SE2(v * dt * float(np.cos(half)), v * dt * float(np.sin(half)), w * dt)
