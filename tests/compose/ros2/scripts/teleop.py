"""TYPE SPEED: a node of ROS 2 with rclpy drives, 20 velocities a second, until it is killed."""

from __future__ import annotations

import sys

import rclpy
from geometry_msgs.msg import Twist, TwistStamped
from rclpy.node import Node

KINDS = {"Twist": Twist, "TwistStamped": TwistStamped}


def main() -> None:
    """0.1 m/s."""
    rclpy.init()
    node = Node("teleop")
    kind = KINDS[sys.argv[1]]
    publisher = node.create_publisher(kind, "/cmd_vel", 10)
    message = kind()
    twist = message if kind is Twist else message.twist
    twist.linear.x = float(sys.argv[2])
    node.create_timer(0.05, lambda: publisher.publish(message))
    rclpy.spin(node)


if __name__ == "__main__":
    main()
