"""`mazebot spin`, `backup`, `dock` and `undock`: one behaviour of a running stack."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Any

import typer
from pydantic import ValidationError

from mazebot.cli.parsing.options import ROUTER, Connect, Json
from mazebot.common.config import ConfigError, one_line

if TYPE_CHECKING:
    from mazebot.common.client.robot import Robot
    from mazebot.common.messages.action_documents import ActionGoal

Timeout = Annotated[
    float | None,
    typer.Option("--timeout", min=0.1, help="seconds until it is canceled"),
]
TimeAllowance = Annotated[
    float,
    typer.Option("--time-allowance", min=0.0, help="longest duration, simulation s; 0: no limit"),
]


def spin(
    angle: Annotated[
        float, typer.Argument(metavar="ANGLE", help="rad; positive: counter-clockwise")
    ] = 1.57,
    time_allowance_s: TimeAllowance = 10.0,
    timeout_s: Timeout = None,
    as_json: Json = False,
    connect: Connect = ROUTER,
) -> None:
    """Turn the robot of a running stack on the spot. Ctrl-C cancels it."""
    from mazebot.common.messages import action_documents as act  # noqa: PLC0415

    if not math.isfinite(angle):
        raise ConfigError(f"spin: ANGLE: {angle}: must be a finite number of radians")
    goal = _checked("spin", act.Spin, target_yaw_rad=angle, time_allowance_s=time_allowance_s)
    _run(connect, "spin", goal, f"turning by {angle:g} rad", timeout_s, as_json)


def backup(
    distance: Annotated[float, typer.Argument(metavar="DISTANCE", help="m")] = 0.15,
    speed: Annotated[float, typer.Option(help="m/s")] = 0.1,
    time_allowance_s: TimeAllowance = 10.0,
    timeout_s: Timeout = None,
    as_json: Json = False,
    connect: Connect = ROUTER,
) -> None:
    """Back up the robot of a running stack. Ctrl-C cancels it."""
    from mazebot.common.messages import action_documents as act  # noqa: PLC0415

    for name, value in (("DISTANCE", distance), ("--speed", speed)):
        if not (math.isfinite(value) and value > 0.0):
            raise ConfigError(f"backup: {name}: {value:g}: must be > 0 and finite")
    goal = _checked(
        "backup", act.BackUp,
        distance_m=distance, speed_m_s=speed, time_allowance_s=time_allowance_s,
    )  # fmt: skip
    _run(connect, "backup", goal, f"backing up by {distance:g} m", timeout_s, as_json)


def dock(
    name: Annotated[
        str,
        typer.Argument(
            metavar="[ID|NAME]", help="a marker's id or name [default: the nearest marker]"
        ),
    ] = "",
    navigate: Annotated[
        bool,
        typer.Option(
            "--navigate/--no-navigate", help="drive to the staging pose first [default: navigate]"
        ),
    ] = True,
    timeout_s: Timeout = None,
    as_json: Json = False,
    connect: Connect = ROUTER,
) -> None:
    """Dock the robot of a running stack at a marker. Ctrl-C cancels it."""
    from mazebot.common.messages import action_documents as act  # noqa: PLC0415

    def goal(robot: Robot) -> ActionGoal:
        return act.DockRobot(
            dock_id=name or _nearest_marker(robot), navigate_to_staging_pose=navigate
        )

    begin = f"docking at {name}" if name else "docking at the nearest marker"
    _run(connect, "dock", goal, begin, timeout_s, as_json)


def undock(timeout_s: Timeout = None, as_json: Json = False, connect: Connect = ROUTER) -> None:
    """Undock the robot of a running stack. Ctrl-C cancels it."""
    from mazebot.common.messages import action_documents as act  # noqa: PLC0415

    _run(connect, "undock", act.UndockRobot(), "undocking", timeout_s, as_json)


def _checked(who: str, kind: Any, **fields: Any) -> ActionGoal:
    """Raises ConfigError where a value is invalid."""
    try:
        goal: ActionGoal = kind(**fields)
    except ValidationError as error:
        raise ConfigError(f"{who}: {one_line(error)}") from error
    return goal


def _run(
    endpoint: str, who: str, goal: Any, begin: str, timeout_s: float | None, as_json: bool
) -> None:
    from mazebot.cli.drive.task import run_task  # noqa: PLC0415 - loads Zenoh

    raise typer.Exit(run_task(endpoint, who, goal, begin, timeout_s, as_json))


def _nearest_marker(robot: Robot) -> str:
    """The name of the marker nearest to the robot, in its map. Raises ConfigError where it knows
    none.
    """
    from mazebot.common.client.subscription import (  # noqa: PLC0415
        first_message,
        running_world,
    )
    from mazebot.common.maths.frames import pose_matrix  # noqa: PLC0415
    from mazebot.common.messages import messages as msg  # noqa: PLC0415
    from mazebot.common.messages.documents import GetEntities  # noqa: PLC0415
    from mazebot.common.messages.topics import AMCL_POSE, GET_ENTITIES  # noqa: PLC0415
    from mazebot.common.robot.known_markers import known_markers  # noqa: PLC0415

    hanging = robot.ask(GET_ENTITIES, GetEntities(), 5.0).markers
    if not hanging:
        raise ConfigError("dock: the world has no markers")
    markers, unknown = known_markers(running_world(robot, 5.0), hanging)
    if not markers:
        raise ConfigError(f"dock: the robot knows no marker: {next(iter(unknown.values()))}")
    at = msg.se2_from_pose(first_message(robot, AMCL_POSE, 5.0).pose.pose)
    far_m = {
        marker.name: math.dist(pose_matrix(marker)[:2, 3].tolist(), (at.x_m, at.y_m))
        for marker in markers
    }
    return min(far_m, key=lambda name: far_m[name])
