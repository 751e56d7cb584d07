"""Reads a camera's calibration from YAML, as ROS or OpenCV write it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from mazebot.common.config import ConfigError
from mazebot.common.files.bounded_yaml import ERRORS, BoundedLoader, not_yaml
from mazebot.common.files.reading import NotReadableError, read_limited
from mazebot.perception.pose import Camera

MAX_BYTES = 64 * 1024
MODELS = ("plumb_bob", "rational_polynomial")
_COUNTS = (0, 4, 5, 8, 12, 14)


@dataclass(frozen=True)
class CalibratedCamera:
    """Intrinsics and the picture size that they are for."""

    camera: Camera
    width_px: int
    height_px: int


class _Loader(BoundedLoader):
    """YAML with OpenCV's matrices."""


def _opencv_matrix(loader: _Loader, node: yaml.MappingNode) -> dict[Any, Any]:
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _opencv_matrix)


def read_camera_file(file: Path) -> CalibratedCamera:
    """The calibration in a camera_info file (camera_calibration, usb_cam, v4l2_camera) or in one of
    OpenCV's calibration sample.

    Its keys are image_width, image_height, camera_matrix (3 x 3), distortion_coefficients, and
    distortion_model in ROS' files. Raises ConfigError in one line for anything else.
    """
    content = _content(file)
    width_px, height_px = (_side(file, content, key) for key in ("image_width", "image_height"))
    matrix = _matrix(file, content, "camera_matrix", (9,)).reshape(3, 3)
    if not (matrix[0, 0] > 0.0 and matrix[1, 1] > 0.0 and matrix[2].tolist() == [0.0, 0.0, 1.0]):
        raise ConfigError(
            f"{file}: camera_matrix: must be fx 0 cx, 0 fy cy, 0 0 1 with fx and fy positive"
        )
    model = content.get("distortion_model", MODELS[0])
    if model not in MODELS:
        raise ConfigError(
            f"{file}: distortion_model: {model!r:.40}: must be one of {', '.join(MODELS)}"
        )
    distortion = np.zeros(5)
    if "distortion_coefficients" in content:
        distortion = _matrix(file, content, "distortion_coefficients", _COUNTS)
    return CalibratedCamera(
        Camera(matrix, distortion if len(distortion) else np.zeros(5)), width_px, height_px
    )


def _content(file: Path) -> Mapping[str, Any]:
    try:
        text = read_limited(file, MAX_BYTES).decode()
    except UnicodeDecodeError as error:
        raise ConfigError(f"{file}: must be UTF-8 text") from error
    except NotReadableError as error:
        raise ConfigError(f"{file}: {error}") from error
    except OSError as error:
        raise ConfigError(f"{file}: cannot be read: {error.strerror}") from error
    # OpenCV starts its files with a directive that YAML does not know: %YAML:1.0
    head, _, rest = text.partition("\n")
    try:
        content = _Loader(f"\n{rest}" if head.startswith("%YAML") else text).get_single_data()
    except ERRORS as error:
        raise not_yaml(str(file), error) from error
    if not isinstance(content, dict):
        raise ConfigError(f"{file}: must be a mapping with image_width, camera_matrix, ...")
    return content


def _side(file: Path, content: Mapping[str, Any], key: str) -> int:
    if key not in content:
        raise ConfigError(f"{file}: {key}: is missing")
    value = content[key]
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= 100_000:
        raise ConfigError(f"{file}: {key}: {value!r:.40}: must be an integer number of pixels")
    return value


def _matrix(
    file: Path, content: Mapping[str, Any], key: str, counts: tuple[int, ...]
) -> np.ndarray[Any, np.dtype[np.float64]]:
    """(n,) the numbers of a matrix, n being one of `counts`."""
    if key not in content:
        raise ConfigError(f"{file}: {key}: is missing")
    part = content[key]
    numbers = part.get("data") if isinstance(part, dict) else part
    many = " or ".join(str(count) for count in counts)
    if not isinstance(numbers, list) or len(numbers) not in counts:
        raise ConfigError(f"{file}: {key}.data: must be a list of {many} numbers")
    for value in numbers:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not number or not math.isfinite(value):
            raise ConfigError(f"{file}: {key}.data: {value!r:.40}: must be a finite number")
    return np.array(numbers, np.float64)
