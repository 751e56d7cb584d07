"""Draws the pictures of docs/navigation.md from the topics of a drive in the house maze, with a box
in the way that the map does not have.

`python -m mazebot.cli.pages.navigation_sheet FOLDER` writes them.
"""

from __future__ import annotations

import contextlib
import io
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages import messages as msg
from mazebot.common.messages.action_documents import BehaviorTreeLog
from mazebot.common.messages.documents import BodyEntity, Box, Shape
from mazebot.common.messages.topics import (
    AMCL_POSE,
    BEHAVIOR_TREE,
    GLOBAL_COSTMAP,
    GOAL_POSE,
    LOCAL_COSTMAP,
    MAP,
    PARTICLE_CLOUD,
    PLAN,
    SCAN,
    TF,
    TRAJECTORIES,
    Topic,
)
from mazebot.embedded.session import Session
from mazebot.navigation.costmap.footprint import WAFFLE

Ink = tuple[int, int, int]
Picture = NDArray[np.uint8]
M = TypeVar("M")

_GOAL = SE2(3.322, -0.178, 1.571)
_BOX_AT, _BOX_SIDE_M = (0.75, -0.75), 0.25
_GATE_AT, _GATE_SIZE_M = (0.75, -0.985), (0.25, 0.2)
"""Shuts the gap between the box and the wall."""
_PANEL_PX, _TITLE_PX, _GAP_PX = 520, 34, 12
_COLOURS = 128
_INK: Ink = (32, 36, 42)
_TRUTH: Ink = (46, 160, 90)
_PATH: Ink = (20, 90, 220)
_SCAN: Ink = (220, 40, 40)
_PARTICLE: Ink = (240, 150, 0)
_STATUS: dict[str, Ink] = {
    "RUNNING": (20, 90, 220),
    "SUCCESS": (46, 160, 90),
    "FAILURE": (214, 39, 40),
    "SKIPPED": (150, 90, 170),
    "IDLE": (190, 190, 190),
}
_IDLE: Ink = (150, 150, 150)
_LASER_X_M = -0.064
_MOST_S = 30.0


@dataclass(frozen=True)
class Scene:
    """The messages at one moment of the drive."""

    truth: SE2
    estimate: SE2
    map_from_odom: SE2
    chart: msg.OccupancyGrid
    global_costmap: msg.OccupancyGrid
    local_costmap: msg.OccupancyGrid
    cloud: msg.PoseArray
    scan: msg.LaserScan
    plan: msg.Path
    rollouts: msg.MarkerArray
    tree: BehaviorTreeLog


class Panel:
    """A square picture of a part of the map, x to the right, y up, under a title."""

    def __init__(self, title: str, middle: tuple[float, float], side_m: float) -> None:
        self._low = middle[0] - side_m / 2.0, middle[1] - side_m / 2.0
        self._scale = _PANEL_PX / side_m
        self._picture = Image.new("RGB", (_PANEL_PX, _PANEL_PX), (255, 255, 255))
        self._title = title

    def grid(
        self, grid: msg.OccupancyGrid, map_from_frame: SE2, inks: Callable[[Array], Array]
    ) -> None:
        """Draw a grid's cells; `inks` gives (n, 4) red, green, blue and opacity of n cells."""
        per_px = (np.arange(_PANEL_PX) + 0.5) / self._scale
        x, y = np.meshgrid(self._low[0] + per_px, self._low[1] + per_px[::-1])
        grid_from_map = (map_from_frame @ msg.se2_from_pose(grid.info.origin)).inverse()
        c, s = math.cos(grid_from_map.yaw_rad), math.sin(grid_from_map.yaw_rad)
        column = (c * x - s * y + grid_from_map.x_m) / grid.info.resolution
        row = (s * x + c * y + grid_from_map.y_m) / grid.info.resolution
        known = (column >= 0) & (row >= 0) & (column < grid.info.width) & (row < grid.info.height)
        cells = msg.cells_from_grid(grid)[row[known].astype(int), column[known].astype(int)]
        picture = np.array(self._picture, np.float64)
        ink = inks(cells.astype(np.float64))
        share = ink[:, 3:]
        picture[known] = (1.0 - share) * picture[known] + share * ink[:, :3]
        self._picture = Image.fromarray(picture.astype(np.uint8))

    def line(self, points_m: Array, ink: Ink, width_px: int = 2) -> None:
        """Draw a line through (n, 2 or more) points."""
        if len(points_m) > 1:
            draw = ImageDraw.Draw(self._picture)
            draw.line(self._pixels(points_m), fill=ink, width=width_px, joint="curve")

    def dots(self, points_m: Array, ink: Ink, radius_px: int = 2) -> None:
        """Draw (n, 2) points."""
        draw = ImageDraw.Draw(self._picture)
        for x, y in self._pixels(points_m):
            draw.ellipse((x - radius_px, y - radius_px, x + radius_px, y + radius_px), fill=ink)

    def robot(self, pose: SE2, ink: Ink = _TRUTH) -> None:
        """Draw the robot's outline, and where it looks."""
        outline = np.array([(pose @ SE2(x, y, 0.0))[:2] for x, y in WAFFLE.points_m.tolist()])
        self.line(np.vstack([outline, outline[:1]]), ink, 3)
        self.line(np.array([pose[:2], (pose @ SE2(0.2, 0.0, 0.0))[:2]]), ink, 3)

    def done(self) -> Picture:
        """The picture under its title."""
        return np.vstack([title_strip(self._title, _PANEL_PX), np.array(self._picture)])

    def _pixels(self, points_m: Array) -> list[tuple[float, float]]:
        x = (points_m[:, 0] - self._low[0]) * self._scale
        y = _PANEL_PX - (points_m[:, 1] - self._low[1]) * self._scale
        return list(zip(x.tolist(), y.tolist(), strict=True))


def passing() -> Scene:
    """The moment of a drive at which the box in the way is seen and passed."""
    with _sent_past_a_box() as session, session.watching(TF) as frames:
        _run_until(session, lambda: session.ground_truth().x_m >= _BOX_AT[0] - 0.35)
        with session.watching(TRAJECTORIES) as rollouts:
            _run_until(session, lambda: bool(rollouts))
        return _scene(session, frames)


def shut() -> BehaviorTreeLog:
    """The tree of the same drive where the gap beside the box is shut: it waits for a way."""
    with _sent_past_a_box() as session, session.watching(BEHAVIOR_TREE) as trees:
        _put(session, "gate", _GATE_AT, _GATE_SIZE_M)
        _run_until(session, lambda: any(map(_waits, trees)))
        return next(filter(_waits, trees))


@contextlib.contextmanager
def _sent_past_a_box() -> Iterator[Session]:
    with Session("original", camera=False) as session:
        _put(session, "box", _BOX_AT, (_BOX_SIDE_M, _BOX_SIDE_M))
        session.run_for(1.0)
        header = msg.header(round(session.now_s * 1e9), "map")
        session.publish(GOAL_POSE, msg.PoseStamped(header, msg.pose_from_se2(_GOAL)))
        yield session


def _run_until(session: Session, done: Callable[[], bool]) -> None:
    end_s = session.now_s + _MOST_S
    while not done():
        if session.now_s > end_s:
            raise TimeoutError(f"the drive timed out after {_MOST_S:g} s")
        session.run_for(0.05)


def _put(
    session: Session, name: str, at_m: tuple[float, float], size_m: tuple[float, float]
) -> None:
    shape = Shape(name="box", geometry=Box(size_m=(*size_m, 0.4)), material="")
    session.spawn(BodyEntity(name=name, position_m=(*at_m, 0.2), shapes=(shape,)))


def _waits(tree: BehaviorTreeLog) -> bool:
    return any(node.kind == "Wait" and node.status == "RUNNING" for node in tree.nodes)


def _scene(session: Session, frames: Sequence[msg.TFMessage]) -> Scene:
    entries = (entry for tree in reversed(frames) for entry in tree.transforms)
    of_odom = next(entry.transform for entry in entries if entry.child_frame_id == "odom")
    turn = of_odom.rotation
    return Scene(
        truth=session.ground_truth(),
        estimate=msg.se2_from_pose(_latest(session, AMCL_POSE).pose.pose),
        map_from_odom=SE2(
            of_odom.translation.x, of_odom.translation.y, 2.0 * math.atan2(turn.z, turn.w)
        ),
        chart=_latest(session, MAP),
        global_costmap=_latest(session, GLOBAL_COSTMAP),
        local_costmap=_latest(session, LOCAL_COSTMAP),
        cloud=_latest(session, PARTICLE_CLOUD),
        scan=_latest(session, SCAN),
        plan=_latest(session, PLAN),
        rollouts=_latest(session, TRAJECTORIES),
        tree=_latest(session, BEHAVIOR_TREE),
    )


def _latest(session: Session, topic: Topic[M]) -> M:
    message = session.latest(topic)
    if message is None:
        raise RuntimeError(f"{topic.name}: no message received")
    return message


def localisation_panel(scene: Scene) -> Picture:
    """The map, the particles, and the scan as it lies by the estimated pose."""
    panel = Panel("localisation: particles and scan on the map", scene.truth[:2], 4.0)
    panel.grid(scene.chart, SE2(0.0, 0.0, 0.0), map_inks)
    ranges = np.array(scene.scan.ranges, np.float64)
    turns = scene.scan.angle_min + scene.scan.angle_increment * np.arange(len(ranges))
    seen = np.isfinite(ranges)
    x, y = ranges[seen] * np.cos(turns[seen]) + _LASER_X_M, ranges[seen] * np.sin(turns[seen])
    c, s = math.cos(scene.estimate.yaw_rad), math.sin(scene.estimate.yaw_rad)
    echoes = np.column_stack([c * x - s * y, s * x + c * y]) + np.array(scene.estimate[:2])
    panel.dots(echoes, _SCAN)
    panel.robot(scene.truth)
    panel.dots(np.array([(p.position.x, p.position.y) for p in scene.cloud.poses]), _PARTICLE, 1)
    return panel.done()


def planning_panel(scene: Scene) -> Picture:
    """The global costmap and the path on it."""
    panel = _on_map(scene, "planning: global costmap and path", (0.6, 0.8), 6.6)
    panel.line(_points(scene.plan), _PATH, 3)
    panel.robot(scene.truth)
    panel.robot(_GOAL, _PATH)
    return panel.done()


def _on_map(scene: Scene, title: str, middle: tuple[float, float], side_m: float) -> Panel:
    panel = Panel(title, middle, side_m)
    panel.grid(scene.chart, SE2(0.0, 0.0, 0.0), map_inks)
    panel.grid(scene.global_costmap, SE2(0.0, 0.0, 0.0), _cost_inks)
    return panel


def control_panel(scene: Scene, side_m: float = 3.0) -> Picture:
    """The local costmap, the rollouts by their cost, and the one chosen."""
    panel = Panel("control: local costmap and MPPI's rollouts", scene.truth[:2], side_m)
    panel.grid(scene.local_costmap, scene.map_from_odom, _cost_inks)
    panel.line(_points(scene.plan), _PATH, 2)
    *rollouts, optimal = scene.rollouts.markers
    for marker in reversed(rollouts):
        ink = round(200 * marker.color.r), round(170 * marker.color.g), 0
        panel.line(_places(marker), ink, 1)
    panel.line(_places(optimal), _INK, 4)
    panel.robot(scene.truth)
    return panel.done()


def tree_panel(title: str, tree: BehaviorTreeLog, line_px: float) -> Picture:
    """The tree, indented, each node in the colour of its answer."""
    height_px = max(round(line_px * (len(tree.nodes) + 2)), _PANEL_PX)
    font = ImageFont.load_default(size=0.8 * line_px)
    picture = Image.new("RGB", (_PANEL_PX, height_px), (255, 255, 255))
    draw = ImageDraw.Draw(picture)
    for number, node in enumerate(tree.nodes):
        left, middle = 10.0 + line_px * (node.depth + 0.5), 6.0 + line_px * (number + 0.5)
        ink, radius = _STATUS[node.status], 0.32 * line_px
        around = (left - radius, middle - radius, left + radius, middle + radius)
        draw.ellipse(around, fill=ink)
        text_ink = _IDLE if node.status == "IDLE" else _INK
        place = left + 0.8 * line_px, middle
        draw.text(place, node.name, fill=text_ink, font=font, anchor="lm")
    for number, (status, ink) in enumerate(_STATUS.items()):
        place = 10.0 + 100.0 * number, height_px - 0.7 * line_px
        draw.text(place, status.lower(), fill=ink, font=font, anchor="lm")
    return np.vstack([title_strip(title, _PANEL_PX), np.array(picture)])


def pictures() -> dict[str, Picture]:
    """The pictures by their file names."""
    scene = passing()
    planning, control = planning_panel(scene), control_panel(scene)
    near = _on_map(scene, "global costmap, in the frame map", scene.truth[:2], 3.0)
    near.robot(scene.truth)
    local = Panel("local costmap, in the frame odom", scene.truth[:2], 3.0)
    local.grid(scene.local_costmap, scene.map_from_odom, _cost_inks)
    local.robot(scene.truth)
    small_px, large_px = _PANEL_PX / 50.0, 16.0
    tree = tree_panel("behaviour: the tree", scene.tree, small_px)
    follows = tree_panel("the path is followed", scene.tree, large_px)
    waits = tree_panel("the way is blocked", shut(), large_px)
    return {
        "navigation.png": stacked(
            beside(localisation_panel(scene), planning), beside(control, tree)
        ),
        "costmaps.png": beside(near.done(), local.done()),
        "rollouts.png": control_panel(scene, 1.8),
        "behavior-tree.png": beside(follows, waits),
    }


def _points(plan: msg.Path) -> Array:
    return np.array([(p.pose.position.x, p.pose.position.y) for p in plan.poses]).reshape(-1, 2)


def _places(marker: Any) -> Array:
    return np.array([(p.x, p.y) for p in marker.points]).reshape(-1, 2)


def map_inks(cells: Array) -> Array:
    """Unknown cells grey, occupied ones dark, free ones white."""
    grey = np.where(cells < 0, 205.0, np.where(cells >= 50, 60.0, 255.0))
    return np.column_stack([grey, grey, grey, np.ones_like(grey)])


def _cost_inks(cells: Array) -> Array:
    """As in RViz: blue to red with the cost, cyan where the robot's middle cannot be, magenta
    for obstacles.
    """
    share = np.clip(cells, 0.0, 98.0) / 98.0
    inks = np.column_stack([255.0 * share, 0.0 * share, 255.0 * (1.0 - share), 0.2 + 0.4 * share])
    inks[cells <= 0] = (0.0, 0.0, 0.0, 0.0)
    inks[cells == 99] = (0.0, 200.0, 210.0, 0.75)
    inks[cells == 100] = (200.0, 0.0, 200.0, 0.85)
    return inks


def title_strip(text: str, width_px: int) -> Picture:
    """A strip with a line of text."""
    strip = Image.new("RGB", (width_px, _TITLE_PX), (255, 255, 255))
    font = ImageFont.load_default(size=18.0)
    ImageDraw.Draw(strip).text((4, _TITLE_PX / 2), text, fill=_INK, font=font, anchor="lm")
    return np.array(strip)


def beside(left: Picture, right: Picture) -> Picture:
    """Two pictures of one height, side by side."""
    gap = np.full((len(left), _GAP_PX, 3), 255, np.uint8)
    return np.hstack([left, gap, right])


def stacked(above: Picture, below: Picture) -> Picture:
    """Two pictures of one width, one above the other."""
    return np.vstack([above, np.full((_GAP_PX, above.shape[1], 3), 255, np.uint8), below])


def png(picture: Picture) -> bytes:
    """A small PNG with few colours."""
    data = io.BytesIO()
    few = Image.fromarray(picture).quantize(_COLOURS, dither=Image.Dither.NONE)
    few.save(data, "PNG", optimize=True)
    return data.getvalue()


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m mazebot.cli.pages.navigation_sheet FOLDER")
    for name, picture in pictures().items():
        Path(sys.argv[1], name).write_bytes(png(picture))
