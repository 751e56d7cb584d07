"""Drives the robot of `docker compose up simulator-enhanced` to a place, with pyzeros: no ROS 2.

    pip install pyzeros==0.1.0 ros2-pyterfaces==0.3.0 eclipse-zenoh==1.6.2
    MAZEBOT_BUS_KEY_FILE=keys/operator.key python drive_pyzeros.py 0.4 -0.8 [tcp/127.0.0.1:7447]

X and Y in metres in the frame `odom`, which begins where the robot stood; the router's endpoint.
Without the variable it signs in with no key, as where the router asks for none.
"""

import asyncio
import json
import math
import os
import sys
from pathlib import Path

import pyzeros
import zenoh
from ros2_pyterfaces.cyclone.all_msgs import Odometry, TwistStamped


async def drive(x_m: float, y_m: float) -> None:
    """Command the velocity that leads there."""
    velocities = pyzeros.Pub(TwistStamped, "cmd_vel")
    async for odom in pyzeros.Sub(Odometry, "odom").listen():
        place, turn = odom.pose.pose.position, odom.pose.pose.orientation
        ahead_m, aside_m = x_m - place.x, y_m - place.y
        bearing = math.atan2(aside_m, ahead_m) - 2.0 * math.atan2(turn.z, turn.w)
        bearing = math.remainder(bearing, math.tau)
        distance_m = math.hypot(ahead_m, aside_m)
        command = TwistStamped()
        if distance_m > 0.05:
            command.twist.angular.z = max(-1.0, min(1.0, 2.0 * bearing))
            command.twist.linear.x = min(0.3, distance_m) if abs(bearing) < 0.3 else 0.0
        velocities.publish(command)
        if distance_m <= 0.05:
            return


router = sys.argv[3] if len(sys.argv) > 3 else "tcp/127.0.0.1:7447"
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", f'["{router}"]')
if "MAZEBOT_BUS_KEY_FILE" in os.environ:
    key = json.loads(Path(os.environ["MAZEBOT_BUS_KEY_FILE"]).read_text())
    login = {"user": key["name"], "password": key["password"]}
    config.insert_json5("transport/auth/usrpwd", json.dumps(login))
with zenoh.open(config) as session, pyzeros.auto_context("driver", session):
    asyncio.run(drive(float(sys.argv[1]), float(sys.argv[2])))
print("there")
