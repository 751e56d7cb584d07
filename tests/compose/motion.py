"""What the robot truly does, as seen from outside the containers."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any, cast

import zenoh

from mazebot.common.bus.liveliness import alive_key, service_and_source
from mazebot.common.bus.subscriber import subscribe
from mazebot.common.messages import wire
from mazebot.common.messages.keys import DEFAULT_KEYS, Keys
from mazebot.common.messages.messages import Odometry
from mazebot.common.messages.topics import GROUND_TRUTH_ODOM
from mazebot.common.node.node import Envelope

REST_M_S = 0.01
REST_RAD_S = 0.02


@dataclass(frozen=True)
class Motion:
    """The robot's speed at a moment of the wall clock."""

    wall_s: float
    speed_m_s: float
    turn_rad_s: float

    @property
    def at_rest(self) -> bool:
        """Whether the robot stands still."""
        return self.speed_m_s < REST_M_S and abs(self.turn_rad_s) < REST_RAD_S


class Witness:
    """Listens to the ground truth from the host."""

    def __init__(self, session: zenoh.Session, keys: Keys = DEFAULT_KEYS) -> None:
        """It closes the session."""
        self._session = session
        self.seen: list[Motion] = []
        self._subscription = subscribe(self._session, GROUND_TRUTH_ODOM, self._on_odom, keys)
        self._appeared: dict[str, float] = {}
        self._tokens = self._session.liveliness().declare_subscriber(
            alive_key("*", "*", keys),
            cast("Any", zenoh.handlers.Callback(self._on_token, indirect=False)),
            history=True,
        )

    def _on_odom(self, payload: bytes, _: Envelope) -> None:
        odom: Odometry = wire.decode(GROUND_TRUTH_ODOM, payload)
        twist = odom.twist.twist
        speed_m_s = math.hypot(twist.linear.x, twist.linear.y)
        self.seen.append(Motion(time.monotonic(), speed_m_s, twist.angular.z))

    def _on_token(self, sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT:
            service, _ = service_and_source(sample.key_expr)
            self._appeared[service] = time.monotonic()

    def driving(self) -> bool:
        """Whether the robot drives at a fair speed now."""
        return bool(self.seen) and self.seen[-1].speed_m_s > 0.15

    def rest_after(self, wall_s: float) -> float | None:
        """When the robot first stood still after a moment; None: it has not."""
        moments = (
            motion.wall_s for motion in self.seen if motion.wall_s > wall_s and motion.at_rest
        )
        return next(moments, None)

    def appeared_after(self, service: str, wall_s: float) -> float | None:
        """When a service last announced itself, where that was after a moment."""
        appeared_s = self._appeared.get(service, 0.0)
        return appeared_s if appeared_s > wall_s else None

    def close(self) -> None:
        """Listen no more."""
        self._session.close()  # type: ignore[no-untyped-call]
