"""`mazebot demo`: a whole run in one process."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from mazebot.cli import own_router, world
from mazebot.cli.own_router import OwnRouter
from mazebot.cli.parsing import known
from mazebot.cli.parsing.completion import world_names
from mazebot.cli.parsing.options import (
    Camera,
    Json,
    TextureBase,
    UseAruco,
    model_folders,
    xacro_arguments,
)
from mazebot.cli.parsing.patience import say_first, wait_quietly
from mazebot.cli.parsing.poses import POSE, given_pose
from mazebot.common.config import ConfigError
from mazebot.common.garbage import collections_held_off

if TYPE_CHECKING:
    from mazebot.console.config import ConsoleConfig

_TRUE, _FALSE = ("true", "1", "yes", "on"), ("false", "0", "no", "off")


def demo(
    world_name: Annotated[
        str | None,
        typer.Option(
            "--world", "--world_name", "--world-name", envvar="WORLD_NAME",
            autocompletion=world_names,
            help="enhanced (sim_house_enhanced), original (sim_house), another of the worlds, or a "
            "file: recipe, SDF, URDF or xacro [default: enhanced]",
        ),
    ] = None,
    overrides: Annotated[
        list[str] | None,
        typer.Option("--set", help="field=value, overrides the world's recipe; repeatable"),
    ] = None,
    arguments: Annotated[
        list[str] | None, typer.Option("--arg", help="name:=value, an argument of a xacro file")
    ] = None,
    path: Annotated[
        list[Path] | None,
        typer.Option("--path", help="folder of models, searched before GZ_SIM_RESOURCE_PATH"),
    ] = None,
    worlds_dir: Annotated[
        Path | None, typer.Option(help="folder of the worlds [default: worlds]")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="the run's seed [default: 7]")
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(help="a YAML file of settings; a run's own config.yaml repeats that run"),
    ] = None,
    params: Annotated[
        Path | None,
        typer.Option(help="a nav2_params.yaml of Nav2; --config and the environment win over it"),
    ] = None,
    controller: Annotated[
        str | None,
        typer.Option(
            help="mppi, regulated_pure_pursuit, or your own: FILE.py:Class or package.module:Class"
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="the run's folder [default: recordings/<time>_<world>]"),
    ] = None,
    goal: Annotated[
        str | None,
        typer.Option(metavar=POSE, help="in the map, m and rad: one goal instead of the tour"),
    ] = None,
    slam: Annotated[
        bool | None,
        typer.Option(
            "--slam/--no-slam",
            help="the robot gets no map: it explores the world and makes one [default: no-slam]",
        ),
    ] = None,
    explore: Annotated[
        bool | None,
        typer.Option("--explore/--no-explore", help="with --slam: or drive to --goal only"),
    ] = None,
    map_file: Annotated[
        Path | None,
        typer.Option(
            "--map", help="YAML file of a map to drive in, instead of the world's own; with "
            "markers.yaml beside it, the robot knows these markers",
        ),
    ] = None,
    use_aruco: UseAruco = None,
    texture_base: TextureBase = None,
    renderer: Annotated[
        Literal["auto", "gl", "cpu", "tiny", "none"] | None,
        typer.Option(help="renderer of the camera images [default: auto]"),
    ] = None,
    camera: Camera = None,
    record: Annotated[
        bool | None, typer.Option("--record/--no-record", help="write run.rrd [default: record]")
    ] = None,
    console: Annotated[
        bool,
        typer.Option(
            "--console", help="serve the console beside the run, and open a router for `mazebot "
            "goal` and all other commands; the run is in real time then and continues after the "
            "tour until Ctrl-C",
        ),
    ] = False,
    console_port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="its port [default: 8080]")
    ] = None,
    router_port: Annotated[
        int | None,
        typer.Option(
            min=0, max=65535, help="with --console: port of the router; 0: any free one "
            "[default: that of MAZEBOT_BUS_CONNECT, 7447]",
        ),
    ] = None,
    foxglove: Annotated[
        bool | None,
        typer.Option(
            "--foxglove/--no-foxglove", help="serve the run to Foxglove on ws://localhost:8765; it "
            "is in real time then and continues after the tour until Ctrl-C [default: no-foxglove]",
        ),
    ] = None,
    tour: Annotated[
        bool,
        typer.Option(
            "--tour/--no-tour", help="with --console or --foxglove: or wait for goals from "
            "there and from commands"
        ),
    ] = True,
    as_json: Json = False,
) -> None:  # fmt: skip
    """Drive the tour of a world, or with --slam explore it, in a single process, as fast as
    possible.
    """
    given = {"--seed": seed, "--world": world_name, "--set": overrides, "--worlds-dir": worlds_dir}
    known.check_not_for_make([option for option, value in given.items() if value])
    pose = None if goal is None else given_pose("--goal", goal)
    explore = _explores(slam, explore, pose, map_file)
    _check_console(console, console_port, router_port)
    if not tour and not (console or foxglove):
        raise ConfigError("--no-tour: must be given with --console or --foxglove")
    if not tour and pose is not None:
        raise ConfigError("--no-tour: must be given without --goal")
    if config is not None:
        known.check_file(config)
    say_first(f"starting the services for world {world_name or 'enhanced'}", as_json)
    with collections_held_off():
        world.refuse_unused(world_name or "enhanced", arguments, path)
        from mazebot.common.recordings.run_folder import check_free  # noqa: PLC0415
        from mazebot.embedded import demo as embedded  # noqa: PLC0415 - pulls in every service

        if out is not None:
            check_free("--out", out)
        options = embedded.DemoOptions(
            world_name=world_name,
            seed=seed,
            out_dir=out,
            camera=camera,
            record=record,
            use_aruco=None if use_aruco is None else parse_bool("--use_aruco", use_aruco),
            texture_base=texture_base,
            renderer=renderer,
            goal=pose,
            slam=slam,
            explore=explore,
            map_file=map_file,
            overrides=tuple(overrides or ()),
            worlds_dir=worlds_dir,
            controller=controller,
            settings=config,
            params=params,
            as_json=as_json,
            arguments=xacro_arguments(arguments),
            roots=model_folders("--path", path),
            console=_console_config(config, console_port) if console else None,
            open_bus=_bus_opener(config, router_port) if console else None,
            foxglove=foxglove,
            tour=tour,
        )
        code = embedded.run(options)
    raise typer.Exit(code)


def _explores(
    slam: bool | None,
    explore: bool | None,
    goal: tuple[float, float, float] | None,
    map_file: Path | None,
) -> bool | None:
    """Whether `explorer` drives; None: as in the settings. Raises ConfigError for flags that
    contradict each other.
    """
    if slam and map_file is not None:
        raise ConfigError(f"--map: {map_file}: must be given without --slam, which makes the map")
    if explore is not None and not slam:
        raise ConfigError("--explore: must be given with --slam")
    if slam and goal is not None and explore is None:
        return False
    if slam and explore and goal is not None:
        raise ConfigError("--goal: must be given without --explore: the explorer chooses the goals")
    if slam and explore is False and goal is None:
        raise ConfigError("--no-explore: must be given with --goal: otherwise no goals are sent")
    return explore


def _check_console(console: bool, port: int | None, router: int | None) -> None:
    given = {"--console-port": port is not None, "--router-port": router is not None}
    for option, is_given in given.items():
        if is_given and not console:
            raise ConfigError(f"{option}: must be given with --console")


def _console_config(settings: Path | None, port: int | None) -> ConsoleConfig:
    """Environment, settings file and defaults, and the port as given. Raises ConfigError."""
    from mazebot.common.settings.load import config_flag, load  # noqa: PLC0415
    from mazebot.console.config import ConsoleConfig  # noqa: PLC0415

    given = {} if port is None else {"port": port}
    return load(ConsoleConfig, "console", config_flag(settings), given)


def _bus_opener(settings: Path | None, port: int | None) -> Callable[[], OwnRouter]:
    """What opens the router. Raises ConfigError where a setting is wrong."""
    from mazebot.common.bus.config import BusConfig  # noqa: PLC0415
    from mazebot.common.settings.load import config_flag, load  # noqa: PLC0415

    keys = load(BusConfig, "bus", config_flag(settings)).keys

    def opened() -> OwnRouter:
        router = OwnRouter(own_router.router_port(port), keys)
        # People take part from now on, and the demo goes on after its tour until they end it.
        wait_quietly()
        return router

    return opened


def parse_bool(option: str, text: str) -> bool:
    """True or False as ROS launch files write it.

    Raises ConfigError where the text is neither.
    """
    if text.lower() in _TRUE:
        return True
    if text.lower() in _FALSE:
        return False
    raise ConfigError(f"{option}: {text!r} is neither True nor False")
