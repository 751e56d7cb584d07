"""The robot tells when it begins to touch something, and once."""

from __future__ import annotations

import math

import pytest

from services.common.topics import CONTACTS
from tests.physics.driver import HOUSE_WALLS, Driver, world

AHEAD = [("Ahead", 2.0, 0.6, 0.0, math.pi / 2)]


def test_driving_into_a_wall_is_told_once() -> None:
    robot = Driver().load(world(AHEAD))
    robot.drive(0.3, 0.0, 4.0)
    (contact,) = robot.all(CONTACTS)
    assert (contact.robot_link, contact.body) == ("base_link", "Ahead")
    assert contact.position_m[0] == pytest.approx(0.6 - 0.075, abs=0.01)
    assert contact.impulse_n_s > 0.0
    # The hull's front is 68.5 mm ahead of the wheels; it had to get there first.
    assert contact.time_s > (0.525 - 0.0685) / 0.3
    assert robot.pose.x_m == pytest.approx(0.525 - 0.0685, abs=0.01)


def test_a_new_touch_is_told_anew() -> None:
    robot = Driver().load(world(AHEAD))
    for _ in range(2):
        robot.drive(0.3, 0.0, 3.0)
        robot.drive(-0.3, 0.0, 1.5)
    assert len(robot.all(CONTACTS)) == 2


def test_the_floor_is_not_told_of() -> None:
    robot = Driver().load(world(HOUSE_WALLS))
    robot.drive(0.2, 1.0, 3.0)
    assert robot.all(CONTACTS) == []


def test_a_wheel_that_rubs_along_a_wall_is_told_by_its_name() -> None:
    robot = Driver().load(world([("Left", 3.0, 0.0, 0.24, 0.0)], start=(-0.5, 0.0, 0.2)))
    robot.drive(0.2, 0.0, 3.0)
    contacts = robot.all(CONTACTS)
    assert {contact.body for contact in contacts} == {"Left"}
    assert "wheel_left_link" in {contact.robot_link for contact in contacts}
    assert all(contact.robot_link != "wheel_right_link" for contact in contacts)
