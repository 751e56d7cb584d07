"""Navigation's parameters within what the robot can do: by physics' parameters, and by the velocity
smoother's, which come after the controller.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

from pydantic import JsonValue

from mazebot.navigation.behavior.motions.motion import BehaviorServerParams
from mazebot.navigation.config import NavigationConfig
from mazebot.navigation.control.safety.velocity_smoother import VelocitySmootherParams

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
    server, monitor, docking = (
        config.controller_server, config.collision_monitor, config.docking_server
    )  # fmt: skip
    braking = monitor.braking
    smoother = _smoother_within(config, limits)
    most = _let_through(smoother, limits)
    controlled = {
        name: min(getattr(server, name), limit)
        for (name, *_), limit in zip(_NAMES, most, strict=True)
    }
    braked = {
        "linear_decel": min(braking.linear_decel, limits.linear_m_s2),
        "angular_decel": min(braking.angular_decel, limits.angular_rad_s2),
    }
    docked = {
        "acceleration": min(docking.acceleration, most.linear_m_s2),
        "angular_acceleration": min(docking.angular_acceleration, most.angular_rad_s2),
    }
    return config.model_copy(
        update={
            "controller_server": server.model_copy(update=controlled),
            "behavior_server": _behaviors_within(config.behavior_server, most),
            "docking_server": docking.model_copy(update=docked),
            "velocity_smoother": smoother,
            "collision_monitor": monitor.model_copy(
                update={"braking": braking.model_copy(update=braked)}
            ),
        }
    )


def _smoother_within(config: NavigationConfig, limits: DriveLimits) -> VelocitySmootherParams:
    smoother, server = config.velocity_smoother, config.controller_server
    v, w, dv, dw = limits
    most, least = smoother.max_velocity, smoother.min_velocity
    smoothed: dict[str, object] = {
        "max_velocity": (min(most[0], v), most[1], min(most[2], w)),
        "min_velocity": (max(least[0], -v), least[1], max(least[2], -w)),
    }
    accel, decel = smoother.max_accel, smoother.max_decel
    if accel is not None or decel is not None:
        accel = accel or (server.max_linear_accel, 0.0, server.max_angular_accel)
        decel = decel or (-accel[0], -accel[1], -accel[2])
        smoothed["max_accel"] = (min(accel[0], dv), accel[1], min(accel[2], dw))
        smoothed["max_decel"] = (max(decel[0], -dv), decel[1], max(decel[2], -dw))
    return smoother.model_copy(update=smoothed)


def _let_through(smoother: VelocitySmootherParams, limits: DriveLimits) -> DriveLimits:
    """What the robot can do at most behind a smoother, both ways: a command that keeps to it passes
    unchanged.
    """
    v, w, dv, dw = limits
    most, accel, decel = smoother.max_velocity, smoother.max_accel, smoother.max_decel
    if accel is not None and decel is not None:
        dv, dw = min(dv, accel[0], -decel[0]), min(dw, accel[2], -decel[2])
    # A smoother that lets nothing through drives nowhere, however it is planned.
    return DriveLimits(most[0] or v, most[2] or w, dv, dw)


def _behaviors_within(params: BehaviorServerParams, most: DriveLimits) -> BehaviorServerParams:
    return params.model_copy(
        update={
            "max_rotational_vel": min(params.max_rotational_vel, most.angular_rad_s),
            "min_rotational_vel": min(params.min_rotational_vel, most.angular_rad_s),
            "rotational_acc_lim": min(params.rotational_acc_lim, most.angular_rad_s2),
            "acceleration_limit": min(params.acceleration_limit, most.linear_m_s2),
            "deceleration_limit": max(params.deceleration_limit, -most.linear_m_s2),
            "minimum_speed": min(params.minimum_speed, most.linear_m_s),
            "teleop_linear_limit": min(params.teleop_linear_limit, most.linear_m_s),
            "teleop_angular_limit": min(params.teleop_angular_limit, most.angular_rad_s),
        }
    )
