"""Opens images of other people: the size is checked before any pixel is decoded."""

from __future__ import annotations

import io
import warnings

from PIL import Image

from mazebot.common.files import png
from mazebot.common.files.limits import MAX_IMAGE_PIXELS


class ImageError(ValueError):
    """An image that cannot be used: a phrase that continues after its name."""


class NotAnImageError(ImageError):
    """No image, or none of the formats that are read."""


def open_image(
    data: bytes, formats: tuple[str, ...] | None = None, max_pixels: int = MAX_IMAGE_PIXELS
) -> Image.Image:
    """An image whose header is valid; its pixels are decoded when they are asked for.

    Raises NotAnImageError for other formats, ImageError for too many pixels or a PNG that is cut:
    Pillow fills its missing part.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            image: Image.Image = Image.open(io.BytesIO(data), formats=formats)
        except Image.DecompressionBombError as error:
            raise ImageError(f"must have at most {max_pixels} pixels") from error
        except Exception as error:
            # On damaged images Pillow's decoders may raise anything.
            raise NotAnImageError("is damaged, or is not an image") from error
    if not 0 < image.width * image.height <= max_pixels:
        raise ImageError(
            f"has {image.width} x {image.height} pixels: must have at least 1 and at most "
            f"{max_pixels}"
        )
    if image.format == "PNG" and not png.is_whole(data):
        raise ImageError("is corrupt or truncated")
    return image
