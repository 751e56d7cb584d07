"""A folder of recipes and small textures to spoil."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

ROOM: dict[str, Any] = {
    "name": "room",
    "wall_height_m": 1.0,
    "map_resolution_m": 0.1,
    "start": {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0},
    "locations": {"corner": {"x_m": 1.0, "y_m": 0.5, "yaw_rad": 1.0}},
    "materials": {
        "brick": {"texture": "brick.png", "diffuse": [0.8, 0.4, 0.3, 1.0]},
        "plain": {"ambient": [1.0, 1.0, 1.0, 1.0]},
    },
    "wall_materials": ["brick", "plain"],
    "light": {"direction": [0.0, 0.0, -1.0]},
    "walls": [
        {"name": "south", "length_m": 4.0, "x_m": 0.0, "y_m": -1.0, "yaw_rad": 0.0},
        {"name": "east", "length_m": 2.0, "x_m": 2.0, "y_m": 0.0, "yaw_rad": 1.5708},
        {"name": "north", "length_m": 4.0, "x_m": 0.0, "y_m": 1.0, "yaw_rad": 3.1416},
        {"name": "west", "length_m": 2.0, "x_m": -2.0, "y_m": 0.0, "yaw_rad": -1.5708},
    ],
    "markers": [{"id": 3, "wall": "south", "side": "left", "offset_m": 0.5, "height_m": 0.3}],
}


class _Plain(yaml.SafeDumper):
    """Writes out what is the same object twice, where YAML would point back."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def room() -> dict[str, Any]:
    """A recipe with everything in it, to change."""
    return copy.deepcopy(ROOM)


def png(width: int = 16, height: int = 8) -> bytes:
    picture = np.arange(width * height * 3, dtype=np.uint32).reshape(height, width, 3) % 251
    return bytes(cv2.imencode(".png", picture.astype(np.uint8))[1].tobytes())


def write(folder: Path, name: str, recipe: Any) -> None:
    text = recipe if isinstance(recipe, str) else yaml.dump(recipe, Dumper=_Plain, sort_keys=False)
    (folder / f"{name}.yaml").write_text(text, encoding="utf-8")


def make(folder: Path, recipe: Any = None) -> Path:
    """A folder of worlds that holds `room`, as given or unspoilt."""
    (folder / "textures").mkdir(parents=True, exist_ok=True)
    (folder / "textures" / "brick.png").write_bytes(png())
    write(folder, "room", ROOM if recipe is None else recipe)
    return folder
