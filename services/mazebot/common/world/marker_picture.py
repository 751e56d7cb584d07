"""The image of an ArUco marker on white paper, as PNG with whole pixels a module."""

from __future__ import annotations

import functools
from collections.abc import Iterable

import cv2
import numpy as np
from numpy.typing import NDArray

from mazebot.common.messages.documents import Marker, MarkerDictionary

MAX_SIDE_PX = 2048
"""The largest size that a renderer accepts."""

# OpenCV has some of the AprilTag families under two spellings.
_DICTIONARIES = {
    name: int(getattr(cv2.aruco, name)) for name in dir(cv2.aruco) if name.startswith("DICT_")
}


@functools.cache
def _predefined(name: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(_DICTIONARIES[name])


def dictionary_of_bits(
    bits: NDArray[np.uint8], max_correction_bits: int = 0
) -> cv2.aruco.Dictionary:
    """A custom dictionary from (markers, modules, modules) bits, 1 white, without borders."""
    rows = [cv2.aruco.Dictionary.getByteListFromBits(marker) for marker in bits]
    return cv2.aruco.Dictionary(np.concatenate(rows), bits.shape[1], max_correction_bits)


def own_dictionaries(
    documents: Iterable[MarkerDictionary],
) -> dict[str, cv2.aruco.Dictionary]:
    """A world's own dictionaries by name."""
    found = {}
    for one in documents:
        digits = np.frombuffer("".join(one.codes).encode(), np.uint8) - ord("0")
        bits = digits.reshape(len(one.codes), one.modules, one.modules)
        found[one.name] = dictionary_of_bits(bits, one.max_correction_bits)
    return found


def identity_problem(marker: Marker, dictionary: cv2.aruco.Dictionary | None = None) -> str:
    """Why there is no such marker; empty where it exists.

    Here and below `dictionary` is the dictionary that the marker names, if it is not one of
    OpenCV's.
    """
    found = identity_mistake(marker.dictionary, marker.id, dictionary)
    if found is None:
        return ""
    field, value, must = found
    return f"{field}: {value!r:.60}: {must}"


def identity_mistake(
    name: str, marker_id: int, dictionary: cv2.aruco.Dictionary | None = None
) -> tuple[str, str | int, str] | None:
    """Why a dictionary of this name has no marker of this id: the field that is wrong,
    `dictionary` or `id`, its value, and what it must be; None where it has.
    """
    if dictionary is None and name not in _DICTIONARIES:
        return "dictionary", name, f"must be one of {', '.join(_DICTIONARIES)}"
    count = marker_count(name, dictionary)
    if marker_id >= count:
        return "id", marker_id, f"must be less than {count} in {name}"
    return None


def marker_count(name: str, dictionary: cv2.aruco.Dictionary | None = None) -> int:
    """Number of markers of a dictionary. Raises KeyError where there is none of this name."""
    return len((dictionary or _predefined(name)).bytesList)


def modules(marker: Marker, dictionary: cv2.aruco.Dictionary | None = None) -> int:
    """Modules along the side of the black square, including its border of one on each side."""
    return int((dictionary or _predefined(marker.dictionary)).markerSize) + 2


def panel_side_m(marker: Marker, dictionary: cv2.aruco.Dictionary | None = None) -> float:
    """Side of the panel: the black square and the quiet zone around it."""
    black = modules(marker, dictionary)
    return marker.size_m * (black + 2 * marker.quiet_zone_modules) / black


def draw(marker: Marker, module_px: int, dictionary: cv2.aruco.Dictionary | None = None) -> bytes:
    """PNG of an existing marker, with its top row up.

    Each module is `module_px` pixels a side, or fewer so that the image fits `MAX_SIDE_PX`.
    """
    black, quiet = modules(marker, dictionary), marker.quiet_zone_modules
    module_px = min(module_px, MAX_SIDE_PX // (black + 2 * quiet))
    square = cv2.aruco.generateImageMarker(
        dictionary or _predefined(marker.dictionary), marker.id, black * module_px, borderBits=1
    )
    paper = np.pad(square, quiet * module_px, constant_values=255)
    done, data = cv2.imencode(".png", cv2.cvtColor(paper, cv2.COLOR_GRAY2BGR))
    if not done:
        raise RuntimeError("OpenCV cannot write PNG")
    return bytes(data.tobytes())
