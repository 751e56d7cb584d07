"""`mazebot sim`: pause, resume, step, reset, another world, and the state of a running stack's
simulation.
"""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from pydantic import ValidationError

from mazebot.cli.parsing.command import App
from mazebot.cli.parsing.completion import world_names
from mazebot.cli.parsing.options import ROUTER, Connect, Json, print_json
from mazebot.common.config import ConfigError, one_line
from mazebot.common.messages.documents import SimulationControl, SimulationStats

if TYPE_CHECKING:
    from mazebot.common.client.robot import Robot
    from mazebot.common.client.subscription import Subscription

PATIENCE_S = 5.0
"""Time to wait for an immediate reply."""
PAUSED_PATIENCE_S = 1.0
"""Time to wait for the reply that explains why no other message was received."""
ALL_DAY_S = 86_400.0
"""Time to wait for the end of a run of steps: practically unlimited."""
RATES_WINDOW_S = 1.0
"""Time between two readings of the clock, and the period of /diagnostics."""
RATES_PATIENCE_S = 0.5
PAUSED = "the simulation is paused: resume it with `mazebot sim resume`"
SPEEDS = {"real_time": 1.0, "fast": 0.0}

LOADED_WITHIN_S = 60.0
"""Time for the simulator to build a world that was loaded."""

app = App(help="Control a running stack's simulation: its time, and its world.")


@app.command()
def pause(as_json: Json = False, connect: Connect = ROUTER) -> None:
    """Pause the simulation."""
    _control(connect, as_json, pause=True)


@app.command()
def resume(as_json: Json = False, connect: Connect = ROUTER) -> None:
    """Resume the simulation."""
    _control(connect, as_json, pause=False)


@app.command()
def step(
    steps: Annotated[int, typer.Argument(metavar="[N]", help="number of steps of 1/240 s")] = 1,
    as_json: Json = False,
    connect: Connect = ROUTER,
) -> None:
    """Advance by N steps, then pause."""
    _control(connect, as_json, step=steps)


@app.command("run-until")
def run_until(
    time_s: Annotated[float, typer.Argument(metavar="T", help="simulation time, seconds")],
    as_json: Json = False,
    connect: Connect = ROUTER,
) -> None:
    """Advance to a simulation time, then pause."""
    _control(connect, as_json, run_until_s=time_s)


@app.command()
def reset(
    scope: Annotated[
        Literal["all", "fresh", "time"] | None,
        typer.Option(
            help="all: the initial state, what was spawned at its first pose; fresh: without what "
            "was spawned; time: only the clock [default: all]"
        ),
    ] = None,
    time_only: Annotated[bool, typer.Option("--time-only", help="as --scope time")] = False,
    seed: Annotated[
        int | None, typer.Option(help="new seed of the random streams [default: unchanged]")
    ] = None,
    as_json: Json = False,
    connect: Connect = ROUTER,
) -> None:
    """Reset the simulation to time 0 and its initial state."""
    if time_only and scope not in (None, "time"):
        raise ConfigError(f"--scope: {scope}: must be time with --time-only")
    _control(connect, as_json, reset="time" if time_only else scope or "all", seed=seed)


@app.command()
def speed(
    factor: Annotated[
        str, typer.Argument(metavar="X", help="simulated seconds a second, or fast, or real_time")
    ],
    as_json: Json = False,
    connect: Connect = ROUTER,
) -> None:
    """Set the speed of simulation time; 0 is as fast as possible."""
    _control(connect, as_json, speed=SPEEDS.get(factor, factor))


@app.command("load-world")
def load_world(
    world: Annotated[
        str, typer.Argument(metavar="WORLD", help="a world's name", autocompletion=world_names)
    ],
    overrides: Annotated[
        list[str] | None,
        typer.Option("--set", help="field=value, overrides the recipe's, e.g. wall_height_m=2.5"),
    ] = None,
    use_aruco: Annotated[
        bool, typer.Option("--aruco/--no-aruco", help="with the recipe's ArUco markers")
    ] = True,
    as_json: Json = False,
    connect: Connect = ROUTER,
) -> None:
    """Load another world in place of the one that is running: goals end, a new recording begins."""
    from mazebot.common.client.over_zenoh import ZenohRobot  # noqa: PLC0415 - loads Zenoh
    from mazebot.common.client.subscription import Subscription  # noqa: PLC0415
    from mazebot.common.messages.action_documents import LoadWorld  # noqa: PLC0415
    from mazebot.common.messages.topics import LOAD_WORLD, SIMULATION_STATS  # noqa: PLC0415

    wanted = LoadWorld(world_name=world, use_aruco=use_aruco, overrides=tuple(overrides or ()))
    with ZenohRobot(connect) as robot, Subscription(robot, SIMULATION_STATS) as stats_sent:
        reply = robot.ask(LOAD_WORLD, wanted, LOADED_WITHIN_S)
        if reply.error:
            raise ConfigError(f"sim load-world: {reply.error}")
        end_s = time.monotonic() + LOADED_WITHIN_S
        while True:
            _, now = stats_sent.next(max(0.0, end_s - time.monotonic())) or (None, None)
            if now is None:
                raise ConfigError(
                    f"sim load-world: {reply.world_name}: physics does not run it after "
                    f"{LOADED_WITHIN_S:g} s: see its log"
                )
            if now.world_hash == reply.world_hash:
                break
    if as_json:
        print_json(reply.model_dump(mode="json"))
    else:
        state = "is running" if reply.is_new else "was running already"
        sys.stdout.write(f"{reply.world_name} ({reply.world_hash}) {state}\n")


@app.command()
def stats(
    as_json: Json = False,
    connect: Connect = ROUTER,
) -> None:
    """Print time, real-time factor, hashes and the rates of the sensors."""
    from mazebot.common.client.over_zenoh import ZenohRobot  # noqa: PLC0415 - loads Zenoh
    from mazebot.common.client.subscription import Subscription  # noqa: PLC0415
    from mazebot.common.messages.topics import DIAGNOSTICS  # noqa: PLC0415

    with ZenohRobot(connect) as robot, Subscription(robot, DIAGNOSTICS) as diagnostics:
        first, first_s = stats_now(robot, "sim stats"), time.monotonic()
        time.sleep(RATES_WINDOW_S)
        last, last_s = stats_now(robot, "sim stats"), time.monotonic()
        rates_hz = _rates(diagnostics)
    factor: float | None = None
    if first.epoch == last.epoch and first.world_hash == last.world_hash:
        factor = (last.sim_time_s - first.sim_time_s) / (last_s - first_s)
    if as_json:
        content = last.model_dump(mode="json")
        content |= {"real_time_factor": factor, "rates_hz": rates_hz}
        print_json(content)
    else:
        sys.stdout.write(_table(last, factor, rates_hz))


def stats_now(robot: Robot, who: str) -> SimulationStats:
    """The state of the simulation.

    Raises ConfigError, prefixed with `who`, where there is no simulation or no world is loaded.
    """
    found = _asked(robot, who, SimulationControl(), PATIENCE_S)
    if found is None:
        raise ConfigError(f"{who}: no world loaded yet")
    return found


def paused(robot: Robot) -> str:
    """A message if the user has paused the simulation, else an empty string."""
    try:
        found = _asked(robot, "", SimulationControl(), PAUSED_PATIENCE_S)
    except ConfigError:
        return ""
    return PAUSED if found is not None and found.paused else ""


def _control(endpoint: str, as_json: bool, **fields: Any) -> None:
    try:
        request = SimulationControl(**fields)
    except ValidationError as error:
        raise ConfigError(f"sim: {one_line(error)}") from error
    from mazebot.common.client.over_zenoh import ZenohRobot  # noqa: PLC0415 - loads Zenoh

    takes_time = request.step is not None or request.run_until_s is not None
    with ZenohRobot(endpoint) as robot:
        now = _asked(robot, "sim", request, ALL_DAY_S if takes_time else PATIENCE_S)
    if as_json:
        print_json(None if now is None else now.model_dump(mode="json"))
    else:
        sys.stdout.write(_state(now, request) + "\n")


def _asked(
    robot: Robot, who: str, request: SimulationControl, timeout_s: float
) -> SimulationStats | None:
    from mazebot.common.messages.topics import SIMULATION_CONTROL  # noqa: PLC0415 - loads the messages

    reply = robot.ask(SIMULATION_CONTROL, request, timeout_s)
    if reply.error:
        raise ConfigError(f"{who}: {reply.error}")
    return reply.stats


def _state(now: SimulationStats | None, request: SimulationControl) -> str:
    """The state of the simulation after a request, in one line."""
    if now is None:
        return "paused; no world loaded yet" if request.pause else "no world loaded yet"
    state = "paused" if now.paused else f"running {_pace(now.speed)}"
    return f"{state} at {now.sim_time_s:.6g} s, step {now.iterations}, epoch {now.epoch}"


def _pace(factor: float) -> str:
    return f"at {factor:g}x real time" if factor else "as fast as possible"


def _rates(diagnostics: Subscription) -> dict[str, float]:
    """The rates of the simulation's topics from its diagnostics, per second of simulation time."""
    from mazebot.common.messages.topics import SIMULATION_CONTROL  # noqa: PLC0415
    from mazebot.common.messages.wire import WireError  # noqa: PLC0415 - loads rosbags
    from mazebot.common.node.diagnostics import RATE_KEY  # noqa: PLC0415

    end_s = time.monotonic() + RATES_PATIENCE_S
    while True:
        try:
            _, array = diagnostics.next(end_s - time.monotonic()) or (None, None)
        except WireError:
            continue
        if array is None and time.monotonic() >= end_s:
            return {}
        for status in () if array is None else array.status:
            if status.name == SIMULATION_CONTROL.owner:
                return {
                    value.key.removeprefix(RATE_KEY): float(value.value)
                    for value in status.values
                    if value.key.startswith(RATE_KEY)
                }


def _table(now: SimulationStats, factor: float | None, rates_hz: dict[str, float]) -> str:
    measured = "not measured: simulation reset" if factor is None else f"{factor:.3g}"
    rows = {
        "simulation time": f"{now.sim_time_s:.6g} s",
        "real-time factor": f"{measured} (requested: {now.speed:g})"
        if now.speed
        else f"{measured} (requested: as fast as possible)",
        "paused": "yes" if now.paused else "no",
        "step": f"{now.iterations} of {now.step_size_s * 1e3:.4g} ms",
        "epoch": str(now.epoch),
        "seed": str(now.seed),
        "entities": str(now.entities),
        "world": now.world_hash,
        "state hash": now.state_hash,
        "image hash": now.image_hash or "none",
        "renderer": now.renderer,
        "watchdog stops": str(now.watchdog_stops),
    }
    rows |= {name: f"{rate_hz:g} Hz" for name, rate_hz in rates_hz.items()}
    width = max(map(len, rows)) + 2
    return "".join(f"{name:{width}}{value}\n" for name, value in rows.items())
