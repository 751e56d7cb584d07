"""The whole of Mazebot in one process: builds every node, drives the tour, shows how far it is."""

from __future__ import annotations

import json
import logging
import signal
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from services.bringup.config import BringupConfig
from services.bringup.node import EXIT_NOT_REACHED, BringupNode
from services.bringup.tour import NoLocationsError, tour_goals
from services.common import log
from services.common.config import ConfigError, load
from services.common.executive import Executive, MemoryTransport, StalledError
from services.common.garbage import settled
from services.common.node import Node
from services.navigation.config import NavigationConfig
from services.navigation.node import NavigationNode
from services.perception.config import PerceptionConfig
from services.perception.node import PerceptionNode
from services.physics.config import PhysicsConfig
from services.physics.node import PhysicsNode
from services.recorder.config import RecorderConfig
from services.recorder.node import RecorderNode
from services.spawner.config import SpawnerConfig
from services.spawner.node import SpawnerNode
from services.worldgen.config import WorldgenConfig
from services.worldgen.loader import LoadedWorld, load_world
from services.worldgen.node import Load, WorldgenNode

EXIT_INTERRUPTED = 130
_LOG = logging.getLogger("demo")

FIRST_STEP = "the simulation runs"
"""What a run says when physics has made its first step."""
COMPACT_TIMEOUT_S = 20.0
"""Nobody waits to kill this process, so that its recording may be made quick to open."""


@dataclass(frozen=True)
class DemoOptions:
    """What a run in one process is told."""

    world_name: str = "sim_house_enhanced"
    seed: int = 7
    out_dir: Path | None = None
    camera: bool = True
    record: bool = True
    use_aruco: bool = True
    texture_base: Path | None = None
    renderer: str = "auto"
    goal: tuple[float, float, float] | None = None
    overrides: tuple[str, ...] = ()
    """`field=value`, put over the world's recipe."""
    worlds_dir: Path | None = None


def build_nodes(options: DemoOptions, load_world: Load = load_world) -> list[Node]:
    """Every node of a run, configured by the options over environment and defaults.

    Raises ConfigError where an option cannot be met.
    """
    recorder = {
        "seed": options.seed,
        "record": options.record,
        "out_dir": options.out_dir,
        "compact_timeout_s": COMPACT_TIMEOUT_S,
    }
    # Each part is made in turn so that a mistake is told before anything is written.
    return [
        *robot_nodes(options, load_world=load_world),
        BringupNode(_bringup_config(options)),
        RecorderNode(load(RecorderConfig, "recorder", (), _set(recorder))),
    ]


def robot_nodes(
    options: DemoOptions,
    physics: Mapping[str, object] = MappingProxyType({}),
    load_world: Load = load_world,
) -> list[Node]:
    """The nodes of the world and of the robot in it, which wait to be told what to do.

    `physics` are fields of PhysicsConfig, which win over what the options say.

    Raises ConfigError where an option cannot be met.
    """
    seed = {"seed": options.seed}
    camera = {"camera_enabled": options.camera, "renderer": options.renderer}
    return [
        WorldgenNode(_worldgen_config(options), load_world),
        PhysicsNode(load(PhysicsConfig, "physics", (), {**seed, **camera, **physics})),
        SpawnerNode(load(SpawnerConfig, "spawner", (), seed)),
        PerceptionNode(load(PerceptionConfig, "perception", (), seed)),
        NavigationNode(load(NavigationConfig, "navigation", (), seed)),
    ]


def _bringup_config(options: DemoOptions) -> BringupConfig:
    told = {
        "seed": options.seed,
        "world_name": options.world_name,
        "use_aruco": options.use_aruco,
        "world_overrides": options.overrides,
        "goal": options.goal,
    }
    return load(BringupConfig, "bringup", (), _set(told))


def _worldgen_config(options: DemoOptions) -> WorldgenConfig:
    told = {
        "seed": options.seed,
        "texture_base": options.texture_base,
        "worlds_dir": options.worlds_dir,
    }
    return load(WorldgenConfig, "worldgen", (), _set(told))


def _set(told: Mapping[str, object]) -> dict[str, object]:
    """Without what is left to the environment and the defaults."""
    return {name: value for name, value in told.items() if value is not None}


def check_world(options: DemoOptions) -> LoadedWorld:
    """The world, read before anything is started.

    Raises ConfigError where it cannot be had or lacks a place of the tour, NoLocationsError where
    it has none at all.
    """
    config = _worldgen_config(options)
    loaded = load_world(
        options.world_name,
        options.use_aruco,
        config.worlds_dir,
        config.texture_base,
        options.overrides,
    )
    bringup = _bringup_config(options)
    if bringup.goal is None:
        try:
            tour_goals(loaded.world, bringup.tour)
        except NoLocationsError:
            raise
        except ValueError as error:
            raise ConfigError(str(error)) from error
    return loaded


def run(options: DemoOptions) -> int:
    """Drive the tour and return its exit code.

    Raises ConfigError where an option cannot be met.
    """
    console = Console(soft_wrap=True)
    rosout = log.configure(_ConsoleHandler(console))
    try:
        loaded = check_world(options)
    except NoLocationsError as error:
        sys.stderr.write(f"error: {error}\n")
        return EXIT_NOT_REACHED
    # Nobody in this process asks for another one.
    nodes = build_nodes(options, lambda *_: loaded)
    executive = Executive(nodes, MemoryTransport(), rosout)
    (bringup,) = (node for node in nodes if isinstance(node, BringupNode))
    with _stop_on_signal() as stopped, _progress(console) as progress:
        task = progress.add_task("starting", total=None)
        start_s = shown_s = time.monotonic()
        runs = False

        def until() -> bool:
            nonlocal shown_s, runs
            if not runs and executive.now_ns > 0:
                runs = True
                _LOG.info(FIRST_STEP)
                settled()
            now_s = time.monotonic()
            if now_s - shown_s > 0.1:
                shown_s = now_s
                done, total, name = bringup.progress
                sim_s = executive.now_ns * 1e-9
                factor = sim_s / (now_s - start_s)
                text = f"{name or 'starting'}  {sim_s:.0f} s simulated, {factor:.1f}x real time"
                progress.update(task, total=total, completed=done, description=text)
            return bool(stopped)

        try:
            code = executive.run(until)
        except StalledError as error:
            # Whoever ran the command gets a line, not a traceback.
            raise ConfigError(str(error)) from error
        finally:
            executive.close()
    if bringup.recording:
        _tell(console, Path(bringup.recording))
    if code is None:
        console.print("interrupted; the recording is closed")
        return EXIT_INTERRUPTED
    return code


def _tell(console: Console, folder: Path) -> None:
    """Say how fast it was, where the recording is and how to look at it."""
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    sim_s, factor = summary["sim_time_s"], summary["real_time_factor"]
    lines = [
        f"{sim_s:.1f} s simulated at {factor:.1f}x real time, "
        f"camera: {summary['renderer']}, state {summary['state_hash']}",
        f"summary:   {folder / 'summary.json'}",
    ]
    if (folder / "run.rrd").is_file():
        lines += [
            f"recording: {folder / 'run.rrd'}",
            f"look at it: .venv/bin/mazebot recordings view {folder}",
        ]
    console.print("\n".join(lines), markup=False, highlight=False)


class _ConsoleHandler(logging.Handler):
    """Prints above the progress bar."""

    def __init__(self, console: Console) -> None:
        super().__init__(logging.INFO)
        self._console = console

    def emit(self, record: logging.LogRecord) -> None:
        self._console.print(self.format(record), markup=False, highlight=False)


def _progress(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed}/{task.total} goals"),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )


@contextmanager
def _stop_on_signal() -> Iterator[list[int]]:
    """A list that is empty until the process is told to stop."""
    stopped: list[int] = []
    before = {
        number: signal.signal(number, lambda got, _: stopped.append(got))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield stopped
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
