"""Times ir-sim in the maze that comes as JSON on standard input; prints JSON. `make bench` runs it
in an environment of its own.
"""

import contextlib
import json
import os
import sys
import tempfile
import time
from importlib.metadata import version
from pathlib import Path

os.environ["MPLBACKEND"] = "Agg"

with contextlib.redirect_stdout(sys.stderr):
    import irsim
    import numpy as np
    from loguru import logger

logger.remove()


def scenario(asked: dict) -> dict:
    x_m = [wall[0] for wall in asked["walls"]]
    y_m = [wall[1] for wall in asked["walls"]]
    low = [min(x_m) - 10.0, min(y_m) - 10.0]
    lidar = {
        "name": "lidar2d",
        "range_min": 0.12,
        "range_max": asked["range_m"],
        "angle_range": 2.0 * np.pi,
        "number": asked["rays"],
        "noise": True,
        "std": asked["noise_m"],
    }
    robot = {
        "kinematics": {"name": "diff"},
        "shape": {"name": "circle", "radius": 0.22},
        "state": asked["start"],
        "vel_min": [-1, -2],
        "vel_max": [1, 2],
        "sensors": [lidar],
    }
    walls = [
        {"shape": {"name": "rectangle", "length": length, "width": width}, "state": [x, y, yaw]}
        for x, y, yaw, length, width in asked["walls"]
    ]
    world = {
        "width": max(x_m) + 10.0 - low[0],
        "height": max(y_m) + 10.0 - low[1],
        "offset": low,
        "step_time": asked["step_s"],
        "sample_time": asked["step_s"],
        "collision_mode": "stop",
    }
    return {"world": world, "robot": [robot], "obstacle": walls}


def main() -> None:
    asked = json.load(sys.stdin)
    command = np.array([[0.15], [1.0]])
    with contextlib.redirect_stdout(sys.stderr), tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "maze.yaml"
        file.write_text(json.dumps(scenario(asked)))
        env = irsim.make(str(file), display=False, disable_all_plot=True, log_level="ERROR")
        env.step(command)
        runs_ms, scans_ms = [], []
        for _ in range(asked["repeats"]):
            start_s = time.perf_counter()
            for _ in range(asked["steps"]):
                env.step(command)
            runs_ms.append((time.perf_counter() - start_s) * 1e3)
        for _ in range(10 * asked["repeats"]):
            start_s = time.perf_counter()
            env.robot.sensor_step()
            scans_ms.append((time.perf_counter() - start_s) * 1e3)
        echoes = int(
            np.sum(np.asarray(env.robot.get_lidar_scan()["ranges"]) < asked["range_m"] - 0.1)
        )
        moved = [float(value) for value in env.robot.state.ravel()[:3]]
        env.end()
    print(
        json.dumps(
            {
                "version": version("ir-sim"),
                "runs_ms": runs_ms,
                "scans_ms": scans_ms,
                "echoes": echoes,
                "state": moved,
            }
        )
    )


main()
