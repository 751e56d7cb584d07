"""`make soak`: an hour of simulated driving to random reachable goals. Contacts and growing memory
are failures.
"""

from __future__ import annotations

import argparse
import json
import logging
import math
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from mazebot.bench.memory import resident_mb
from mazebot.common.config import ConfigError, ServiceConfig, fail
from mazebot.common.maths.frames import MAP_FRAME, SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import Evaluation, Planar, WorldRequest
from mazebot.common.messages.topics import (
    EVALUATION,
    GOAL_POSE,
    NAVIGATION_RESULT,
    NAVIGATION_STATUS,
    WORLD,
    WORLD_REQUEST,
)
from mazebot.common.node.executive import Executive, MemoryTransport
from mazebot.common.node.node import Inbox, Node, Outbox, random_generator
from mazebot.common.settings.load import load
from mazebot.common.world.costmap import FREE
from mazebot.common.world.grids import connected_regions, distance_cells
from mazebot.embedded.demo import DemoOptions, bringup_config, robot_nodes
from mazebot.recorder.config import RecorderConfig
from mazebot.recorder.node import RecorderNode
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.recipe.loader import load_world

CLEARANCE_M = 0.35
"""Minimum clearance of a goal: the robot turns there, and maps are rounded to cells."""
LEAST_DRIVE_M = 1.0
"""Minimum straight-line distance between two goals."""
SLOPE_LIMIT_MB_H = 1.0
SAMPLE_S = 10.0
WARM_UP_SHARE = 0.25
"""Share of the drive that is ignored, because caches are filling."""
LEAST_HOURS_JUDGED = 0.2
"""Minimum time after the warm-up to judge the slope, since memory grows in steps."""
_NOTHING_NEW_S = 300.0
"""Simulation time without a goal result after which the robot counts as stuck."""


class Sample(NamedTuple):
    """Memory of the process at a simulation time."""

    time_s: float
    memory_mb: float


class Ended(NamedTuple):
    """The data kept of a goal that has ended: little, since memory is being measured."""

    error_code: int
    number_of_recoveries: int


@dataclass
class Drive:
    """The result of a drive."""

    results: list[Ended] = field(default_factory=list)
    samples: list[Sample] = field(default_factory=list)
    evaluation: Evaluation | None = None
    state_hash: str = ""
    real_time_factor: float = 0.0
    stuck: bool = False

    @property
    def reached(self) -> int:
        """Number of goals reached."""
        return sum(result.error_code == 0 for result in self.results)

    @property
    def contacts(self) -> int:
        """Number of contacts of the robot."""
        return len(self.evaluation.contacts) if self.evaluation is not None else 0

    def slope_mb_h(self) -> tuple[float, float] | None:
        """Memory growth per simulated hour after the warm-up, by least squares, and the hours
        measured; None if these are too few.
        """
        if len(self.samples) < 2:
            return None
        times_s, memory_mb = np.array(self.samples).T
        late = times_s >= WARM_UP_SHARE * times_s[-1]
        hours = float(times_s[late][-1] - times_s[late][0]) / 3600.0
        if hours < LEAST_HOURS_JUDGED:
            return None
        return float(np.polyfit(times_s[late] / 3600.0, memory_mb[late], 1)[0]), hours

    def faults(self) -> list[str]:
        """The reasons why this drive failed."""
        faults = []
        if self.contacts:
            faults.append(f"{self.contacts} contacts")
        slope = self.slope_mb_h()
        if slope is not None and slope[0] > SLOPE_LIMIT_MB_H:
            faults.append(f"memory grows by {slope[0]:.2f} MB per simulated hour")
        if self.stuck:
            faults.append(f"no goal finished for {_NOTHING_NEW_S:g} s of simulation")
        return faults


class RandomGoals(Node):
    """Replaces bringup: requests a world, and drives to one goal after another in it."""

    name: ClassVar[str] = "bringup"
    _config = ServiceConfig()
    period_ns: ClassVar[int | None] = 100_000_000

    def __init__(self, request: WorldRequest, goals: Iterator[Planar]) -> None:
        self._request = request
        self._goals = goals
        self._requested = False
        self._active = False
        self._goal_stamp_ns: int | None = None
        self.results: list[Ended] = []
        self.evaluation: Evaluation | None = None

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        """Send the next goal when the last one has ended."""
        if not self._requested:
            self._requested = True
            outbox.put(WORLD_REQUEST, self._request)
        world = inbox.latest(WORLD)
        if world is not None:
            self.world_hash = world.hash
        for status in inbox.new(NAVIGATION_STATUS):
            self._active = status.localization_active and status.navigation_active
        self.evaluation = inbox.latest(EVALUATION) or self.evaluation
        for result in inbox.new(NAVIGATION_RESULT):
            if result.goal_stamp_ns == self._goal_stamp_ns:
                self.results.append(Ended(result.error_code, result.number_of_recoveries))
                self._goal_stamp_ns = None
        if self._active and self._goal_stamp_ns is None:
            goal = next(self._goals)
            pose = msg.pose_from_se2(SE2(goal.x_m, goal.y_m, goal.yaw_rad))
            outbox.put(GOAL_POSE, msg.PoseStamped(header=msg.header(now_ns, MAP_FRAME), pose=pose))
            self._goal_stamp_ns = now_ns


def reachable_goals(loaded: LoadedWorld, seed: int) -> Iterator[Planar]:
    """An infinite sequence of poses on free floor connected to the start, each at some distance
    from the last. Raises ValueError where there are none.
    """
    free = np.asarray(loaded.map_cells) == FREE
    side_m = loaded.world.map_resolution_m
    roomy = distance_cells(~free) * side_m >= CLEARANCE_M
    regions = connected_regions(roomy)
    map_from_grid = loaded.map_origin
    here = map_from_grid.inverse() @ loaded.world.start.se2()
    rows, columns = np.nonzero(roomy)
    if not len(rows):
        raise ValueError(f"world: {loaded.world.name}: has no free space to drive in")
    near = np.argmin((columns - here.x_m / side_m) ** 2 + (rows - here.y_m / side_m) ** 2)
    mine = regions[rows, columns] == regions[rows[near], columns[near]]
    rows, columns = rows[mine], columns[mine]
    places = [
        map_from_grid @ SE2((column + 0.5) * side_m, (row + 0.5) * side_m, 0.0)
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True)
    ]
    spread_m = max(place.distance_m(places[0]) for place in places)
    return _wander(places, min(LEAST_DRIVE_M, spread_m / 2.0), seed)


def _wander(places: Sequence[SE2], least_m: float, seed: int) -> Iterator[Planar]:
    random = random_generator(seed, "soak/goals")
    last = places[0]
    while True:
        place = places[int(random.integers(len(places)))]
        yaw_rad = float(random.uniform(-math.pi, math.pi))
        if place.distance_m(last) >= least_m:
            last = place
            yield Planar(x_m=place.x_m, y_m=place.y_m, yaw_rad=yaw_rad)


def drive(options: DemoOptions, hours: float, console: Console) -> Drive:
    """Drive for this number of simulated hours.

    Raises ConfigError where the world cannot be loaded.
    """
    wanted = bringup_config(options)
    worlds_dir = {"worlds_dir": options.worlds_dir} if options.worlds_dir is not None else {}
    loaded = load_world(wanted.world_name, wanted.use_aruco, overrides=wanted.world_overrides,
                        **worlds_dir)  # fmt: skip
    request = WorldRequest(
        world_name=wanted.world_name,
        use_aruco=wanted.use_aruco,
        overrides=wanted.world_overrides,
    )
    goals = RandomGoals(request, reachable_goals(loaded, wanted.seed))
    del loaded
    done = Drive()
    with tempfile.TemporaryDirectory() as folder:
        out_dir = Path(folder) / "run"
        config = load(
            RecorderConfig,
            "recorder",
            [],
            {"seed": wanted.seed, "record": bool(options.record), "out_dir": out_dir},
        )
        executive = Executive(
            [*robot_nodes(options), goals, RecorderNode(config)], MemoryTransport()
        )
        for node in executive.nodes:
            # What is loaded later would count as growth.
            node.prepare()
        try:
            _run(executive, goals, done, hours, console)
        finally:
            executive.close()
        summary = json.loads((out_dir / "summary.json").read_text(encoding="utf-8"))
    done.state_hash = summary["state_hash"]
    return done


def _run(
    executive: Executive, goals: RandomGoals, done: Drive, hours: float, console: Console
) -> None:
    start_s, end_s = time.perf_counter(), hours * 3600.0
    ended, ended_s = 0, 0.0
    while not done.stuck and executive.now_ns * 1e-9 < end_s:
        until_ns = executive.now_ns + round(min(SAMPLE_S, end_s) * 1e9)
        executive.run(lambda until_ns=until_ns: executive.now_ns >= until_ns)  # type: ignore[misc]
        now_s = executive.now_ns * 1e-9
        done.results, done.evaluation = goals.results, goals.evaluation
        done.samples.append(Sample(now_s, resident_mb()))
        done.real_time_factor = now_s / (time.perf_counter() - start_s)
        if len(done.results) > ended:
            ended, ended_s = len(done.results), now_s
        done.stuck = now_s - ended_s > _NOTHING_NEW_S
        if len(done.samples) % 30 == 0:
            console.print(_progress(done), style="dim")


def _progress(done: Drive) -> str:
    time_s, memory = done.samples[-1]
    return (
        f"{time_s:.0f} s simulated, {done.real_time_factor:.1f}x real time, "
        f"{done.reached} of {len(done.results)} goals, {done.contacts} contacts, {memory:.1f} MB"
    )


def _table(done: Drive) -> Table:
    table = Table(box=box.SIMPLE_HEAD, show_header=False)
    evaluation, slope = done.evaluation, done.slope_mb_h()
    table.add_row("simulated", f"{done.samples[-1].time_s / 3600.0:.2f} h")
    table.add_row("real time factor", f"{done.real_time_factor:.1f}")
    table.add_row("goals reached", f"{done.reached} of {len(done.results)}")
    recoveries = sum(result.number_of_recoveries for result in done.results)
    table.add_row("recoveries", str(recoveries))
    table.add_row("contacts", str(done.contacts))
    if evaluation is not None:
        metres, radians = evaluation.localisation_error_m, evaluation.localisation_error_rad
        if metres.p95 is not None and radians.p95 is not None:
            table.add_row("localisation error p95", f"{metres.p95:.3f} m")
            table.add_row("", f"{math.degrees(radians.p95):.2f} deg")
    first, last = done.samples[0].memory_mb, done.samples[-1].memory_mb
    table.add_row("memory at first and last", f"{first:.1f} MB, {last:.1f} MB")
    slope_text = "run too short" if slope is None else f"{slope[0]:+.2f} MB/h over {slope[1]:.2f} h"
    table.add_row("its slope after warm-up", slope_text)
    table.add_row("state hash", done.state_hash)
    return table


def main(arguments: list[str] | None = None) -> int:
    """Drive and print; return 0 if the drive has no faults."""
    parser = argparse.ArgumentParser(prog="soak", description=__doc__)
    parser.add_argument("--hours", type=float, default=1.0, help="simulated hours to drive")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--world", default="enhanced")
    parser.add_argument("--camera", action="store_true", help="with camera images and markers")
    parser.add_argument("--record", action="store_true", help="with a recording, discarded")
    options = parser.parse_args(arguments)
    if not 0.0 < options.hours <= 1000.0:
        fail(f"--hours: must be more than 0, at most 1000 (got {options.hours:g})")
    logging.disable(logging.INFO)
    console = Console()
    demo = DemoOptions(
        world_name=options.world, seed=options.seed, camera=options.camera, record=options.record,
        renderer="auto" if options.camera else "none",
    )  # fmt: skip
    try:
        done = drive(demo, options.hours, console)
    except (ConfigError, ValueError) as error:
        fail(str(error))
    console.print(_table(done))
    faults = done.faults()
    if faults:
        console.print("; ".join(faults), style="red")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
