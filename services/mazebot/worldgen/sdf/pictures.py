"""Converts images of any format to PNG for a recipe."""

from __future__ import annotations

import io
from pathlib import Path

from PIL import Image

from mazebot.common.config import ConfigError
from mazebot.common.files import png
from mazebot.common.files.images import ImageError, open_image
from mazebot.common.files.limits import MAX_DOCUMENT_BYTES
from mazebot.common.files.reading import NotReadableError, read_limited, reason

_SIDES_PX = (png.MAX_SIDE_PX, png.MAX_SIDE_PX)


def picture_as_png(picture: Path) -> bytes:
    """An image of any format as PNG for renderers; a PNG's own bytes if they are suitable.

    Raises ConfigError.
    """
    try:
        data = read_limited(picture, MAX_DOCUMENT_BYTES)
    except (OSError, NotReadableError) as error:
        raise ConfigError(f"{picture}: cannot be read: {reason(error)}") from error
    if not png.problem(data):
        return data
    try:
        image = open_image(data)
        if image.mode in ("L", "LA", "RGB", "RGBA"):
            # At its full size there is one copy of it.
            image.thumbnail(_SIDES_PX, Image.Resampling.LANCZOS)
        picture_rgb = image.convert("RGBA" if image.has_transparency_data else "RGB")
    except ImageError as error:
        raise ConfigError(f"{picture}: {error}") from error
    except Exception as error:
        # Pillow's readers may raise anything.
        words = " ".join(str(error).split())
        raise ConfigError(f"{picture}: is not an image: {words:.80}") from error
    picture_rgb.thumbnail(_SIDES_PX, Image.Resampling.LANCZOS)
    written = io.BytesIO()
    picture_rgb.save(written, "PNG")
    return written.getvalue()
