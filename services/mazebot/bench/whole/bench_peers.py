"""Other simulators in the same maze: PyBullet used as in its manual, and ir-sim."""

from __future__ import annotations

import functools
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from typing import Any

import numpy as np

from mazebot.bench.bench_figures import Figure, figure, missing, timed_ms
from mazebot.common.files.root import ROOT
from mazebot.common.messages.documents import World
from mazebot.physics.bodies.bullet import pybullet

IRSIM_PYTHON = ROOT / ".venv-bench" / "bin" / "python"
_IRSIM_SCRIPT = ROOT / "scripts" / "measure-irsim.py"
_GROUP = "against others, same maze"
_RAYS, _RANGE_M, _LIDAR_HEIGHT_M = 360, 3.5, 0.182
_STEPS_A_SCAN = 24
_STEPS_PER_SECOND = 240
_WHEELS_RAD_S = 9.0
_DEADLINE_S = 120.0


class PlainPyBullet:
    """PyBullet as in its quick start guide: boxes, the robot's URDF, motors, `rayTestBatch`, and
    TinyRenderer by `getCameraImage`; no textures.
    """

    def __init__(self, world: World) -> None:
        self._client = pybullet.connect(pybullet.DIRECT)
        self._robot = _build(world, self._client)

    def drive(self, seconds: float) -> None:
        """Drive for this long in simulation time, with steps of 1/240 s and 10 scans a second."""
        for number in range(round(seconds * _STEPS_PER_SECOND)):
            if number % _STEPS_A_SCAN == 0:
                _drive(self._robot, self._client)
                self.scan()
            pybullet.stepSimulation(physicsClientId=self._client)

    def scan(self) -> None:
        """Take one scan."""
        _scan(self._robot, self._client)

    def picture(self) -> None:
        """Take one picture."""
        _picture(self._robot, self._client)

    def close(self) -> None:
        """Free PyBullet's world."""
        pybullet.disconnect(physicsClientId=self._client)


def plain_pybullet(world: World, seconds: float, repeats: int, frames: int) -> list[Figure]:
    """Figures of `PlainPyBullet`."""
    with closing(PlainPyBullet(world)) as plain:
        runs_ms = timed_ms(functools.partial(plain.drive, seconds), repeats)
        factors = [seconds * 1e3 / each for each in runs_ms]
        return [
            figure(_GROUP, "plain PyBullet: 240 Hz and lidar", "x real time", factors),
            figure(_GROUP, "plain PyBullet: one scan", "ms", timed_ms(plain.scan, 10 * repeats)),
            figure(_GROUP, "plain PyBullet: one picture 640x480", "ms",
                   timed_ms(plain.picture, frames), "TinyRenderer, no textures"),
        ]  # fmt: skip


def ir_sim(world: World, seconds: float, repeats: int) -> list[Figure]:
    """ir-sim with a driving disc, steps of 0.1 s, the same lidar and noise, no rendering."""
    names = {
        "steps": ("ir-sim: 10 Hz and lidar", "x real time"),
        "scans": ("ir-sim: one scan", "ms"),
    }
    request = {
        "walls": [
            [wall.x_m, wall.y_m, wall.yaw_rad, wall.length_m, wall.thickness_m]
            for wall in world.walls
        ],
        "start": [world.start.x_m, world.start.y_m, world.start.yaw_rad],
        "rays": _RAYS, "range_m": _RANGE_M, "noise_m": 0.01, "step_s": 0.1,
        "steps": round(seconds / 0.1), "repeats": repeats,
    }  # fmt: skip
    try:
        measured = _ask_ir_sim(request)
    except (OSError, subprocess.SubprocessError, ValueError) as error:
        why = "not installed: make bench" if not IRSIM_PYTHON.exists() else str(error)
        return [missing(_GROUP, name, unit, why) for name, unit in names.values()]
    factors = [seconds * 1e3 / taken_ms for taken_ms in measured["runs_ms"]]
    return [
        figure(_GROUP, *names["steps"], factors, f"ir-sim {measured['version']}"),
        figure(_GROUP, *names["scans"], measured["scans_ms"]),
    ]


def _ask_ir_sim(request: dict[str, Any]) -> dict[str, Any]:
    """Raises OSError, SubprocessError or ValueError where it gives no result."""
    done = subprocess.run(
        [str(IRSIM_PYTHON), str(_IRSIM_SCRIPT)], input=json.dumps(request),
        capture_output=True, text=True, check=True, timeout=_DEADLINE_S,
    )  # fmt: skip
    measured: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return measured


def _build(world: World, client: int) -> int:
    pybullet.setGravity(0.0, 0.0, -9.8, physicsClientId=client)
    plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
    pybullet.createMultiBody(0.0, plane, physicsClientId=client)
    for wall in world.walls:
        half = [wall.length_m / 2.0, wall.thickness_m / 2.0, wall.height_m / 2.0]
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=half, physicsClientId=client
        )
        seen = pybullet.createVisualShape(
            pybullet.GEOM_BOX, halfExtents=half, physicsClientId=client
        )
        pybullet.createMultiBody(
            0.0, shape, seen, [wall.x_m, wall.y_m, half[2]],
            pybullet.getQuaternionFromEuler([0.0, 0.0, wall.yaw_rad]), physicsClientId=client,
        )  # fmt: skip
    with _quiet():
        robot: int = pybullet.loadURDF(
            str(ROOT / "models" / "turtlebot3_waffle" / "model.urdf"),
            [world.start.x_m, world.start.y_m, 0.01],
            pybullet.getQuaternionFromEuler([0.0, 0.0, world.start.yaw_rad]),
            physicsClientId=client,
        )
    return robot


@contextmanager
def _quiet() -> Iterator[None]:
    """PyBullet's C code prints a warning for every link without inertia."""
    sys.stdout.flush()
    kept = os.dup(1)
    with open(os.devnull, "wb") as nothing:  # noqa: PTH123 - not a path, a device
        os.dup2(nothing.fileno(), 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


def _drive(robot: int, client: int) -> None:
    """Drive in a narrow circle, without collisions."""
    pybullet.setJointMotorControlArray(
        robot, [1, 2], pybullet.VELOCITY_CONTROL,
        targetVelocities=[_WHEELS_RAD_S * 0.2, _WHEELS_RAD_S], forces=[1.0, 1.0],
        physicsClientId=client,
    )  # fmt: skip


def _scan(robot: int, client: int) -> object:
    place, turn = pybullet.getBasePositionAndOrientation(robot, physicsClientId=client)
    yaw = pybullet.getEulerFromQuaternion(turn)[2]
    angles = yaw + np.arange(_RAYS) * (2.0 * np.pi / _RAYS)
    start = np.array([place[0], place[1], _LIDAR_HEIGHT_M])
    rays = np.stack([np.cos(angles), np.sin(angles), np.zeros(_RAYS)], axis=1)
    starts = np.broadcast_to(start, rays.shape)
    # The rays start outside of the robot's own bodies.
    hits = pybullet.rayTestBatch(
        (starts + 0.3 * rays).tolist(), (starts + _RANGE_M * rays).tolist(), numThreads=1,
        physicsClientId=client,
    )  # fmt: skip
    return np.array([hit[2] for hit in hits]) * (_RANGE_M - 0.3) + 0.3


def _picture(robot: int, client: int) -> object:
    place, turn = pybullet.getBasePositionAndOrientation(robot, physicsClientId=client)
    rotation = np.array(pybullet.getMatrixFromQuaternion(turn)).reshape(3, 3)
    eye = np.array(place) + rotation @ [0.08, 0.0, 0.1]
    view = pybullet.computeViewMatrix(eye, eye + rotation[:, 0], [0.0, 0.0, 1.0])
    projection = pybullet.computeProjectionMatrixFOV(46.8, 640.0 / 480.0, 0.02, 50.0)
    return pybullet.getCameraImage(
        640, 480, view, projection, renderer=pybullet.ER_TINY_RENDERER, physicsClientId=client
    )
