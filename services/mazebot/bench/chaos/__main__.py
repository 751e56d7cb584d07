"""`make chaos`: faults in mid-drive, what the robot does, and how long until all is well again."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from mazebot.bench.chaos.faults import (
    EXPLORING_FAULTS,
    FAULTS,
    LINK_FAULTS,
    MACHINES,
    SHORT,
    Fault,
)
from mazebot.bench.chaos.machines import compiler
from mazebot.bench.chaos.plots import write_plot
from mazebot.bench.chaos.recordings import faults_of_recordings
from mazebot.bench.chaos.run import run_faults
from mazebot.bench.chaos.scratch import scratch_folder
from mazebot.bench.chaos.stacks import ContainerStack, LinkedStack, ProcessStack, Stack
from mazebot.bench.chaos.summary import Row, met, rows_of
from mazebot.bench.chaos.trial import Trial
from mazebot.bench.chaos.witness import Witness
from mazebot.bench.ending import run
from mazebot.common.bus.session import BusUnavailableError
from mazebot.common.config import ConfigError, fail
from mazebot.common.node.node import random_generator

_ACTIVE_S = 240.0


def main(arguments: Sequence[str]) -> int:
    """Run them; the exit code is 1 where a promise was not kept."""
    options = _options(arguments)
    try:
        faults, left_out = _chosen(options)
    except ConfigError as error:
        fail(str(error))
    for one in left_out:
        _say(f"left out: {one.name}: {_obstacle(one, options.containers)}")
    order = [one for one in faults for _ in range(options.times)]
    order = [
        order[i] for i in random_generator(options.seed, "chaos/order").permutation(len(order))
    ]
    with scratch_folder("mazebot-chaos-") as scratch:
        stack = _stack(options, scratch.path, any(one.kind in MACHINES for one in faults))
        try:
            trials, broken = _run(stack, order, options)
        except (BusUnavailableError, ConfigError) as error:
            fail(str(error))
        rows = rows_of(faults, trials)
        failures = [line for row in rows for line in met(row)] + broken
        scratch.is_needed = bool(failures)
    Console(width=150).print(_table(rows))
    for line in broken:
        _say(f"recording: {line}")
    if options.json:
        report = {
            "seed": options.seed, "containers": options.containers, "explore": options.explore,
            "links": options.links,
            "rows": [row._asdict() for row in rows],
            "trials": [trial.values() for trial in trials], "broken_recordings": broken,
        }  # fmt: skip
        Path(options.json).write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
    if options.plot:
        write_plot(Path(options.plot), rows, trials)
    for line in failures:
        _say(f"not kept: {line}")
    return 1 if failures else 0


def _say(line: str) -> None:
    sys.stderr.write(f"{line}\n")
    sys.stderr.flush()


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="make chaos", description=__doc__)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--times", type=int, default=1, help="how often each fault is done")
    parser.add_argument("--fault", action="append", default=[], help="only this one; repeatable")
    parser.add_argument("--short", action="store_true", help="only the main ones")
    parser.add_argument("--explore", action="store_true", help="while the robot makes its map")
    parser.add_argument("--containers", action="store_true", help="in containers of Docker")
    parser.add_argument("--links", action="store_true", help="with a proxy before the router")
    parser.add_argument("--world", default="sim_house_enhanced")
    parser.add_argument("--json", default="", help="write a report")
    parser.add_argument("--plot", default="", help="write a picture")
    return parser.parse_args(arguments)


def _chosen(options: argparse.Namespace) -> tuple[list[Fault], list[Fault]]:
    """The faults to be done, and those that cannot be done here. Raises ConfigError."""
    if options.links and (options.explore or options.containers):
        raise ConfigError("LINKS: goes with neither EXPLORE nor CONTAINERS")
    table = EXPLORING_FAULTS if options.explore else LINK_FAULTS if options.links else FAULTS
    known = {one.name: one for one in table}
    for name in options.fault:
        if name not in known:
            raise ConfigError(f"FAULT: {name!r:.60}: must be one of {', '.join(known)}")
    wanted = options.fault or [name for name in known if name in SHORT or not options.short]
    chosen = [known[name] for name in wanted]
    left_out = [one for one in chosen if _obstacle(one, options.containers)]
    if len(left_out) == len(chosen):
        # No trial would be a success of nothing.
        names = ", ".join(one.name for one in left_out) or "--short"
        raise ConfigError(f"FAULT: {names}: nothing of it can be done here")
    return [one for one in chosen if one not in left_out], left_out


def _obstacle(fault: Fault, containers: bool) -> str:
    """Why a fault cannot be done here; empty: it can."""
    if fault.needs_containers and not containers:
        return "needs containers (CONTAINERS=1)"
    if fault.kind in MACHINES:
        try:
            compiler()
        except ConfigError as error:
            return str(error)
    return ""


def _stack(options: argparse.Namespace, folder: Path, has_machines: bool) -> Stack:
    if options.links:
        return LinkedStack(folder, options.seed)
    kind = ContainerStack if options.containers else ProcessStack
    return kind(folder, options.seed, options.explore, has_machines)


def _run(
    stack: Stack, order: Sequence[Fault], options: argparse.Namespace
) -> tuple[list[Trial], list[str]]:
    """All trials, and what is wrong with the recordings. Raises ConfigError and
    BusUnavailableError.
    """
    _say("starting the stack")

    def tell(trial: Trial) -> None:
        # Of an exploration the end is known later.
        well = trial.recovered or (options.explore and not trial.problem)
        how = "recovered" if well else f"NOT recovered: {trial.problem or trial.goal}"
        _say(f"{trial.number + 1} of {len(order)}: {trial.fault}: {how}")

    try:
        stack.start()
        witness = Witness(stack.bus, options.world, options.explore)
        try:
            witness.request_world(_ACTIVE_S)
            trials = run_faults(stack, witness, order, options.seed, tell, options.explore)
        finally:
            witness.close()
    finally:
        stack.stop()
    return trials, faults_of_recordings(stack.recordings)


def _table(rows: Sequence[Row]) -> Table:
    table = Table(box=box.SIMPLE_HEAD)
    for name in (
        "fault", "times", "recovered", "contacts", "stop s", "stop m", "back s", "promised",
        "drives again s", "goals reached",
    ):  # fmt: skip
        table.add_column(name, justify="left" if name == "fault" else "right")
    for row in rows:
        table.add_row(*row.cells())
    return table


if __name__ == "__main__":
    run(main)
