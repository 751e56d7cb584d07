"""Reads a texture's file, and validates it before any other use."""

from __future__ import annotations

from pathlib import Path

from mazebot.common.files import png
from mazebot.common.files.reading import read_limited


def read_texture_file(path: Path) -> bytes:
    """The bytes of a valid PNG file with the suffix .png.

    Raises ValueError otherwise, with a phrase that continues after the file's name.
    """
    try:
        data = read_limited(path, png.MAX_BYTES)
    except OSError as error:
        raise ValueError(f"cannot be read ({error.strerror}), must be a PNG") from error
    problem = png.problem(data)
    if problem:
        raise ValueError(problem)
    if path.suffix.lower() != ".png":
        # Other readers, including Gazebo, go by the suffix.
        raise ValueError(f"is a PNG, must be named {path.with_suffix('.png').name}")
    return data
