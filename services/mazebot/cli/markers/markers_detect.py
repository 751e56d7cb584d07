"""`mazebot markers detect`: the markers in pictures, with their poses."""

from __future__ import annotations

import difflib
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from mazebot.cli.markers.camera_file import CalibratedCamera, read_camera_file
from mazebot.cli.markers.markers_drawing import draw_markers
from mazebot.cli.parsing.options import print_json
from mazebot.cli.parsing.outputs import refuse_inputs
from mazebot.common.config import ConfigError
from mazebot.common.files.folder_writing import write_file
from mazebot.common.files.images import ImageError, NotAnImageError, open_image
from mazebot.common.files.reading import NotReadableError, read_limited
from mazebot.common.maths.frames import position_and_quaternion
from mazebot.common.messages.documents import DICTIONARY_FILES
from mazebot.common.world.marker_dictionary import read_dictionary
from mazebot.perception.detect import dictionary_names
from mazebot.perception.photo import PhotoMarker, markers_in_photo, unreadable_in_photo
from mazebot.perception.pose import Solution

MAX_BYTES = 256 * 1024 * 1024
FORMATS = ("PNG", "JPEG", "BMP", "WEBP", "TIFF", "PPM")
PICTURE_FILES = (".png", ".jpg", ".jpeg", ".bmp", ".webp", ".tiff", ".tif")
LARGEST_DICTIONARIES = (
    "DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_ARUCO_ORIGINAL",
    "DICT_APRILTAG_16h5", "DICT_APRILTAG_25h9", "DICT_APRILTAG_36h10", "DICT_APRILTAG_36h11",
)  # fmt: skip
"""Of each family: the smaller ones are beginnings of these."""

Picture = NDArray[np.uint8]


_UNREADABLE = {
    "mirrored": "as in a mirror: no detector reads it so",
    "inverted": "in white on black: must be black on white",
    "mirrored and inverted": "as in a mirror, and in white on black",
}


@dataclass(frozen=True)
class _Seen:
    """A picture and what is in it."""

    file: Path
    picture: Picture
    markers: list[PhotoMarker]
    unreadable: dict[str, list[int]]
    """Ids of those that are mirrored or white on black."""


def detect_markers(
    images: Sequence[Path],
    dictionary: str,
    camera_file: Path | None,
    side_m: float | None,
    corner_sigma_px: float,
    as_json: bool,
    draw: Path | None,
) -> None:
    """Print the markers in pictures, and draw them.

    Raises ConfigError for an argument that is wrong, before anything is printed or written.
    """
    book = read_book(dictionary)
    camera = _calibrated(camera_file, side_m)
    if not 0.0 < corner_sigma_px < math.inf:
        raise ConfigError(f"--corner-sigma: {corner_sigma_px:g}: must be more than 0 pixels")
    outputs = _outputs(images, draw)
    seen = []
    for file in images:
        picture = read_picture(file)
        height, width = picture.shape[:2]
        if camera is not None and (width, height) != (camera.width_px, camera.height_px):
            raise ConfigError(
                f"--camera: {camera_file}: is for images of {camera.width_px} x "
                f"{camera.height_px}: {file} has {width} x {height}"
            )
        grey = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), np.uint8)
        pinhole = camera.camera if camera is not None else None
        markers = markers_in_photo(grey, book, pinhole, side_m or 0.0, corner_sigma_px)
        seen.append(_Seen(file, picture, markers, unreadable_in_photo(grey, book, markers)))
    refuse_inputs("--draw", outputs)
    for one, output in zip(seen, outputs, strict=False):
        pinhole = camera.camera if camera is not None else None
        _write_picture(output, draw_markers(one.picture, one.markers, pinhole, side_m or 0.0))
    if as_json:
        print_json({"dictionary": dictionary, "images": [_as_json(one) for one in seen]})
        return
    for one in seen:
        _print(one)
    if not any(one.markers or one.unreadable for one in seen):
        _hint(seen)


def read_book(dictionary: str) -> cv2.aruco.Dictionary:
    """A dictionary by OpenCV's name, in any case and with or without `DICT_`, or of a file.

    Raises ConfigError where there is none.
    """
    if dictionary.lower().endswith(DICTIONARY_FILES):
        return read_dictionary(Path(dictionary))
    by_name = {name.upper(): name for name in dictionary_names()}
    asked = dictionary.upper()
    name = by_name.get(asked) or by_name.get(f"DICT_{asked}")
    if name is None:
        near = difflib.get_close_matches(
            asked if asked.startswith("DICT_") else f"DICT_{asked}", by_name, 4, 0.6
        )
        names = dict.fromkeys(by_name[one] for one in near)
        hint = f"did you mean {', '.join(names)}?" if names else _families()
        raise ConfigError(f"--dictionary: {dictionary!r:.60}: unknown to OpenCV: {hint}")
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def _families() -> str:
    endings = ", ".join(DICTIONARY_FILES)
    return f"must be one of {', '.join(dictionary_names())}, or a file ({endings})"


def _calibrated(file: Path | None, side_m: float | None) -> CalibratedCamera | None:
    if side_m is not None and not 0.0 < side_m < math.inf:
        raise ConfigError(f"--size: {side_m:g}: must be more than 0 metres")
    if file is None and side_m is None:
        return None
    if file is None:
        raise ConfigError("--size: a pose needs --camera CAMERA.yaml as well")
    if side_m is None:
        raise ConfigError("--camera: a pose needs --size M, the side of the black square, as well")
    return read_camera_file(file)


def _outputs(images: Sequence[Path], draw: Path | None) -> list[Path]:
    """The file to draw each picture in; for several pictures, in the folder `draw`."""
    if draw is None:
        return []
    if len(images) > 1 or draw.is_dir():
        names = [file.with_suffix(".png").name for file in images]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise ConfigError(f"--draw: {draw}: two of the images would be written to {twice}")
        if draw.suffix.lower() in PICTURE_FILES or (draw.exists() and not draw.is_dir()):
            raise ConfigError(f"--draw: {draw}: must be a folder for several images")
        return [draw / name for name in names]
    if draw.suffix.lower() not in PICTURE_FILES:
        raise ConfigError(f"--draw: {draw}: must end in {', '.join(PICTURE_FILES)}")
    return [draw]


def read_picture(file: Path) -> Picture:
    """(height, width, 3) BGR, turned as a camera's note in the file says.

    By Pillow: OpenCV writes to standard error by itself where a file is damaged.
    """
    try:
        data = read_limited(file, MAX_BYTES)
    except NotReadableError as error:
        raise ConfigError(f"{file}: {error}") from error
    except OSError as error:
        raise ConfigError(f"{file}: cannot be read: {error.strerror}") from error
    try:
        with open_image(data, FORMATS) as picture:
            rgb = _eight_bits(ImageOps.exif_transpose(picture))
    except NotAnImageError as error:
        raise ConfigError(
            f"{file}: is not an image, or of a kind that cannot be read: must be "
            f"{', '.join(FORMATS)}"
        ) from error
    except ImageError as error:
        raise ConfigError(f"{file}: {error}") from error
    except (OSError, SyntaxError, ValueError, EOFError) as error:
        raise ConfigError(f"{file}: is corrupt: {error!s:.80}") from error
    return np.ascontiguousarray(rgb[..., ::-1])


def _eight_bits(picture: Image.Image) -> Picture:
    """(height, width, 3) RGB of any mode, on white where it is transparent."""
    if picture.mode[0] in "IF":
        return np.repeat(_scaled(np.asarray(picture, np.float64))[..., None], 3, axis=2)
    if picture.has_transparency_data:
        seen = picture.convert("RGBA")
        # One that hides everything says nothing.
        if np.asarray(seen)[..., 3].any():
            picture = Image.alpha_composite(Image.new("RGBA", seen.size, "white"), seen)
    return np.asarray(picture.convert("RGB"), np.uint8)


def _scaled(grey: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Brightness of any range, as of 0 to 1, or of 12 bits in 16, by what is in the picture; a few
    brightest and darkest pixels do not count. NaN is black.
    """
    finite = grey[np.isfinite(grey)]
    if not len(finite):
        raise ValueError("has no finite values")
    low, high = np.percentile(finite, (0.1, 99.9)).tolist()
    if low == high:
        low, high = float(finite.min()), float(finite.max())
    share = (np.nan_to_num(grey, nan=low, posinf=high, neginf=low) - low) / (high - low or 1.0)
    return np.asarray(np.rint(share.clip(0.0, 1.0) * 255.0), np.uint8)


def _write_picture(file: Path, picture: Picture) -> None:
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        done, data = cv2.imencode(file.suffix.lower(), picture)
        if not done:
            raise ConfigError(f"--draw: {file}: cannot be written in this format")
        write_file(file, data.tobytes())
    except OSError as error:
        raise ConfigError(f"--draw: {file}: cannot be written: {error.strerror}") from error


def _as_json(seen: _Seen) -> dict[str, Any]:
    height, width = seen.picture.shape[:2]
    return {
        "image": str(seen.file),
        "width": width,
        "height": height,
        "markers": [
            {
                "id": one.marker_id,
                "corners_px": one.corners.round(3).tolist(),
                "clarity": round(one.clarity, 1),
                "poses": [_pose(solution) for solution in one.solutions],
                "ambiguity": one.ambiguity,
            }
            for one in seen.markers
        ],
        "unreadable": seen.unreadable,
    }


def _pose(solution: Solution) -> dict[str, Any]:
    position_m, orientation_xyzw = position_and_quaternion(solution.camera_from_marker)
    return {
        "position_m": list(position_m),
        "orientation_xyzw": list(orientation_xyzw),
        "covariance": solution.covariance.tolist(),
        "reprojection_error_px": solution.reprojection_error_px,
        "score": solution.score,
    }


def _print(seen: _Seen) -> None:
    hints = "".join(
        f"; there is id {', '.join(map(str, ids))} {_UNREADABLE[way]}"
        for way, ids in seen.unreadable.items()
    )
    if hints or not seen.markers:
        sys.stdout.write(f"{seen.file}: no {'other ' if seen.markers else ''}marker{hints}\n")
    for one in seen.markers:
        corners = " ".join(f"({x:.2f}, {y:.2f})" for x, y in one.corners.tolist())
        sys.stdout.write(f"{seen.file}: id {one.marker_id}: corners {corners} px\n")
        if one.solutions:
            sys.stdout.write(f"  {_pose_words(one)}\n")


def _pose_words(marker: PhotoMarker) -> str:
    best = marker.solutions[0]
    place, normal = best.camera_from_marker[:3, 3], best.camera_from_marker[:3, 2]
    x, y, z = place.tolist()
    sigma_x, sigma_y, sigma_z = np.sqrt(np.diagonal(best.covariance)[:3]).tolist()
    range_m = float(np.linalg.norm(place))
    angle_deg = math.degrees(math.acos(min(max(-float(normal @ place) / range_m, -1.0), 1.0)))
    sure = "only one pose"
    if marker.ambiguity is not None:
        sure = f"ambiguity {marker.ambiguity:.1f}"
        sure += " (either of two poses)" if marker.ambiguity < 2.0 else ""
    return (
        f"x {x:.4f} y {y:.4f} z {z:.4f} m (sigma {sigma_x:.4f} {sigma_y:.4f} {sigma_z:.4f}), "
        f"seen from {range_m:.3f} m at {angle_deg:.1f} deg, "
        f"reprojection {best.reprojection_error_px:.2f} px, {sure}"
    )


def _hint(seen: Sequence[_Seen]) -> None:
    """Name another dictionary whose markers are there."""
    greys = [np.asarray(cv2.cvtColor(one.picture, cv2.COLOR_BGR2GRAY), np.uint8) for one in seen]
    counts = {}
    for name in LARGEST_DICTIONARIES:
        book = read_book(name)
        counts[name] = sum(len(markers_in_photo(grey, book, magnify=False)) for grey in greys)
    best = max(counts, key=lambda name: counts[name])
    if counts[best]:
        sys.stdout.write(f"{counts[best]} of {best}: see --dictionary\n")
