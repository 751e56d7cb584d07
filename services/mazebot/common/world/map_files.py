"""Maps as Nav2's map_server reads and its map_saver writes them: a YAML file and an image.

The rules are those of nav2_map_server's map_io.cpp of today, with one exception: map_saver writes
unknown cells as grey 205 and `free_thresh: 0.25`, which map_server reads back as free. Files
written here use 0.196, as ROS 1 did, so that map_server too keeps them unknown.
"""

from __future__ import annotations

import contextlib
import io
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from mazebot.common.config import ConfigError
from mazebot.common.files.folder_writing import write_file
from mazebot.common.files.images import NotAnImageError, open_image
from mazebot.common.files.reading import read_limited
from mazebot.common.files.yaml_source import Source, read_source
from mazebot.common.maths.frames import SE2, Array
from mazebot.common.problems import Problem, WorldError
from mazebot.common.world.costmap import FREE, MAX_CELLS, OCCUPIED, UNKNOWN, Cells

Mode = Literal["trinary", "scale", "raw"]
ImageFormat = Literal["pgm", "png", "bmp"]

MAX_IMAGE_BYTES = 5 * MAX_CELLS
_FORMATS = {"PPM": "PGM", "PNG": "PNG", "BMP": "BMP"}
_SUFFIXES = {".pgm", ".png", ".bmp"}
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_FLAGS = {
    **dict.fromkeys(("1", "true", "yes", "on", "y"), True),
    **dict.fromkeys(("0", "false", "no", "off", "n"), False),
}
"""The words of yaml-cpp."""
_SHOWN = 160
"""Characters of a value in an error: of a longer path its end counts, too."""
_MAX_COORDINATE_M = 1e6
_MAX_16_BITS = 65535
_OCCUPIED_THRESH = {"trinary": 0.65, "scale": 1.0, "raw": 0.65}
FREE_THRESH = 0.196
"""Of the files that are written: the grey of unknown cells is above it."""
_FREE_THRESH = {"trinary": FREE_THRESH, "scale": 0.0, "raw": FREE_THRESH}
_GREY_FREE, _GREY_OCCUPIED, _GREY_UNKNOWN = 254, 0, 205


@dataclass(frozen=True, eq=False)
class MapFile:
    """A map: (rows, columns) cells of 0 free to 100 occupied, -1 unknown, row 0 at the smallest y
    of its own axes.
    """

    cells: Cells
    resolution_m: float
    origin: SE2
    """map_from_grid, of the corner of cell (0, 0)."""
    warning: str = ""
    """One line: what its file probably does not mean; empty: nothing."""


def read_map(path: Path) -> MapFile:
    """Read a map by its YAML file.

    Raises WorldError, a ConfigError, with one line that names file, field and value.
    """
    source = read_source(path, str(path))
    values = _Values(source)
    name = values.text("image")
    resolution_m = values.number("resolution", 1e-3, 100.0)
    origin = values.origin()
    occupied = values.number("occupied_thresh", 0.0, 1.0)
    free = values.number("free_thresh", 0.0, 1.0)
    if free >= occupied:
        raise values.wrong("free_thresh", f"must be < occupied_thresh, which is {occupied:g}")
    negate = values.flag("negate")
    mode = values.mode()
    file = path.parent / name
    try:
        grey, alpha = _read_image(file)
    except FileNotFoundError as error:
        where = "" if Path(name).is_absolute() else f" {file}"
        raise values.wrong("image", f"no such file{where}{_nearby(path.parent, name)}") from error
    except ValueError as error:
        raise values.wrong("image", str(error)) from error
    cells = _cells(grey, alpha, mode, negate, occupied, free)
    warning = _unknown_as_free(path, grey, cells, mode, free)
    return MapFile(np.ascontiguousarray(cells[::-1]), resolution_m, origin, warning)


def _nearby(folder: Path, name: str) -> str:
    """The hint for a missing image: one beside the YAML file that is probably meant, for maps are
    moved with the folder that they were in.
    """
    wanted = PureWindowsPath(name)
    try:
        beside = sorted(one.name for one in folder.iterdir() if one.is_file())
    except OSError:
        return ""
    alike = [one for one in beside if one.casefold() == wanted.name.casefold()] or [
        one
        for one in beside
        if Path(one).stem.casefold() == wanted.stem.casefold()
        and Path(one).suffix.casefold() in _SUFFIXES
    ]
    if not alike:
        return ""
    return f"; a {alike[0]} lies beside the YAML file: write image: {alike[0]}"


def _unknown_as_free(path: Path, grey: Array, cells: Cells, mode: Mode, free: float) -> str:
    if mode == "raw":
        return ""
    lost = int(((np.rint(grey) == _GREY_UNKNOWN) & (cells == FREE)).sum())
    if not lost:
        return ""
    return (
        f"{path}: free_thresh: {free:g}: {lost} cells of grey {_GREY_UNKNOWN}, which map_saver "
        f"writes for unknown, are read as free, as by map_server: at most "
        f"{_FREE_THRESH['trinary']} keeps them unknown"
    )


def write_map(
    folder: Path,
    name: str,
    cells: Cells,
    resolution_m: float,
    origin: SE2,
    mode: Mode = "trinary",
    image_format: ImageFormat = "pgm",
    free_thresh: float = FREE_THRESH,
    occupied_thresh: float = _OCCUPIED_THRESH["trinary"],
) -> Path:
    """Write `name`.yaml and its image as map_saver does; returns the YAML file's path. The
    thresholds are those of `trinary_cells`, for the mode trinary.

    Raises ConfigError if a mode or format is invalid, or cannot represent these cells, or the files
    cannot be written. A file is either complete or does not exist.
    """
    if mode not in get_args(Mode):
        raise ConfigError(f"mode: {mode!r:.60}: must be trinary, scale or raw")
    if image_format not in get_args(ImageFormat):
        raise ConfigError(f"image_format: {image_format!r:.60}: must be pgm, png or bmp")
    if not re.fullmatch(r"[A-Za-z0-9][\w.-]*", name, re.ASCII):
        raise ConfigError(f"name: {name!r:.60}: must be a file name without folders")
    if cells.ndim != 2 or not cells.size:
        raise ConfigError(f"cells: {cells.shape}: must have at least one row and one column")
    if mode == "scale" and image_format != "png" and bool((cells < 0).any()):
        raise ConfigError(
            f"image_format: {image_format}: must be png, for the unknown cells of mode scale"
        )
    if mode == "trinary":
        cells = trinary_cells(cells, free_thresh, occupied_thresh)
    picture = io.BytesIO()
    _image(np.ascontiguousarray(cells[::-1]), mode).save(picture, _PILLOW_FORMATS[image_format])
    image = f"{name}.{image_format}"
    lines = (
        f"image: {image}",
        f"mode: {mode}",
        f"resolution: {_shortest(resolution_m)}",
        f"origin: [{', '.join(repr(float(value)) for value in origin)}]",
        "negate: 0",
        f"occupied_thresh: {_OCCUPIED_THRESH[mode]}",
        f"free_thresh: {_FREE_THRESH[mode]}",
    )
    path = folder / f"{name}.yaml"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # The image first: an existing YAML file then names an existing image.
        write_file(folder / image, picture.getvalue())
        write_file(path, ("\n".join(lines) + "\n").encode())
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from error
    return path


def trinary_cells(cells: Cells, free_thresh: float, occupied_thresh: float) -> Cells:
    """Cells of a map as free (0), occupied (100) or unknown (-1), as map_saver's mode trinary draws
    them: free up to 100 * `free_thresh`, occupied from 100 * `occupied_thresh`, both rounded.

    Raises ConfigError where the thresholds are not 0 <= free < occupied <= 1.
    """
    if not 0.0 <= free_thresh < occupied_thresh <= 1.0:
        raise ConfigError(
            f"free_thresh, occupied_thresh: {free_thresh:g}, {occupied_thresh:g}: must be "
            "0 <= free_thresh < occupied_thresh <= 1"
        )
    known = (cells >= FREE) & (cells <= OCCUPIED)
    found = np.full(cells.shape, UNKNOWN, np.int8)
    found[known & (cells <= round(100.0 * free_thresh))] = FREE
    found[known & (cells >= round(100.0 * occupied_thresh))] = OCCUPIED
    return found


def _shortest(value: float) -> str:
    """A number; one of single precision, as in a message, by the digits that it has."""
    single = np.float32(value)
    return str(single) if float(single) == value else repr(float(value))


_PILLOW_FORMATS = {"pgm": "PPM", "png": "PNG", "bmp": "BMP"}


class _Values:
    """The fields of a map's YAML file, with checked types."""

    def __init__(self, source: Source) -> None:
        self._source = source

    def wrong(self, field: str, must: str) -> WorldError:
        """The error to raise about a field."""
        value = self._source.content.get(field)
        return WorldError(
            [
                Problem(
                    file=self._source.file,
                    line=self._source.line_of((field,)),
                    field=field,
                    value=_shown(value) if field in self._source.content else "",
                    must=must,
                )
            ]
        )

    def _value(self, field: str) -> Any:
        if field not in self._source.content:
            raise self.wrong(field, "is missing")
        return self._source.content[field]

    def text(self, field: str) -> str:
        value = self._value(field)
        if not isinstance(value, str) or not value or "\0" in value:
            raise self.wrong(field, "must be a file name")
        return value

    def number(self, field: str, low: float, high: float) -> float:
        value = _unquoted(self._value(field))
        if not _is_number(value) or not low <= value <= high:
            raise self.wrong(field, f"must be a number from {low:g} to {high:g}")
        return float(value)

    def flag(self, field: str) -> bool:
        value = self._value(field)
        if isinstance(value, str):
            value = _FLAGS.get(value.lower(), value)
        if value not in (0, 1):
            raise self.wrong(field, "must be 0 or 1")
        return bool(value)

    def mode(self) -> Mode:
        value = self._source.content.get("mode", "trinary")
        lowered = value.lower() if isinstance(value, str) else ""
        for mode in get_args(Mode):
            if lowered == mode:
                return mode  # type: ignore[no-any-return]
        raise self.wrong("mode", "must be trinary, scale or raw")

    def origin(self) -> SE2:
        value = self._value("origin")
        given = [_unquoted(part) for part in value] if isinstance(value, list | tuple) else []
        if len(given) != 3 or not all(
            _is_number(part) and abs(part) <= _MAX_COORDINATE_M for part in given
        ):
            raise self.wrong("origin", "must be [x, y, yaw], metres and radians")
        x_m, y_m, yaw_rad = (float(part) for part in given)
        return SE2(x_m, y_m, yaw_rad)


def _shown(value: Any) -> str:
    text = f"{value!r}"
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN // 2]}...{text[-_SHOWN // 2 :]}"


def _unquoted(value: Any) -> Any:
    """A number in quotes as the number, as yaml-cpp reads it."""
    is_text = isinstance(value, str) and len(value) <= _SHOWN
    return float(value) if is_text and _NUMBER.fullmatch(value) else value


def _is_number(value: Any) -> bool:
    # NaN is not in any range.
    return isinstance(value, int | float) and not isinstance(value, bool) and -1e9 < value < 1e9


def _read_image(file: Path) -> tuple[Array, NDArray[np.uint8] | None]:
    """(rows, columns) brightness of 0 to 255, row 0 at the top, and opacity if there is any.

    Raises FileNotFoundError, and ValueError with a phrase.
    """
    try:
        data = read_limited(file, MAX_IMAGE_BYTES)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise ValueError(f"cannot be read: {error.strerror}") from error
    if data[:2] == b"P2":
        return _read_plain_pgm(data), None
    try:
        image = open_image(data, tuple(_FORMATS), MAX_CELLS)
    except NotAnImageError as error:
        raise ValueError("must be a PGM, PNG or BMP image") from error
    with _no_warnings():
        if image.mode.startswith("I"):
            # 16 bits: Pillow's conversion to 8 cuts instead of scaling.
            wanted = "I"
        elif image.mode in ("P", "PA", "1") or "transparency" in image.info:
            wanted = "RGBA" if "transparency" in image.info or image.mode == "PA" else "RGB"
        elif image.mode in ("L", "LA", "RGB", "RGBA"):
            wanted = image.mode
        else:
            raise ValueError("must have 8 or 16 bits a channel")
        try:
            pixels = np.asarray(image.convert(wanted))
        except Exception as error:
            # On damaged images Pillow's decoders may raise anything.
            raise ValueError("is truncated or corrupt") from error
    alpha = pixels[..., -1] if wanted in ("LA", "RGBA") else None
    if wanted == "I":
        return np.rint(pixels * (255.0 / _MAX_16_BITS)), None
    if pixels.ndim == 2:
        return pixels.astype(np.float64), alpha
    colours = pixels[..., : 1 if wanted == "LA" else 3]
    return colours.sum(-1, dtype=np.float64) / colours.shape[-1], alpha


def _read_plain_pgm(data: bytes) -> Array:
    """A PGM image in ASCII, for which Pillow takes a second per megapixel."""
    text = re.sub(rb"#[^\r\n]*", b"", data[2:])
    if text.translate(None, b"0123456789 \t\r\n\v\f"):
        raise ValueError("is truncated or corrupt")
    header = text.split(None, 3)
    if len(header) < 4 or max(len(number) for number in header[:3]) > 9:
        raise ValueError("is truncated or corrupt")
    columns, rows, most = (int(number) for number in header[:3])
    _check_size(columns, rows)
    if not 0 < most <= _MAX_16_BITS:
        raise ValueError("must have 8 or 16 bits a channel")
    values = np.fromstring(header[3].decode(), np.int64, sep=" ")
    if len(values) < rows * columns or values.min() < 0 or values.max() > most:
        raise ValueError("is truncated or corrupt")
    grey = values[: rows * columns].reshape(rows, columns)
    return np.asarray(grey if most == 255 else np.rint(grey * 255.0 / most), np.float64)


def _check_size(columns: int, rows: int) -> None:
    if not 0 < rows * columns <= MAX_CELLS:
        raise ValueError(
            f"has {columns} x {rows} pixels: must have at least 1 and at most {MAX_CELLS}"
        )


@contextlib.contextmanager
def _no_warnings() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _cells(
    grey: Array, alpha: NDArray[np.uint8] | None, mode: Mode, negate: bool,
    occupied: float, free: float,
) -> Cells:  # fmt: skip
    """As loadMapFromFile of map_io.cpp, including rounding and single precision."""
    if mode == "raw":
        value = np.floor(grey + 0.5)
        return np.where(value <= OCCUPIED, value, UNKNOWN).astype(np.int8)
    share = (grey / 255.0).astype(np.float32)
    if not negate:
        share = np.float32(1.0) - share
    low, high = np.float32(free), np.float32(occupied)
    if mode == "trinary":
        between: NDArray[np.float32] | int = UNKNOWN
    else:
        between = np.rint((share - low) / (high - low) * np.float32(100.0))
    cells = np.where(share >= high, OCCUPIED, np.where(share <= low, FREE, between))
    if alpha is not None:
        # What can be seen through has not been drawn.
        cells = np.where(alpha < 255, UNKNOWN, cells)
    return cells.astype(np.int8)


def _image(cells: Cells, mode: Mode) -> Image.Image:
    """The image of (rows, columns) cells, row 0 at the top, as map_saver draws it; for the mode
    trinary of `trinary_cells`.
    """
    known = (cells >= 0) & (cells <= OCCUPIED)
    if mode == "raw":
        return Image.fromarray(np.where(known, cells, 255).astype(np.uint8))
    if mode == "scale":
        grey = np.where(known, np.rint((100.0 - cells) * 2.55), 128).astype(np.uint8)
        if known.all():
            return Image.fromarray(grey)
        return Image.fromarray(np.stack([grey, np.where(known, 255, 0).astype(np.uint8)], axis=-1))
    grey = np.where(cells == FREE, _GREY_FREE, _GREY_UNKNOWN)
    grey[cells == OCCUPIED] = _GREY_OCCUPIED
    return Image.fromarray(grey.astype(np.uint8))
