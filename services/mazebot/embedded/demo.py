"""All of Mazebot in one process: builds every node, drives the tour, shows its progress."""

from __future__ import annotations

import json
import logging
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from mazebot.bringup.config import BringupConfig
from mazebot.bringup.node import EXIT_NOT_REACHED, BringupNode
from mazebot.bringup.tour import NoLocationsError, tour_goals
from mazebot.common.config import ConfigError, ServiceConfig
from mazebot.common.garbage import settled
from mazebot.common.node import log
from mazebot.common.node.executive import Executive, MemoryTransport, StalledError
from mazebot.common.node.node import Node
from mazebot.common.own_command import own_command
from mazebot.common.recordings.run_folder import RECORDING, SUMMARY, TO_COMPRESS
from mazebot.common.settings.load import config_flag, load, world_hash_of_run
from mazebot.common.stop_signals import exit_code_of, stopped_by
from mazebot.common.world.map_files import read_map
from mazebot.embedded.compile_progress import CompileProgress
from mazebot.embedded.compiling import CompilingStoppedError, compiled_side_by_side
from mazebot.navigation.config import NavigationConfig
from mazebot.navigation.node import NavigationNode
from mazebot.perception.config import PerceptionConfig
from mazebot.perception.node import PerceptionNode
from mazebot.physics.config import PhysicsConfig
from mazebot.recorder.config import RecorderConfig
from mazebot.recorder.node import RecorderNode
from mazebot.recorder.transcoding.background import start
from mazebot.spawner.config import SpawnerConfig
from mazebot.spawner.node import SpawnerNode
from mazebot.worldgen.config import WorldgenConfig
from mazebot.worldgen.files import load_any
from mazebot.worldgen.node import Load, WorldgenNode
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.recipe.loader import load_world
from mazebot.worldgen.recipe.sources import SHORT_NAMES, full_name

if TYPE_CHECKING:
    from mazebot.common.client.robot import Robot
    from mazebot.console.config import ConsoleConfig
    from mazebot.embedded.beside import Beside, BusBeside

C = TypeVar("C", bound=ServiceConfig)

_LOG = logging.getLogger("demo")

FIRST_STEP = "the simulation runs"
"""Log message after the first step of physics."""
_TELL_PERIOD_S = 1.2
"""How often a line tells how far the run is, where there is no terminal for a bar."""
COMPACT_TIMEOUT_S = 20.0
"""This process is not killed after a timeout, so there is time to compact its recording."""


@dataclass(frozen=True)
class DemoOptions:
    """The options of a run in one process. None: from environment, settings file or defaults."""

    world_name: str | None = None
    """Name of a world, or a recipe, SDF, URDF or xacro file."""
    seed: int | None = None
    out_dir: Path | None = None
    camera: bool | None = None
    record: bool | None = None
    use_aruco: bool | None = None
    texture_base: Path | None = None
    renderer: str | None = None
    goal: tuple[float, float, float] | None = None
    overrides: tuple[str, ...] = ()
    """`field=value`, overrides the world's recipe."""
    worlds_dir: Path | None = None
    slam: bool | None = None
    """Whether the robot makes the map itself."""
    explore: bool | None = None
    """With slam: whether it explores, instead of driving to the goal."""
    map_file: Path | None = None
    """YAML file of a map to drive in, instead of the world's own."""
    controller: str | None = None
    """Name of navigation's controller, or FILE.py:Class."""
    settings: Path | None = None
    """A settings file, or a run's own config.yaml to repeat that run."""
    params: Path | None = None
    """A parameter file of Nav2, under the settings file."""
    as_json: bool = False
    """Print the run's summary as JSON on standard output, and the log on standard error."""
    arguments: Mapping[str, str] = field(default_factory=dict)
    """Arguments of a xacro file."""
    roots: tuple[Path, ...] = ()
    """Folders of models that an SDF file may include."""
    console: ConsoleConfig | None = None
    """Where the console is served; with it the run is in real time, and goes on until Ctrl-C."""
    foxglove: bool | None = None
    """Whether the recorder serves the run to Foxglove; this has the same effect on the run."""
    open_bus: Callable[[], BusBeside] | None = None
    """With a console: opens the bus on which the user's tools find the run."""
    tour: bool = True
    """Without one, only the console and the user's tools send goals."""


def build_nodes(
    options: DemoOptions, load_world: Load = load_any, robot: Robot | None = None
) -> list[Node]:
    """Every node of a run, configured by the options over environment and defaults. `robot`: how
    clients of Foxglove reach it.

    Raises ConfigError where an option cannot be met.
    """
    # In this order, so that errors are reported before anything is written.
    bringup = bringup_config(options)
    return [
        *robot_nodes(options, load_world=load_world, slam=bringup.slam),
        BringupNode(bringup),
        RecorderNode(recorder_config(options), robot=None if robot is None else lambda: robot),
    ]


def recorder_config(options: DemoOptions) -> RecorderConfig:
    """Where and how a run is recorded and shown. Raises ConfigError."""
    settings = {
        "seed": options.seed,
        "record": options.record,
        "out_dir": options.out_dir,
        "foxglove": options.foxglove,
        "compact_timeout_s": COMPACT_TIMEOUT_S,
    }
    return _configured(options, RecorderConfig, "recorder", settings)


def robot_nodes(
    options: DemoOptions,
    physics: Mapping[str, object] = MappingProxyType({}),
    load_world: Load = load_any,
    slam: bool = False,
) -> list[Node]:
    """The nodes of the world and of the robot in it, which wait for requests.

    `physics` are fields of PhysicsConfig, which win over the options. With `slam`, mapping and the
    explorer take localisation's place.

    Raises ConfigError where an option cannot be met.
    """
    from mazebot.physics.node import PhysicsNode  # noqa: PLC0415 - uses kernels at once

    seed = {"seed": options.seed}
    camera = {"camera_enabled": options.camera, "renderer": options.renderer}
    settings = {**seed, **camera, **physics}
    named = options.controller and {"controller": options.controller}
    navigation = {**seed, "controller_server": named}
    mappers = _mappers(options, seed) if slam else [_localization(options, seed)]
    return [
        WorldgenNode(worldgen_config(options), load_world),
        PhysicsNode(_configured(options, PhysicsConfig, "physics", settings)),
        SpawnerNode(_configured(options, SpawnerConfig, "spawner", seed)),
        PerceptionNode(
            _configured(options, PerceptionConfig, "perception", seed),
            has_camera=options.camera is not False,
        ),
        NavigationNode(_configured(options, NavigationConfig, "navigation", navigation)),
        *mappers,
    ]


def _localization(options: DemoOptions, seed: Mapping[str, object]) -> Node:
    from mazebot.localization.config import LocalizationConfig  # noqa: PLC0415 - loaded if used
    from mazebot.localization.node import LocalizationNode  # noqa: PLC0415

    return LocalizationNode(_configured(options, LocalizationConfig, "localization", seed))


def _mappers(options: DemoOptions, seed: Mapping[str, object]) -> list[Node]:
    """The nodes in localisation's place."""
    from mazebot.explorer.config import ExplorerConfig  # noqa: PLC0415 - loaded if used
    from mazebot.explorer.node import ExplorerNode  # noqa: PLC0415
    from mazebot.mapping.config import MappingConfig  # noqa: PLC0415
    from mazebot.mapping.node import MappingNode  # noqa: PLC0415

    return [
        MappingNode(_configured(options, MappingConfig, "mapping", seed)),
        ExplorerNode(_configured(options, ExplorerConfig, "explorer", seed)),
    ]


def bringup_config(options: DemoOptions) -> BringupConfig:
    """The world and the goals of a run. Raises ConfigError."""
    settings = {
        "seed": options.seed,
        "world_name": options.world_name,
        "use_aruco": options.use_aruco,
        "world_overrides": options.overrides or None,
        "goal": options.goal,
        "slam": options.slam,
        "explore": options.explore,
        "only_ask": None if options.tour else True,
    }
    config = _configured(options, BringupConfig, "bringup", settings)
    return with_full_name(config, worldgen_config(options).worlds_dir)


def with_full_name(config: BringupConfig, worlds_dir: Path) -> BringupConfig:
    """The configuration with the world's full name, so that a run is recorded as the same one
    whichever of its names was given. Raises WorldError.
    """
    if config.world_name not in SHORT_NAMES:
        return config
    return config.model_copy(update={"world_name": full_name(config.world_name, worlds_dir)})


def worldgen_config(options: DemoOptions) -> WorldgenConfig:
    """Where worlds, textures and the map are. Raises ConfigError."""
    settings = {
        "seed": options.seed,
        "texture_base": options.texture_base,
        "worlds_dir": options.worlds_dir,
        "map_file": options.map_file,
    }
    return _configured(options, WorldgenConfig, "worldgen", settings)


def _configured(
    options: DemoOptions, kind: type[C], service: str, settings: Mapping[str, object]
) -> C:
    """A service's configuration: the options over environment, file and defaults."""
    given = {name: value for name, value in settings.items() if value is not None}
    return load(kind, service, config_flag(options.settings, options.params), given)


def beside_run(console: ConsoleConfig, recorder: RecorderConfig) -> ConsoleConfig:
    """The configuration of the console beside a run: unless it is configured otherwise, it
    shows the run's folder and only the live data of the run's recorder.
    """
    folder = recorder.out_dir.parent if recorder.out_dir else recorder.recordings_dir
    its = {
        "recordings_dir": folder,
        "live_data_port": recorder.grpc_port if recorder.live else 0,
    }
    configured = console.model_fields_set
    return console.model_copy(
        update={name: value for name, value in its.items() if name not in configured}
    )


def check_world(options: DemoOptions) -> LoadedWorld:
    """The world, loaded before anything is started.

    Raises ConfigError where it cannot be loaded or lacks a location of the tour, NoLocationsError
    where there is no reachable goal.
    """
    config, bringup = worldgen_config(options), bringup_config(options)
    loaded = load_any(
        bringup.world_name,
        bringup.use_aruco,
        config.worlds_dir,
        config.texture_base,
        bringup.world_overrides,
        options.arguments,
        options.roots,
    )
    _check_repeats(options, bringup, loaded)
    if bringup.slam and config.map_file is not None:
        raise ConfigError(f"map_file: {config.map_file}: must be given without slam")
    if bringup.goal is None and not bringup.slam:
        # The tour of a world without locations depends on the map.
        cells, origin = loaded.map_cells, loaded.map_origin
        world, chart = loaded.world, None
        if config.map_file is not None:
            chart = read_map(config.map_file)
            cells, origin = chart.cells, chart.origin
            world = world.model_copy(update={"map_resolution_m": chart.resolution_m})
        try:
            tour_goals(world, bringup.tour, cells, origin, bringup.seed)
        except ValueError as error:
            from mazebot.worldgen.map.disagreement import misfit_in  # noqa: PLC0415 - loads scipy

            found = "" if chart is None else misfit_in(chart, loaded.world, loaded.meshes)
            if found:
                raise ConfigError(
                    f"map_file: {config.map_file}: must fit the world {world.name}: {found}"
                ) from error
            if isinstance(error, NoLocationsError):
                raise
            raise ConfigError(str(error)) from error
    return loaded


def _check_repeats(options: DemoOptions, bringup: BringupConfig, loaded: LoadedWorld) -> None:
    """Raises ConfigError where the run of a config.yaml cannot be repeated."""
    if options.settings is None:
        return
    if bringup.only_ask:
        reason = (
            "only_ask: true: this run was controlled by a program (Session): there is no "
            "tour to repeat"
        )
        raise ConfigError(f"{options.settings}: bringup.{reason}")
    world = (
        options.world_name, options.use_aruco, options.texture_base, options.worlds_dir,
        options.overrides or None,
    )  # fmt: skip
    was = world_hash_of_run(options.settings)
    if was and was != loaded.world.hash and all(option is None for option in world):
        raise ConfigError(
            f"{options.settings}: world_hash: {was}: must be that of {loaded.world.name}, "
            f"{loaded.world.hash}: its recipe has changed, or is in another folder (--worlds-dir)"
        )


def run(options: DemoOptions) -> int:
    """Drive the tour and return its exit code.

    Raises ConfigError where an option cannot be met.
    """
    console = Console(soft_wrap=True, stderr=options.as_json)
    rosout = log.configure(_ConsoleHandler(console))
    try:
        loaded = check_world(options)
    except NoLocationsError as error:
        sys.stderr.write(f"error: {error}\n")
        return EXIT_NOT_REACHED
    beside = _beside(options)
    with (
        nullcontext() if beside is None else closing(beside),
        _stop_on_signal() as stopped,
        compiled_side_by_side(CompileProgress(console), lambda: bool(stopped)),
    ):
        try:
            return _run(options, loaded, beside, console, rosout, stopped)
        except CompilingStoppedError:
            console.print("interrupted")
            return exit_code_of(stopped)


def _beside(options: DemoOptions) -> Beside | None:
    """What serves the run to people, if anything."""
    recorder = recorder_config(options)
    if options.console is None and not recorder.foxglove:
        return None
    from mazebot.embedded.beside import Beside  # noqa: PLC0415 - loads the server

    console = None if options.console is None else beside_run(options.console, recorder)
    return Beside(console, options.open_bus)


def _world_loader(options: DemoOptions, loaded: LoadedWorld) -> Load:
    """Loads worlds by name, as in a stack of services; the run's own one is there already."""
    config, bringup = worldgen_config(options), bringup_config(options)
    own = (
        bringup.world_name, bringup.use_aruco, config.worlds_dir, config.texture_base,
        bringup.world_overrides,
    )  # fmt: skip
    return lambda *asked: loaded if asked == own else load_world(*asked)


def _run(
    options: DemoOptions,
    loaded: LoadedWorld,
    beside: Beside | None,
    console: Console,
    rosout: log.RosoutHandler,
    stopped: list[int],
) -> int:
    load = _world_loader(options, loaded)
    nodes = build_nodes(options, load, None if beside is None else beside.robot)
    if beside is not None:
        for node in nodes:
            node.prepare()
    transport = MemoryTransport() if beside is None else beside.transport
    executive = Executive(nodes, transport, rosout)
    (bringup,) = (node for node in nodes if isinstance(node, BringupNode))
    (recorder,) = (node for node in nodes if isinstance(node, RecorderNode))
    with _progress(console) as progress:
        unit = "%" if bringup.explores else "goals"
        task = progress.add_task("starting", total=None, unit=unit)
        start_s = shown_s = told_s = time.monotonic()
        runs, told_ns = False, 0

        def until() -> bool:
            nonlocal shown_s, told_s, told_ns, runs
            if not runs and executive.now_ns > 0:
                runs = True
                _LOG.info(FIRST_STEP)
                settled()
            now_s = time.monotonic()
            if now_s - shown_s > 0.1:
                shown_s = now_s
                done, total, text = _doing(bringup)
                sim_s = executive.now_ns * 1e-9
                factor = sim_s / (now_s - start_s)
                text = f"{text}  {sim_s:.0f} s simulated, {factor:.1f}x real time"
                progress.update(task, total=total, completed=done, description=text)
                is_new = executive.now_ns != told_ns and bringup.exit_code is None
                if is_new and now_s - told_s > _TELL_PERIOD_S and not console.is_terminal:
                    told_s, told_ns = now_s, executive.now_ns
                    console.print(f"{text}, {done} of {total} {unit}", highlight=False)
            return bool(stopped)

        try:
            if beside is None:
                code = executive.run(until)
            else:
                beside.play(executive, until)
                code = bringup.exit_code
        except CompilingStoppedError:
            code = None
        except StalledError as error:
            # Print one line instead of a traceback.
            raise ConfigError(str(error)) from error
        finally:
            executive.close()
    ended = exit_code_of(stopped) if code is None else code
    if bringup.recording:
        folder, unrecorded = Path(bringup.recording), recorder.unrecorded
        if options.as_json:
            _print_json(folder, ended, unrecorded)
        else:
            _print_summary(console, folder, unrecorded)
    if code is None:
        console.print("interrupted; recording closed")
    return ended


def _doing(bringup: BringupNode) -> tuple[int, int, str]:
    """How much of how much is done, and what is being done."""
    status = bringup.exploration
    if status is None:
        done, total, name = bringup.progress
        return done, total, name or "starting"
    frontiers = f"{status.reachable} of {status.frontiers} frontiers"
    return round(100.0 * status.seen_share), 100, f"{status.state}, {frontiers}"


def _print_json(folder: Path, code: int, unrecorded: str | None) -> None:
    """Print the run's summary, with its folder, the exit code and why it is not recorded to its
    end, as one JSON object.
    """
    result = {"folder": str(folder), "exit_code": code, "unrecorded": unrecorded}
    sys.stdout.write(json.dumps(result | _summary(folder), indent=2, allow_nan=False) + "\n")


def _print_summary(console: Console, folder: Path, unrecorded: str | None) -> None:
    """Print the speed, the recording's folder and how to view it, or why it is not recorded to its
    end.
    """
    lines = []
    if summary := _summary(folder):
        sim_s, factor = summary["sim_time_s"] or 0.0, summary["real_time_factor"]
        pace = "" if factor is None else f" at {factor:.1f}x real time"
        lines = [
            f"{sim_s:.1f} s simulated{pace}, "
            f"camera: {summary['renderer']}, state {summary['state_hash']}",
            f"summary:   {folder / SUMMARY}",
        ]
    if unrecorded is not None:
        lines.append(f"recording: {unrecorded}")
    if (folder / RECORDING).is_file():
        lines += [
            f"recording: {folder / RECORDING}",
            f"view it:   {own_command('recordings', 'view', folder)}",
        ]
    if (folder / TO_COMPRESS).exists():
        if console.is_terminal:
            start(folder)
            lines.append("compressing its images to a video in the background")
        else:
            lines.append(f"compress it: {own_command('recordings', 'compress', folder)}")
    console.print("\n".join(lines), markup=False, highlight=False)


def _summary(folder: Path) -> dict[str, Any]:
    """A run's summary; empty where its disk took none, as the recorder's log says."""
    try:
        content: dict[str, Any] = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    return content


class _ConsoleHandler(logging.Handler):
    """Prints above the progress bar."""

    def __init__(self, console: Console) -> None:
        super().__init__(logging.INFO)
        self._console = console

    def emit(self, record: logging.LogRecord) -> None:
        # A run whose output nobody takes is closed as any other.
        with suppress(OSError):
            self._console.print(self.format(record), markup=False, highlight=False)


def _progress(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed}/{task.total} {task.fields[unit]}"),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )


@contextmanager
def _stop_on_signal() -> Iterator[list[int]]:
    """A list that is empty until a stop signal is received."""
    stopped: list[int] = []
    with stopped_by(lambda number, _: stopped.append(number)):
        yield stopped
