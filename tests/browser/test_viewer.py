"""A recording in a real browser: is what a person would look for on the screen?"""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from services.cli.loopback_router import free_port
from services.recorder.config import RecorderConfig
from services.recorder.node import RecorderNode
from tests.browser.viewer import CHROMIUM, Picture, count_near, screenshot, served
from tests.recorder.synthetic import Bench, WallClock, driving, opening, room

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
