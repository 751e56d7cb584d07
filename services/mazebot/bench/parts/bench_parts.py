"""The simulator's parts separately: steps, lidar, cameras, and world generation."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from mazebot.bench.bench_figures import Figure, figure, missing, timed_ms
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import LINK_FROM_OPTICAL, SE2
from mazebot.common.settings.load import load
from mazebot.physics.bodies.robot_model import robot_model_from_urdf
from mazebot.physics.camera.camera import Intrinsics
from mazebot.physics.camera.renderers import RendererKind, make_renderer
from mazebot.physics.camera.scene import build_scene
from mazebot.physics.config import PhysicsConfig, steps_per_period, time_of_step_ns
from mazebot.physics.sensor_profiles import CAMERA_PROFILES
from mazebot.physics.simulation import STEP_S, Simulation
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.recipe.loader import load_world
from mazebot.worldgen.sdf.convert import to_recipe
from mazebot.worldgen.sdf.reading.read import read_sdf

THOUSAND_WALLS = ("maze.rows=44", "maze.columns=44")
_CAMERA_HEIGHT_M = 0.117
_DRIVE = (0.3, 0.2)


def worlds() -> dict[str, LoadedWorld]:
    """The worlds used for the measurements, by label."""
    maze = load_world("maze", overrides=THOUSAND_WALLS)
    return {"enhanced": load_world("enhanced"), f"{len(maze.world.walls)} walls": maze}


def simulation(loaded: dict[str, LoadedWorld], repeats: int) -> list[Figure]:
    """Steps of PyBullet with drive and state hash, and scans, while the robot drives."""
    figures = []
    for name, world in loaded.items():
        with _simulation(world) as simulated:
            steps = iter(range(1, 1_000_000))

            def step(simulated: Simulation = simulated, steps: Iterator[int] = steps) -> None:
                for _ in range(24):
                    now_ns = time_of_step_ns(next(steps))
                    simulated.drive.command(*_DRIVE, now_ns)
                    simulated.step(now_ns)

            taken_ms = timed_ms(step, repeats)
            factors = [24 * STEP_S * 1e3 / each for each in taken_ms]
            figures.append(figure("physics alone", name, "x real time", factors))
            each_ms = [each / 24 for each in taken_ms]
            figures.append(figure("physics alone", f"{name}, one step", "ms", each_ms))
            scan = functools.partial(simulated.lidar.read, 0)
            samples = PhysicsConfig(seed=1).scan_samples
            label = f"{name}, {samples} rays"
            figures.append(figure("lidar, one scan", label, "ms", timed_ms(scan, repeats)))
    return figures


def sensors_and_steps(loaded: LoadedWorld, seconds: float, repeats: int) -> Figure:
    """Physics at 240 Hz with a 10 Hz scan only, as measured for the other simulators."""
    every = steps_per_period(10.0)
    with _simulation(loaded) as simulated:
        steps = iter(range(1, 10_000_000))

        def run() -> None:
            for _ in range(round(seconds / STEP_S)):
                number = next(steps)
                now_ns = time_of_step_ns(number)
                if number % every == 0:
                    simulated.drive.command(*_DRIVE, now_ns)
                    simulated.lidar.read(now_ns)
                simulated.step(now_ns)

        factors = [seconds * 1e3 / each for each in timed_ms(run, repeats)]
    return figure("against others, same maze", "Mazebot: 240 Hz and lidar", "x real time", factors)


def cameras(loaded: dict[str, LoadedWorld], frames: int) -> list[Figure]:
    """One image, colour and depth, by profile and renderer, while the camera turns."""
    return [
        camera(label, world, kind, profile, max(frames // 10, 3) if kind == "tiny" else frames)
        for label, world in loaded.items()
        for profile in CAMERA_PROFILES
        for kind in ("cpu", "gl", "tiny")
        if kind != "tiny" or (label, profile) == ("enhanced", "d435i")
    ]


def camera(
    label: str, loaded: LoadedWorld, kind: RendererKind, profile: str, frames: int
) -> Figure:
    """Rendering times of one renderer."""
    sensor = CAMERA_PROFILES[profile]
    width, height = sensor.camera_width_px, sensor.camera_height_px
    group, name = "camera, one picture", f"{label}, {profile} {width}x{height} RGB-D, {kind}"
    intrinsics = Intrinsics.from_horizontal_fov(width, height, sensor.camera_horizontal_fov_rad)
    depth_range_m = sensor.camera_depth_min_m, sensor.camera_depth_max_m
    try:
        renderer = make_renderer(kind, intrinsics, depth_range_m)
    except ConfigError as error:
        return missing(group, name, "ms", str(error))
    if renderer is None:
        return missing(group, name, "ms", "draws nothing")
    try:
        renderer.set_scene(build_scene(loaded.world, loaded.assets, ()))
        start = loaded.world.start.se2()
        turns = iter(np.linspace(0.0, 2.0 * np.pi, frames + 1).tolist())

        def render() -> None:
            pose = SE2(start.x_m, start.y_m, next(turns)).matrix(_CAMERA_HEIGHT_M)
            renderer.render(pose @ LINK_FROM_OPTICAL)

        return figure(group, name, "ms", timed_ms(render, frames), renderer.name)
    finally:
        renderer.close()


def generation(repeats: int) -> list[Figure]:
    """Durations of world generation."""
    figures = []
    size = ("maze.rows=50", "maze.columns=50")
    for kind in ("algorithm=wilson", "algorithm=recursive_backtracker", "algorithm=rooms",
                 "braiding=0.5"):  # fmt: skip
        work = functools.partial(load_world, "maze", overrides=(*size, f"maze.{kind}"))
        name = f"maze of 50 x 50 cells, {kind}, with its map"
        figures.append(figure("world", name, "ms", timed_ms(work, repeats)))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "wood.sdf"
        file.write_text(_wood(300), encoding="utf-8")
        taken_ms = timed_ms(lambda: to_recipe(read_sdf(file), "wood"), repeats)
    figures.append(figure("world", "SDF of 300 cylinders to a recipe", "ms", taken_ms))
    return figures


@contextmanager
def _simulation(loaded: LoadedWorld) -> Iterator[Simulation]:
    config = load(PhysicsConfig, "physics", ["--seed", "7"])
    model = robot_model_from_urdf(config.robot_urdf())
    simulated = Simulation(loaded.world, model, config)
    try:
        yield simulated
    finally:
        simulated.close()


def _wood(count: int) -> str:
    """SDF of static cylinders, one a model."""
    shape = "<geometry><cylinder><radius>0.075</radius><length>1</length></cylinder></geometry>"
    models = "".join(
        f"<model name='tree_{i}'><static>1</static><pose>{0.15 * (i % 30)} {0.15 * (i // 30)} 0 "
        f"0 0 0</pose><link name='link'><collision name='c'>{shape}</collision>"
        f"<visual name='v'>{shape}</visual></link></model>"
        for i in range(count)
    )
    return f"<sdf version='1.6'><world name='wood'>{models}</world></sdf>"
