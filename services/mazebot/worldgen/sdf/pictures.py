"""Converts images of any format to PNG for a recipe."""

from __future__ import annotations

import io
import warnings
from pathlib import Path

from PIL import Image

from mazebot.common.config import ConfigError
from mazebot.common.files import png

MAX_PIXELS = 64_000_000
"""Of an image before it is scaled down; also the maximum bytes of its file."""


def picture_as_png(picture: Path) -> bytes:
    """An image of any format as PNG for renderers; a PNG's own bytes if they are suitable.

    Raises ConfigError.
    """
    try:
        if picture.stat().st_size > MAX_PIXELS:
            raise ConfigError(f"{picture}: must have at most {MAX_PIXELS} bytes")
        data = picture.read_bytes()
    except OSError as error:
        raise ConfigError(f"{picture}: cannot be read: {error.strerror}") from error
    if not png.problem(data):
        return data
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(io.BytesIO(data)) as image:
                if image.width * image.height > MAX_PIXELS:
                    raise ConfigError(f"{picture}: must have at most {MAX_PIXELS} pixels")
                picture_rgb = image.convert("RGBA" if image.has_transparency_data else "RGB")
    except ConfigError:
        raise
    except Exception as error:
        # Pillow's readers may raise anything.
        words = " ".join(str(error).split())
        raise ConfigError(f"{picture}: is not an image: {words:.80}") from error
    picture_rgb.thumbnail((png.MAX_SIDE_PX, png.MAX_SIDE_PX), Image.Resampling.LANCZOS)
    written = io.BytesIO()
    picture_rgb.save(written, "PNG")
    return written.getvalue()
