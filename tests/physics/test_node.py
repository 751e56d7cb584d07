"""How the node starts, what it sends when, and what it keeps out."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mazebot.common.config import ConfigError
from mazebot.common.maths.frames import LINK_FROM_OPTICAL, transform_matrix
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.documents import Entities, MarkerEntity, SimulationStats, World
from mazebot.common.messages.topics import (
    ASSETS,
    BATTERY_STATE,
    CAMERA_IMAGE,
    CAMERA_INFO,
    CLOCK,
    DESIRED_ENTITIES,
    ENTITIES,
    GROUND_TRUTH_ODOM,
    IMU,
    JOINT_STATES,
    ODOM,
    SCAN,
    SIMULATION_STATS,
    TF,
    TF_STATIC,
    WORLD,
    Topic,
)
from mazebot.common.settings.load import load
from mazebot.physics.bodies.bullet import pybullet
from mazebot.physics.config import PhysicsConfig
from mazebot.physics.node import PhysicsNode
from tests.physics.bodies.test_bodies import heap, world_of
from tests.physics.driver import HOUSE_WALLS, Driver, asset, panel, texture, world

WALL_TEXTURE, PANEL_TEXTURE = texture(200), texture(40)
WALL_SHA, PANEL_SHA = WALL_TEXTURE.header.frame_id, PANEL_TEXTURE.header.frame_id


def test_time_stands_still_until_everything_is_there() -> None:
    driver = Driver()
    textured = world(texture_sha256=WALL_SHA)
    desired = Entities(world_hash=textured.hash, entities=(panel("a", PANEL_SHA),))
    assert driver.node.waiting_for() == "a world on /world"
    steps: list[tuple[Callable[[], None], str | None]] = [
        (lambda: driver.deliver(WORLD, textured), "assets of the world on /world/assets: "),
        (lambda: driver.send_asset(WALL_TEXTURE), "the entities on /entities/desired"),
        (lambda: driver.deliver(DESIRED_ENTITIES, desired), "assets of the entities on /world"),
        (lambda: driver.send_asset(PANEL_TEXTURE), None),
    ]
    for deliver, expected in steps:
        assert driver.node.next_step_ns() is None
        deliver()
        driver.turn()
        said = driver.node.waiting_for()
        assert said is None if expected is None else (said or "").startswith(expected)
    assert driver.node.next_step_ns() == 4_166_666
    assert driver.node.world_hash == textured.hash
    assert [entity.name for entity in driver.last(ENTITIES).entities] == ["a"]


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (3, 2, 1, 0), (2, 0, 3, 1)])
def test_the_order_in_which_things_come_does_not_matter(order: tuple[int, ...]) -> None:
    driver = Driver()
    textured = world(texture_sha256=WALL_SHA)
    desired = Entities(world_hash=textured.hash, entities=(panel("a", PANEL_SHA),))
    deliveries: list[Callable[[], None]] = [
        lambda: driver.deliver(WORLD, textured),
        lambda: driver.send_asset(WALL_TEXTURE),
        lambda: driver.deliver(DESIRED_ENTITIES, desired),
        lambda: driver.send_asset(PANEL_TEXTURE),
    ]
    for index in order:
        deliveries[index]()
        driver.turn()
    assert len(driver.all(ENTITIES)) == 1
    assert driver.last(ENTITIES).refused == ()


def test_every_stamp_is_a_multiple_of_the_step() -> None:
    driver = Driver(scan_rate_hz=5).load(world())
    driver.wait(1.0)
    assert driver.now_ns == 1_000_000_000
    counts: dict[Topic[Any], int] = {
        CLOCK: 60,
        IMU: 120,
        ODOM: 30,
        TF: 30,
        JOINT_STATES: 30,
        BATTERY_STATE: 1,
        GROUND_TRUTH_ODOM: 30,
        SCAN: 5,
        SIMULATION_STATS: 6,  # one of them at the load
    }
    assert {topic.name: len(driver.all(topic)) for topic in counts} == {
        topic.name: count for topic, count in counts.items()
    }
    stamps = [msg.ns_from_time(reading.header.stamp) for reading in driver.all(IMU)]
    assert stamps == [2 * n * 1_000_000_000 // 240 for n in range(1, 121)]


def test_static_frames_are_sent_once_and_exactly() -> None:
    driver = Driver().load(world())
    driver.wait(0.2)
    (static,) = driver.all(TF_STATIC)
    at = {entry.child_frame_id: entry for entry in static.transforms}
    assert {"base_link", "imu_link", "base_scan", "camera_link", "camera_rgb_optical_frame"} <= set(
        at
    )
    base_from_optical = msg.chain_transforms(
        static.transforms, "base_link", "camera_rgb_optical_frame"
    )
    assert base_from_optical is not None
    expected = transform_matrix(np.eye(3), (0.069, -0.047, 0.107)) @ LINK_FROM_OPTICAL
    assert np.abs(base_from_optical - expected).max() < 1e-15
    assert at["base_scan"].transform.translation == msg.Vector3(-0.064, 0.0, 0.122)


def test_the_same_world_again_changes_nothing() -> None:
    driver = Driver().load(world())
    driver.drive(0.3, 0.0, 1.0)
    before = driver.pose
    driver.load(world())
    driver.wait(0.1)
    assert len(driver.all(TF_STATIC)) == 1
    assert driver.pose.x_m >= before.x_m


def test_another_world_takes_the_place_of_the_old_one_and_time_goes_on() -> None:
    driver = Driver().load(world())
    driver.drive(0.3, 0.0, 1.0)
    other = world(start=(0.0, 5.0, 0.0), texture_sha256=WALL_SHA)
    driver.load(other)
    driver.wait(0.5)
    # Its texture has not come: the old world runs on.
    assert driver.node.world_hash == world().hash
    driver.send_asset(WALL_TEXTURE)
    driver.wait(0.5)
    assert driver.node.world_hash == other.hash
    assert driver.last(SIMULATION_STATS).world_hash == other.hash
    assert driver.now_ns == pytest.approx(2_000_000_000, abs=10_000_000)
    assert driver.pose.y_m == pytest.approx(5.0, abs=1e-3)
    assert len(driver.all(TF_STATIC)) == 2


def _with(changes: dict[str, object]) -> World:
    draft = world().model_copy(update=changes)
    return draft.model_copy(update={"hash": draft.content_hash()})


@pytest.mark.parametrize(
    "bad",
    [
        world().model_copy(update={"hash": "0" * 16}),
        _with({"walls": world().walls * 2}),
        _with({"walls": (world().walls[0].model_copy(update={"length_m": 1e9}),)}),
        _with({"walls": (world().walls[0].model_copy(update={"x_m": math.nan}),)}),
    ],
    ids=["hash", "double", "huge", "nan"],
)
def test_a_bad_world_leaves_the_old_one_running(
    bad: World, caplog: pytest.LogCaptureFixture
) -> None:
    driver = Driver().load(world())
    driver.load(bad)
    driver.drive(0.3, 0.0, 1.0)
    assert driver.node.world_hash == world().hash
    assert driver.pose.x_m > 0.2
    assert sum(driver.inbox.counts[WORLD.name].rejected.values()) == 1
    (line,) = [record.message for record in caplog.records if "rejected" in record.message]
    assert "\n" not in line


def test_a_damaged_asset_is_not_taken_in() -> None:
    driver = Driver()
    png = PANEL_TEXTURE.data.tobytes()
    driver.send_asset(asset(png[:-20]))
    driver.send_asset(asset(b"no picture"))
    wrong = msg.CompressedImage(
        header=msg.header(0, "0" * 64), format="png", data=WALL_TEXTURE.data
    )
    driver.send_asset(wrong)
    driver.turn()
    assert driver.inbox.counts[ASSETS.name].rejected == {
        "not a PNG of at most 2048 x 2048": 2,
        "does not match its sha256": 1,
    }


def _desire(driver: Driver, *entities: MarkerEntity) -> Entities:
    driver.revision += 1
    desired = Entities.model_construct(
        world_hash=world().hash, revision=driver.revision, entities=entities, refused=()
    )
    driver.deliver(DESIRED_ENTITIES, desired)
    driver.turn()
    return driver.last(ENTITIES)


def test_entities_are_made_what_is_desired_and_told_once() -> None:
    driver = Driver()
    driver.send_asset(PANEL_TEXTURE)
    driver.load(world())
    a, b = panel("a", PANEL_SHA), panel("b", PANEL_SHA, position_m=(-0.7, -1.957, 0.3))
    assert _desire(driver, a, b).entities == (a, b)
    told = len(driver.all(ENTITIES))
    driver.revision -= 1
    _desire(driver, a, b)
    assert len(driver.all(ENTITIES)) == told
    moved = panel("a", PANEL_SHA, position_m=(-1.3, -1.957, 0.4))
    assert _desire(driver, moved).entities == (moved,)
    assert _desire(driver).entities == ()


def test_entities_that_cannot_stand_are_refused_with_a_reason() -> None:
    driver = Driver()
    driver.send_asset(PANEL_TEXTURE)
    driver.load(world())
    good = panel("good", PANEL_SHA)
    bad = {
        "texture_sha256": panel("unknown", "f" * 64),
        "position_m: (nan": panel("nan", PANEL_SHA, position_m=(math.nan, 0.0, 0.0)),
        "panel_side_m": panel("huge", PANEL_SHA, panel_side_m=50.0),
        "position_m: ": panel("far", PANEL_SHA, position_m=(0.0, 1e6, 0.0)),
        "orientation_xyzw": panel("turn", PANEL_SHA, orientation_xyzw=(0.0, 0.0, 0.0, 2.0)),
        "marker_size_m": panel("marker", PANEL_SHA, marker_size_m=0.5),
        "name": panel("good", PANEL_SHA, marker_id=8),
        "floats 0.043 m off Wall_0": panel("off", PANEL_SHA, position_m=(-0.7, -1.916, 0.3)),
        "is buried in Wall_0": panel("in", PANEL_SHA, position_m=(-0.7, -2.0, 0.3)),
        "overlaps good": panel("over", PANEL_SHA, position_m=(-1.1, -1.957, 0.3)),
        "extends 0.1": panel("top", PANEL_SHA, position_m=(-0.7, -1.957, 0.9)),
    }
    told = _desire(driver, good, *bad.values())
    assert told.entities == (good,)
    assert [refusal.name for refusal in told.refused] == [entity.name for entity in bad.values()]
    for refusal, field in zip(told.refused, bad, strict=True):
        assert refusal.reason.startswith(field)


def test_an_entity_stands_as_soon_as_its_texture_comes() -> None:
    driver = Driver().load(world())
    assert _desire(driver, panel("a", PANEL_SHA)).entities == ()
    driver.send_asset(PANEL_TEXTURE)
    driver.turn()
    assert len(driver.last(ENTITIES).entities) == 1
    assert driver.last(ENTITIES).refused == ()


def test_a_spawner_that_begins_anew_finds_what_stood_before() -> None:
    driver = Driver()
    driver.send_asset(PANEL_TEXTURE)
    driver.load(world())
    a, b = panel("a", PANEL_SHA), panel("b", PANEL_SHA, position_m=(-0.7, -1.957, 0.3))
    in_the_air = panel("c", PANEL_SHA, position_m=(-0.7, -1.0, 0.3))
    _desire(driver, b, in_the_air)
    driver.revision = -1
    told = _desire(driver, a, in_the_air)
    assert (told.revision, told.entities) == (0, (b,))
    assert [refusal.name for refusal in told.refused] == ["c"]


@pytest.mark.parametrize("set_first", [False, True])
def test_a_world_that_is_loaded_again_has_what_its_new_set_has(set_first: bool) -> None:
    driver = Driver()
    driver.send_asset(PANEL_TEXTURE)
    driver.load(world())
    hung, spawned = panel("a", PANEL_SHA), panel("b", PANEL_SHA, position_m=(-0.7, -1.957, 0.3))
    _desire(driver, hung, spawned)
    other = world(name="other")
    driver.deliver(WORLD, other)
    driver.deliver(DESIRED_ENTITIES, Entities(world_hash=other.hash))
    anew = Entities(world_hash=world().hash, entities=(hung,))
    if set_first:
        # The spawner is back before the other world is built.
        driver.deliver(DESIRED_ENTITIES, anew)
    driver.turn()
    assert driver.node.world_hash == other.hash
    driver.deliver(WORLD, world())
    driver.turn()
    if not set_first:
        assert driver.node.world_hash == other.hash
        driver.deliver(DESIRED_ENTITIES, anew)
        driver.turn()
    assert driver.node.world_hash == world().hash
    assert driver.last(ENTITIES).entities == (hung,)
    # A spawner that starts again within this load finds what it had.
    driver.revision = 0
    _desire(driver, hung, spawned)
    driver.revision = -1
    assert _desire(driver, hung).entities == (hung, spawned)


def test_the_old_world_after_one_that_cannot_be_built_is_answered() -> None:
    driver = Driver().load(world())
    bad = world_of(*heap(100))
    driver.load(bad)
    assert driver.node.world_hash == world().hash
    told = driver.all(ENTITIES)
    # The spawner has left this world, and begins it anew.
    driver.load(world())
    assert driver.all(ENTITIES) == [*told, Entities(world_hash=world().hash)]
    driver.turn()
    assert len(driver.all(ENTITIES)) == len(told) + 1


def test_no_more_than_200_entities() -> None:
    driver = Driver()
    driver.send_asset(PANEL_TEXTURE)
    long_wall = world(walls=[("Long", 30.0, 0.0, -2.03381, 0.0)])
    driver.load(long_wall)
    small = {"panel_side_m": 0.08, "marker_size_m": 0.06}
    panels = tuple(
        panel(f"p{n}", PANEL_SHA, position_m=(0.1 * n - 10.0, -1.957, 0.3), **small)
        for n in range(205)
    )
    desired = Entities(world_hash=long_wall.hash, revision=1, entities=panels)
    driver.deliver(DESIRED_ENTITIES, desired)
    driver.turn()
    told = driver.last(ENTITIES)
    assert len(told.entities) == 200
    assert [refusal.name for refusal in told.refused] == [f"p{n}" for n in range(200, 205)]


def test_entities_of_another_world_are_not_placed() -> None:
    driver = Driver().load(world())
    told = len(driver.all(ENTITIES))
    driver.deliver(DESIRED_ENTITIES, Entities(world_hash="0" * 16))
    driver.turn()
    assert len(driver.all(ENTITIES)) == told


def _script(driver: Driver) -> tuple[str, list[bytes]]:
    driver.load(world(HOUSE_WALLS))
    for linear, angular in ((0.4, 0.3), (0.2, -1.5), (-0.3, 0.5), (0.46, 0.0)):
        driver.drive(linear, angular, 1.0)
    scans = [scan.ranges.tobytes() for scan in driver.all(SCAN)]
    driver.node.close()
    return driver.last(SIMULATION_STATS).state_hash, scans


def test_the_same_commands_give_the_same_state_to_the_last_bit() -> None:
    first, second, other_seed = _script(Driver()), _script(Driver()), _script(Driver(seed=8))
    assert first == second
    assert len(first[0]) == 16
    # The seed is the sensors': the robot moves alike.
    assert other_seed[0] == first[0]
    assert other_seed[1] != first[1]


def test_other_commands_give_another_state_hash() -> None:
    hashes = []
    for speed in (0.2, 0.2 + 1e-9):
        driver = Driver().load(world())
        driver.drive(speed, 0.0, 0.5)
        hashes.append(driver.last(SIMULATION_STATS).state_hash)
    assert hashes[0] != hashes[1]


@pytest.mark.parametrize("poison", [math.nan, math.inf, 1e30])
def test_a_robot_that_is_not_physical_is_built_anew(
    poison: float, caplog: pytest.LogCaptureFixture
) -> None:
    driver = Driver().load(world())
    driver.drive(0.4, 0.0, 1.0)
    bodies = driver.node._simulation.bodies  # type: ignore[union-attr]
    pybullet.resetBaseVelocity(bodies._robot.number, [poison, 0, 0], physicsClientId=bodies._client)
    driver.turn()
    assert [record.levelname for record in caplog.records if "invalid state" in record.message] == [
        "ERROR"
    ]
    driver.wait(0.1)
    assert math.hypot(driver.pose.x_m, driver.pose.y_m) < 1e-3
    driver.drive(0.3, 0.0, 1.0)
    assert driver.pose.x_m > 0.2
    assert driver.node.world_hash == world().hash


def test_all_it_sends_survives_the_wire() -> None:
    driver = Driver(renderer="auto", camera_width_px=64, camera_height_px=48).load(world())
    driver.drive(0.4, 0.5, 0.4)
    assert len(driver.sent) > 100
    assert not driver.outbox.rejected
    for topic, message in driver.sent:
        again = wire.decode(topic, wire.encode(topic, message))
        assert wire.encode(topic, again) == wire.encode(topic, message)
        assert repr(again) == repr(message)


def test_pictures_come_with_their_intrinsics() -> None:
    driver = Driver(renderer="auto").load(world())
    driver.wait(0.2)
    images, infos = driver.all(CAMERA_IMAGE), driver.all(CAMERA_INFO)
    assert len(images) == len(infos) == 2
    image, info = images[0], infos[0]
    assert image.header == info.header
    assert (image.width, image.height, image.step) == (640, 480, 1920)
    assert (image.encoding, image.header.frame_id) == ("rgb8", "camera_rgb_optical_frame")
    assert image.data.shape == (640 * 480 * 3,)
    assert image.data.std() > 1.0
    assert images[1].data is not image.data
    assert info.k[0] == pytest.approx(320.0 / math.tan(1.047 / 2.0))
    assert info.k[2] == 320.0
    assert info.distortion_model == "plumb_bob"
    assert not info.d.any()
    assert driver.last(SIMULATION_STATS).renderer != "none"


def test_without_a_camera_no_pictures_come() -> None:
    driver = Driver(renderer="auto", camera_enabled=False).load(world())
    driver.wait(0.2)
    assert driver.all(CAMERA_IMAGE) == []
    assert driver.last(SIMULATION_STATS).renderer == "none"


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (["--scan-rate-hz", "7"], "scan_rate_hz"),
        (["--renderer", "vulkan"], "renderer"),
        (["--max-linear-speed-m-s", "-1"], "max_linear_speed_m_s"),
        (["--robot-model", "../secret"], "robot_model"),
    ],
)
def test_a_mistake_in_the_configuration_is_one_line(flags: list[str], words: str) -> None:
    with pytest.raises(ConfigError, match=words) as caught:
        load(PhysicsConfig, "physics", flags)
    assert "\n" not in str(caught.value)


def test_an_unknown_robot_is_one_line() -> None:
    with pytest.raises(ConfigError, match="robot_model") as caught:
        PhysicsNode(PhysicsConfig(robot_model="burger"))
    assert "\n" not in str(caught.value)


def test_a_process_that_comes_back_goes_on_counting_epochs() -> None:
    def stats(epoch: int) -> SimulationStats:
        return SimulationStats(
            world_hash="", sim_time_s=1.0, iterations=240, step_size_s=1 / 240, epoch=epoch,
            renderer="none", state_hash="",
        )  # fmt: skip

    early = Driver()
    early.deliver(SIMULATION_STATS, stats(3))
    early.load(world())
    assert early.last(SIMULATION_STATS).epoch == 4
    late = Driver().load(world())
    assert late.last(SIMULATION_STATS).epoch == 1
    late.deliver(SIMULATION_STATS, stats(3))
    late.turn()
    assert late.last(SIMULATION_STATS).epoch == 4


def test_it_rests_while_the_robot_stands_and_nobody_commands() -> None:
    robot = Driver().load(world())
    assert robot.node.resting
    robot.drive(0.3, 0.0, 0.5)
    assert not robot.node.resting
    robot.wait(0.5)
    assert robot.node.resting
