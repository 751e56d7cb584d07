from collections.abc import Mapping
from typing import Any

from mazebot.common.config import ServiceConfig
from mazebot.common.messages import messages as msg
from mazebot.common.messages.topics import CAMERA_IMAGE, DETECTIONS, IMU, PLAN, SCAN, Topic
from mazebot.common.node.diagnostics import SelfReport
from mazebot.common.node.node import ClockNode, Envelope, Inbox, Node, Outbox
from tests.common.samples import SAMPLES

S = 1_000_000_000


class Physics(ClockNode):
    name = "physics"
    _config = ServiceConfig()
    now_ns = 0
    promised: Mapping[str, float] = {SCAN.name: 10.0}

    def next_step_ns(self) -> int | None:
        return None

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        pass

    def nominal_rates_hz(self) -> Mapping[str, float | Topic[Any]]:
        return self.promised


class Perception(Node):
    name = "perception"
    _config = ServiceConfig()

    def step(self, now_ns: int, inbox: Inbox, outbox: Outbox) -> None:
        pass

    def nominal_rates_hz(self) -> Mapping[str, float | Topic[Any]]:
        return {DETECTIONS.name: CAMERA_IMAGE}


class Telling(Perception):
    def facts(self) -> Mapping[str, str]:
        return {"unknown marker DICT_4X4_100:7": "3"}


def boxes(node: Node) -> tuple[Inbox, Outbox, SelfReport]:
    inbox, outbox = Inbox(node), Outbox(node, lambda *_: None)
    return inbox, outbox, SelfReport(node, inbox, outbox)


def told(array: msg.DiagnosticArray) -> tuple[int, str, dict[str, str]]:
    (status,) = array.status
    return status.level, status.message, {value.key: value.value for value in status.values}


def send(outbox: Outbox, topic: Topic[Any], count: int) -> None:
    for _ in range(count):
        outbox.put(topic, SAMPLES[topic])


def test_rates_are_per_second_of_simulation() -> None:
    _, outbox, report = boxes(Physics())
    send(outbox, SCAN, 1)
    send(outbox, IMU, 1)
    assert "rate_hz /scan" not in told(report.report(S))[2]
    send(outbox, SCAN, 20)
    send(outbox, IMU, 240)
    level, message, values = told(report.report(3 * S))
    assert values["rate_hz /scan"] == "10.00"
    assert values["rate_hz /imu"] == "120.00"
    assert "rate_hz /odom" not in values
    assert (level, message) == (0, "active")


def test_a_rate_that_is_not_kept_is_a_warning_until_it_is() -> None:
    _, outbox, report = boxes(Physics())
    send(outbox, SCAN, 1)
    report.report(0)
    send(outbox, SCAN, 17)
    level, message, values = told(report.report(2 * S))
    assert values["rate_hz /scan"] == "8.50"
    assert level == 1
    assert message == "slow: /scan at 8.50 Hz"
    # Within the next window the last rate stands.
    assert told(report.report(3 * S))[0] == 1
    send(outbox, SCAN, 19)
    assert told(report.report(4 * S))[0] == 0


def test_what_is_not_promised_may_be_slow() -> None:
    node = Physics()
    node.promised = {}
    _, outbox, report = boxes(node)
    send(outbox, SCAN, 1)
    report.report(0)
    send(outbox, SCAN, 2)
    level, _, values = told(report.report(2 * S))
    assert (level, values["rate_hz /scan"]) == (0, "1.00")


def test_what_is_promised_in_mid_window_is_counted_from_then() -> None:
    node = Physics()
    node.promised = {}
    _, outbox, report = boxes(node)
    send(outbox, SCAN, 1)
    report.report(0)
    node.promised = {SCAN.name: 10.0}
    assert told(report.report(3 * S))[0] == 0
    send(outbox, SCAN, 20)
    assert told(report.report(5 * S))[2]["rate_hz /scan"] == "10.00"


def test_time_that_stands_or_begins_anew_is_no_fault() -> None:
    _, outbox, report = boxes(Physics())
    send(outbox, SCAN, 1)
    for _ in range(60):
        assert told(report.report(9 * S))[0] == 0
    assert told(report.report(1 * S))[0] == 0
    send(outbox, SCAN, 20)
    assert told(report.report(3 * S))[2]["rate_hz /scan"] == "10.00"


def test_who_answers_each_message_is_held_to_the_rate_of_these() -> None:
    inbox, outbox, report = boxes(Perception())
    image = SAMPLES[CAMERA_IMAGE]
    inbox.deliver(CAMERA_IMAGE, image, Envelope("a", 0, 0, ""))
    send(outbox, DETECTIONS, 1)
    report.report(0)
    # Five pictures a second are sent, and each is answered.
    inbox.deliver(CAMERA_IMAGE, image, Envelope("a", 10, 0, ""))
    send(outbox, DETECTIONS, 10)
    inbox.counts[CAMERA_IMAGE.name].lost = 0
    assert told(report.report(2 * S))[0] == 0
    # Ten are sent, and half of them are.
    inbox.deliver(CAMERA_IMAGE, image, Envelope("a", 30, 0, ""))
    send(outbox, DETECTIONS, 10)
    inbox.counts[CAMERA_IMAGE.name].lost = 0
    level, message, _ = told(report.report(4 * S))
    assert (level, message) == (1, "slow: /aruco/detections at 5.00 Hz")


def test_the_real_time_factor_is_told_where_a_clock_is_given_and_time_goes_on() -> None:
    node = Physics()
    _, _, report = boxes(node)
    assert "real_time_factor" not in told(report.report(0))[2]
    report.report(0, wall_s=10.0)
    level, _, values = told(report.report(S, wall_s=11.0))
    assert (level, values["real_time_factor"]) == (0, "1.000")
    level, message, values = told(report.report(2 * S, wall_s=13.0))
    assert (level, values["real_time_factor"]) == (1, "0.500")
    assert message == "slow: real_time_factor 0.50"
    node.paused = True
    assert told(report.report(2 * S, wall_s=15.0))[0] == 0
    node.paused = False
    assert told(report.report(2 * S, wall_s=75.0))[0] == 0
    assert told(report.report(3 * S, wall_s=76.0))[2]["real_time_factor"] == "1.000"


def test_a_plan_that_nobody_asks_for_is_no_fault() -> None:
    class Navigation(Perception):
        name = "navigation"

        def nominal_rates_hz(self) -> Mapping[str, float | Topic[Any]]:
            return {}

    _, outbox, report = boxes(Navigation())
    send(outbox, PLAN, 1)
    report.report(0)
    level, _, values = told(report.report(100 * S))
    assert (level, values["rate_hz /plan"]) == (0, "0.00")


def test_a_pause_between_two_reports_is_no_fault() -> None:
    node = Physics()
    report = boxes(node)[2]
    report.report(1 * S, wall_s=1.0)
    assert told(report.report(2 * S, wall_s=2.0))[2]["real_time_factor"] == "1.000"
    node.interventions += 2
    level, message, values = told(report.report(2 * S + S // 3, wall_s=3.0))
    assert (level, message) == (0, "active")
    assert "real_time_factor" not in values
    assert told(report.report(3 * S + S // 3, wall_s=4.0))[2]["real_time_factor"] == "1.000"


def test_a_node_adds_its_own_facts() -> None:
    _, _, report = boxes(Telling())
    assert told(report.report(S))[2]["unknown marker DICT_4X4_100:7"] == "3"


def test_the_step_time_is_told_where_it_is_measured_and_missed_periods_are_counted() -> None:
    class Periodic(Telling):
        period_ns = 50_000_000

    _, _, report = boxes(Periodic())
    assert "step_time_p99_ms" not in told(report.report(S))[2]
    for tick in range(100):
        report.stepped(tick * 50_000_000, 0.004 if tick < 98 else 0.020)
    values = told(report.report(S))[2]
    assert (values["step_time_p99_ms"], values["missed_periods"]) == ("20.0", "0")
    # Late by three periods; then time begins anew, which misses none.
    for now_ns in (99 * 50_000_000 + 200_000_000, 0, 50_000_000, 60_000_000, 100_000_000):
        report.stepped(now_ns, 0.004)
    assert told(report.report(S))[2]["missed_periods"] == "3"
