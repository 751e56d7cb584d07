"""Pictures as a video stream, and back."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from mazebot.recorder.transcoding.vp9 import VideoError, VideoFrame, decode, encode
from tests.recorder.transcoding.pictures import jpeg, textured

COUNT = 30


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> list[VideoFrame]:
    scratch = tmp_path_factory.mktemp("video") / "a.mp4"
    made = list(encode(map(jpeg, textured(COUNT)), scratch))
    assert not scratch.exists()
    return made


def test_every_picture_is_a_frame_and_the_first_is_a_key_frame(frames: list[VideoFrame]) -> None:
    assert len(frames) == COUNT
    keys = [number for number, frame in enumerate(frames) if frame.is_key]
    assert keys[0] == 0
    # A viewer that jumps decodes from the key frame before.
    assert max(np.diff([*keys, COUNT])) <= 12


def test_the_video_shows_what_the_pictures_showed(frames: list[VideoFrame]) -> None:
    shown = list(decode(frames))
    assert len(shown) == COUNT
    psnr_db = [cv2.PSNR(old, new) for old, new in zip(textured(COUNT), shown, strict=True)]
    assert min(psnr_db) > 30.0
    # In order: each is most like its own picture.
    assert cv2.PSNR(next(textured(COUNT)), shown[-1]) < min(psnr_db)


def test_it_is_much_smaller_than_the_pictures(frames: list[VideoFrame]) -> None:
    pictures_bytes = sum(len(jpeg(picture)) for picture in textured(COUNT))
    assert 4 * sum(len(frame.data) for frame in frames) < pictures_bytes


def test_no_pictures_are_no_video(tmp_path: Path) -> None:
    assert list(encode([], tmp_path / "a.mp4")) == []


def _of_two_sizes() -> Iterator[bytes]:
    yield jpeg(np.zeros((48, 64, 3), np.uint8))
    yield jpeg(np.zeros((64, 48, 3), np.uint8))


@pytest.mark.parametrize(
    ("pictures", "said"),
    [
        ([b"nothing"], "neither JPEG nor PNG"),
        (_of_two_sizes(), "two sizes"),
        ([jpeg(np.zeros((47, 64, 3), np.uint8))], "64 x 47"),
    ],
)
def test_what_cannot_be_a_video_is_said(pictures: list[bytes], said: str, tmp_path: Path) -> None:
    with pytest.raises(VideoError, match=said):
        list(encode(pictures, tmp_path / "a.mp4"))
    assert list(tmp_path.iterdir()) == []


def test_no_stream_cannot_be_decoded() -> None:
    with pytest.raises(VideoError):
        list(decode([VideoFrame(b"nothing")]))
