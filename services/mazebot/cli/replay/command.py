"""`mazebot replay`: a recorded run again, on the bus or through one service."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mazebot.cli.parsing.completion import run_names, service_names, topic_names
from mazebot.cli.parsing.options import ROUTER, Connect, Json
from mazebot.cli.parsing.patience import say_first
from mazebot.common.config import ConfigError

if TYPE_CHECKING:
    from mazebot.cli.replay.reading.recording import Recording


def replay(
    run: Annotated[
        str,
        typer.Argument(
            metavar="RUN",
            help="a run's folder or name, `latest`, an MCAP file, a folder of "
            "rosbag2, or a .bag of ROS 1",
            autocompletion=run_names,
        ),
    ],
    service: Annotated[
        str | None,
        typer.Option(
            help="run this service in this process on the recording, and print the differences",
            autocompletion=service_names,
        ),
    ] = None,
    speed: Annotated[
        float,
        typer.Option(min=0.0, max=1000.0, help="simulated seconds a second; 0: as fast as "
                                               "possible"),
    ] = 1.0,
    only: Annotated[
        list[str] | None,
        typer.Option(
            help="publish this topic, and the clock; repeatable", autocompletion=topic_names
        ),
    ] = None,
    without: Annotated[
        list[str] | None,
        typer.Option(
            help="leave out the messages of this service: a running one takes its place; "
                 "repeatable",
            autocompletion=service_names,
        ),
    ] = None,
    start_s: Annotated[
        float, typer.Option("--start", min=0.0, help="start, in seconds from the beginning "
                                                     "of the recording")
    ] = 0.0,
    duration_s: Annotated[
        float | None, typer.Option("--duration", min=0.001, help="seconds [default: to its end]")
    ] = None,
    loop: Annotated[bool, typer.Option("--loop", help="repeat until Ctrl-C")] = False,
    lockstep: Annotated[
        bool,
        typer.Option(
            "--lockstep", help="in lockstep with the services that run with "
                               "MAZEBOT_BUS_PACE=lockstep"
        ),
    ] = False,
    compare: Annotated[
        bool,
        typer.Option("--compare", help="print the differences of the services of --without "
                                       "from the recording"),
    ] = False,
    config: Annotated[
        Path | None, typer.Option(help="with --service: a YAML file of settings that "
                                       "override the recorded ones")
    ] = None,
    overrides: Annotated[
        list[str] | None,
        typer.Option("--set", help="with --service: name=value, one of its settings; repeatable"),
    ] = None,
    directory: Annotated[
        Path, typer.Option("--dir", help="folder of recordings")
    ] = Path("recordings"),
    as_json: Json = False,
    connect: Connect = ROUTER,
) -> None:  # fmt: skip
    """Publish a recorded run on the bus, with its clock; or run one service against it.

    With --service the exit code is 0 if all its messages are as recorded, to the last bit, else 1.
    Of a run whose files are cut, missing or another run's it is 1.
    """
    _check_use(
        service,
        {"--speed": speed != 1.0, "--only": only, "--without": without, "--loop": loop,
         "--lockstep": lockstep, "--compare": compare},
        {"--config": config, "--set": overrides},
    )  # fmt: skip
    if as_json and service is None and not compare:
        raise ConfigError("--json: must be given with --service or --compare")
    say_first(f"reading {run}", as_json)
    # Zenoh, and the services, take long to load.
    from mazebot.cli.replay.reading.find import open_recording  # noqa: PLC0415

    if service is not None:
        from mazebot.cli.replay.settings import check_service  # noqa: PLC0415
        from mazebot.cli.replay.through_service import compare_service  # noqa: PLC0415

        check_service(service)
        recording = open_recording(directory, run, slam=service in ("mapping", "explorer"))
        _warn(recording)
        span_ns = recording.span_ns(start_s, duration_s)
        code = compare_service(recording, service, span_ns, config, overrides or [], as_json)
    else:
        from mazebot.cli.replay.on_bus import Choice, publish_recording  # noqa: PLC0415

        choice = Choice.of(only or (), without or ())
        choice.check(compare, lockstep)
        recording = open_recording(directory, run)
        _warn(recording)
        span_ns = recording.span_ns(start_s, duration_s)
        code = publish_recording(
            recording, connect, choice, span_ns, speed, loop, lockstep, compare, as_json
        )
    # Of a part, neither "the same" nor its messages are what was asked for.
    raise typer.Exit(code or int(bool(recording.faults)))


def _warn(recording: Recording) -> None:
    """Say first what makes a comparison worth nothing, and a replay another run."""
    if recording.gap:
        sys.stderr.write(
            f"warning: {recording.name} has a hole: {recording.gap}: neither a difference nor its "
            "absence proves anything\n"
        )
    if recording.unended:
        sys.stderr.write(f"warning: {recording.name} {recording.unended}\n")
    if recording.faults:
        sys.stderr.write(
            f"warning: {recording.name}: {'; '.join(recording.faults)}: read as far as it goes, "
            "with exit code 1\n"
        )


def _check_use(
    service: str | None, of_bus: Mapping[str, object], of_service: Mapping[str, object]
) -> None:
    """Raise ConfigError if an option of the other use of the command is given."""
    for option, given in (of_bus if service is not None else of_service).items():
        if given:
            how = "without" if service is not None else "with"
            raise ConfigError(f"{option}: must be given {how} --service")
