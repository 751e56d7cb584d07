"""`mazebot localize`: localisation on a recorded log, as in the running robot."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Annotated

import typer

from services.cli.localize_log import ScanForm, read_log
from services.cli.localize_run import HEADER, WAFFLE_LIDAR_M, run
from services.cli.options import ROUTER, Connect, Json, print_json
from services.common.config import ConfigError
from services.common.frames import SE2


def localize(
    map_file: Annotated[
        Path | None, typer.Option("--map", help="the map's YAML file, as Nav2's")
    ] = None,
    log_file: Annotated[
        Path | None,
        typer.Option(
            "--log",
            help="CSV with the header time_s,odom_x_m,odom_y_m,odom_yaw_rad,range_0,range_1,...; "
            "*.mcap or a folder of rosbag2 with /odom and /scan",
        ),
    ] = None,
    everywhere: Annotated[
        bool,
        typer.Option(
            "--global",
            help="start from nothing; without --map and --log: the robot of a running stack",
        ),
    ] = False,
    start: Annotated[
        tuple[float, float, float] | None,
        typer.Option(help="x, y (m) and yaw (rad) in the map at the log's begin"),
    ] = None,
    draw: Annotated[
        Path | None, typer.Option(help="a PNG of map, trajectory and 95 % ellipses")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="of the filter")] = 0,
    lidar: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            help="x, y (m) and yaw (rad) of the lidar on the robot "
            f"[default: the log's /tf_static, else {WAFFLE_LIDAR_M} 0 0]"
        ),
    ] = None,
    angle_min: Annotated[
        float, typer.Option(help="rad; direction of range_0 of a CSV file, 0 is ahead")
    ] = 0.0,
    angle_increment: Annotated[
        float | None, typer.Option(help="rad between its ranges [default: a full turn in all]")
    ] = None,
    range_min: Annotated[float, typer.Option(help="m; its least range")] = 0.12,
    range_max: Annotated[float, typer.Option(help="m; its longest range")] = 3.5,
    timeout_s: Annotated[
        float | None,
        typer.Option("--timeout", min=0.1, help="seconds to wait for a running robot's pose"),
    ] = None,
    as_json: Json = False,
    connect: Connect = ROUTER,
) -> None:
    """Localise on a recorded log, or let the robot of a running stack find itself.

    With --map and --log, print the pose at each scan, and whether it is trusted.

    With --global alone, let the robot of a running stack find itself on the whole map, and wait
    until it has. It moves if it has to. Ctrl-C ends the waiting, not the search.
    """
    if map_file is None and log_file is None:
        if not everywhere:
            raise ConfigError(
                "localize: must be given --map and --log, or --global for a running robot"
            )
        for option, value in (("--start", start), ("--draw", draw), ("--lidar", lidar)):
            if value is not None:
                raise ConfigError(f"{option}: must be given with --map and --log")
        from services.cli.drive.find_robot import find_robot  # noqa: PLC0415 - loads Zenoh

        raise typer.Exit(find_robot(connect, timeout_s, as_json))
    if map_file is None or log_file is None:
        missing, given = ("--map", "--log") if map_file is None else ("--log", "--map")
        raise ConfigError(f"{missing}: must be given beside {given}")
    if timeout_s is not None:
        raise ConfigError("--timeout: must be given without --map and --log")
    from services.common.world.map_files import read_map  # noqa: PLC0415 - loads images

    if everywhere and start is not None:
        raise ConfigError("--global: start from nothing, or at --start: not both")
    form = _form(angle_min, angle_increment, range_min, range_max)
    chart = read_map(map_file)
    begin = None if start is None else _finite("--start", start)
    base_from_scan = None if lidar is None else _finite("--lidar", lidar)
    if draw is not None and not draw.parent.is_dir():
        raise ConfigError(f"--draw: {draw}: {draw.parent} is no folder")
    log = read_log(log_file, form)
    fixes = list(run(chart, log, begin, base_from_scan, seed))
    if not fixes:
        raise ConfigError(f"--log: {log_file}: has no scan with odometry at its time")
    if draw is not None:
        from services.cli.localize_drawing import draw_fixes  # noqa: PLC0415 - loads OpenCV

        draw_fixes(draw, chart, fixes)
    if as_json:
        print_json([fix.document() for fix in fixes])
    else:
        sys.stdout.write("\n".join([HEADER, *(fix.row() for fix in fixes)]) + "\n")


def _form(
    angle_min: float, angle_increment: float | None, range_min: float, range_max: float
) -> ScanForm:
    if not math.isfinite(angle_min):
        raise ConfigError(f"--angle-min: {angle_min}: must be a finite number of radians")
    if angle_increment is not None and not 0.0 < abs(angle_increment) <= math.pi:
        raise ConfigError(f"--angle-increment: {angle_increment}: must be radians, not 0")
    if not 0.0 <= range_min < range_max < 1e4:
        raise ConfigError(
            f"--range-max: {range_max}: must be > --range-min, {range_min}, which is >= 0"
        )
    return ScanForm(angle_min, angle_increment, range_min, range_max)


def _finite(option: str, values: tuple[float, float, float]) -> SE2:
    if not all(math.isfinite(value) for value in values):
        raise ConfigError(f"{option}: {' '.join(map(str, values))}: must be finite numbers")
    return SE2(*values)
