"""The `mazebot` command."""

from __future__ import annotations

import functools
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, NoReturn

import typer
from pydantic import ValidationError

from mazebot.cli import console, demo, entities, plan, sim, world
from mazebot.cli.access import keys, security
from mazebot.cli.drive import behaviors, teleop, waypoints
from mazebot.cli.localize import localize
from mazebot.cli.map import group as map_group
from mazebot.cli.markers import markers
from mazebot.cli.parsing import known
from mazebot.cli.parsing.command import App, UsageMistake, in_one_line, overview
from mazebot.cli.parsing.completion import topic_names, written_topic_names
from mazebot.cli.parsing.options import ROUTER as _ROUTER
from mazebot.cli.parsing.options import Connect, Json
from mazebot.cli.parsing.poses import POSE, given_pose
from mazebot.cli.recordings import group as recordings_group
from mazebot.cli.recordings.group import RecordingsDir, RunName
from mazebot.cli.replay import command as replay
from mazebot.cli.stack import commands as stack_commands
from mazebot.common.config import ConfigError, one_line
from mazebot.common.files.reading import forget_opened
from mazebot.common.files.version import mazebot_version
from mazebot.common.problems import words
from mazebot.common.stop_signals import INTERRUPTED

app = App(
    name="mazebot",
    help="A TurtleBot house maze simulator without ROS or Gazebo.",
    pretty_exceptions_enable=False,
)
topics_app = App(help="Inspect the topics of a running stack, and publish to them.")
app.add_typer(topics_app, name="topic")
app.add_typer(recordings_group.app, name="recordings")
app.add_typer(world.app, name="world")
app.add_typer(map_group.app, name="map")
app.add_typer(markers.app, name="markers")
app.add_typer(sim.app, name="sim")
app.add_typer(keys.app, name="keys")
app.add_typer(security.app, name="security")

TopicName = Annotated[
    str, typer.Argument(metavar="TOPIC", help="e.g. /scan", autocompletion=topic_names)
]


def _print_version(wanted: bool) -> None:
    if wanted:
        sys.stdout.write(f"mazebot {mazebot_version()}\n")
        raise typer.Exit


@app.callback()
def _begin(
    context: typer.Context,
    _: Annotated[
        bool,
        typer.Option("--version", is_eager=True, callback=_print_version, help="print the version"),
    ] = False,
) -> None:
    overview(context)
    forget_opened()
    if context.invoked_subcommand is not None and "--help" not in sys.argv:
        known.check_environment()


app.command()(demo.demo)


@app.command()
def params(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="a nav2_params.yaml of Nav2")],
    as_json: Json = False,
    as_settings: Annotated[
        bool, typer.Option("--settings", help="print the resulting settings, for --config")
    ] = False,
) -> None:
    """Report each parameter of a Nav2 file as used, mapped, unsupported or unknown."""
    from mazebot.cli.params import print_params  # noqa: PLC0415

    if as_json and as_settings:
        raise ConfigError("--settings: prints YAML: must be given without --json")
    print_params(file, as_json, as_settings)


@app.command()
def doctor(
    ros: Annotated[bool, typer.Option("--ros", help="how ROS 2 joins the stack")] = False,
    as_json: Json = False,
    connect: Connect = _ROUTER,
) -> None:
    """Print how ROS 2 joins a running stack, and what is in the way; exit code 1 if anything is."""
    from mazebot.cli.doctor import doctor as examine  # noqa: PLC0415
    from mazebot.common.bus.config import BusConfig  # noqa: PLC0415
    from mazebot.common.settings.load import load  # noqa: PLC0415

    if not ros:
        raise ConfigError("--ros: must be given: there is no other examination")
    config = load(BusConfig, "bus", []).model_copy(update={"connect": connect})
    raise typer.Exit(examine(config, os.environ, as_json))


@app.command()
def diff(
    first: RunName,
    second: RunName,
    directory: RecordingsDir = None,
    as_json: Json = False,
) -> None:
    """Print the first message in which two runs differ; exit code 0 if there is none, else 1."""
    from mazebot.cli.diff import diff_runs  # noqa: PLC0415

    code = diff_runs(directory or Path("recordings"), first, second, as_json)
    raise typer.Exit(code)


@app.command()
def goal(
    pose: Annotated[
        list[str] | None,
        typer.Argument(metavar=POSE, help="in the map, m and rad; also X,Y[,YAW]"),
    ] = None,
    timeout_s: Annotated[
        float | None,
        typer.Option("--timeout", min=0.1, help="timeout in seconds; then the goal is canceled"),
    ] = None,
    as_json: Json = False,
    connect: Connect = _ROUTER,
) -> None:
    """Send the robot of a running stack to a pose in the map, and wait for the result.

    Ctrl-C or the end of --timeout cancels the goal: the robot stops.
    """
    from mazebot.cli.drive.goal import send_goal  # noqa: PLC0415

    raise typer.Exit(send_goal(connect, given_pose("goal", pose or ()), timeout_s, as_json))


@app.command()
def cancel(as_json: Json = False, connect: Connect = _ROUTER) -> None:
    """Cancel the current goal of a running stack: the robot stops."""
    from mazebot.cli.drive.goal import cancel_goal  # noqa: PLC0415

    cancel_goal(connect, as_json)


@app.command()
def stop(
    reason: Annotated[str, typer.Argument(metavar="[REASON]", help="told to those who look")] = "",
    clear: Annotated[bool, typer.Option("--clear", help="let the robot move again")] = False,
    as_json: Json = False,
    connect: Connect = _ROUTER,
) -> None:
    """Emergency stop: stop the robot of a running stack, and hold it at rest until --clear.

    A task waits meanwhile, and goes on then.
    """
    from mazebot.cli.drive.emergency_stop import emergency_stop  # noqa: PLC0415
    from mazebot.common.messages.documents import EmergencyStop  # noqa: PLC0415

    if clear and reason:
        raise ConfigError(f"stop: REASON: {reason!r:.40}: must be given without --clear")
    try:
        asked = EmergencyStop(stop=not clear, reason=reason)
    except ValidationError as error:
        raise ConfigError(f"stop: {one_line(error)}") from error
    emergency_stop(connect, asked, as_json)


@topics_app.command("list")
def topic_list(
    connect: Connect = _ROUTER,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="with types")] = False,
    as_json: Json = False,
) -> None:
    """List the topics whose publishers are running."""
    from mazebot.cli.topics.topic import list_topics  # noqa: PLC0415

    list_topics(connect, verbose, as_json)


@topics_app.command("info")
def topic_info(name: TopicName, as_json: Json = False, connect: Connect = _ROUTER) -> None:
    """Print a topic's type, publishers and subscribers, and which of them are running."""
    from mazebot.cli.topics.topic import print_topic  # noqa: PLC0415

    print_topic(connect, name, as_json)


@topics_app.command("hz")
def topic_hz(
    name: TopicName,
    connect: Connect = _ROUTER,
    window_s: Annotated[float, typer.Option("--window", min=0.5, help="seconds to measure")] = 5.0,
    as_json: Json = False,
) -> None:
    """Measure the rate of a topic."""
    from mazebot.cli.topics.topic import measure_rate  # noqa: PLC0415

    measure_rate(connect, name, window_s, as_json)


@topics_app.command("echo")
def topic_echo(
    name: TopicName,
    connect: Connect = _ROUTER,
    once: Annotated[bool, typer.Option("--once", help="stop after one message")] = False,
    timeout_s: Annotated[float, typer.Option("--timeout", min=0.1, help="seconds to wait")] = 10.0,
    as_json: Annotated[
        bool, typer.Option("--json", help="print a JSON object a line, arrays in full")
    ] = False,
) -> None:
    """Print a topic's messages as YAML."""
    from mazebot.cli.topics.topic import echo  # noqa: PLC0415

    echo(connect, name, once, timeout_s, as_json)


@topics_app.command("pub")
def topic_pub(
    name: Annotated[
        str,
        typer.Argument(
            metavar="TOPIC", help="such as /cmd_vel, /goal_pose, /initialpose or /explore/resume",
            autocompletion=written_topic_names,
        ),
    ],
    message: Annotated[
        str, typer.Argument(metavar="MESSAGE", help="JSON or YAML; missing fields are zero")
    ] = "{}",
    rate_hz: Annotated[
        float, typer.Option("--rate", "-r", min=0.01, max=1000.0, help="messages a second")
    ] = 1.0,
    once: Annotated[bool, typer.Option("--once", "-1", help="send one message")] = False,
    times: Annotated[
        int | None, typer.Option("--times", "-t", min=1, help="send this number of messages")
    ] = None,
    connect: Connect = _ROUTER,
) -> None:  # fmt: skip
    """Publish messages to a topic until Ctrl-C, like `ros2 topic pub`.

    A missing stamp is set to the simulation time, a missing frame to the topic's frame.
    """
    from mazebot.cli.topics.publishing import publish_messages  # noqa: PLC0415

    publish_messages(connect, name, message, rate_hz, 1 if once else times)


stack_commands.register(app)
entities.register(app)
app.command()(console.console)
app.command()(replay.replay)
app.command()(plan.plan)
app.command()(localize.localize)
app.command()(waypoints.waypoints)
app.command()(behaviors.dock)
app.command()(behaviors.undock)
app.command()(behaviors.spin)
app.command()(behaviors.backup)
app.command()(teleop.teleop)


@functools.cache
def _command() -> Callable[..., object]:
    """The command with all its options, built once."""
    return typer.main.get_command(app)


def _told(line: str, details: str = "") -> int:
    """Print an error on standard error, and with --json also as JSON on standard output. Returns
    the exit code.
    """
    code = 2
    sys.stderr.write(f"error: {line}\n{details}".rstrip() + "\n")
    if "--json" in sys.argv:
        sys.stdout.write(json.dumps({"error": line, "exit_code": code}) + "\n")
    return code


def main() -> NoReturn:
    """Run the command; an error is one line on standard error, with --json also an object on
    standard output, and a nonzero exit code.
    """
    code: object = 0
    try:
        code = _command()(prog_name="mazebot", standalone_mode=False)
    except UsageMistake as error:
        code = _told(in_one_line(error))
    except ConfigError as error:
        code = _told(words(error), error.details)
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED
    except BrokenPipeError:
        code = 0
    sys.exit(code if isinstance(code, int) else 0)
