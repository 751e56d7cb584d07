"""What a node takes for a message of the run that it is in."""

import numpy as np

from mazebot.common.maths.frames import SE2
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import SimulationStats
from mazebot.common.messages.topics import MAP, SIMULATION_STATS
from mazebot.common.node.node import Envelope, Inbox
from mazebot.common.node.simulation_watch import SimulationWatch
from mazebot.explorer.config import ExplorerConfig
from mazebot.explorer.node import ExplorerNode
from tests.common.samples import SAMPLES

S = 1_000_000_000


def delivered(inbox: Inbox, stamp_ns: int, number: int = 0) -> None:
    grid = msg.occupancy_grid(stamp_ns, 0.05, SE2(0.0, 0.0, 0.0), np.zeros((2, 2), np.int8))
    inbox.deliver(MAP, grid, Envelope("mapping", number, stamp_ns, ""))


def taken_ns(watch: SimulationWatch, inbox: Inbox, now_ns: int) -> int | None:
    watch.restarted(now_ns, ())
    grid = watch.latest_of_this_run(MAP, inbox)
    return None if grid is None else msg.ns_from_time(grid.header.stamp)


def test_a_message_that_is_sent_once_is_taken_when_its_time_has_come() -> None:
    watch, inbox = SimulationWatch(0), Inbox(ExplorerNode(ExplorerConfig()))
    delivered(inbox, 3 * S)
    assert taken_ns(watch, inbox, 0) is None
    assert taken_ns(watch, inbox, 2 * S) is None
    assert taken_ns(watch, inbox, 3 * S) == 3 * S
    assert taken_ns(watch, inbox, 4 * S) is None
    assert not inbox.counts[MAP.name].rejected


def test_that_of_a_run_that_has_ended_gives_way_to_the_new_one_s() -> None:
    watch, inbox = SimulationWatch(0), Inbox(ExplorerNode(ExplorerConfig()))
    assert taken_ns(watch, inbox, 100 * S) is None
    delivered(inbox, 99 * S)
    assert taken_ns(watch, inbox, S) is None
    delivered(inbox, 2 * S, 1)
    assert taken_ns(watch, inbox, 2 * S) == 2 * S
    assert taken_ns(watch, inbox, 200 * S) is None


def test_one_that_comes_before_the_news_of_a_restart_is_given_again() -> None:
    watch, inbox = SimulationWatch(0), Inbox(ExplorerNode(ExplorerConfig()))
    assert taken_ns(watch, inbox, 100 * S) is None
    delivered(inbox, 2 * S)
    assert taken_ns(watch, inbox, 101 * S) == 2 * S
    assert taken_ns(watch, inbox, S) is None
    assert taken_ns(watch, inbox, 2 * S) == 2 * S
    assert taken_ns(watch, inbox, 3 * S) is None


def told(epoch: int, time_s: float, resumed_from: int | None = None) -> SimulationStats:
    stats: SimulationStats = SAMPLES[SIMULATION_STATS]
    changes = {"epoch": epoch, "sim_time_s": time_s, "resumed_from": resumed_from}
    return stats.model_copy(update=changes)


def test_a_simulator_that_goes_on_where_it_was_begins_no_other_run() -> None:
    watch = SimulationWatch(0)
    assert not watch.restarted(S, [told(1, 1.0)])
    assert not watch.restarted(2 * S, [told(2, 2.0, resumed_from=1)])
    assert not watch.restarted(3 * S, [told(3, 3.0, resumed_from=1)])
    assert watch.epoch == 1
    assert watch.restarted(4 * S, [told(4, 4.0)])
    # Two on, of which the first was missed.
    assert watch.restarted(5 * S, [told(6, 5.0, resumed_from=5)])
    assert watch.epoch == 5
