"""`mazebot localize`: localisation on a recorded log, as in the running robot."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from mazebot.cli.localize.localize_run import HEADER, run
from mazebot.cli.logs.log import Topics
from mazebot.cli.logs.options import (
    AngleIncrement,
    AngleMin,
    Lidar,
    LogFile,
    OdomScale,
    OdomTopic,
    RangeMax,
    RangeMin,
    ScanTopic,
    check_odom_scale,
    scan_form,
    warn_of_guess,
    warn_of_odometry,
    warn_of_place,
)
from mazebot.cli.logs.read import read_log
from mazebot.cli.logs.scale import check_scale
from mazebot.cli.logs.turned import check_turn
from mazebot.cli.parsing.options import ROUTER, Connect, Json, print_json
from mazebot.cli.parsing.outputs import refuse_inputs
from mazebot.cli.parsing.poses import POSE, given_pose
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import SE2


def localize(
    map_file: Annotated[
        Path | None, typer.Option("--map", help="the map's YAML file, as Nav2's")
    ] = None,
    log_file: LogFile = None,
    everywhere: Annotated[
        bool,
        typer.Option(
            "--global",
            help="global localization, without a start pose; without --map and --log: for "
            "the robot of a running stack",
        ),
    ] = False,
    start: Annotated[
        str | None,
        typer.Option(metavar=POSE, help="in the map, m and rad, at the start of the log"),
    ] = None,
    draw: Annotated[
        Path | None, typer.Option(help="a PNG of map, trajectory and 95 % ellipses")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="of the filter")] = 0,
    lidar: Lidar = None,
    angle_min: AngleMin = None,
    angle_increment: AngleIncrement = None,
    range_min: RangeMin = None,
    range_max: RangeMax = None,
    scan_topic: ScanTopic = "/scan",
    odom_topic: OdomTopic = "/odom",
    odom_scale: OdomScale = 1.0,
    timeout_s: Annotated[
        float | None,
        typer.Option(
            "--timeout", min=0.1, help="timeout in seconds for the pose of a running robot"
        ),
    ] = None,
    as_json: Json = False,
    connect: Connect = ROUTER,
) -> None:
    """Localise on a recorded log, or let the robot of a running stack find itself.

    With --map and --log, print the pose at each scan, and whether it is trusted. The exit code is 1
    if it is trusted at none.

    With --global alone, let the robot of a running stack find itself on the whole map, and wait
    until it has. It moves if it has to. Ctrl-C ends the waiting, not the search.
    """
    if map_file is None and log_file is None:
        if not everywhere:
            raise ConfigError(
                "localize: must be given --map and --log, or --global for a running robot"
            )
        of_a_log = {
            "--start": start is not None,
            "--draw": draw is not None,
            "--seed": seed != 0,
            "--lidar": lidar is not None,
            "--angle-min": angle_min is not None,
            "--angle-increment": angle_increment is not None,
            "--range-min": range_min is not None,
            "--range-max": range_max is not None,
            "--scan-topic and --odom-topic": Topics(scan_topic, odom_topic).are_given,
            "--odom-scale": odom_scale != 1.0,
        }
        for option, is_given in of_a_log.items():
            if is_given:
                raise ConfigError(f"{option}: must be given with --map and --log")
        from mazebot.cli.drive.find_robot import find_robot  # noqa: PLC0415 - loads Zenoh

        raise typer.Exit(find_robot(connect, timeout_s, as_json))
    if map_file is None or log_file is None:
        missing, given = ("--map", "--log") if map_file is None else ("--log", "--map")
        raise ConfigError(f"{missing}: must be given with {given}")
    if timeout_s is not None:
        raise ConfigError("--timeout: must be given without --map and --log")
    from mazebot.common.world.map_files import read_map  # noqa: PLC0415 - loads images

    if everywhere and start is not None:
        raise ConfigError("--global: must not be given with --start")
    check_odom_scale(odom_scale)
    form = scan_form(angle_min, angle_increment, range_min, range_max)
    chart = read_map(map_file)
    if chart.warning:
        sys.stderr.write(f"warning: {chart.warning}\n")
    begin = None if start is None else SE2(*given_pose("--start", start))
    base_from_scan = None if lidar is None else SE2(*given_pose("--lidar", lidar))
    if draw is not None and not draw.parent.is_dir():
        raise ConfigError(f"--draw: {draw}: {draw.parent} is not a folder")
    log = read_log(log_file, form, Topics(scan_topic, odom_topic), odom_scale)
    if draw is not None:
        refuse_inputs("--draw", (draw,))
    for remark in log.remarks():
        sys.stderr.write(f"{log_file}: {remark}\n")
    warn_of_guess(log_file, log)
    warn_of_odometry(log_file, log)
    if base_from_scan is None:
        warn_of_place(log_file, log)
    check_scale(log_file, log, base_from_scan, odom_scale)
    check_turn(log_file, log, base_from_scan)
    done = run(chart, log, begin, base_from_scan, seed)
    fixes, left_out = done.found, done.without_odometry
    _check_used(log_file, len(fixes), left_out)
    if draw is not None:
        from mazebot.cli.localize.localize_drawing import draw_fixes  # noqa: PLC0415 - loads OpenCV

        draw_fixes(draw, chart, fixes)
    if as_json:
        print_json([fix.document() for fix in fixes])
    else:
        sys.stdout.write("\n".join([HEADER, *(fix.row() for fix in fixes)]) + "\n")
    known = sum(fix.state == "localized" for fix in fixes)
    sys.stdout.flush()
    if known == 0:
        sys.stderr.write(
            f"--log: {log_file}: localized at none of {len(fixes)} scans: must be recorded where "
            f"{map_file} was made\n"
        )
        raise typer.Exit(1)
    rest = f"; {left_out} left out, without odometry at their time" if left_out else ""
    sys.stderr.write(f"localized at {known} of {len(fixes)} scans{rest}\n")


def _check_used(log_file: Path, used: int, without_odometry: int) -> None:
    """Raises ConfigError where most scans could not be used."""
    if not used:
        raise ConfigError(f"--log: {log_file}: has no scan with odometry at its time")
    if used < without_odometry:
        raise ConfigError(
            f"--log: {log_file}: {used} of {used + without_odometry} scans have odometry at their "
            "time: must be at least half of them"
        )
