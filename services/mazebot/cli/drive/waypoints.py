"""`mazebot waypoints`: drives to places one after the other, with tasks at each."""

from __future__ import annotations

import select
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mazebot.cli.parsing.options import ROUTER, Connect, Json
from mazebot.common.config import ConfigError
from mazebot.common.files.folder_writing import write_file

if TYPE_CHECKING:
    from mazebot.common.client.robot import Robot
    from mazebot.common.messages.action_documents import ActionGoal
    from mazebot.common.messages.messages import CompressedImage
    from mazebot.common.messages.topics import Topic


def waypoints(
    places: Annotated[
        list[str],
        typer.Argument(
            metavar="FILE|NAME|X,Y[,YAW]...",
            help="a YAML file of waypoints, or names of the world's locations and poses in the map",
        ),
    ],
    loops: Annotated[
        int | None, typer.Option(min=0, help="further loops after the first [default: the file's]")
    ] = None,
    photo: Annotated[bool, typer.Option("--photo", help="take a picture at each waypoint")] = False,
    photos: Annotated[
        Path | None,
        typer.Option("--photos", help="folder for the pictures [default: they are recorded only]"),
    ] = None,
    timeout_s: Annotated[
        float | None,
        typer.Option("--timeout", min=0.1, help="seconds until they are canceled"),
    ] = None,
    as_json: Json = False,
    connect: Connect = ROUTER,
) -> None:
    """Send the robot of a running stack to waypoints, one after the other. Ctrl-C cancels them.

    A waypoint that cannot be reached is skipped, and reported at the end, with exit code 1. Enter
    is the input for which a waypoint with `input_timeout_s` waits.
    """
    from mazebot.cli.drive.task import run_task  # noqa: PLC0415 - loads Zenoh
    from mazebot.cli.drive.waypoints_file import read_mission  # noqa: PLC0415
    from mazebot.common.client.subscription import running_world  # noqa: PLC0415
    from mazebot.common.messages.topics import PHOTO, PHOTO_REQUEST  # noqa: PLC0415

    mission = read_mission(places)
    count = len(mission.waypoints)
    if photos is not None and photos.exists() and not photos.is_dir():
        raise ConfigError(f"--photos: {photos}: must be a folder")

    def goal(robot: Robot) -> ActionGoal:
        found = mission.goal(running_world(robot, 5.0).locations)
        changes: dict[str, Any] = {}
        if loops is not None:
            changes["number_of_loops"] = loops
        if photo:
            changes["tasks"] = tuple(
                task.model_copy(update={"photo": True}) for task in found.tasks or _usual(count)
            )
        return found.model_copy(update=changes)

    album = _Album(photos)

    def on_message(topic: Topic[Any], message: Any) -> str:
        if topic is PHOTO_REQUEST:
            album.waypoint = message.waypoint
        return album.keep(message) if topic is PHOTO else ""

    many = f"{count} waypoint{'s' * (count != 1)}"
    code = run_task(
        connect, "waypoints", goal, f"driving to {many}", timeout_s, as_json,
        (PHOTO_REQUEST, PHOTO), on_message, _give_input,
    )  # fmt: skip
    raise typer.Exit(code)


def _usual(count: int) -> tuple[Any, ...]:
    from mazebot.common.messages.action_documents import WaypointTask  # noqa: PLC0415

    return (WaypointTask(),) * count


class _Album:
    """Writes pictures into a folder, under Nav2's names: the waypoint's index and the seconds."""

    def __init__(self, folder: Path | None) -> None:
        """`folder`: None keeps none."""
        self._folder = folder
        self.waypoint = 0
        """The waypoint at which the next picture is taken."""

    def keep(self, photo: CompressedImage) -> str:
        """Write a picture; returns a line about it. Raises ConfigError."""
        if self._folder is None:
            return f"photo at waypoint {self.waypoint}"
        stamp = photo.header.stamp
        name = f"{self.waypoint}_{stamp.sec}.{stamp.nanosec // 1_000_000:03d}.png"
        file = self._folder / name
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            write_file(file, photo.data.tobytes())
        except OSError as error:
            raise ConfigError(f"--photos: {file}: failed to write: {error.strerror}") from error
        return f"photo at waypoint {self.waypoint}: {file}"


def _give_input(robot: Robot) -> None:
    """Send the input for a waypoint where Enter was pressed."""
    from mazebot.common.messages.action_documents import Empty  # noqa: PLC0415
    from mazebot.common.messages.topics import INPUT_AT_WAYPOINT  # noqa: PLC0415

    if sys.stdin.isatty() and select.select([sys.stdin], [], [], 0.0)[0] and sys.stdin.readline():
        robot.ask(INPUT_AT_WAYPOINT, Empty(), 5.0)
