"""Whatever is commanded, drive and robot stay within their limits."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from mazebot.common.messages.topics import CMD_VEL, SIMULATION_STATS
from mazebot.physics.config import PhysicsConfig
from mazebot.physics.drive import Drive
from mazebot.physics.simulation import drive_limits
from tests.physics.driver import HOUSE_WALLS, Driver, world

LIMITS = drive_limits(PhysicsConfig())
STEP_S = 1.0 / 240.0
STEP_NS = 4_166_667
ODD = (
    *(math.nan, math.inf, -math.inf, 0.0, -0.0),
    *(5e-324, -2.2e-308, 1e-300, 1e308, -1.7976931348623157e308, 1e16, -1e9),
    *(0.46, -0.46, 0.46000000000000002, 1.9, -1.9, 0.1, -0.1),
)


def commands(count: int, seed: int) -> Iterator[tuple[float, float]]:
    """Odd values, any bits, sensible ones, and full ones whose signs change each time."""
    random = np.random.default_rng(seed)
    for start in range(0, count, 1000):
        any_bits = np.frombuffer(random.bytes(16_000), np.float64).reshape(-1, 2).tolist()
        sensible = random.normal(0.0, 1.0, (1000, 2)).tolist()
        odd = random.choice(ODD, (1000, 2)).tolist()
        kinds = random.integers(0, 4, 1000).tolist()
        for index in range(min(1000, count - start)):
            sign = 1.0 if index % 2 else -1.0
            alternating = (sign * 1e3, -sign * 1e3)
            chosen = (any_bits[index], sensible[index], odd[index], alternating)[kinds[index]]
            yield chosen[0], chosen[1]


def check_drive(count: int, seed: int) -> None:
    """A command before every step; now and then so long a silence that the watchdog brakes."""
    drive = Drive(LIMITS)
    highest = LIMITS.linear_speed_m_s + LIMITS.angular_speed_rad_s * LIMITS.wheel_separation_m / 2.0
    jerk = (
        LIMITS.watchdog_linear_deceleration_m_s2
        + LIMITS.watchdog_angular_deceleration_rad_s2 * LIMITS.wheel_separation_m / 2.0
    )
    left = right = 0.0
    now_ns = 0
    for number, command in enumerate(commands(count, seed)):
        drive.command(*command, now_ns)
        now_ns += STEP_NS if number % 997 else 60 * STEP_NS
        speeds = drive.step(now_ns, STEP_S)
        if speeds is None:
            continue
        for before, after in zip((left, right), speeds, strict=True):
            surface_m_s = after * LIMITS.wheel_radius_m
            # Of what is no number no comparison is true.
            assert abs(surface_m_s) <= highest * (1.0 + 1e-12), (number, command)
            assert abs(after - before) * LIMITS.wheel_radius_m <= jerk * STEP_S * (1.0 + 1e-9)
        left, right = speeds


def check_robot(count: int, seed: int) -> None:
    """The same through the node's inbox, between walls."""
    robot = Driver().load(world(HOUSE_WALLS))
    simulation = robot.node._simulation
    assert simulation is not None
    refused = 0
    for command in commands(count, seed):
        robot.command(*command)
        refused += not all(map(math.isfinite, command))
        robot.turn()
        if len(robot.sent) > 1000:
            robot.sent.clear()
        assert simulation.bodies.state.is_sane()
        speed, spin = robot.speeds
        # A wall may bounce it a little.
        assert abs(speed) < 0.6
        assert abs(spin) < 4.0
    robot.wait(0.5)
    assert robot.inbox.counts[CMD_VEL.name].rejected["not finite"] == refused
    # It was built once: no state was so wrong that the world had to be made anew.
    assert robot.node._simulation is simulation
    assert robot.last(SIMULATION_STATS).epoch == 1
    assert math.isfinite(robot.pose.x_m)
    robot.node.close()


def test_any_command_leaves_the_wheels_within_their_limits() -> None:
    check_drive(50_000, seed=1)


def test_any_command_leaves_the_robot_in_a_state_it_can_be_in() -> None:
    check_robot(2_000, seed=2)


@pytest.mark.slow
def test_a_million_commands_leave_the_state_finite() -> None:
    check_drive(900_000, seed=3)
    check_robot(100_000, seed=4)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("other", [0.0, 0.3])
def test_a_command_that_is_not_finite_changes_nothing(value: float, other: float) -> None:
    drive, untouched = Drive(LIMITS), Drive(LIMITS)
    for one in (drive, untouched):
        one.command(0.3, 0.5, 0)
    drive.command(value, other, STEP_NS)
    drive.command(other, value, STEP_NS)
    for step in range(1, 100):
        assert drive.step(step * STEP_NS, STEP_S) == untouched.step(step * STEP_NS, STEP_S)
    assert drive.watchdog_stops == untouched.watchdog_stops == 1
