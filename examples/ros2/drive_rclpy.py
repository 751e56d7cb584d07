"""Drives the robot of `docker compose up simulator-enhanced ros2-bridge` to a place, with rclpy:

    python3 drive_rclpy.py 0.4 -0.8

X and Y in metres in the frame `odom`, which begins where the robot stood.
"""

import math
import sys

import rclpy
from geometry_msgs.msg import TwistStamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data


class Driver(Node):  # type: ignore[misc]
    """Turns to the place, then drives."""

    def __init__(self, x_m: float, y_m: float) -> None:
        super().__init__("driver")
        self.goal, self.is_there = (x_m, y_m), False
        self.velocities = self.create_publisher(TwistStamped, "/cmd_vel", 10)
        self.create_subscription(Odometry, "/odom", self.on_odom, qos_profile_sensor_data)

    def on_odom(self, odom: Odometry) -> None:
        """Command the velocity that leads there."""
        place, turn = odom.pose.pose.position, odom.pose.pose.orientation
        ahead_m, aside_m = self.goal[0] - place.x, self.goal[1] - place.y
        bearing = math.atan2(aside_m, ahead_m) - 2.0 * math.atan2(turn.z, turn.w)
        bearing = math.remainder(bearing, math.tau)
        distance_m = math.hypot(ahead_m, aside_m)
        self.is_there = distance_m < 0.05
        command = TwistStamped()
        if not self.is_there:
            command.twist.angular.z = max(-1.0, min(1.0, 2.0 * bearing))
            command.twist.linear.x = min(0.3, distance_m) if abs(bearing) < 0.3 else 0.0
        self.velocities.publish(command)


rclpy.init()
driver = Driver(float(sys.argv[1]), float(sys.argv[2]))
while not driver.is_there:
    rclpy.spin_once(driver)
print("there")
