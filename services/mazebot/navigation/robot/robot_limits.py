"""Navigation's parameters within what the robot can do: by physics' parameters, and by the velocity
smoother's, which come after the controller.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

from pydantic import JsonValue

from mazebot.navigation.config import NavigationConfig

_NAMES: Final = (
    ("max_linear_vel", "max_linear_speed_m_s", "m/s"),
    ("max_angular_vel", "max_angular_speed_rad_s", "rad/s"),
    ("max_linear_accel", "max_linear_acceleration_m_s2", "m/s2"),
    ("max_angular_accel", "max_angular_acceleration_rad_s2", "rad/s2"),
)
"""Of the controller server, of physics, and their unit; in the order of DriveLimits."""


class DriveLimits(NamedTuple):
    """What the robot can do at most; inf where that is not known."""

    linear_m_s: float = math.inf
    angular_rad_s: float = math.inf
    linear_m_s2: float = math.inf
    angular_rad_s2: float = math.inf


def limits_of(physics: Mapping[str, JsonValue]) -> DriveLimits:
    """The robot's limits, by physics' parameters."""
    values = [physics.get(theirs) for _, theirs, _ in _NAMES]
    return DriveLimits(*(
        float(value) if isinstance(value, int | float) and value > 0.0 else math.inf
        for value in values
    ))  # fmt: skip


def beyond(config: NavigationConfig, limits: DriveLimits) -> str:
    """The parameters of the controller server that ask for more than the robot can do, in one line;
    empty: none does.
    """
    return "; ".join(
        f"controller_server.{name} is {value:g} {unit}, but {theirs} of physics {limit:g} {unit}: "
        f"navigation keeps to {limit:g} {unit}"
        for (name, theirs, unit), limit in zip(_NAMES, limits, strict=True)
        if (value := getattr(config.controller_server, name)) > limit
    )


def within(config: NavigationConfig, limits: DriveLimits) -> NavigationConfig:
    """A configuration that asks for nothing that the robot cannot do, or may not do by the velocity
    smoother: what is predicted is then what happens.
    """
    smoother = config.velocity_smoother
    v, w, dv, dw = limits
    most, least = smoother.max_velocity, smoother.min_velocity
    most = (min(most[0], v), most[1], min(most[2], w))
    smoothed: dict[str, object] = {
        "max_velocity": most,
        "min_velocity": (max(least[0], -v), least[1], max(least[2], -w)),
    }
    accel, decel = smoother.max_accel, smoother.max_decel
    if accel is not None:
        smoothed["max_accel"] = (min(accel[0], dv), accel[1], min(accel[2], dw))
    if decel is not None:
        smoothed["max_decel"] = (max(decel[0], -dv), decel[1], max(decel[2], -dw))
    server, monitor = config.controller_server, config.collision_monitor
    braking = monitor.braking
    # A smoother that lets nothing through drives nowhere, however it is planned.
    controlled = {
        name: min(getattr(server, name), limit)
        for (name, *_), limit in zip(_NAMES, (most[0] or v, most[2] or w, dv, dw), strict=True)
    }
    braked = {
        "linear_decel": min(braking.linear_decel, dv),
        "angular_decel": min(braking.angular_decel, dw),
    }
    return config.model_copy(
        update={
            "controller_server": server.model_copy(update=controlled),
            "velocity_smoother": smoother.model_copy(update=smoothed),
            "collision_monitor": monitor.model_copy(
                update={"braking": braking.model_copy(update=braked)}
            ),
        }
    )
