"""What can be chosen of a camera: its profile, noise, depth and JPEG; and the pictures' hash."""

from __future__ import annotations

import logging
import math
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from mazebot.common.messages.documents import (
    SimulationControl,
    SimulationControlReply,
    SimulationStats,
)
from mazebot.common.messages.topics import (
    CAMERA_COMPRESSED,
    CAMERA_IMAGE,
    CAMERA_INFO,
    DEPTH_IMAGE,
    DEPTH_INFO,
    SIMULATION_CONTROL,
    SIMULATION_STATS,
    Topic,
)
from mazebot.common.node.node import random_generator
from mazebot.physics.bodies.bullet import pybullet
from mazebot.physics.camera.camera_noise import CameraNoise
from mazebot.physics.camera.image_hash import ImageHash
from mazebot.physics.config import PhysicsConfig
from tests.physics.driver import Driver, world

SMALL: dict[str, Any] = {"renderer": "auto", "camera_width_px": 64, "camera_height_px": 48}


def config(**values: Any) -> PhysicsConfig:
    return PhysicsConfig.model_validate(values)


@pytest.mark.parametrize(
    ("profile", "figures"),
    [
        ("d435i", (640, 480, 10.0, 1.047, 0.175, 10.0, 0.0)),
        ("small", (320, 240, 10.0, 1.047, 0.175, 10.0, 0.0)),
        ("waffle", (1920, 1080, 30.0, 1.02974, 0.02, 300.0, 0.007)),
    ],
)
def test_a_profile_gives_the_figures_that_nobody_set(
    profile: str, figures: tuple[float, ...]
) -> None:
    def figures_of(c: PhysicsConfig) -> tuple[float, ...]:
        return (
            *(c.camera_width_px, c.camera_height_px, c.camera_rate_hz),
            *(c.camera_horizontal_fov_rad, c.camera_depth_min_m, c.camera_depth_max_m),
            c.camera_noise,
        )

    assert figures_of(config(camera_profile=profile)) == figures
    changed = config(camera_profile=profile, camera_noise=0.02, camera_width_px=100)
    assert figures_of(changed) == (100, *figures[1:6], 0.02)
    assert config() == config(camera_profile="d435i")


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *((f"camera_{side}_px", size) for side in ("width", "height") for size in (-5, 0, 20_000)),
        ("camera_profile", "kinect"),
        ("camera_rate_hz", 7.0),
        ("camera_horizontal_fov_rad", 3.2),
        ("camera_noise", -0.1),
        ("camera_noise", float("nan")),
        ("camera_depth_min_m", -1.0),
        ("camera_depth_max_m", 1000.0),
        ("camera_depth_max_m", 0.1),
        ("camera_jpeg_quality", 101),
    ],
)
def test_what_no_camera_can_have_is_refused(field: str, value: object) -> None:
    with pytest.raises(ValidationError, match=field):
        config(**{field: value})


def noise(share: float, values: int, seed: int = 1) -> CameraNoise:
    return CameraNoise(share, values, random_generator(seed, "physics/camera"))


def grey(level: int) -> NDArray[np.uint8]:
    return np.full((120, 160, 3), level, np.uint8)


@pytest.mark.parametrize("share", [0.007, 0.03])
def test_noise_has_its_sigma_and_no_bias(share: float) -> None:
    made = noise(share, grey(0).size)
    for _ in range(3):
        picture = grey(128)
        made.add_to(picture)
        errors = picture.astype(float) - 128.0
        assert abs(errors.mean()) < 0.1
        # Rounding to whole steps adds a twelfth to the variance.
        assert errors.std() == pytest.approx(np.hypot(255 * share, 12**-0.5), rel=0.02)
        for one, other in ((errors[:-1], errors[1:]), (errors[..., 0], errors[..., 1])):
            assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.03


def test_noise_stays_on_the_scale() -> None:
    made = noise(0.1, grey(0).size)
    for level in (0, 255):
        picture = grey(level)
        made.add_to(picture)
        assert 0.4 < (picture == level).mean() < 0.6
        assert np.abs(picture.astype(int) - level).max() < 160


def test_noise_differs_from_picture_to_picture_and_repeats_from_run_to_run() -> None:
    runs = []
    for seed in (1, 1, 2):
        made, pictures = noise(0.02, grey(0).size, seed), []
        for _ in range(3):
            picture = grey(100)
            made.add_to(picture)
            pictures.append(picture.tobytes())
        runs.append(pictures)
    assert runs[0] == runs[1]
    assert len({*runs[0], *runs[2]}) == 6


def test_no_noise_changes_nothing() -> None:
    picture = grey(77)
    noise(0.0, picture.size).add_to(picture)
    assert (picture == 77).all()


def test_colour_depth_and_jpeg_are_of_one_instant_and_one_sensor() -> None:
    driver = Driver(**SMALL, camera_compressed_enabled=True, camera_jpeg_quality=95)
    driver.load(world())
    driver.wait(0.2)
    topics: tuple[Topic[Any], ...] = (
        CAMERA_IMAGE,
        CAMERA_INFO,
        CAMERA_COMPRESSED,
        DEPTH_IMAGE,
        DEPTH_INFO,
    )
    for first, *others in zip(*(driver.all(topic) for topic in topics), strict=True):
        assert all(other.header == first.header for other in others)
    rates = driver.node.nominal_rates_hz()
    assert [rates[topic.name] for topic in topics] == [10.0] * 5
    image, depth = driver.last(CAMERA_IMAGE), driver.last(DEPTH_IMAGE)
    assert (depth.encoding, depth.step, depth.is_bigendian) == ("32FC1", 4 * 64, 0)
    metres = depth.data.view(np.float32).reshape(48, 64)
    # Of a level floor, depth times rows below the horizon is one.
    assert metres[30, 32] * (30 - 24) == pytest.approx(metres[45, 32] * (45 - 24), rel=0.02)
    assert metres[30, 32] > 0.5
    assert (repr(driver.last(DEPTH_INFO))) == repr(driver.last(CAMERA_INFO))
    jpeg = driver.last(CAMERA_COMPRESSED)
    assert jpeg.format == "rgb8; jpeg compressed bgr8"
    bgr = cv2.imdecode(jpeg.data, cv2.IMREAD_COLOR)
    assert bgr is not None
    rgb = image.data.reshape(48, 64, 3).astype(int)
    assert np.abs(bgr[:, :, ::-1] - rgb).mean() < 3.0


def test_only_what_is_asked_for_is_sent() -> None:
    driver = Driver(**SMALL, camera_depth_enabled=False).load(world())
    driver.wait(0.2)
    assert driver.all(CAMERA_IMAGE)
    unasked: tuple[Topic[Any], ...] = (CAMERA_COMPRESSED, DEPTH_IMAGE, DEPTH_INFO)
    for topic in unasked:
        assert not driver.all(topic)
        assert topic.name not in driver.node.nominal_rates_hz()


def image_hash(**values: Any) -> str:
    driver = Driver(**SMALL, **values).load(world())
    driver.drive(0.2, 0.3, 0.5)
    return driver.last(SIMULATION_STATS).image_hash


def stats_now(driver: Driver) -> SimulationStats:
    """As `mazebot sim` asks for them."""
    answers: list[SimulationControlReply] = []
    driver.inbox.ask(SIMULATION_CONTROL, SimulationControl(), answers.append)
    driver.turn()
    assert answers[0].stats is not None
    return answers[0].stats


def test_the_hash_is_that_of_all_pictures_of_an_epoch() -> None:
    driver = Driver(**SMALL).load(world())
    driver.drive(0.2, 0.3, 0.6)
    told = ImageHash()
    for image in driver.all(CAMERA_IMAGE):
        told.add(image.data)
    assert stats_now(driver).image_hash == told.hex()
    last = ImageHash()
    for image in driver.all(CAMERA_IMAGE)[:-1]:
        last.add(image.data)
    # Of the same instant, and sent before its picture.
    assert driver.last(SIMULATION_STATS).image_hash == last.hex()
    answers: list[SimulationControlReply] = []
    driver.inbox.ask(SIMULATION_CONTROL, SimulationControl(reset="all"), answers.append)
    driver.turn()
    assert answers[0].stats is not None
    assert answers[0].stats.image_hash == ImageHash().hex()
    driver.sent.clear()
    driver.drive(0.2, 0.3, 0.6)
    anew = ImageHash()
    for image in driver.all(CAMERA_IMAGE):
        anew.add(image.data)
    assert stats_now(driver).image_hash == anew.hex()


def test_the_hash_begins_anew_with_a_world_that_is_built_anew() -> None:
    driver = Driver(**SMALL).load(world())
    driver.drive(0.2, 0.3, 0.3)
    driver.sent.clear()
    assert driver.node._simulation is not None
    bodies = driver.node._simulation.bodies
    pybullet.resetBaseVelocity(
        bodies._robot.number, [math.nan, 0, 0], physicsClientId=bodies._client
    )
    driver.drive(0.2, 0.3, 0.5)
    told = ImageHash()
    for image in driver.all(CAMERA_IMAGE):
        told.add(image.data)
    stats = stats_now(driver)
    assert (stats.epoch, stats.image_hash) == (2, told.hex())


def test_the_hash_is_the_same_in_every_run_of_a_seed() -> None:
    assert image_hash() == image_hash() == image_hash(camera_depth_enabled=False)
    noisy = image_hash(camera_noise=0.01, seed=3)
    assert noisy == image_hash(camera_noise=0.01, seed=3)
    assert len({image_hash(), noisy, image_hash(camera_noise=0.01, seed=4)}) == 3


def test_without_a_camera_there_is_no_hash_of_pictures() -> None:
    driver = Driver().load(world())
    driver.wait(0.3)
    assert driver.last(SIMULATION_STATS).image_hash == ""


@pytest.mark.parametrize(
    ("settings", "says"),
    [({"camera_enabled": False}, 1), ({**SMALL, "camera_depth_enabled": False}, 1), (SMALL, 0)],
)
def test_without_depths_it_is_said_once_what_is_not_seen(
    settings: dict[str, Any], says: int, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO, logger="physics"):
        Driver(**settings).load(world())
    told = [record.getMessage() for record in caplog.records]
    assert sum("0.132 m above the floor" in line and "glass" in line for line in told) == says
