"""A sequence of faults in mid-drive, each with a steady state before and after."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

from mazebot.bench.chaos.faults import MACHINES, SHAPES, Fault
from mazebot.bench.chaos.stacks import Stack
from mazebot.bench.chaos.tasks import GOAL_S, RECOVERY_S, Drive, Exploration, Task
from mazebot.bench.chaos.trial import Trial
from mazebot.bench.chaos.witness import Motion, Witness
from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import wrap_angle
from mazebot.common.node.node import random_generator

STEADY_S = 60.0
_SAME_M, _SAME_RAD = 0.15, 0.3
"""A simulator that goes on may have lost as much of the drive as there is in 0.2 s of it."""


def run_faults(
    stack: Stack,
    witness: Witness,
    faults: Sequence[Fault],
    seed: int,
    tell: Callable[[Trial], None],
    explores: bool = False,
) -> list[Trial]:
    """Do one fault after the other, each in mid-drive, or in mid-exploration."""
    task: Task = Exploration(witness) if explores else Drive(witness, seed)
    moments = random_generator(seed, "chaos/moments")
    trials = []
    for number, fault in enumerate(faults):
        trial = Trial(fault.name, number)
        try:
            _steady(witness, task)
            time.sleep(float(moments.uniform(0.0, 1.0)))
            try_one(stack, witness, task, fault, trial)
        except ConfigError as error:
            trial.problem = str(error)
        trials.append(trial)
        tell(trial)
        witness.forget()
    try:
        task.finish()
    except ConfigError as error:
        trials[-1].problem = trials[-1].problem or str(error)
    return trials


def _steady(witness: Witness, task: Task) -> None:
    """Wait until the robot is well on its way. Raises ConfigError."""
    witness.wait(lambda: witness.is_active, STEADY_S, "an active navigation before the fault")
    end_s = time.monotonic() + GOAL_S
    while not task.is_driving():
        if task.is_over():
            task.begin()
        if time.monotonic() > end_s:
            raise ConfigError("the robot does not drive before the fault")
        time.sleep(0.1)


def try_one(stack: Stack, witness: Witness, task: Task, fault: Fault, trial: Trial) -> None:
    """Do one fault in mid-drive, and see what becomes of it. Raises ConfigError where the robot
    does not drive before, or not again.
    """
    stack.look()
    if not task.is_driving():
        _steady(witness, task)
    there, world_hash, stops = witness.alive(), _hash(witness), _watchdog_stops(witness)
    begun_s = time.monotonic()
    before = witness.last_before(begun_s)
    trial.seen_m2 = 0.0 if witness.exploration is None else witness.exploration[1].free_m2
    fault.begin(stack)
    if fault.kind == "squeeze":
        # It took until now.
        begun_s = time.monotonic()
        before = witness.last_before(begun_s)
    if fault.hold_s:
        time.sleep(fault.hold_s)
    fault.end(stack)
    ended_s = time.monotonic() if fault.hold_s else begun_s
    if "router" in fault.services or fault.ends_all:
        witness.close()
        witness.open()
    killed = fault.services if fault.kills else ()

    def is_back() -> bool:
        here = witness.alive()
        return all(here.get(one, frozenset()) - there.get(one, frozenset()) for one in killed)

    if killed:
        witness.wait(is_back, RECOVERY_S, f"{' and '.join(killed)} back")
        trial.back_s = time.monotonic() - ended_s
    if fault.ends_all:
        # Nobody is left who knows the world: the demo, which is started again too, asks for it.
        witness.request_world(RECOVERY_S)
    witness.wait(lambda: witness.active_since(ended_s), RECOVERY_S, "an active navigation")
    trial.drives_s = time.monotonic() - ended_s
    _judge_stop(witness, fault, trial, before, begun_s)
    _judge_continuity(witness, fault, trial, before, ended_s, world_hash)
    if fault.kind in MACHINES and _watchdog_stops(witness) != stops:
        trial.problem = "the watchdog has stopped the robot"
    if fault.ends_all:
        trial.goal = "ended with the stack"
    try:
        task.conclude(trial)
    finally:
        trial.contacts = sum(at_s > begun_s for at_s, _ in witness.contacts)


def _hash(witness: Witness) -> str:
    return "" if witness.stats is None else witness.stats.world_hash


def _watchdog_stops(witness: Witness) -> int:
    return 0 if witness.stats is None else witness.stats.watchdog_stops


def _judge_stop(
    witness: Witness, fault: Fault, trial: Trial, before: Motion | None, begun_s: float
) -> None:
    rest = witness.rest_after(begun_s)
    if not fault.stops or rest is None or before is None:
        return
    trial.stop_m = math.hypot(rest.x_m - before.x_m, rest.y_m - before.y_m)
    hidden = {"physics", "router"} & set(fault.services) or fault.ends_all
    if not hidden:
        trial.stop_s = rest.wall_s - begun_s


def _judge_continuity(
    witness: Witness,
    fault: Fault,
    trial: Trial,
    before: Motion | None,
    ended_s: float,
    world_hash: str,
) -> None:
    """Whether the simulation goes on where it was, after its process was another one."""
    if "physics" not in fault.services or fault.kind in SHAPES or before is None:
        trial.same_world = _hash(witness) == world_hash
        return
    first = next((one for one in witness.motions if one.wall_s > ended_s), None)
    trial.same_world = (
        first is not None
        and _hash(witness) == world_hash
        and first.stamp_ns >= before.stamp_ns
        and math.hypot(first.x_m - before.x_m, first.y_m - before.y_m) < _SAME_M
        and abs(wrap_angle(first.yaw_rad - before.yaw_rad)) < _SAME_RAD
    )
    if not trial.same_world and fault.kills:
        trial.problem = "the simulation did not go on where it was"
