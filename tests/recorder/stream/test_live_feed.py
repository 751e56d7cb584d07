"""A viewer that takes nothing holds up neither the recording nor its recorder."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest
import rerun as rr
import rerun.blueprint as rrb

from mazebot.bench.parts.loopback_router import free_port
from mazebot.recorder.config import RecorderConfig
from mazebot.recorder.keeping import live as live_module
from mazebot.recorder.keeping.live import LiveView
from mazebot.recorder.keeping.run import run as run_module
from mazebot.recorder.node import RecorderNode
from mazebot.recorder.stream import live_feed
from tests.recorder.stream.stalled_viewer import stalled_viewer
from tests.recorder.synthetic import Bench, driving, opening, room
from tests.recorder.test_node import verify


def until(condition: Callable[[], bool], timeout_s: float = 20.0) -> None:
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.02)


def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Bring a viewer soon to where it does not keep up: it is so many chunks behind."""
    monkeypatch.setattr(run_module, "SEND_PERIOD_S", 0.0)
    monkeypatch.setattr(live_feed, "BATCH_PERIOD_S", 0.01)
    monkeypatch.setattr(live_feed, "_SLOW_S", 0.6)
    monkeypatch.setattr(live_feed, "_FLUSH_TIMEOUT_S", 0.1)
    monkeypatch.setattr(live_feed, "_END_TIMEOUT_S", 0.1)
    monkeypatch.setattr(live_module, "_END_TIMEOUT_S", 0.1)


@pytest.mark.slow
def test_a_viewer_that_stalls_costs_the_file_nothing_and_nobody_waits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    impatient(monkeypatch)
    port = free_port()
    config = RecorderConfig(
        recordings_dir=tmp_path, live=True, bind="127.0.0.1", web_port=free_port(), grpc_port=port
    )
    world = room()
    bench = Bench(RecorderNode(config))
    bench.say(opening(world))
    longest_s, second = 0.0, 0
    with stalled_viewer(port):
        # As long as it takes to fill what the server keeps for a viewer, and a second more.
        while "does not keep up" not in caplog.text or second % 5:
            start_s = time.monotonic()
            bench.say(driving(world, 1.0, second * 1_000_000_000))
            longest_s = max(longest_s, time.monotonic() - start_s)
            assert bench.node.waiting_for() is None
            second += 1
            assert second < 200
        start_s = time.monotonic()
        bench.node.close()
        assert time.monotonic() - start_s < 5.0
    assert longest_s < 2.0
    (run,) = tmp_path.iterdir()
    assert [path.name for path in run.glob("*.rrd")] == ["run.rrd"]
    verify(run / "run.rrd")
    assert "disk" not in caplog.text
    assert "recording stopped" not in caplog.text


@pytest.mark.slow
def test_behind_a_viewer_that_stalls_only_the_newest_of_everything_waits(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    impatient(monkeypatch)
    monkeypatch.setattr(live_feed, "_MOST_WAITING", 100)
    port = free_port()
    live = LiveView("127.0.0.1", free_port(), port, 64)
    feed = live.feed
    feed.begin("run", rrb.Blueprint(), {"seed": "1"})
    places = [(0.0, 0.0, float(i)) for i in range(1000)]
    points = rr.Points3D.columns(positions=places).partition([1000])

    def say(count: int) -> None:
        for number in range(count):
            times = rr.TimeColumn(live_feed.TIMELINE, duration=[number * 1e-9])
            feed.send_columns(f"points/{number % 7}", times, points)

    def is_stuck() -> bool:
        say(50)
        return "does not keep up" in caplog.text

    try:
        with stalled_viewer(port):
            until(is_stuck)
            feed.log_static("floor", rr.Points3D(places).as_component_batches())
            say(10_000)
            waiting = {key[0] for key in (entry.key for entry in feed._waiting)}  # type: ignore[index]
            assert waiting == {"floor", *(f"points/{number}" for number in range(7))}
            assert len(feed._waiting) <= 100
        until(lambda: not feed._waiting)  # the viewer has gone
    finally:
        live.close()
