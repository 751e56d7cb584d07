"""`mazebot up|down|ps|logs`: all services on this machine, without Docker."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mazebot.cli.own_router import how_to_find, router_port
from mazebot.cli.parsing import known
from mazebot.cli.parsing.completion import (
    stack_part_names,
    stack_service_names,
    world_names,
)
from mazebot.cli.parsing.options import Camera, Json, TextureBase, UseAruco, print_json
from mazebot.cli.parsing.patience import doing, say_first, wait_quietly
from mazebot.common.bus.connections import listens
from mazebot.common.config import ConfigError

if TYPE_CHECKING:
    from mazebot.cli.parsing.command import App
    from mazebot.cli.stack.state import StackFolder, StackState

_ACTIVE_S = 180.0
"""Time for the services to become active."""
_OTHERS_S, _LATER_S = 20.0, 3.0
"""For so long what others send is waited for, where there are some, and where they may come yet."""
_THIS_MACHINE = "127.0.0.1"

RouterPort = Annotated[
    int | None,
    typer.Option(
        "--router-port", min=1, max=65535,
        help="port of the stack's router [default: MAZEBOT_ROUTER_PORT, that of "
        "MAZEBOT_BUS_CONNECT, 7447]",
    ),
]  # fmt: skip


def up(
    world: Annotated[
        str,
        typer.Option(
            "--world", "--world_name", "--world-name", envvar="WORLD_NAME",
            autocompletion=world_names, help="the world's name",
        ),
    ] = "enhanced",
    overrides: Annotated[
        list[str] | None,
        typer.Option("--set", help="field=value, overrides the world's recipe; repeatable"),
    ] = None,
    slam: Annotated[
        bool,
        typer.Option("--slam", help="the robot gets no map: it explores the world and makes one"),
    ] = False,
    only: Annotated[
        list[str] | None,
        typer.Option(
            help="start only the router and these services, separated by commas; simulator: all "
            "but what localises and drives the robot; navigation-only: that, and a recorder",
            autocompletion=stack_part_names,
        ),
    ] = None,
    map_file: Annotated[
        Path | None,
        typer.Option("--map", help="YAML file of a map to drive in, instead of the world's own"),
    ] = None,
    worlds_dir: Annotated[
        Path | None, typer.Option(envvar="WORLDS_DIR", help="folder of the worlds")
    ] = None,
    texture_base: TextureBase = None,
    use_aruco: UseAruco = None,
    camera: Camera = None,
    seed: Annotated[
        int | None, typer.Option(min=0, envvar="SEED", help="of all services [default: 7]")
    ] = None,
    pace: Annotated[
        str | None,
        typer.Option(
            envvar="PACE",
            help="real_time, a factor of it such as 0.5, fast, or lockstep [default: real_time]",
        ),
    ] = None,
    config: Annotated[Path | None, typer.Option(help="a YAML file of settings")] = None,
    connect: Annotated[
        str | None,
        typer.Option(
            help="start no router but join that of another stack, such as tcp/127.0.0.1:7447; "
            "what runs there already is left out"
        ),
    ] = None,
    keys_dir: Annotated[
        Path | None,
        typer.Option(
            "--keys", metavar="FOLDER",
            help="let only those in who have a key in this folder: see mazebot keys; keys that "
            "are missing are made, and your own tools find yours",
        ),
    ] = None,
    detach: Annotated[
        bool,
        typer.Option("--detach", "-d", help="return when the services are active"),
    ] = False,
    port: RouterPort = None,
) -> None:  # fmt: skip
    """Start all services on this machine, each in a process of its own, and follow the tour.

    As docker compose up: the services go on after the tour, until mazebot down. Ctrl-C ends them.
    """
    known.check_not_for_make([], reads=("SEED", "WORLDS_DIR", "PACE"))
    say_first(f"starting the services for world {world}")
    from mazebot.cli.demo import parse_bool  # noqa: PLC0415
    from mazebot.cli.stack.control import refuse_second, start  # noqa: PLC0415
    from mazebot.cli.stack.plan import StackOptions, plan_of, service_names  # noqa: PLC0415
    from mazebot.cli.stack.state import StackFolder  # noqa: PLC0415
    from mazebot.common.stop_signals import (  # noqa: PLC0415
        exit_code_of,
        interrupt_on_stop,
        on_stop,
    )

    folder = StackFolder(router_port(port))
    refuse_second(folder)
    options = StackOptions(
        world=world,
        port=folder.port,
        overrides=tuple(overrides or ()),
        only=service_names(only or ()),
        connect=connect,
        slam=slam,
        map_file=map_file,
        worlds_dir=worlds_dir,
        texture_base=texture_base,
        use_aruco=None if use_aruco is None else parse_bool("--use_aruco", use_aruco),
        seed=seed,
        pace=pace,
        camera=camera,
        config=config,
        keys_dir=keys_dir,
    )
    plan = plan_of(options)
    if plan.left_out:
        _say(f"left out, as they run on {connect} already: {', '.join(plan.left_out)}")
    _compile_kernels()
    # What ends the command from now on ends the stack.
    stops: list[int] = []
    interrupt_on_stop(stops)
    try:
        state = start(plan, folder)
        _say(
            f"{len(state.services)} services run, on {state.endpoint}{how_to_find(state.endpoint)}"
        )
        code = _wait(folder, connect is not None) if detach else _follow(folder, state)
    except KeyboardInterrupt:
        # A second one must not leave half of them.
        on_stop(lambda *_: None)
        _say("ending the services")
        _end(folder)
        code = exit_code_of(stops)
    raise typer.Exit(code)


def _compile_kernels() -> None:
    """Have all kernels on the disk before any service runs: each would compile what it needs for
    itself, beside all others, and meanwhile do nothing else.
    """
    from mazebot.embedded.kernels import compile_all  # noqa: PLC0415 - takes half a second

    # What could not be compiled is said; the service that needs it tells why.
    compile_all()


def _wait(folder: StackFolder, joins: bool) -> int:
    from mazebot.cli.stack.control import wait_until_active  # noqa: PLC0415

    def tell(missing: str) -> None:
        _say(missing)
        doing(missing)

    others_s = _OTHERS_S if joins else _LATER_S
    code, waiting = wait_until_active(folder, tell, _ACTIVE_S, others_s)
    if waiting:
        _say(f"not active yet: {waiting}")
    else:
        _say("the demo has ended" if code else "active")
    _say("see mazebot ps, mazebot logs; mazebot down ends them")
    return code


def _follow(folder: StackFolder, state: StackState) -> int:
    """Print what the demo says until it has ended, or without a demo what all say."""
    from mazebot.cli.stack.log_file import follow  # noqa: PLC0415
    from mazebot.cli.stack.plan import DEMO, ROUTER  # noqa: PLC0415
    from mazebot.cli.stack.supervisor import SUPERVISOR  # noqa: PLC0415

    has_demo = state.service(DEMO) is not None
    shown = [DEMO] if has_demo else [one.name for one in state.services if one.name != ROUTER]

    def goes_on() -> bool:
        now = folder.read()
        demo = None if now is None else now.service(DEMO)
        return now is not None and now.supervisor.runs() and not (demo and demo.phase == "ended")

    for line in follow(folder.path, [*shown, SUPERVISOR], goes_on):
        if line is not None:
            # From now on, silence is for the demo to break.
            wait_quietly()
            service, text = line
            _say(text if service != SUPERVISOR else f"[WARN] [{SUPERVISOR}]: {text}")
    now = folder.running()
    if now is None:
        _say("the stack has ended")
        return 0
    demo = now.service(DEMO)
    how = "mazebot goal 0.5 -0.9 0 sends the robot, " if now.service("navigation") else ""
    _say(f"the other services go on: {how}mazebot down ends them")
    return 0 if demo is None else demo.exit_code or 0


def down(port: RouterPort = None) -> None:
    """End all services that mazebot up has started, and close the recording."""
    from mazebot.cli.stack.state import StackFolder  # noqa: PLC0415

    folder = StackFolder(router_port(port))
    if folder.running() is None:
        if listens(_THIS_MACHINE, folder.port):
            sys.stderr.write(f"error: down: {_nothing(folder)}\n")
            raise typer.Exit(1)
        _say(_nothing(folder))
        return
    _say("ending the services")
    _end(folder)


def _end(folder: StackFolder) -> None:
    from mazebot.cli.stack.control import end  # noqa: PLC0415

    count = end(folder)
    _say(f"{count} service{'' if count == 1 else 's'} ended")


def ps(as_json: Json = False, port: RouterPort = None) -> None:
    """List the services that mazebot up has started: process, state, uptime."""
    from mazebot.cli.stack.state import StackFolder  # noqa: PLC0415

    folder = StackFolder(router_port(port))
    state = folder.running()
    now_s = time.time()
    if as_json:
        print_json(
            [] if state is None else [
                {
                    "service": one.name, "pid": one.process.pid if one.process else None,
                    "state": one.text, "uptime_s": round(now_s - one.since_s, 1),
                    "restarts": one.restarts,
                }
                for one in state.services
            ]
        )  # fmt: skip
        return
    if state is None:
        _say(_nothing(folder))
        return
    rows = [("service", "pid", "uptime", "restarts", "state")]
    for one in state.services:
        uptime = "" if one.process is None else _duration(now_s - one.since_s)
        pid = "" if one.process is None else str(one.process.pid)
        rows.append((one.name, pid, uptime, str(one.restarts or ""), one.text))
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    for row in rows:
        cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=False)]
        _say("  ".join([*cells, row[4]]).rstrip())


def logs(
    service: Annotated[
        str | None,
        typer.Argument(
            metavar="[SERVICE]", help="of this service alone", autocompletion=stack_service_names
        ),
    ] = None,
    follow: Annotated[
        bool, typer.Option("--follow", "-f", help="go on with what they say, until Ctrl-C")
    ] = False,
    port: RouterPort = None,
) -> None:
    """Print what the services of mazebot up have said, also after mazebot down."""
    from mazebot.cli.stack import log_file  # noqa: PLC0415
    from mazebot.cli.stack.plan import known_service, known_services  # noqa: PLC0415
    from mazebot.cli.stack.state import StackFolder  # noqa: PLC0415
    from mazebot.cli.stack.supervisor import SUPERVISOR  # noqa: PLC0415

    folder = StackFolder(router_port(port))
    if service is not None:
        known_service("SERVICE", service)
    wanted = (*known_services(), SUPERVISOR) if service is None else (service,)
    if not log_file.exists(folder.path):
        raise ConfigError(f"logs: {_nothing(folder)}")
    width = max(map(len, wanted))
    lines = (
        log_file.follow(folder.path, wanted, lambda: folder.running() is not None)
        if follow
        else log_file.read_lines(folder.path, wanted)
    )
    if follow:
        wait_quietly()
    for line in lines:
        if line is not None:
            name, text = line
            _say(text if service is not None else f"{name.ljust(width)} | {text}")


def _nothing(folder: StackFolder) -> str:
    """That no stack runs, and which others do."""
    from mazebot.cli.stack.state import running_stacks  # noqa: PLC0415

    others = [state.endpoint.rpartition(":")[2] for state in running_stacks()]
    hint = f"; another one does: --router-port {' or '.join(others)}" if others else ""
    if listens(_THIS_MACHINE, folder.port):
        return (
            f"something listens on port {folder.port} that is no stack this shell knows of: "
            "containers (docker compose ps), a demo with --console, or a mazebot up of another "
            f"user or with another TMPDIR or XDG_RUNTIME_DIR{hint}"
        )
    return f"no stack runs on port {folder.port}: mazebot up starts one{hint}"


def _duration(seconds: float) -> str:
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}"


def _say(line: str) -> None:
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def register(app: App) -> None:
    """Add the commands."""
    for command in (up, down, ps, logs):
        app.command()(command)
