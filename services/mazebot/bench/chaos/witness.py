"""What the robot truly does, and what is said of it, while faults are done to its stack."""

from __future__ import annotations

import contextlib
import math
import threading
import time
import uuid
from collections.abc import Callable
from typing import Any, NamedTuple

from mazebot.common.access.grants import OPERATOR
from mazebot.common.bus.attachment import pack_attachment
from mazebot.common.bus.config import BusConfig
from mazebot.common.bus.liveliness import alive, alive_key
from mazebot.common.bus.publisher import publish
from mazebot.common.bus.query import QueryError, ask
from mazebot.common.bus.session import open_session
from mazebot.common.bus.subscriber import subscribe
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import MAP_FRAME, yaw_from_quaternion
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.action_documents import LoadWorld
from mazebot.common.messages.documents import (
    Contact,
    LocalizationStatus,
    NavigationResult,
    NavigationStatus,
    Planar,
    SimulationControl,
    SimulationStats,
    World,
    WorldRequest,
)
from mazebot.common.messages.slam_documents import ExplorationStatus
from mazebot.common.messages.topics import (
    CONTACTS,
    EXPLORATION_STATUS,
    GOAL_POSE,
    GROUND_TRUTH_ODOM,
    LOAD_WORLD,
    LOCALIZATION_STATUS,
    NAVIGATION_RESULT,
    NAVIGATION_STATUS,
    SIMULATION_CONTROL,
    SIMULATION_STATS,
    WORLD,
    WORLD_REQUEST,
    Topic,
)
from mazebot.common.node.node import Envelope

REST_M_S, REST_RAD_S = 0.01, 0.02
_POLL_S = 0.02
_SESSION_S = 60.0
_FRESH_S = 1.0
_RESET_S = 20.0


class Motion(NamedTuple):
    """The robot's true motion at a moment of the wall clock."""

    wall_s: float
    x_m: float
    y_m: float
    yaw_rad: float
    speed_m_s: float
    turn_rad_s: float
    stamp_ns: int

    @property
    def at_rest(self) -> bool:
        """Whether the robot stands still."""
        return self.speed_m_s < REST_M_S and abs(self.turn_rad_s) < REST_RAD_S


class Witness:
    """A person at a terminal who watches the robot and sends it about."""

    def __init__(
        self, bus: Callable[[str], BusConfig], world_name: str, explores: bool = False
    ) -> None:
        """`bus`: how it joins as one or another. Raises BusUnavailableError where there is no
        router.
        """
        self._lock = threading.Lock()
        self.motions: list[Motion] = []
        self.contacts: list[tuple[float, Contact]] = []
        self.results: list[NavigationResult] = []
        self.stats: SimulationStats | None = None
        self.navigation: tuple[float, NavigationStatus] | None = None
        self.localization: tuple[float, LocalizationStatus] | None = None
        self.exploration: tuple[float, ExplorationStatus] | None = None
        self.world: World | None = None
        self._bus = bus
        self._request = WorldRequest(world_name=world_name, slam=explores, explore=explores)
        self._source, self._number = uuid.uuid4().hex, 0
        self.open()

    def open(self) -> None:
        """Join the bus, anew if need be."""
        self._session = open_session(self._bus(OPERATOR), _SESSION_S)
        heard: tuple[tuple[Topic[Any], Callable[[Any], None]], ...] = (
            (GROUND_TRUTH_ODOM, self._on_truth),
            (CONTACTS, lambda one: self.contacts.append((time.monotonic(), one))),
            (NAVIGATION_RESULT, self.results.append),
            (SIMULATION_STATS, lambda one: setattr(self, "stats", one)),
            (WORLD, lambda one: setattr(self, "world", one)),
            (NAVIGATION_STATUS, lambda one: self._on_status("navigation", one)),
            (LOCALIZATION_STATUS, lambda one: self._on_status("localization", one)),
            (EXPLORATION_STATUS, lambda one: self._on_status("exploration", one)),
        )
        self._heard = [subscribe(self._session, topic, _taking(topic, on)) for topic, on in heard]
        self._publishers = {one.name: publish(self._session, one) for one in (GOAL_POSE,)}

    def close(self) -> None:
        """Leave the bus."""
        self._session.close()  # type: ignore[no-untyped-call]

    def request_world(self, timeout_s: float) -> None:
        """Ask for the world, as a demo does, and wait until the robot can be sent about in it.

        Raises ConfigError where it cannot in this time.
        """
        with open_session(self._bus("bringup"), _SESSION_S) as session:
            token = session.liveliness().declare_token(alive_key("bringup", self._source))
            publisher = publish(session, WORLD_REQUEST)
            self.navigation = None
            self._say(publisher, WORLD_REQUEST, self._request)
            self.wait(
                lambda: self.is_active and self.world is not None, timeout_s, "an active robot"
            )
            token.undeclare()  # type: ignore[no-untyped-call]
            publisher.undeclare()

    def load_world(self, name: str, timeout_s: float) -> None:
        """Load another world in place of the one that runs, and wait until the robot can be sent
        about in it. Raises ConfigError where it is refused, or cannot in this time.
        """
        try:
            reply = ask(self._session, LOAD_WORLD, LoadWorld(world_name=name), timeout_s)
        except (QueryError, wire.WireError) as error:
            raise ConfigError(f"{name}: {error}") from error
        if reply.error:
            raise ConfigError(reply.error)
        loaded_s = time.monotonic()

        def runs() -> bool:
            world, stats = self.world, self.stats
            return (
                world is not None
                and world.hash == reply.world_hash
                and stats is not None
                and stats.world_hash == reply.world_hash
                and self.active_since(loaded_s)
            )

        self.wait(runs, timeout_s, f"an active robot in {name}")

    def reset(self) -> None:
        """Put everything back to the start. Raises ConfigError where it is refused."""
        try:
            reply = ask(self._session, SIMULATION_CONTROL, SimulationControl(reset="all"), _RESET_S)
        except (QueryError, wire.WireError) as error:
            raise ConfigError(f"reset: {error}") from error
        if reply.error:
            raise ConfigError(reply.error)

    def wait(self, holds: Callable[[], object], timeout_s: float, what: str) -> float:
        """Seconds until something held. Raises ConfigError where it does not in this time."""
        start_s = time.monotonic()
        while not holds():
            if time.monotonic() - start_s > timeout_s:
                raise ConfigError(f"not within {timeout_s:g} s: {what}")
            time.sleep(_POLL_S)
        return time.monotonic() - start_s

    def send_goal(self, pose: Planar, stamp_ns: int) -> None:
        """Send the robot to a pose; the stamp names the goal."""
        message = msg.PoseStamped(msg.header(stamp_ns, MAP_FRAME), msg.pose_from_se2(pose.se2()))
        self._say(self._publishers[GOAL_POSE.name], GOAL_POSE, message)

    def result_of(self, stamp_ns: int) -> NavigationResult | None:
        """How a goal has ended."""
        return next((one for one in self.results if one.goal_stamp_ns == stamp_ns), None)

    def alive(self) -> dict[str, frozenset[str]]:
        """The services that are alive."""
        return dict(alive(self._session))

    @property
    def is_active(self) -> bool:
        """Whether navigation takes goals, by its last word."""
        return self.navigation is not None and self.navigation[1].navigation_active

    def active_since(self, wall_s: float) -> bool:
        """Whether navigation takes goals, said after a moment, while the simulation runs."""
        said, motion = self.navigation, self.motions[-1] if self.motions else None
        return (
            said is not None
            and said[0] > wall_s
            and said[1].navigation_active
            and motion is not None
            and motion.wall_s > max(wall_s, time.monotonic() - _FRESH_S)
        )

    def rest_after(self, wall_s: float) -> Motion | None:
        """The first moment after one at which the robot stood; None: it has not."""
        with self._lock:
            motions = list(self.motions)
        return next((one for one in motions if one.wall_s > wall_s and one.at_rest), None)

    def last_before(self, wall_s: float) -> Motion | None:
        """Where the robot was at a moment."""
        with self._lock:
            return next((one for one in reversed(self.motions) if one.wall_s <= wall_s), None)

    def forget(self) -> None:
        """Let go of what came before the last minute."""
        with self._lock:
            del self.motions[:-2000]

    def _say(self, publisher: Any, topic: Topic[Any], message: Any) -> None:
        attachment = pack_attachment(topic, Envelope(self._source, self._number, 0, ""))
        self._number += 1
        publisher.put(wire.encode(topic, message), attachment=attachment)

    def _on_status(self, name: str, status: Any) -> None:
        setattr(self, name, (time.monotonic(), status))

    def _on_truth(self, odom: msg.Odometry) -> None:
        twist, position = odom.twist.twist, odom.pose.pose.position
        turn = odom.pose.pose.orientation
        motion = Motion(
            time.monotonic(), position.x, position.y,
            yaw_from_quaternion(turn.x, turn.y, turn.z, turn.w),
            math.hypot(twist.linear.x, twist.linear.y), twist.angular.z,
            msg.ns_from_time(odom.header.stamp),
        )  # fmt: skip
        with self._lock:
            self.motions.append(motion)


def _taking(topic: Topic[Any], take: Callable[[Any], None]) -> Callable[[bytes, Envelope], None]:
    def receive(data: bytes, _: Envelope) -> None:
        # Others may send what they like.
        with contextlib.suppress(wire.WireError):
            take(wire.decode(topic, data))

    return receive
