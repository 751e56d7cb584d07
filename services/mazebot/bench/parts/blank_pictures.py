"""Pictures without ArUco markers: worlds, textures, noise, clutter and printed patterns."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from mazebot.bench.parts.perception_views import Viewer
from mazebot.common.files.root import ROOT

Picture = NDArray[np.uint8]
"""(height, width) grey"""

WIDTH, HEIGHT = 640, 480
WORLDS = ("sim_house", "sim_house_enhanced", "sim_house_rooms", "sim_house_floor", "maze",
          "maze_rooms")  # fmt: skip
_TEXTURES = ROOT / "worlds" / "textures"
_TEXT = "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789#&@%"


def blank_pictures(count: int, generator: np.random.Generator) -> Iterator[tuple[str, Picture]]:
    """Kind and picture of `count` pictures; a half are rendered worlds without their markers."""
    rendered = count - count // 2
    for index, world in enumerate(WORLDS):
        share = rendered // len(WORLDS) + (index < rendered % len(WORLDS))
        if share:
            with closing(Viewer(world, with_markers=False)) as viewer:
                for _ in range(share):
                    rgb = viewer.look(viewer.random_pose(generator)).rgb
                    yield "rendered world", _grey(rgb)
    makers = tuple(_MAKERS.items())
    for index in range(count // 2):
        kind, make = makers[index % len(makers)]
        yield kind, _as_photographed(make(generator), generator)


def texture(generator: np.random.Generator) -> Picture:
    """A wall texture of the shipped worlds, tiled and seen from a random direction."""
    files = sorted(_TEXTURES.glob("*.png"))
    tile = _read(files[int(generator.integers(len(files)))])
    tile = _small(tile, 0.4)
    repeats = (-(-2 * HEIGHT // tile.shape[0]), -(-2 * WIDTH // tile.shape[1]))
    return _seen_askew(np.tile(tile, repeats)[: 2 * HEIGHT, : 2 * WIDTH], generator)


def noise(generator: np.random.Generator) -> Picture:
    """Noise with structures from one pixel to a quarter of the picture."""
    picture = 128.0 + float(generator.uniform(0.0, 60.0)) * _grain(generator)
    for cell_px in (4, 12, 40, 120):
        cells = generator.normal(
            0.0, generator.uniform(0.0, 60.0), (-(-HEIGHT // cell_px), -(-WIDTH // cell_px))
        )
        how = cv2.INTER_NEAREST if generator.random() < 0.5 else cv2.INTER_CUBIC
        picture += cv2.resize(cells, (WIDTH, HEIGHT), interpolation=how)
    return _bytes(picture)


def clutter(generator: np.random.Generator) -> Picture:
    """Shapes that cover each other, small ones more frequent: the dead leaves model of photos."""
    picture = np.full((HEIGHT, WIDTH), 128, np.uint8)
    for _ in range(250):
        size_px = min(8.0 * float(generator.pareto(1.5) + 1.0), 250.0)
        centre = generator.uniform((0, 0), (WIDTH, HEIGHT))
        sides = (size_px, size_px * float(generator.uniform(0.4, 1.0)))
        shade = int(generator.integers(256))
        box = cv2.boxPoints((tuple(centre.tolist()), sides, float(generator.uniform(0, 180))))
        if generator.random() < 0.7:
            cv2.fillConvexPoly(picture, box.astype(np.int32), shade, cv2.LINE_AA)
        else:
            radius = max(int(size_px / 2), 1)
            cv2.circle(picture, tuple(centre.astype(int).tolist()), radius, shade, -1, cv2.LINE_AA)
    return picture


def checkers(generator: np.random.Generator) -> Picture:
    """Chequered and crossword grids, whose cells are those of markers, without a marker's frame."""
    cell_px = int(generator.integers(8, 60))
    shape = (-(-2 * HEIGHT // cell_px), -(-2 * WIDTH // cell_px))
    if generator.random() < 0.5:
        cells = np.indices(shape).sum(axis=0) % 2
    else:
        cells = (generator.random(shape) < generator.uniform(0.2, 0.8)).astype(np.int64)
    dark, light = sorted(generator.integers(0, 256, 2).tolist())
    shades = np.where(cells > 0, light, dark).astype(np.uint8)
    grid = np.kron(shades, np.ones((cell_px, cell_px), np.uint8))
    return _seen_askew(grid[: 2 * HEIGHT, : 2 * WIDTH], generator)


def printed(generator: np.random.Generator) -> Picture:
    """Dark text, frames and the finder patterns of QR codes on light paper."""
    page = np.full((2 * HEIGHT, 2 * WIDTH), int(generator.integers(150, 256)), np.uint8)
    ink = int(generator.integers(0, 70))
    for _ in range(40):
        x, y = (int(v) for v in generator.uniform((0, 0), (2 * WIDTH - 200, 2 * HEIGHT - 200)))
        side = int(generator.integers(30, 200))
        choice = int(generator.integers(4))
        if choice == 0:
            letters = "".join(generator.choice(list(_TEXT), 6).tolist())
            cv2.putText(page, letters, (x, y + side), cv2.FONT_HERSHEY_SIMPLEX, side / 40.0, ink,
                        max(side // 10, 1), cv2.LINE_AA)  # fmt: skip
        elif choice == 1:
            cv2.rectangle(page, (x, y), (x + side, y + side), ink, max(side // 8, 1))
        elif choice == 2:
            cv2.rectangle(page, (x, y), (x + side, y + side), ink, -1)
        else:
            module = max(side // 7, 2)
            cv2.rectangle(page, (x, y), (x + 7 * module, y + 7 * module), ink, -1)
            cv2.rectangle(page, (x + module, y + module), (x + 6 * module, y + 6 * module), 255, -1)
            cv2.rectangle(
                page, (x + 2 * module, y + 2 * module), (x + 5 * module, y + 5 * module), ink, -1
            )
    return _seen_askew(page, generator)


_MAKERS: dict[str, Callable[[np.random.Generator], Picture]] = {
    "texture": texture,
    "noise": noise,
    "clutter": clutter,
    "checkers": checkers,
    "printed": printed,
}


def _seen_askew(plane: Picture, generator: np.random.Generator) -> Picture:
    """The picture of a plane that is larger than the view, seen from a random direction."""
    height, width = plane.shape
    corners = np.array([(0, 0), (WIDTH, 0), (WIDTH, HEIGHT), (0, HEIGHT)], np.float32)
    on_plane = corners * 1.2 + np.array((width - 1.2 * WIDTH, height - 1.2 * HEIGHT)) / 2.0
    on_plane += generator.uniform(-0.15, 0.15, (4, 2)) * (width, height)
    how = cv2.getPerspectiveTransform(on_plane.astype(np.float32), corners)
    return np.asarray(cv2.warpPerspective(plane, how, (WIDTH, HEIGHT), borderMode=cv2.BORDER_WRAP))


def _as_photographed(picture: Picture, generator: np.random.Generator) -> Picture:
    """With another exposure, blur and noise."""
    blur_px = float(generator.choice([0.0, 0.6, 1.2]))
    if blur_px:
        picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), blur_px))
    exposed = picture * float(generator.uniform(0.4, 1.1)) + float(generator.uniform(-10.0, 40.0))
    return _bytes(exposed + float(generator.uniform(0.0, 6.0)) * _grain(generator))


def _grain(generator: np.random.Generator) -> NDArray[np.float32]:
    """(height, width) normal deviates: a random slice of those that are drawn once."""
    deviates = _deviates()
    first = int(generator.integers(len(deviates) - HEIGHT * WIDTH))
    return deviates[first : first + HEIGHT * WIDTH].reshape(HEIGHT, WIDTH)


@functools.cache
def _deviates() -> NDArray[np.float32]:
    return np.random.default_rng(0).standard_normal(4 * HEIGHT * WIDTH, np.float32)


def _grey(rgb: NDArray[np.uint8]) -> Picture:
    return np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), np.uint8)


def _read(file: Path) -> Picture:
    return np.asarray(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE), np.uint8)


def _small(picture: Picture, share: float) -> Picture:
    size = round(picture.shape[1] * share), round(picture.shape[0] * share)
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)


def _bytes(picture: NDArray[np.floating[Any]]) -> Picture:
    return np.asarray(np.clip(np.rint(picture), 0, 255), np.uint8)
