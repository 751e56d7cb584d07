"""The `mazebot` command."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from services.cli import entities, markers, sim, world
from services.cli.options import ROUTER as _ROUTER
from services.cli.options import Connect
from services.common.config import ConfigError
from services.common.garbage import collections_held_off

app = typer.Typer(
    name="mazebot",
    help="The TurtleBot house maze with no ROS and no Gazebo.",
    invoke_without_command=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
topics_app = typer.Typer(help="Look at the topics of a running stack.", invoke_without_command=True)
recordings_app = typer.Typer(help="Look at what runs have left.", invoke_without_command=True)
app.add_typer(topics_app, name="topic")
app.add_typer(recordings_app, name="recordings")
app.add_typer(world.app, name="world")
app.add_typer(markers.app, name="markers")
app.add_typer(sim.app, name="sim")

RecordingsDir = Annotated[
    Path | None, typer.Option("--dir", help="folder of recordings [default: ./recordings]")
]
# typer keeps click to itself: this is click's UsageError.
_UsageMistake: type[Exception] = typer.BadParameter.__mro__[1]
_TRUE, _FALSE = ("true", "1", "yes", "on"), ("false", "0", "no", "off")


@app.callback()
@topics_app.callback()
@recordings_app.callback()
def _overview(context: typer.Context) -> None:
    if context.invoked_subcommand is None:
        sys.stdout.write(context.get_help() + "\n")


@app.command()
def demo(
    world_name: Annotated[
        str,
        typer.Option(
            "--world", "--world_name", "--world-name", envvar="WORLD_NAME",
            help="enhanced (sim_house_enhanced), original (sim_house), or another of the worlds",
        ),
    ] = "enhanced",
    overrides: Annotated[
        list[str] | None,
        typer.Option("--set", help="field=value put over the world's recipe; may be given again"),
    ] = None,
    worlds_dir: Annotated[
        Path | None, typer.Option(help="folder of the worlds [default: worlds]")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="the run's one seed")] = 7,
    out: Annotated[
        Path | None,
        typer.Option(help="the run's folder [default: recordings/<time>_<world>]"),
    ] = None,
    goal: Annotated[
        tuple[float, float, float] | None,
        typer.Option(help="x, y (m) and yaw (rad) in the map: drive there instead of the tour"),
    ] = None,
    use_aruco: Annotated[
        str, typer.Option("--use_aruco", "--use-aruco", envvar="USE_ARUCO", help="True or False")
    ] = "True",
    texture_base: Annotated[
        Path | None,
        typer.Option(
            "--texture_base", "--texture-base", envvar="TEXTURE_BASE",
            help="folder of the wall textures [default: worlds/textures]",
        ),
    ] = None,
    renderer: Annotated[str, typer.Option(help="auto, gl, cpu, tiny or none")] = "auto",
    camera: Annotated[bool, typer.Option("--camera/--no-camera", help="simulate it")] = True,
    record: Annotated[bool, typer.Option("--record/--no-record", help="write run.rrd")] = True,
) -> None:  # fmt: skip
    """Drive the tour of a world in this process, as fast as the machine allows."""
    with collections_held_off():
        from services.embedded import demo as embedded  # noqa: PLC0415 - pulls in every service

        options = embedded.DemoOptions(
            world_name=world_name,
            seed=seed,
            out_dir=out,
            camera=camera,
            record=record,
            use_aruco=parse_bool("--use_aruco", use_aruco),
            texture_base=texture_base,
            renderer=renderer,
            goal=goal,
            overrides=tuple(overrides or ()),
            worlds_dir=worlds_dir,
        )
        code = embedded.run(options)
    raise typer.Exit(code)


@app.command()
def diff(
    first: Annotated[str, typer.Argument(help="a run's folder or its name")],
    second: Annotated[str, typer.Argument(help="another's")],
    directory: RecordingsDir = None,
) -> None:
    """Name the first message in which two runs differ; exit code 0 where none does, else 1."""
    from services.cli.diff import diff_runs  # noqa: PLC0415

    raise typer.Exit(diff_runs(directory or Path("recordings"), first, second))


@app.command(context_settings={"ignore_unknown_options": True})
def goal(x: float, y: float, yaw: float, connect: Connect = _ROUTER) -> None:
    """Send the robot of a running stack to x, y (m) and yaw (rad) in the map, and wait for the
    result.
    """
    from services.cli.goal import send_goal  # noqa: PLC0415

    raise typer.Exit(send_goal(connect, x, y, yaw))


@topics_app.command("list")
def topic_list(
    connect: Connect = _ROUTER,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="with types")] = False,
) -> None:
    """Name the topics that somebody publishes."""
    from services.cli.topic import list_topics  # noqa: PLC0415

    list_topics(connect, verbose)


@topics_app.command("hz")
def topic_hz(
    name: str,
    connect: Connect = _ROUTER,
    window_s: Annotated[float, typer.Option("--window", min=0.5, help="seconds to count")] = 5.0,
) -> None:
    """Measure how often a topic's messages come."""
    from services.cli.topic import measure_rate  # noqa: PLC0415

    measure_rate(connect, name, window_s)


@topics_app.command("echo")
def topic_echo(
    name: str,
    connect: Connect = _ROUTER,
    once: Annotated[bool, typer.Option("--once", help="stop after one message")] = False,
    timeout_s: Annotated[float, typer.Option("--timeout", min=0.1, help="seconds to wait")] = 10.0,
) -> None:
    """Print a topic's messages as YAML."""
    from services.cli.topic import echo  # noqa: PLC0415

    echo(connect, name, once, timeout_s)


@recordings_app.command("list")
def recordings_list(directory: RecordingsDir = None) -> None:
    """List the runs, newest first."""
    from services.cli.recordings import list_runs  # noqa: PLC0415

    list_runs(directory or Path("recordings"))


@recordings_app.command("view")
def recordings_view(
    name: Annotated[str, typer.Argument(help="a run's folder or its name")] = "",
    directory: RecordingsDir = None,
    port: Annotated[int, typer.Option(min=1, max=65534, help="of the web viewer")] = 9090,
) -> None:
    """Serve a run (the newest one, without a name) to a browser."""
    from services.cli.recordings import view_run  # noqa: PLC0415

    view_run(directory or Path("recordings"), name, port)


entities.register(app)


def parse_bool(option: str, text: str) -> bool:
    """True or False as ROS launch files write it.

    Raises ConfigError where the text is neither.
    """
    if text.lower() in _TRUE:
        return True
    if text.lower() in _FALSE:
        return False
    raise ConfigError(f"{option}: {text!r} is neither True nor False")


@functools.cache
def _command() -> Callable[..., object]:
    """The command with all its options, made once."""
    return typer.main.get_command(app)


def main() -> NoReturn:
    """Run the command; a mistake is one line on standard error, and not exit code 0."""
    code: object = 0
    try:
        code = _command()(standalone_mode=False)
    except _UsageMistake as error:
        sys.stderr.write(f"error: {' '.join(error.format_message().split())}\n")  # type: ignore[attr-defined]
        code = 2
    except ConfigError as error:
        sys.stderr.write(f"error: {' '.join(str(error).split())}\n")
        code = 2
    except (KeyboardInterrupt, typer.Abort):
        code = 130
    except BrokenPipeError:
        code = 0
    sys.exit(code if isinstance(code, int) else 0)
