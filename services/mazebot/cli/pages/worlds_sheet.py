"""Draws docs/images/worlds.png: the plan of every world, and an image of the robot's camera in it.

`python -m mazebot.cli.pages.worlds_sheet OUT.png` writes it.
"""

from __future__ import annotations

import io
import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from mazebot.common.maths.frames import LINK_FROM_OPTICAL, SE2
from mazebot.common.world.marker_entities import marker_entities
from mazebot.physics.camera.camera import Intrinsics
from mazebot.physics.camera.renderers import make_renderer
from mazebot.physics.camera.scene import build_scene
from mazebot.worldgen.preview import BOTTOM_PX, LEFT_PX, RIGHT_PX, TOP_PX, draw_plan
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.recipe.loader import load_world

WORLDS: dict[str, SE2] = {
    "sim_house": SE2(-0.3, 3.3, -2.0),
    "sim_house_enhanced": SE2(-0.3, 3.3, -2.0),
    "sim_house_floor": SE2(0.3, 0.0, 2.9),
    "sim_house_rooms": SE2(0.3, -0.9, 0.0),
    "sim_house_slam": SE2(2.75, 3.0, 1.57),
    "sim_house_markers": SE2(4.3, 2.9, -2.6),
    "maze": SE2(-7.0, 1.0, -1.57),
    "maze_rooms": SE2(0.0, 0.0, 0.0),
}
"""The camera's position and heading in each world."""

_CAMERA_HEIGHT_M = 0.21
_CELL_PX = 400, 340
_COLUMNS = 4
_COLOURS = 256
_NAME_PX = 30

Picture = NDArray[np.uint8]


def worlds_sheet() -> Picture:
    """(height, width, 3) RGB: the plan of each world above its image, four worlds a row."""
    renderer = make_renderer("auto", Intrinsics.from_horizontal_fov(400, 240, 1.3))
    if renderer is None:
        raise RuntimeError("no renderer is available")
    cells = []
    for name, map_from_camera in WORLDS.items():
        loaded = load_world(name)
        entities, pictures = marker_entities(loaded.world)
        assets = {**loaded.assets, **pictures}
        renderer.set_scene(build_scene(loaded.world, assets, entities.markers))
        seen = renderer.render(map_from_camera.matrix(_CAMERA_HEIGHT_M) @ LINK_FROM_OPTICAL).rgb
        cells.append(np.vstack([_name(name), _plan(loaded), seen]))
    renderer.close()
    gap = 12
    padded = [np.pad(cell, ((0, gap), (0, gap), (0, 0)), constant_values=255) for cell in cells]
    rows = [np.hstack(padded[i : i + _COLUMNS]) for i in range(0, len(padded), _COLUMNS)]
    return np.asarray(np.vstack(rows), np.uint8)


def _name(name: str) -> Picture:
    strip = Image.new("RGB", (_CELL_PX[0], _NAME_PX), (255, 255, 255))
    font = ImageFont.load_default(size=0.7 * _NAME_PX)
    middle = _CELL_PX[0] / 2.0, _NAME_PX / 2.0
    ImageDraw.Draw(strip).text(middle, name, fill=(32, 36, 42), font=font, anchor="mm")
    return np.asarray(strip, np.uint8)


def _plan(loaded: LoadedWorld) -> Picture:
    """The plan without its margins, centred in a cell and as large as possible."""
    plan = draw_plan(loaded)[TOP_PX:-BOTTOM_PX, LEFT_PX:-RIGHT_PX]
    width, height = _CELL_PX
    scale = min(width / plan.shape[1], height / plan.shape[0])
    size = round(plan.shape[1] * scale), round(plan.shape[0] * scale)
    cell = np.full((height, width, 3), 255, np.uint8)
    left = (width - size[0]) // 2
    cell[: size[1], left : left + size[0]] = cv2.resize(plan, size, interpolation=cv2.INTER_AREA)
    return cell


def sheet_png() -> bytes:
    """The sheet as a small PNG with few colours."""
    data = io.BytesIO()
    few = Image.fromarray(worlds_sheet()).quantize(_COLOURS, dither=Image.Dither.NONE)
    few.save(data, "PNG", optimize=True)
    return data.getvalue()


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python -m mazebot.cli.pages.worlds_sheet OUT.png")
    Path(sys.argv[1]).write_bytes(sheet_png())
