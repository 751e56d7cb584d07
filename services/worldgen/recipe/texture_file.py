"""A texture's file, checked before anything else looks at it."""

from __future__ import annotations

from pathlib import Path

from services.common import png


def read_texture_file(path: Path) -> bytes:
    """The bytes of a PNG file that is called one.

    Raises ValueError, in a phrase that goes on from the file's name, where it is none.
    """
    try:
        if path.exists() and not path.is_file():
            # A pipe would wait for ever.
            raise ValueError("is no file, must be a PNG")
        if path.stat().st_size > png.MAX_BYTES:
            raise ValueError(f"must have at most {png.MAX_BYTES} bytes")
        data = path.read_bytes()
    except OSError as error:
        raise ValueError(f"cannot be read ({error.strerror}), must be a PNG") from error
    problem = png.problem(data)
    if problem:
        raise ValueError(problem)
    if path.suffix.lower() != ".png":
        # Others who read it, Gazebo among them, go by its name.
        raise ValueError(f"is a PNG, must be called {path.with_suffix('.png').name}")
    return data
