"""A recording in a real browser: is what a person would look for on the screen?"""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from mazebot.bench.parts.loopback_router import free_port
from mazebot.recorder.config import RecorderConfig
from mazebot.recorder.node import RecorderNode
from tests.browser.viewer import (
    CHROMIUM,
    Picture,
    count_near,
    opened,
    screenshot,
    served,
)
from tests.recorder.synthetic import Bench, WallClock, driving, opening, room
from tests.recorder.test_node import verify

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed"),
    pytest.mark.timeout(300),
]

SIZE = 1280, 720
# BGR, as the synthetic run paints them.
SKY, GROUND = (200, 60, 30), (20, 200, 230)
OUTLINE = (200, 0, 255)
TRUE_PATH = (113, 204, 46)
LETHAL = (190, 0, 190)
"""Of the costmap, as RViz has it, over the map."""
MAP_TAB = 105, 50


def bricks(picture: Picture) -> int:
    """Pixels of the red bricks, in light and in shade, left of the camera's picture."""
    maze = picture[:, : SIZE[0] * 5 // 8].astype(int)
    blue, green, red = maze[..., 0], maze[..., 1], maze[..., 2]
    return int(((red > 100) & (red > 2 * green) & (green >= blue - 10)).sum())


def complete(picture: Picture) -> bool:
    """Textured walls, the camera's picture, the marker's outline and the driven path."""
    return (
        bricks(picture) > 3000
        and count_near(picture, SKY) > 10_000
        and count_near(picture, GROUND) > 10_000
        and count_near(picture, OUTLINE, 60) > 100
        and count_near(picture, TRUE_PATH, 60) > 100
    )


def rows_near(picture: Picture, bgr: tuple[int, int, int]) -> tuple[float, float]:
    """The mean row and column, among the pixels of the map, of those of a colour."""
    part = picture[70 : SIZE[1] * 3 // 4, : SIZE[0] * 5 // 8].astype(int)
    rows, columns = np.nonzero(np.abs(part - bgr).max(axis=2) <= 70)
    return float(rows.mean()), float(columns.mean())


def check(picture: Picture) -> None:
    assert picture.shape == (SIZE[1], SIZE[0], 3)
    assert bricks(picture) > 3000
    assert count_near(picture, SKY) > 10_000
    assert count_near(picture, GROUND) > 10_000
    assert count_near(picture, OUTLINE, 60) > 100
    assert count_near(picture, TRUE_PATH, 60) > 100


def test_a_recording_shows_textured_walls_the_camera_and_the_way(tmp_path: Path) -> None:
    world = room()
    bench = Bench(RecorderNode(RecorderConfig(recordings_dir=tmp_path), WallClock()))
    bench.say(opening(world))
    bench.say(driving(world, 10.0))
    bench.node.close()
    (run,) = tmp_path.iterdir()
    with served(run / "run.rrd") as url:
        check(screenshot(url, complete, size=SIZE, timeout_s=200.0))


def test_on_the_map_x_is_to_the_right_and_y_up_and_the_costmap_is_seen(tmp_path: Path) -> None:
    world = room()
    bench = Bench(RecorderNode(RecorderConfig(recordings_dir=tmp_path), WallClock()))
    bench.say(opening(world))
    # A quarter of a circle from (1, 0): right of the middle, and above it.
    bench.say(driving(world, 6.0))
    bench.node.close()
    (run,) = tmp_path.iterdir()

    def shown(picture: Picture) -> bool:
        map_part = picture[:, : SIZE[0] * 5 // 8]
        return count_near(map_part, LETHAL, 60) > 2000 and count_near(map_part, TRUE_PATH, 70) > 100

    def shown_as_driven(picture: Picture) -> bool:
        """Whether the whole way is drawn: at first, a slow browser shows its beginning only."""
        if not shown(picture):
            return False
        middle, way = rows_near(picture, LETHAL), rows_near(picture, TRUE_PATH)
        return way[0] < middle[0] - 20 and way[1] > middle[1] + 20

    with served(run / "run.rrd") as url:
        picture = screenshot(url, shown_as_driven, size=SIZE, timeout_s=200.0, click=MAP_TAB)
    assert shown(picture)
    middle, way = rows_near(picture, LETHAL), rows_near(picture, TRUE_PATH)
    assert way[0] < middle[0] - 20
    assert way[1] > middle[1] + 20


def test_the_bare_address_shows_the_run_while_it_happens(tmp_path: Path) -> None:
    world = room()
    port = free_port()
    config = RecorderConfig(
        recordings_dir=tmp_path, live=True, bind="127.0.0.1", web_port=port, grpc_port=free_port()
    )
    bench = Bench(RecorderNode(config))
    bench.say(opening(world))
    bench.say(driving(world, 10.0))
    seen = threading.Event()

    def stand() -> None:
        while not seen.wait(0.25):
            bench.step(10_000_000_000)

    standing = threading.Thread(target=stand)
    standing.start()
    try:
        picture = screenshot(f"http://127.0.0.1:{port}", complete, size=SIZE, timeout_s=200.0)
    finally:
        seen.set()
        standing.join()
        bench.node.close()
    check(picture)


def test_a_browser_that_is_stopped_costs_the_recording_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    world = room()
    port = free_port()
    config = RecorderConfig(
        recordings_dir=tmp_path, live=True, bind="127.0.0.1", web_port=port, grpc_port=free_port()
    )
    bench = Bench(RecorderNode(config))
    bench.say(opening(world))
    bench.say(driving(world, 10.0))
    second, longest_s = 10, 0.0
    with opened(f"http://127.0.0.1:{port}", lambda shown: bricks(shown) > 3000, 150.0) as browser:
        assert browser
        for pid in browser:
            os.kill(pid, signal.SIGSTOP)
        try:
            end_s = time.monotonic() + 60.0
            while "does not keep up" not in caplog.text:
                start_s = time.monotonic()
                assert start_s < end_s
                bench.say(driving(world, 1.0, second * 1_000_000_000))
                second += 1
                longest_s = max(longest_s, time.monotonic() - start_s)
                assert bench.node.waiting_for() is None
                # What the recorder takes in at once must not be skipped for its own sake.
                time.sleep(0.05)
            bench.node.close()
        finally:
            for pid in browser:
                os.kill(pid, signal.SIGCONT)
    assert longest_s < 3.0
    (run,) = tmp_path.iterdir()
    assert [path.name for path in run.glob("*.rrd")] == ["run.rrd"]
    verify(run / "run.rrd")
    assert "recording stopped" not in caplog.text
