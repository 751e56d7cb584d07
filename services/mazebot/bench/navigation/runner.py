"""Runs seeds of scenarios, in several processes.

A newly started process cannot find what stands in a package's `__main__`.
"""

from __future__ import annotations

import logging
import multiprocessing
import signal
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import NamedTuple

from mazebot.bench.navigation.courses.scenarios import BY_NAME
from mazebot.bench.navigation.scenario import Options, Row


class Unit(NamedTuple):
    """One seed of one scenario: what one process runs at a time."""

    scenario: str
    seed: int


class Ran(NamedTuple):
    """The trials of a unit."""

    rows: list[Row]
    cpu_s: float


def run_unit(unit: Unit, options: Options) -> Ran:
    """Run one seed; an error in it makes a failed trial and does not end the benchmark."""
    with quiet():
        start_s = time.process_time()
        rows = _rows_of(unit, options)
        return Ran(rows, time.process_time() - start_s)


@contextmanager
def quiet() -> Iterator[None]:
    """Log nothing in this context: the services of a thousand drives."""
    before = logging.root.manager.disable
    logging.disable(logging.ERROR)
    try:
        yield
    finally:
        logging.disable(before)


def _rows_of(unit: Unit, options: Options) -> list[Row]:
    try:
        return BY_NAME[unit.scenario].run(unit.scenario, unit.seed, options)
    except Exception as error:
        # It is reported in the table, and the other trials continue.
        text = " ".join(f"{type(error).__name__}: {error}".split())
        return [Row(unit.scenario, "", unit.seed, 0, error_msg=f"trial failed: {text}")]


def run_units(units: Sequence[Unit], options: Options, jobs: int) -> Iterator[tuple[Unit, Ran]]:
    """Run all, as they are done."""
    if jobs == 1:
        for unit in units:
            yield unit, run_unit(unit, options)
        return
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=leave_interrupts_to_the_first)
    try:
        pending = {pool.submit(run_unit, unit, options): unit for unit in units}
        for done in as_completed(pending):
            yield pending[done], result_of(done, pending[done])
    finally:
        # Of an interrupted run the figures are written before the last seeds have ended.
        pool.shutdown(wait=False, cancel_futures=True)


def result_of(done: Future[Ran], unit: Unit) -> Ran:
    """What a process found; a failed trial where it was killed, for instance for lack of memory."""
    try:
        return done.result()
    except BrokenProcessPool:
        row = Row(unit.scenario, "", unit.seed, 0, error_msg="its process was killed")
        return Ran([row], 0.0)


def leave_interrupts_to_the_first() -> None:
    """The first process ends the others."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
