import pytest

from mazebot.common.config import ServiceConfig
from mazebot.common.messages.topics import CLOCK, CMD_VEL, DIAGNOSTICS, SCAN
from mazebot.common.node.executive import Executive, MemoryTransport, StalledError
from mazebot.common.node.node import ClockNode, Inbox, Node, Outbox
from tests.common.samples import SAMPLES

STEP_NS = 1_000_000


class Physics(ClockNode):
    name = "physics"
    _config = ServiceConfig()

    def __init__(self, log: list[str]) -> None:
        self.log = log
        self.now_ns = 0
        self.closed = False
        self.running = True

    def next_step_ns(self) -> int | None:
        return self.now_ns + STEP_NS if self.running else None

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        self.now_ns = now_ns
        self.log.append(f"physics {now_ns // STEP_NS} {len(inbox.new(CMD_VEL))}")
        if now_ns % (5 * STEP_NS) == 0:
            outbox.put(SCAN, SAMPLES[SCAN])

    def close(self) -> None:
        self.closed = True


class Navigation(Node):
    name = "navigation"
    _config = ServiceConfig()
    wakes = (SCAN,)

    def __init__(self, log: list[str]) -> None:
        self.log = log

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        self.log.append(f"navigation {now_ns // STEP_NS} {len(inbox.new(SCAN))}")
        outbox.put(CMD_VEL, SAMPLES[CMD_VEL])

    def waiting_for(self) -> str | None:
        return "a scan on /scan"


class Bringup(Node):
    name = "bringup"
    _config = ServiceConfig()
    period_ns = 10 * STEP_NS

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        if now_ns >= 20 * STEP_NS:
            self.exit_code = 3


def test_nodes_step_in_table_order_and_see_what_came_before() -> None:
    log: list[str] = []
    executive = Executive([Navigation(log), Physics(log)], MemoryTransport())
    assert executive.run(lambda: executive.now_ns >= 6 * STEP_NS) is None
    # The scan of step 5 reaches navigation within step 5, its command reaches physics in step 6.
    assert log == [
        "physics 1 0", "physics 2 0", "physics 3 0", "physics 4 0",
        "physics 5 0", "navigation 5 1", "physics 6 1",
    ]  # fmt: skip


def test_a_node_that_is_done_ends_the_run_with_its_code() -> None:
    log: list[str] = []
    physics = Physics(log)
    executive = Executive([physics, Bringup()], MemoryTransport())
    assert executive.run() == 3
    assert executive.now_ns == 20 * STEP_NS
    executive.close()
    assert physics.closed


def test_a_simulation_that_stands_still_says_who_waits_for_what() -> None:
    log: list[str] = []
    physics = Physics(log)
    physics.running = False
    executive = Executive([physics, Navigation(log)], MemoryTransport())
    with pytest.raises(StalledError, match="navigation is waiting for a scan on /scan"):
        executive.run()


def test_a_paused_simulation_is_said_to_be_paused() -> None:
    log: list[str] = []
    physics = Physics(log)
    physics.running, physics.paused = False, True
    executive = Executive([physics, Navigation(log)], MemoryTransport())
    with pytest.raises(StalledError, match="physics is paused and no other node can resume it"):
        executive.run()


def test_time_that_begins_anew_is_everybody_s() -> None:
    class Again(Physics):
        def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
            super().step(now_ns, inbox, outbox)
            if now_ns == 1_500 * STEP_NS and not self.closed:
                self.closed, self.now_ns = True, 0
                outbox.put(SCAN, SAMPLES[SCAN])

    log: list[str] = []
    executive = Executive([Again(log), Navigation(log)], MemoryTransport())
    executive.run(lambda: executive.now_ns == 1_500 * STEP_NS or log[-1] == "navigation 0 1")
    assert executive.now_ns == 0
    executive.run(lambda: executive.now_ns >= 7 * STEP_NS)
    assert log[-3:] == ["navigation 5 1", "physics 6 1", "physics 7 0"]


def test_each_node_tells_of_itself_once_a_second() -> None:
    class Recorder(Node):
        name = "recorder"
        _config = ServiceConfig()
        wakes = (CLOCK, DIAGNOSTICS)
        told: list[str] = []  # noqa: RUF012

        def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
            for array in inbox.new(DIAGNOSTICS):
                self.told += [f"{status.name} {status.message}" for status in array.status]

    log: list[str] = []
    recorder = Recorder()
    executive = Executive([Physics(log), Navigation(log), recorder], MemoryTransport())
    executive.run(lambda: executive.now_ns >= 2_500 * STEP_NS)
    assert recorder.told.count("navigation waiting for a scan on /scan") == 3
    assert recorder.told.count("physics active") == 3
