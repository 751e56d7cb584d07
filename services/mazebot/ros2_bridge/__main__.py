"""Runs the service: `python -m mazebot.ros2_bridge`."""

import sys

from mazebot.ros2_bridge.start import main

main(sys.argv[1:])
