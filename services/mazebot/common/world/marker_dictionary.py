"""Custom dictionaries of ArUco markers, from files in OpenCV's format."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import yaml
from lxml import etree

from mazebot.common.config import ConfigError
from mazebot.common.files.reading import NotReadableError, read_limited
from mazebot.common.files.yaml_words import line_and_words
from mazebot.common.messages.documents import MarkerDictionary
from mazebot.common.world.marker_picture import own_dictionaries

MAX_BYTES = 4 * 1024 * 1024
MAX_MARKERS = 100_000
MIN_SIZE, MAX_SIZE = 2, 16
"""Modules along a side, without the border."""


def read_dictionary(file: Path) -> cv2.aruco.Dictionary:
    """The dictionary in a file: see read_codes. Raises ConfigError in one line."""
    codes = read_codes(file)
    return own_dictionaries((codes,))[codes.name]


def read_codes(file: Path) -> MarkerDictionary:
    """The dictionary in a YAML, JSON or XML file with OpenCV's keys.

    They are nmarkers, markersize, maxCorrectionBits (optional), and marker_0, marker_1, ... of `0`
    (black) and `1` (white) row by row, as written by cv::aruco::Dictionary::writeDictionary. Parsed
    here, because OpenCV's own reader ends the process on some files.

    Raises ConfigError in one line for anything else.
    """
    try:
        text = read_limited(file, MAX_BYTES).decode()
    except UnicodeDecodeError as error:
        raise ConfigError(f"{file}: must be UTF-8 text") from error
    except NotReadableError as error:
        raise ConfigError(f"{file}: {error}") from error
    except OSError as error:
        raise ConfigError(f"{file}: cannot be read: {error.strerror}") from error
    content = _content(file, text)
    count = _number(file, content, "nmarkers", 1, MAX_MARKERS)
    size = _number(file, content, "markersize", MIN_SIZE, MAX_SIZE)
    correction = 0
    if "maxCorrectionBits" in content:
        correction = _number(file, content, "maxCorrectionBits", 0, size * size)
    codes = tuple(_code(file, content, f"marker_{index}", size) for index in range(count))
    return MarkerDictionary(
        name=file.name, modules=size, max_correction_bits=correction, codes=codes
    )


def _content(file: Path, text: str) -> Mapping[str, Any]:
    """The top level of a file; values are texts in YAML and XML."""
    try:
        if text.lstrip().startswith("<"):
            if "<!" in text.replace("<!--", ""):
                raise ValueError("must not have a DOCTYPE")
            parser = etree.XMLParser(resolve_entities=False, no_network=True, huge_tree=False)
            root = etree.fromstring(text.encode(), parser)
            return {str(child.tag): (child.text or "").strip().strip('"') for child in root}
        if text.lstrip().startswith("{"):
            content = json.loads(text)
        else:
            # OpenCV starts its files with a directive that YAML does not know: %YAML:1.0
            head, _, rest = text.partition("\n")
            content = _flat(f"\n{rest}" if head.startswith("%YAML") else text)
    except yaml.YAMLError as error:
        line, words = line_and_words(error)
        place = f"{file}:{line}" if line else str(file)
        raise ConfigError(f"{place}: neither YAML nor JSON nor XML: {words}") from error
    except (etree.XMLSyntaxError, ValueError, RecursionError) as error:
        words = " ".join(str(error).split())
        raise ConfigError(f"{file}: neither YAML nor JSON nor XML: {words:.120}") from error
    if not isinstance(content, dict):
        raise ConfigError(
            f"{file}: must be a flat mapping with nmarkers, markersize, marker_0, ..."
        )
    return content


def _flat(text: str) -> dict[str, str] | None:
    """Keys and values of a YAML mapping of texts, None for anything else.

    Based on the parser's events, stopping at the first invalid one: for four megabytes of lists
    and aliases a loader takes minutes.
    """
    inside: list[str] = []
    kinds = ("StreamStart", "DocumentStart", "MappingStart")
    for number, event in enumerate(yaml.parse(text, yaml.CSafeLoader)):
        name = type(event).__name__.removesuffix("Event")
        if number < len(kinds):
            if name != kinds[number]:
                return None
        elif isinstance(event, yaml.ScalarEvent):
            inside.append(event.value)
        else:
            break
    return dict(zip(inside[::2], inside[1::2], strict=True)) if name == "MappingEnd" else None


def _number(file: Path, content: Mapping[str, Any], key: str, low: int, high: int) -> int:
    if key not in content:
        raise ConfigError(f"{file}: {key}: is missing")
    value = content[key]
    text = str(value)
    if isinstance(value, bool) or not (text.isascii() and text.isdigit() and len(text) < 10):
        raise ConfigError(f"{file}: {key}: {value!r:.40}: must be an integer")
    if not low <= int(text) <= high:
        raise ConfigError(f"{file}: {key}: {text}: must be from {low} to {high}")
    return int(text)


def _code(file: Path, content: Mapping[str, Any], key: str, size: int) -> str:
    if key not in content:
        raise ConfigError(f"{file}: {key}: is missing")
    value = content[key]
    if not (isinstance(value, str) and len(value) == size * size and set(value) <= {"0", "1"}):
        raise ConfigError(
            f"{file}: {key}: {value!r:.40}: must be {size * size} digits, each 0 or 1 "
            f"(markersize {size})"
        )
    return value
