"""Reads a texture's file, and validates it before any other use."""

from __future__ import annotations

from pathlib import Path

from mazebot.common.files import png


def read_texture_file(path: Path) -> bytes:
    """The bytes of a valid PNG file with the suffix .png.

    Raises ValueError otherwise, with a phrase that continues after the file's name.
    """
    try:
        if path.exists() and not path.is_file():
            # Reading a pipe would block forever.
            raise ValueError("is not a file, must be a PNG")
        if path.stat().st_size > png.MAX_BYTES:
            raise ValueError(f"must have at most {png.MAX_BYTES} bytes")
        data = path.read_bytes()
    except OSError as error:
        raise ValueError(f"cannot be read ({error.strerror}), must be a PNG") from error
    problem = png.problem(data)
    if problem:
        raise ValueError(problem)
    if path.suffix.lower() != ".png":
        # Other readers, including Gazebo, go by the suffix.
        raise ValueError(f"is a PNG, must be named {path.with_suffix('.png').name}")
    return data
