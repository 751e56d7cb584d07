"""What a drive is seen by: its costmaps, zones, footprint, tree and trajectories, as messages."""

from __future__ import annotations

from mazebot.common.maths.frames import MAP_FRAME, ODOM_FRAME
from mazebot.common.messages.topics import (
    BEHAVIOR_TREE,
    COLLISION_MONITOR_STATE,
    GLOBAL_COSTMAP,
    GLOBAL_COSTMAP_UPDATES,
    KEEPOUT_FILTER_MASK,
    LOCAL_COSTMAP,
    PUBLISHED_FOOTPRINT,
    SPEED_FILTER_MASK,
    TRAJECTORIES,
)
from mazebot.common.node.node import Outbox
from mazebot.common.node.schedule import Schedule
from mazebot.navigation.behavior.bt_navigator import BtNavigator
from mazebot.navigation.behavior.engine.tree import NodeSnapshot
from mazebot.navigation.behavior.engine.tree_log import TreeLog
from mazebot.navigation.control.mppi.mppi import MPPIController
from mazebot.navigation.control.safety.collision_monitor import MonitorState
from mazebot.navigation.costmap.layered_costmap import GridFrame, LayeredCostmap
from mazebot.navigation.costmap.zones import Zones
from mazebot.navigation.drive import Drive
from mazebot.navigation.messages import (
    costmap_message,
    costmap_update_message,
    footprint_message,
    mask_message,
    monitor_document,
    trajectories_message,
    tree_document,
)
from mazebot.navigation.robot.measurements import Measurements
from mazebot.navigation.robot.robot_context import RobotContext

_COSTMAP_PERIOD_NS = 1_000_000_000
_COSTMAP_UPDATES_PERIOD_NS = 200_000_000
_LOCAL_COSTMAP_PERIOD_NS = 500_000_000
_TREE_PERIOD_NS = 200_000_000
_TRAJECTORIES_PERIOD_NS = 500_000_000


class DriveReports:
    """Publishes what changed of a drive, each kind at its own highest rate."""

    def __init__(self) -> None:
        self._schedule = Schedule()
        self._costmap_shown = -1
        self._frame_shown: GridFrame | None = None
        self._zones_shown: Zones | None = None
        self._tree_log = TreeLog()
        self._tree_published: tuple[str, tuple[NodeSnapshot, ...]] | None = None
        """The action and its tree last published."""

    def restart(self) -> None:
        """Begin the periods anew: time may have gone back."""
        self._schedule.clear()

    def publish(
        self,
        now_ns: int,
        outbox: Outbox,
        drive: Drive,
        measured: Measurements,
        monitor_state: MonitorState | None,
        highest_m_s: float,
    ) -> None:
        """Publish what is due; `highest_m_s` is the speed that limits in percent are of."""
        robot = drive.robot
        self._publish_zones(now_ns, outbox, robot, highest_m_s)
        self._publish_costmap(now_ns, outbox, robot.costmap)
        self._publish_local(now_ns, outbox, robot, measured)
        state = monitor_state
        if state is not None and drive.monitor_published != (state.action, state.polygon_name):
            drive.monitor_published = (state.action, state.polygon_name)
            outbox.put(COLLISION_MONITOR_STATE, monitor_document(state))
        self._publish_tree(now_ns, outbox, drive.navigator)
        self._publish_trajectories(now_ns, outbox, robot)

    def _publish_local(
        self, now_ns: int, outbox: Outbox, robot: RobotContext, measured: Measurements
    ) -> None:
        if measured.echoes is None:
            return
        if not self._schedule.is_due("local", now_ns, _LOCAL_COSTMAP_PERIOD_NS):
            return
        local, odom, footprint = robot.local_costmap, measured.odom, robot.footprint
        outbox.offer(LOCAL_COSTMAP, lambda: costmap_message(now_ns, local, ODOM_FRAME))
        if odom is not None:
            outbox.offer(PUBLISHED_FOOTPRINT, lambda: footprint_message(now_ns, footprint, odom[1]))

    def _publish_zones(
        self, now_ns: int, outbox: Outbox, robot: RobotContext, highest_m_s: float
    ) -> None:
        """Publish masks of the zones; of zones that were removed, an empty one."""
        frame, zones, shown = robot.costmap.frame, robot.zones, self._zones_shown
        if zones is shown:
            return
        self._zones_shown = zones
        if any(each is not None and each.keepout.size for each in (zones, shown)):
            keepout = zones.keepout if zones is not None and zones.keepout.size else None
            outbox.put(KEEPOUT_FILTER_MASK, mask_message(now_ns, frame, keepout))
        if any(each is not None and each.limits_m_s.size for each in (zones, shown)):
            speeds = zones.speed_values(highest_m_s) if zones is not None else None
            outbox.put(SPEED_FILTER_MASK, mask_message(now_ns, frame, speeds))

    def _publish_costmap(self, now_ns: int, outbox: Outbox, costmap: LayeredCostmap) -> None:
        if costmap.revision == self._costmap_shown:
            return
        if self._schedule.is_due("costmap", now_ns, _COSTMAP_PERIOD_NS):
            self._costmap_shown = costmap.revision
            self._frame_shown = costmap.frame
            costmap.take_changed()
            outbox.offer(GLOBAL_COSTMAP, lambda: costmap_message(now_ns, costmap, MAP_FRAME))
        elif costmap.frame is self._frame_shown and outbox.is_read(GLOBAL_COSTMAP_UPDATES):
            self._publish_costmap_update(now_ns, outbox, costmap)

    def _publish_costmap_update(self, now_ns: int, outbox: Outbox, costmap: LayeredCostmap) -> None:
        if not self._schedule.is_due("costmap updates", now_ns, _COSTMAP_UPDATES_PERIOD_NS):
            return
        changed = costmap.take_changed()
        if changed is not None:
            update = costmap_update_message(now_ns, costmap, changed, MAP_FRAME)
            outbox.put(GLOBAL_COSTMAP_UPDATES, update)

    def _publish_tree(self, now_ns: int, outbox: Outbox, navigator: BtNavigator) -> None:
        if not outbox.is_read(BEHAVIOR_TREE):
            return
        self._tree_log.add(navigator.running_tree())
        if not self._schedule.is_due("tree", now_ns, _TREE_PERIOD_NS):
            return
        action = navigator.request.action if navigator.request is not None else ""
        tree = action, self._tree_log.take()
        if tree != self._tree_published:
            self._tree_published = tree
            outbox.put(BEHAVIOR_TREE, tree_document(*tree))

    def _publish_trajectories(self, now_ns: int, outbox: Outbox, robot: RobotContext) -> None:
        controller = robot.controller_server.controller
        if not robot.controlled or not isinstance(controller, MPPIController):
            return
        if not outbox.is_read(TRAJECTORIES):
            return
        if self._schedule.is_due("trajectories", now_ns, _TRAJECTORIES_PERIOD_NS):
            drawn = controller.trajectories()
            if drawn is not None:
                outbox.put(TRAJECTORIES, trajectories_message(now_ns, drawn))
