"""Draws the pictures of docs/mapping.md: a map as it grows, against the world, with its pose graph,
and how much is mapped over the metres driven.

`python -m mazebot.cli.pages.mapping_sheet FOLDER` writes them.
"""

from __future__ import annotations

import sys
import tempfile
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from PIL import Image, ImageDraw, ImageFont

from mazebot.bench.slam.exploration import WORLDS, offline_tour_m, place_of
from mazebot.cli.pages.navigation_sheet import (
    Ink,
    Panel,
    Picture,
    beside,
    map_inks,
    png,
    stacked,
    title_strip,
)
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.messages import messages as msg
from mazebot.common.messages.documents import World
from mazebot.common.messages.slam_documents import PoseGraph
from mazebot.common.messages.topics import (
    EXPLORATION_STATUS,
    GROUND_TRUTH_ODOM,
    MAP,
    POSE_GRAPH,
    WORLD,
)
from mazebot.embedded.session import Session
from mazebot.explorer.params import ExplorerParams
from mazebot.recorder.judging.map.true_map import Lattice, TrueMap, true_map

_HERE = SE2(0.0, 0.0, 0.0)
_SEED = 1
_MOST_S = 1200.0
_AT_SHARES = (0.02, 0.3, 0.75, 1.0)
"""Of the exploration's time: when the growing map is shown."""
_INK: Ink = (32, 36, 42)
_TRUTH: Ink = (46, 160, 90)
_MISSED: Ink = (214, 39, 40)
_WAY: Ink = (240, 150, 0)
_NODE: Ink = (20, 90, 220)
_EDGE: Ink = (150, 150, 150)
_LOOP: Ink = (46, 190, 90)
_MARKER: Ink = (200, 0, 160)
_POLICIES: dict[str, Ink] = {"tour": (20, 90, 220), "nearest": (240, 150, 0)}
_PLOT_PX, _PLOT_MARGIN_PX = (1052, 420), 56


@dataclass(frozen=True, eq=False)
class Explored:
    """The messages of one exploration."""

    world: World
    maps: list[msg.OccupancyGrid]
    graph: PoseGraph
    stamps_ns: list[int]
    """Of the true positions, (n, 2)."""
    way: Array

    def until(self, stamp_ns: int) -> Array:
        """The true positions up to a time."""
        return self.way[: bisect_right(self.stamps_ns, stamp_ns)]

    def driven_m(self, stamp_ns: int) -> float:
        """Length of the true path up to a time."""
        return float(np.linalg.norm(np.diff(self.until(stamp_ns), axis=0), axis=1).sum())


def explored(world: str, policy: str, camera: bool) -> Explored:
    """Explore one of the benchmark's worlds."""
    name, overrides = WORLDS[world]
    with tempfile.TemporaryDirectory() as folder:
        settings = Path(folder, "settings.yaml")
        settings.write_text(yaml.safe_dump({"explorer": {"choice": policy}}), encoding="utf-8")
        with Session(
            name, _SEED, camera=camera, slam=True, settings=settings,
            overrides=tuple(one.format(seed=_SEED) for one in overrides),
        ) as session:  # fmt: skip
            return _followed(session)


def _followed(session: Session) -> Explored:
    with (
        session.watching(MAP) as maps,
        session.watching(GROUND_TRUTH_ODOM) as truths,
        session.watching(EXPLORATION_STATUS) as statuses,
    ):
        while not statuses or statuses[-1].state not in ("complete", "failed"):
            if session.now_s > _MOST_S:
                raise TimeoutError(f"exploration timed out after {_MOST_S:g} s")
            session.run_for(1.0)
        world, graph = session.latest(WORLD), session.latest(POSE_GRAPH)
    if world is None or graph is None:
        raise RuntimeError("mapping has published no graph")
    poses = [truth.pose.pose.position for truth in truths]
    return Explored(
        world=world,
        maps=maps,
        graph=graph,
        stamps_ns=[msg.ns_from_time(truth.header.stamp) for truth in truths],
        way=np.array([(at.x, at.y) for at in poses]).reshape(-1, 2),
    )


def growth(run: Explored) -> Picture:
    """The map at four times, beside the true walls, with the way driven until then."""
    truth = true_map(run.world, {})
    end_ns = msg.ns_from_time(run.maps[-1].header.stamp)
    stamps_ns = [msg.ns_from_time(grid.header.stamp) for grid in run.maps]
    panels = []
    for share in _AT_SHARES:
        at_ns = round(share * end_ns)
        index = max(bisect_right(stamps_ns, at_ns) - 1, 0)
        text = f"{at_ns * 1e-9:.0f} s, {run.driven_m(at_ns):.1f} m driven"
        panel = _panel(text, truth)
        panel.grid(run.maps[index], _HERE, map_inks)
        for face in truth.faces_m:
            panel.line(face, _TRUTH, 1)
        panel.line(run.until(at_ns), _WAY, 2)
        panels.append(panel.done())
    first, second, third, fourth = panels
    return stacked(beside(first, second), beside(third, fourth))


def against_truth(run: Explored) -> Picture:
    """The map with the walls that it holds and those that it lacks; and its pose graph."""
    truth, grid = true_map(run.world, {}), run.maps[-1]
    origin, cells = msg.se2_from_pose(grid.info.origin), msg.cells_from_grid(grid)
    lattice = Lattice(truth, float(grid.info.resolution), origin)
    found, shares = lattice.found(cells, origin), lattice.judge(cells, origin)
    walls = _panel(f"walls: {shares.walls_found or 0.0:.1%} found (green), missed (red)", truth)
    walls.grid(grid, _HERE, map_inks)
    for face, is_found in zip(truth.faces_m, found, strict=True):
        walls.line(face, _TRUTH if is_found else _MISSED, 2 if is_found else 4)
    return beside(walls.done(), graph_panel(run, truth))


def graph_panel(run: Explored, truth: TrueMap) -> Picture:
    """Keyframes blue, edges grey, loops green, markers purple."""
    graph = run.graph
    text = f"{len(graph.nodes)} keyframes, {graph.loops} loops, {len(graph.landmarks)} markers"
    panel = _panel(text, truth)
    panel.grid(run.maps[-1], _HERE, _faint)
    places = {node.id: (node.pose.x_m, node.pose.y_m) for node in graph.nodes}
    markers = [landmark.position_m[:2] for landmark in graph.landmarks]
    for kind, ink, width_px in (
        ("marker", _MARKER, 1), ("odometry", _EDGE, 1), ("scan_match", _EDGE, 1), ("loop", _LOOP, 3)
    ):  # fmt: skip
        for edge in graph.edges:
            if edge.kind == kind:
                end = markers[edge.target] if kind == "marker" else places[edge.target]
                panel.line(np.array([places[edge.source], end]), ink, width_px)
    panel.dots(np.array(list(places.values())).reshape(-1, 2), _NODE, 3)
    panel.dots(np.array(markers).reshape(-1, 2), _MARKER, 5)
    return panel.done()


def coverage_plot(world: str) -> Picture:
    """Share of the reachable floor that is mapped, over the metres driven, by each policy."""
    lines = {}
    for policy in _POLICIES:
        run = explored(world, policy, camera=False)
        truth = true_map(run.world, {})
        origin = msg.se2_from_pose(run.maps[0].info.origin)
        lattice = Lattice(truth, float(run.maps[0].info.resolution), origin)
        points = []
        for grid in run.maps:
            at, cells = msg.se2_from_pose(grid.info.origin), msg.cells_from_grid(grid)
            covered = lattice.judge(cells, at).coverage or 0.0
            points.append((run.driven_m(msg.ns_from_time(grid.header.stamp)), covered))
        points.append((run.driven_m(run.stamps_ns[-1]), points[-1][1]))
        lines[policy] = np.array(points)
    tour_m = offline_tour_m(place_of(world, _SEED), ExplorerParams())
    text = f"reachable floor mapped (%) over metres driven, with the way home: {WORLDS[world][0]}"
    return np.vstack([title_strip(text, _PLOT_PX[0]), _plot(lines, tour_m)])


def _plot(lines: dict[str, Array], tour_m: float) -> Picture:
    width, height = _PLOT_PX
    margin = _PLOT_MARGIN_PX
    most_m = 1.05 * max(tour_m, *(float(line[-1, 0]) for line in lines.values()))
    picture = Image.new("RGB", _PLOT_PX, (255, 255, 255))
    draw = ImageDraw.Draw(picture)
    font = ImageFont.load_default(size=15.0)

    def at(x_m: float, share: float) -> tuple[float, float]:
        x = margin + (width - 2 * margin) * x_m / most_m
        return x, height - margin - (height - 2 * margin) * share

    for percent in range(0, 101, 20):
        draw.line([at(0.0, percent / 100), at(most_m, percent / 100)], fill=(225, 225, 225))
        x, y = at(0.0, percent / 100)
        draw.text((x - 8, y), str(percent), fill=_INK, font=font, anchor="rm")
    step_m = 10 if most_m < 100 else 25
    for metres in range(0, int(most_m) + 1, step_m):
        x, y = at(metres, 0.0)
        draw.text((x, y + 8), str(metres), fill=_INK, font=font, anchor="mt")
    draw.line([at(tour_m, 0.0), at(tour_m, 1.0)], fill=_EDGE, width=2)
    x, y = at(tour_m, 0.5)
    draw.text((x - 6, y), f"offline tour {tour_m:.0f} m", fill=_INK, font=font, anchor="rm")
    for number, (policy, line) in enumerate(lines.items()):
        ink = _POLICIES[policy]
        draw.line([at(x_m, share) for x_m, share in line.tolist()], fill=ink, width=3)
        x, y = at(float(line[-1, 0]), float(line[-1, 1]))
        draw.ellipse((x - 5, y - 5, x + 5, y + 5), fill=ink)
        text = f"{policy}: {line[-1, 0]:.1f} m"
        place = width / 2, height - margin - 60 + 24 * number
        draw.text(place, text, fill=ink, font=font, anchor="lm")
    return np.asarray(picture)


def pictures() -> dict[str, Callable[[], Picture]]:
    """The pictures by their file names."""
    runs: list[Explored] = []

    def house() -> Explored:
        if not runs:
            runs.append(explored("enhanced", "tour", camera=True))
        return runs[0]

    return {
        "mapping-growth.png": lambda: growth(house()),
        "mapping-truth.png": lambda: against_truth(house()),
        "mapping-coverage.png": lambda: coverage_plot("slam"),
    }


def _panel(text: str, truth: TrueMap) -> Panel:
    low, high = truth.faces_m.min(axis=(0, 1)), truth.faces_m.max(axis=(0, 1))
    middle = (low + high) / 2.0
    return Panel(text, (float(middle[0]), float(middle[1])), float((high - low).max()) + 0.6)


def _faint(cells: Array) -> Array:
    inks = map_inks(cells)
    inks[:, 3] = 0.5
    return inks


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m mazebot.cli.pages.mapping_sheet FOLDER")
    for name, make in pictures().items():
        Path(sys.argv[1], name).write_bytes(png(make()))
