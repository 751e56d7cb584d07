"""Maps, worlds and runs that come and go while the navigation node drives."""

from __future__ import annotations

import itertools
from collections import Counter
from typing import TypeVar

import numpy as np

from mazebot.common.maths.frames import (
    BASE_FOOTPRINT_FRAME,
    SCAN_FRAME,
    SE2,
)
from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.action_documents import DockRobot, SendGoal
from mazebot.common.messages.documents import (
    Entities,
)
from mazebot.common.messages.error_codes import ErrorCode
from mazebot.common.messages.topics import (
    ACTION_RESULT,
    CMD_VEL,
    ENTITIES,
    GLOBAL_COSTMAP,
    GLOBAL_COSTMAP_UPDATES,
    MAP,
    NAVIGATION_STATUS,
    ODOM,
    PARTICLE_CLOUD,
    PLAN,
    SEND_GOAL,
    SIMULATION_STATS,
    TF_STATIC,
    WORLD,
    Topic,
)
from mazebot.common.node.node import Envelope
from mazebot.common.world.footprint import wall_corners
from mazebot.navigation.config import NavigationConfig
from mazebot.navigation.control.collision import STOP
from mazebot.worldgen.map.occupancy import Grid, rasterise
from tests.common.samples import SAMPLES
from tests.navigation.driving import (
    IDENTITY,
    LOCATIONS,
    START,
    NodeDriver,
    asked,
    box_segments,
    estimate_error_m,
    odometry,
    ready,
    stats,
)
from tests.navigation.house_tour import house

M = TypeVar("M")


def test_a_map_larger_than_can_be_planned_in_is_refused_and_the_robot_drives_on() -> None:
    driver = ready()
    cells = np.zeros((2001, 2000), np.int8)
    driver.deliver(MAP, msg.occupancy_grid(0, 0.05, SE2(0.0, 0.0, 0.0), cells))
    assert driver.drive_to(LOCATIONS["location1"]).error_code == 0
    assert driver.rejected(MAP) == {"invalid map": 1}


def test_a_ring_of_fixed_frames_is_refused_and_the_robot_drives_on() -> None:
    driver = ready()
    back = msg.transform_stamped(0, SCAN_FRAME, BASE_FOOTPRINT_FRAME, np.eye(4))
    driver.deliver(TF_STATIC, msg.TFMessage([back]))
    assert driver.drive_to(LOCATIONS["location1"]).error_code == 0
    assert driver.rejected(TF_STATIC) == {"loop in the frame tree": 1}


def test_it_says_what_it_waits_for_in_the_order_it_comes() -> None:
    driver = NodeDriver()
    driver.blind = True
    said = [driver.node.waiting_for()]
    driver.deliver(WORLD, house().world)
    driver.node.step(0, driver.inbox, driver.outbox)
    said.append(driver.node.waiting_for())
    driver.deliver(MAP, msg.occupancy_grid(0, 0.05, house().map_origin, house().map_cells))
    driver.node.step(0, driver.inbox, driver.outbox)
    said.append(driver.node.waiting_for())
    driver.learn()
    driver.step()
    said.append(driver.node.waiting_for())
    driver.blind = False
    driver.run(0.2)
    said.append(driver.node.waiting_for())
    assert said == ["the world", "the map", "static transforms on /tf_static", "a scan", None]


def test_what_is_no_map_is_refused_and_counted() -> None:
    driver = NodeDriver()
    driver.deliver(WORLD, house().world)
    driver.deliver(MAP, msg.occupancy_grid(0, 0.0, house().map_origin, house().map_cells))
    driver.step()
    assert driver.rejected(MAP)["invalid map"] == 1
    assert driver.node.waiting_for() == "the map"


def test_it_drives_by_a_map_that_is_turned() -> None:
    grid = Grid(240, 260, 0.05, SE2(-1.6, -5.6, 0.5))
    walls = np.array([wall_corners(wall) for wall in house().world.walls])
    cells = np.where(rasterise([walls], grid), 100, 0).astype(np.int8)
    driver = ready()
    driver.deliver(MAP, msg.occupancy_grid(0, 0.05, grid.origin, cells))
    driver.run(0.5)
    driver.goal(LOCATIONS["location1"])
    driver.run(20.0)
    (result,) = driver.results()
    assert (result.error_code, result.error_msg) == (0, "")
    assert driver.robot.map_from_base.distance_m(LOCATIONS["location1"]) < 0.3
    assert estimate_error_m(driver) < 0.05
    assert msg.se2_from_pose(driver.of(GLOBAL_COSTMAP)[-1].info.origin).yaw_rad == 0.0


def test_the_same_world_and_map_latched_again_change_nothing() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(2.0)
    driver.learn()
    driver.run(0.2)
    assert driver.results() == []
    assert driver.of(NAVIGATION_STATUS)[-1].state == "controlling"


def test_another_world_aborts_the_goal_and_begins_at_its_start() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(3.0)
    other = house().world.model_copy(update={"hash": "0123456789abcdef"})
    driver.deliver(WORLD, other)
    driver.step()
    assert [r.error_code for r in driver.results()] == [ErrorCode.WORLD_RESTARTED]
    assert driver.node.world_hash == other.hash
    last = driver.of(CMD_VEL)[-1].twist
    assert (last.linear.x, last.angular.z) == (0.0, 0.0)
    # Odometry of the world before counts no longer.
    assert driver.node.waiting_for() == "odometry"
    driver.run(0.2)
    assert driver.rejected(ODOM)["other world"] > 0


def test_time_going_back_begins_anew_at_the_start() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location1"])
    driver.run(5.0)
    driver.now_ns = 0
    driver.robot.map_from_base = START
    driver.odom_from_base = IDENTITY
    driver.step()
    assert [r.error_code for r in driver.results()] == [ErrorCode.WORLD_RESTARTED]
    driver.run(0.5)
    assert driver.node.waiting_for() is None
    assert estimate_error_m(driver) < 0.05
    assert driver.drive_to(LOCATIONS["location1"]).error_code == 0


def test_another_epoch_begins_anew_though_time_goes_on() -> None:
    driver = ready()
    driver.deliver(SIMULATION_STATS, stats(epoch=1))
    driver.goal(LOCATIONS["location1"])
    driver.run(5.0)
    assert driver.results() == []
    # The robot stands at its start again; one message of before is still on its way.
    driver.deliver(ODOM, odometry(driver.now_ns, driver.odom_from_base, STOP))
    driver.robot.map_from_base = START
    driver.odom_from_base = IDENTITY
    driver.deliver(SIMULATION_STATS, stats(epoch=2, sim_time_s=driver.now_ns * 1e-9 + 0.01))
    driver.step()
    assert [r.error_code for r in driver.results()] == [ErrorCode.WORLD_RESTARTED]
    driver.run(0.5)
    assert driver.rejected(ODOM)["from an earlier epoch"] == 1
    assert driver.node.waiting_for() is None
    assert estimate_error_m(driver) < 0.05


def test_the_seed_is_the_simulation_s() -> None:
    clouds = []
    for config_seed, told_seed in ((7, 7), (7, 8), (8, 8)):
        driver = NodeDriver(config=NavigationConfig(seed=config_seed))
        driver.deliver(SIMULATION_STATS, stats(epoch=1, seed=told_seed))
        driver.learn()
        driver.run(2.0)
        clouds.append(wire.encode(PARTICLE_CLOUD, driver.of(PARTICLE_CLOUD)[-1]))
    assert clouds[0] != clouds[1]
    assert clouds[1] == clouds[2]


def test_the_global_costmap_with_its_updates_is_the_next_one() -> None:
    driver = ready()
    driver.goal(LOCATIONS["location3"])
    driver.run(2.5)
    driver.extra_segments = box_segments(1.33, -0.87, 0.85)
    driver.run(3.0)
    costmaps, updates = driver.of(GLOBAL_COSTMAP), driver.of(GLOBAL_COSTMAP_UPDATES)
    assert len(updates) > len(costmaps) > 1
    stamp_ns = [msg.ns_from_time(one.header.stamp) for one in costmaps]
    changed = late = 0
    for (before, after), times in zip(
        itertools.pairwise(costmaps), itertools.pairwise(stamp_ns), strict=True
    ):
        cells, wanted = msg.cells_from_grid(before).copy(), msg.cells_from_grid(after)
        changed += int(np.count_nonzero(cells != wanted))
        for update in updates:
            if times[0] < msg.ns_from_time(update.header.stamp) < times[1]:
                wire.validate(GLOBAL_COSTMAP_UPDATES, update)
                rows = np.s_[update.y : update.y + update.height]
                columns = np.s_[update.x : update.x + update.width]
                cells[rows, columns] = update.data.reshape(update.height, update.width)
        late += int(np.count_nonzero(cells != wanted))
    # What has changed since the last update is in the costmap alone.
    assert late < changed
    assert min(update.width * update.height for update in updates) < wanted.size


class GrowingMapDriver(NodeDriver):
    """Navigation hears of a robot that maps; whoever localises it knows the whole map."""

    def deliver(self, topic: Topic[M], message: M | bytes) -> None:
        if topic.name not in (WORLD.name, MAP.name):
            super().deliver(topic, message)
            return
        number = self._sequence.get(topic.name, 0)
        self._sequence[topic.name] = number + 1
        envelope = Envelope("test", number, self.now_ns, house().world.hash)
        self.localization_inbox.deliver(topic, message, envelope)
        if topic.name == WORLD.name:
            mapped = house().world.model_copy(update={"slam": True})
            self.inbox.deliver(WORLD, mapped, envelope)

    def show(self, limit_x_m: float) -> None:
        """The map as far as a line across the house: the rest is unknown, and left out."""
        columns = round((limit_x_m - house().map_origin.x_m) / 0.05)
        cells = house().map_cells[:, :columns].copy()
        grid = msg.occupancy_grid(self.now_ns, 0.05, house().map_origin, cells)
        self.inbox.deliver(MAP, grid, Envelope("mapping", self.now_ns, self.now_ns, ""))

    def refusals(self) -> Counter[str]:
        return self.inbox.counts[MAP.name].rejected


def test_a_map_grows_while_the_robot_drives_and_the_task_goes_on() -> None:
    driver = GrowingMapDriver()
    driver.learn()
    driver.run(0.2)
    driver.show(2.0)
    driver.run(0.5)
    assert driver.node.waiting_for() is None
    assert driver.drive_to(LOCATIONS["location3"]).error_code != 0
    driver.show(3.0)
    driver.run(0.2)
    driver.goal(SE2(1.6, -0.9, 0.0))
    results = len(driver.results())
    for step in range(40):
        driver.show(3.0 + 0.05 * step)
        driver.run(0.3)
    assert [one.error_code for one in driver.results()[results:]] == [0]
    assert driver.drive_to(LOCATIONS["location3"]).error_code == 0
    assert driver.of(GLOBAL_COSTMAP)[-1].info.width > driver.of(GLOBAL_COSTMAP)[0].info.width
    assert not driver.refusals()


def test_a_wall_that_the_map_comes_to_show_makes_a_new_way() -> None:
    driver = GrowingMapDriver()
    driver.learn()
    driver.run(0.2)
    driver.show(9.0)
    driver.run(0.3)
    driver.goal(LOCATIONS["location3"])
    driver.run(1.0)
    before = driver.of(PLAN)[-1]
    cells = house().map_cells.copy()
    x_m = before.poses[len(before.poses) // 2].pose.position.x
    column = round((x_m - house().map_origin.x_m) / 0.05)
    cells[:, column - 2 : column + 2] = 100
    grid = msg.occupancy_grid(driver.now_ns, 0.05, house().map_origin, cells)
    driver.inbox.deliver(MAP, grid, Envelope("mapping", driver.now_ns, driver.now_ns, ""))
    for _ in range(60):
        driver.run(1.0)
        if driver.results():
            break
    assert driver.results()[-1].error_code == ErrorCode.NO_VALID_PATH
    assert driver.robot.map_from_base.x_m < x_m


def test_a_map_of_an_earlier_run_is_not_driven_in() -> None:
    driver = GrowingMapDriver()
    driver.learn()
    driver.run(0.2)
    late = msg.occupancy_grid(99_000_000_000, 0.05, house().map_origin, house().map_cells)
    driver.inbox.deliver(MAP, late, Envelope("mapping", 0, 0, ""))
    driver.run(1.0)
    assert driver.node.waiting_for() == "the map"
    driver.show(2.0)
    driver.step()
    assert driver.node.waiting_for() != "the map"
    (columns,) = {grid.info.width for grid in driver.of(GLOBAL_COSTMAP)}
    assert columns < house().map_cells.shape[1]


def test_a_map_that_is_sent_once_waits_for_the_clock_and_the_world() -> None:
    driver = GrowingMapDriver()
    ahead_ns = 300_000_000
    grid = msg.occupancy_grid(ahead_ns, 0.05, house().map_origin, house().map_cells)
    driver.inbox.deliver(MAP, grid, Envelope("mapping", 0, ahead_ns, ""))
    driver.run(0.1)
    assert driver.node.waiting_for() == "the world"
    driver.learn()
    driver.run(0.1)
    assert driver.node.waiting_for() == "the map"
    driver.run(0.2)
    assert driver.node.waiting_for() != "the map"
    assert not driver.refusals()


def test_of_a_world_that_is_being_mapped_no_dock_is_known() -> None:
    driver = GrowingMapDriver()
    marker = SAMPLES[ENTITIES].entities[0]
    driver.learn(entities=Entities(world_hash=house().world.hash, entities=(marker,)))
    driver.run(0.2)
    driver.show(9.0)
    driver.run(0.5)
    send = SendGoal(goal_id="d", goal=DockRobot(dock_id="60"))
    asked(driver, SEND_GOAL, send)
    driver.run(1.0)
    (result,) = driver.of(ACTION_RESULT)
    assert result.error_code == ErrorCode.DOCK_NOT_IN_DB
