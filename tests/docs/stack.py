"""All services in processes of their own round a router, for commands that need a running stack."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

from mazebot.bench.parts.loopback_router import running_router

FLAGS: dict[str, tuple[str, ...]] = {
    "worldgen": (),
    "physics": ("--camera-enabled", "false"),
    "spawner": (),
    "perception": (),
    "localization": (),
    "navigation": (),
}


SIMULATOR = ("worldgen", "physics", "spawner")


@contextmanager
def running_stack(
    pace: str = "2", camera: bool = False, goal: tuple[float, float, float] | None = (0.5, 0.0, 0.0)
) -> Iterator[str]:
    """The endpoint of a stack in the enhanced world, active, with its first goal reached; without a
    goal, of a simulator in which nobody localises or drives.

    Raises AssertionError, with what the services said, where it does not come up.
    """
    with running_router() as endpoint, tempfile.TemporaryFile("w+") as log:
        environment = {
            **os.environ,
            "MAZEBOT_BUS_CONNECT": endpoint,
            "MAZEBOT_BUS_PACE": pace,
        }

        def start(name: str, *flags: str) -> subprocess.Popen[bytes]:
            command = [sys.executable, "-m", f"mazebot.{name}", *flags]
            return subprocess.Popen(command, env=environment, stdout=log, stderr=subprocess.STDOUT)

        flags_of = {**FLAGS, "physics": ()} if camera else FLAGS
        names = SIMULATOR if goal is None else flags_of.keys()
        processes = [start(name, *flags_of[name]) for name in names]
        drive = ("--drive", "false") if goal is None else ("--goal", str(list(goal)))
        try:
            bringup = start("bringup", "--world-name", "sim_house_enhanced", *drive)
            code = bringup.wait(timeout=90)
            log.seek(0)
            assert code == 0, log.read()
            yield endpoint
        finally:
            for process in processes:
                process.kill()
                process.wait()
