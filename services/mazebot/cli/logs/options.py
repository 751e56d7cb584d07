"""Options of the commands that read a log."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Annotated

import typer

from mazebot.cli.logs.doubts import doubts_of_odometry
from mazebot.cli.logs.log import Log, ScanForm
from mazebot.cli.parsing.poses import POSE
from mazebot.common.config import ConfigError
from mazebot.common.robot.waffle import BASE_FROM_SCAN

LogFile = Annotated[
    Path | None,
    typer.Option(
        "--log",
        help="CSV with the header time_s,odom_x_m,odom_y_m,odom_yaw_rad,range_0,range_1,...; "
        "CARMEN's FLASER or ROBOTLASER1; *.mcap, *.db3, a folder of rosbag2 or a *.bag of ROS 1, "
        "with /odom and /scan",
    ),
]
ScanTopic = Annotated[str, typer.Option(help="LaserScan of a bag")]
OdomTopic = Annotated[str, typer.Option(help="Odometry of a bag; without it: /tf")]
Lidar = Annotated[
    str | None,
    typer.Option(
        metavar=POSE,
        help="pose of the lidar on the robot, m and rad [default: the log's, "
        f"else {BASE_FROM_SCAN.x_m} 0 0]",
    ),
]
AngleMin = Annotated[
    float | None,
    typer.Option(
        help="rad; direction of the first range, 0 is ahead [default: 0; CARMEN and a bag: the "
        "log's]"
    ),
]
AngleIncrement = Annotated[
    float | None,
    typer.Option(
        help="rad between ranges [default: a full turn in all; CARMEN and a bag: the log's]"
    ),
]
RangeMin = Annotated[
    float | None,
    typer.Option(help="m; least range [default: 0.12; CARMEN: 0.05; a bag: the log's]"),
]
RangeMax = Annotated[
    float | None,
    typer.Option(help="m; longest range [default: 3.5; CARMEN and a bag: the log's]"),
]

OdomScale = Annotated[
    float,
    typer.Option(
        help="x and y of odometry are multiplied by it, to be metres: 0.01 where they are "
        "centimetres"
    ),
]


def check_odom_scale(odom_scale: float) -> None:
    """Raises ConfigError where the option is out of its range."""
    if not 0.0 < odom_scale < math.inf:
        raise ConfigError(f"--odom-scale: {odom_scale:g}: must be a finite number > 0")


def scan_form(
    angle_min: float | None,
    angle_increment: float | None,
    range_min: float | None,
    range_max: float | None,
) -> ScanForm:
    """The options in one.

    Raises ConfigError where one is out of its range.
    """
    if angle_min is not None and not math.isfinite(angle_min):
        raise ConfigError(f"--angle-min: {angle_min}: must be a finite number of radians")
    if angle_increment is not None and not 0.0 < abs(angle_increment) <= math.pi:
        raise ConfigError(f"--angle-increment: {angle_increment}: must be radians, not 0")
    if range_min is not None and not 0.0 <= range_min < 1e4:
        raise ConfigError(f"--range-min: {range_min}: must be metres, 0 or more")
    least = range_min or 0.0
    if range_max is not None and not least < range_max < 1e4:
        raise ConfigError(
            f"--range-max: {range_max}: must be > --range-min, {least}, which is >= 0"
        )
    return ScanForm(angle_min, angle_increment, range_min, range_max)


def warn_of_guess(log_file: Path, log: Log) -> None:
    """Say on standard error what the log does not say, and is a guess."""
    if log.assumed:
        sys.stderr.write(f"warning: --log: {log_file}: {log.assumed}\n")


def warn_of_place(log_file: Path, log: Log) -> None:
    """Say on standard error where the log should have the lidar's pose, and has not."""
    if warning := log.warning_of_place():
        sys.stderr.write(f"warning: --log: {log_file}: {warning}\n")


def warn_of_odometry(log_file: Path, log: Log) -> None:
    """Say on standard error what of odometry and its stamps is doubtful."""
    for warning in doubts_of_odometry(log):
        sys.stderr.write(f"warning: --log: {log_file}: {warning}\n")
