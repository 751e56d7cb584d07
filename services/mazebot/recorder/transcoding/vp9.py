"""Pictures as a VP9 video stream, made with the FFmpeg library that comes with OpenCV."""

from __future__ import annotations

import struct
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

BITS_PER_PIXEL = 0.16
"""What the encoder aims at; a drive through textured rooms needs about a third of it."""
_MOST_BITS_PER_S = (2**31 - 1) // 2
"""OpenCV asks the encoder for 64 bits a pixel, and for at most this bit rate."""
_KEY_FRAME = 0x80


class VideoError(Exception):
    """Pictures that cannot be made a video; one line."""


@dataclass(frozen=True)
class VideoFrame:
    """One picture, encoded: a key frame is decoded alone, any other after those before it."""

    data: bytes

    @property
    def is_key(self) -> bool:
        """Whether it is a key frame (VP9 bitstream, 6.2: marker, profile 0, new, type)."""
        return bool(self.data) and self.data[0] & 0xFC == _KEY_FRAME


def encode(encoded_pictures: Iterable[bytes], scratch: Path) -> Iterator[VideoFrame]:
    """A frame per JPEG or PNG picture, in the same order; all of one even size.

    OpenCV offers neither bit rate nor quality: the encoder is given a frame rate so high that the
    greatest bit rate leaves as many bits for a picture as wanted. The times of the frames are
    not part of the stream. Every twelfth frame is a key frame. Meanwhile the file `scratch`, whose
    name must end with `.mp4`, holds the video.

    Raises VideoError if a picture cannot be read or has another size, or if nothing was made.
    """
    try:
        count = _write(scratch, encoded_pictures)
        frames = 0
        for frame in _frames(scratch) if count else ():
            if not frames and not frame.is_key:
                raise VideoError("the video does not start with a key frame")
            frames += 1
            yield frame
        if frames != count:
            raise VideoError(f"got {frames} video frames of {count} pictures")
    finally:
        scratch.unlink(missing_ok=True)


def decode(frames: Iterable[VideoFrame]) -> Iterator[NDArray[np.uint8]]:
    """The pictures of a stream again, (h, w, 3) BGR, from its first frame, a key frame.

    Raises VideoError for a stream that cannot be read.
    """
    with tempfile.TemporaryDirectory(prefix="mazebot-video-") as folder:
        path = Path(folder) / "video.ivf"
        path.write_bytes(_ivf([frame.data for frame in frames]))
        video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
        count = 0
        try:
            while video.isOpened():
                is_read, picture = video.read()
                if not is_read:
                    break
                count += 1
                yield np.asarray(picture, np.uint8)
        finally:
            video.release()
        if not count:
            raise VideoError("the video cannot be read")


def _write(path: Path, encoded_pictures: Iterable[bytes]) -> int:
    writer: cv2.VideoWriter | None = None
    size_px: tuple[int, int] | None = None
    count = 0
    try:
        for encoded in encoded_pictures:
            picture = cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_COLOR)
            if picture is None:
                raise VideoError(f"picture {count + 1} is neither JPEG nor PNG")
            height, width = picture.shape[:2]
            if writer is None:
                size_px = width, height
                writer = _writer(path, size_px)
            if (width, height) != size_px:
                raise VideoError(f"pictures of two sizes: {size_px} and {(width, height)}")
            writer.write(picture)
            count += 1
    finally:
        if writer is not None:
            writer.release()
    return count


def _writer(path: Path, size_px: tuple[int, int]) -> cv2.VideoWriter:
    width, height = size_px
    if width % 2 or height % 2:
        raise VideoError(f"pictures of {width} x {height}: a video needs an even width and height")
    nominal_hz = float(round(_MOST_BITS_PER_S / (BITS_PER_PIXEL * width * height)))
    # The tag of MP4 files: for another one, OpenCV prints that it takes this one.
    codec = cv2.VideoWriter.fourcc(*"vp09")
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, codec, nominal_hz, size_px)
    if not writer.isOpened():
        raise VideoError("this OpenCV has no VP9 encoder")
    return writer


def _frames(path: Path) -> Iterator[VideoFrame]:
    as_encoded = [cv2.CAP_PROP_FORMAT, -1]
    video = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, as_encoded)
    if not video.isOpened():
        raise VideoError("the encoded video cannot be read")
    try:
        while True:
            is_read, packet = video.read()
            if not is_read:
                return
            yield VideoFrame(np.asarray(packet, np.uint8).tobytes())
    finally:
        video.release()


def _ivf(packets: list[bytes]) -> bytes:
    """An IVF file (libvpx): a header, then each packet with its size and number. The size of the
    pictures is in the packets, too.
    """
    header = b"DKIF" + struct.pack("<HH4sHHIIII", 0, 32, b"VP90", 0, 0, 10, 1, len(packets), 0)
    pieces = [header]
    for number, packet in enumerate(packets):
        pieces += [struct.pack("<IQ", len(packet), number), packet]
    return b"".join(pieces)
