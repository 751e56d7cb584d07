"""Masks of keepout zones and speed limits, as Nav2's map_server reads them: a YAML file and its
picture.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, get_args

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image

from services.common.config import ConfigError
from services.common.frames import SE2
from services.common.world.costmap import MAX_MAP_CELLS, straightened
from services.common.yaml_words import line_and_words
from services.navigation.config import NavigationConfig
from services.navigation.costmap.costmap import frame_of
from services.navigation.costmap.filters import (
    KEEPOUT,
    FilterInfo,
    FilterMask,
    MapMode,
    occupancy_of_picture,
)
from services.navigation.costmap.zones import NamedMask

_MAX_YAML_BYTES: Final = 100_000
_MAX_PICTURE_BYTES: Final = 5 * MAX_MAP_CELLS
_MAX_COORDINATE_M: Final = 1e6
_FORMATS: Final = ("PPM", "PNG", "BMP")


@dataclass(frozen=True, slots=True)
class Masks:
    """Those that a configuration names."""

    keepout: tuple[NamedMask, ...] = ()
    speed: tuple[NamedMask, ...] = ()


def masks_of(config: NavigationConfig) -> Masks:
    """The masks of a configuration. Raises ConfigError, see `read_mask`."""
    keepout, speed = config.keepout_mask, config.speed_mask
    told = FilterInfo(config.speed_mask_type, config.speed_mask_base, config.speed_mask_multiplier)
    return Masks(
        (read_mask("keepout_mask", keepout, FilterInfo(KEEPOUT)),) if keepout else (),
        (read_mask("speed_mask", speed, told),) if speed else (),
    )


def read_mask(setting: str, file: str, info: FilterInfo) -> NamedMask:
    """Read a mask by its YAML file, relative to the working directory.

    Raises ConfigError with one line that begins with the setting and names file, field and value.
    """
    path = Path(file)
    try:
        info.check()
    except ValueError as error:
        raise ConfigError(f"{setting}_{error}") from error
    fields = _Fields(f"{setting}: {file:.120}", _read_yaml(setting, path))
    free = fields.number("free_thresh", 0.0, 1.0)
    occupied = fields.number("occupied_thresh", 0.0, 1.0)
    if free >= occupied:
        raise fields.wrong("free_thresh", f"must be < occupied_thresh, which is {occupied:g}")
    resolution_m = fields.number("resolution", 1e-3, 100.0)
    origin = fields.origin()
    mode = fields.mode()
    negate = fields.number("negate", 0.0, 1.0)
    if negate not in (0.0, 1.0):
        raise fields.wrong("negate", "must be 0 or 1")
    try:
        grey, opaque = _read_picture(path.parent / fields.text("image"))
    except ValueError as error:
        raise fields.wrong("image", str(error)) from error
    cells = occupancy_of_picture(grey, mode, negate == 1.0, occupied, free)
    if mode == "scale":
        cells = np.where(opaque[::-1], cells, np.int8(-1))
    origin, cells = straightened(resolution_m, origin, cells)
    return NamedMask(path.name, FilterMask(frame_of(resolution_m, origin, cells), cells, info))


class _Fields:
    """The values of a YAML file, with checked types."""

    def __init__(self, where: str, values: dict[Any, Any]) -> None:
        self._where, self._values = where, values

    def wrong(self, field: str, must: str) -> ConfigError:
        """The error to raise about a field."""
        if field not in self._values:
            return ConfigError(f"{self._where}: {field}: {must}")
        return ConfigError(f"{self._where}: {field}: {self._values[field]!r:.60}: {must}")

    def _value(self, field: str) -> Any:
        if field not in self._values:
            raise self.wrong(field, "is missing")
        return self._values[field]

    def text(self, field: str) -> str:
        value = self._value(field)
        if not isinstance(value, str) or not value or "\0" in value:
            raise self.wrong(field, "must be a file name")
        return value

    def number(self, field: str, low: float, high: float) -> float:
        value = self._value(field)
        if not _is_number(value) or not low <= value <= high:
            raise self.wrong(field, f"must be a number from {low:g} to {high:g}")
        return float(value)

    def mode(self) -> MapMode:
        value = self._values.get("mode", "trinary")
        for mode in get_args(MapMode):
            if isinstance(value, str) and value.lower() == mode:
                return mode  # type: ignore[no-any-return]
        raise self.wrong("mode", "must be trinary, scale or raw")

    def origin(self) -> SE2:
        value = self._value("origin")
        if (
            not isinstance(value, list)
            or len(value) != 3
            or not all(_is_number(part) and abs(part) <= _MAX_COORDINATE_M for part in value)
        ):
            raise self.wrong("origin", "must be [x, y, yaw], metres and radians")
        return SE2(*(float(part) for part in value))


def _is_number(value: Any) -> bool:
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and math.isfinite(value)


def _read_yaml(setting: str, path: Path) -> dict[Any, Any]:
    told = f"{setting}: {str(path)[:120]}"
    try:
        data = _read(path, _MAX_YAML_BYTES)
        content = yaml.safe_load(data)
    except ValueError as error:
        if isinstance(error, UnicodeError):
            raise ConfigError(f"{told}: must be a map_server YAML file") from error
        raise ConfigError(f"{told}: {error}") from error
    except yaml.YAMLError as error:
        line, words = line_and_words(error)
        raise ConfigError(f"{told}:{line}: {words}") from error
    except RecursionError as error:
        raise ConfigError(f"{told}: must be a map_server YAML file") from error
    if not isinstance(content, dict):
        raise ConfigError(f"{told}: must be a map_server YAML file: image, resolution, origin, ...")
    return content


def _read(path: Path, most_bytes: int) -> bytes:
    """Raises ValueError with a phrase."""
    try:
        if not path.is_file():
            raise ValueError("no such file")
        with path.open("rb") as opened:
            data = opened.read(most_bytes + 1)
    except OSError as error:
        raise ValueError(f"cannot be read: {error.strerror}") from error
    if len(data) > most_bytes:
        raise ValueError(f"must have at most {most_bytes} bytes")
    return data


def _read_picture(path: Path) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """(rows, columns) grey values and where they are opaque. Raises ValueError with a phrase."""
    data = _read(path, _MAX_PICTURE_BYTES)
    try:
        picture = Image.open(io.BytesIO(data), formats=_FORMATS)
    except Exception as error:
        # On damaged files Pillow's decoders may raise anything.
        raise ValueError("must be a PGM, PNG or BMP picture") from error
    columns, rows = picture.size
    if not 0 < rows * columns <= MAX_MAP_CELLS:
        raise ValueError(
            f"has {columns} x {rows} pixels: must have at least 1 and at most {MAX_MAP_CELLS}"
        )
    if picture.mode not in ("1", "L", "LA", "P", "PA", "RGB", "RGBA"):
        raise ValueError("must have 8 bits a channel")
    try:
        pixels = np.asarray(picture.convert("RGBA"))
    except Exception as error:
        raise ValueError("is cut short or damaged") from error
    colours = pixels[..., :3].sum(-1, dtype=np.float64) / 3.0
    return np.rint(colours).astype(np.uint8), pixels[..., 3] == 255
