"""`PACE=lockstep docker compose up`: the same run each time, and the same as in one process."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest

from mazebot.common.bus.subscriber import subscribe
from mazebot.common.messages.documents import SimulationStats
from mazebot.common.messages.topics import SIMULATION_STATS, Topic
from mazebot.common.messages.wire import decode
from mazebot.common.node.executive import Executive, MemoryTransport
from mazebot.common.node.node import Envelope
from mazebot.embedded.demo import DemoOptions, build_nodes
from tests.compose.checks import check_recordings, check_table
from tests.compose.stack import DEMOS, SERVICES, Stack, stack_of, wait_until

pytestmark = [pytest.mark.compose, pytest.mark.usefixtures("image")]

DEMO = DEMOS["enhanced"]
SETTINGS = {"PACE": "lockstep"}
EPISODE_S = 15.0
START_S = 240.0


def told(stats: list[SimulationStats], until_s: float = EPISODE_S) -> list[SimulationStats]:
    """What was said of an episode up to a time."""
    return [one for one in stats if one.sim_time_s <= until_s]


class _Statistics(MemoryTransport):
    """Keeps what physics says of the simulation."""

    def __init__(self) -> None:
        super().__init__()
        self.stats: list[SimulationStats] = []

    def _send(self, topic: Topic[object], message: object, envelope: Envelope) -> None:
        if isinstance(message, SimulationStats):
            self.stats.append(message)
        super()._send(topic, message, envelope)


def driven(options: DemoOptions) -> list[SimulationStats]:
    """The whole tour in one process."""
    transport = _Statistics()
    executive = Executive(build_nodes(options), transport)
    try:
        assert executive.run() == 0
    finally:
        executive.close()
    return transport.stats


@pytest.fixture(scope="module")
def in_process(
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Future[list[SimulationStats]]]:
    """What will have been said of the tour in one process. Services that take turns leave another
    processor to it.
    """
    folder = tmp_path_factory.mktemp("tour") / "run"
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        yield pool.submit(driven, DemoOptions(out_dir=folder, record=False))


@contextmanager
def listening(stack: Stack) -> Iterator[list[SimulationStats]]:
    """What physics says of the simulation, from its first step on."""
    session = stack.session(60.0)
    stats: list[SimulationStats] = []
    subscription = subscribe(
        session, SIMULATION_STATS, lambda data, _: stats.append(decode(SIMULATION_STATS, data))
    )
    try:
        yield stats
    finally:
        del subscription
        session.close()  # type: ignore[no-untyped-call]


@contextmanager
def running(person: int) -> Iterator[tuple[Stack, list[SimulationStats]]]:
    """A stack that is listened to before its tour may begin."""
    with stack_of(person, SETTINGS) as stack:
        assert stack.compose("up", "--detach", *SERVICES).returncode == 0
        with listening(stack) as stats:
            yield stack, stats


def test_a_tour_in_lockstep_is_that_of_one_process(
    person: int, in_process: Future[list[SimulationStats]], tmp_path: Path
) -> None:
    with running(person) as (stack, stats):
        assert not stats, "physics stepped before all were there"
        up = stack.compose("up", DEMO, timeout_s=600.0)
        assert up.returncode == 0, up.stdout
        check_table(stack.logs(DEMO))
        expected = in_process.result()
        end_s = expected[-1].sim_time_s
        wait_until(lambda: stats[-1].sim_time_s > end_s, 20.0, "what comes after the tour")
        assert told(stats, end_s) == expected
        assert stack.down() <= 5.0
        assert "error" not in stack.compose("logs").stdout
        (summary,) = check_recordings(stack)
        assert [goal["reached"] for goal in summary["goals"]] == [True] * 5
        (config,) = stack.recordings.glob("*/config.yaml")
        # As `mazebot demo --config` would, on this side of the containers.
        repeated = DemoOptions(settings=config, out_dir=tmp_path / "again", record=False)
        assert driven(repeated) == expected


@pytest.mark.longest
@pytest.mark.parametrize("attempt", range(3))
def test_it_repeats(person: int, in_process: Future[list[SimulationStats]], attempt: int) -> None:
    with running(person) as (stack, stats):
        assert stack.compose("up", "--detach", DEMO).returncode == 0
        wait_until(
            lambda: bool(stats) and stats[-1].sim_time_s > EPISODE_S, START_S, f"run {attempt}"
        )
        assert told(stats) == told(in_process.result())


def test_it_repeats_until_one_dies_who_is_named_and_the_stack_begins_anew(
    person: int, in_process: Future[list[SimulationStats]]
) -> None:
    expected = told(in_process.result())
    with running(person) as (stack, stats):
        assert stack.compose("up", "--detach", DEMO).returncode == 0
        wait_until(lambda: bool(stats) and stats[-1].sim_time_s > EPISODE_S, START_S, "the drive")
        assert told(stats) == expected
        stack.kill("navigation")
        named = "lockstep: navigation disconnected at"
        wait_until(lambda: named in stack.logs("physics"), 20.0, "why physics ended")
        del stats[:]
        wait_until(
            lambda: bool(stats) and 2.0 < stats[-1].sim_time_s < 5.0, START_S, "the next run"
        )
