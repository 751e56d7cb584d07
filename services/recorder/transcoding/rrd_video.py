"""Replaces the camera's pictures in a Rerun recording by a video stream."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray
from rerun.chunk import Chunk, LazyChunkStream, RrdReader

from services.recorder.drawing.picture_drawing import CAMERA_ENTITY
from services.recorder.stream.live_feed import TIMELINE
from services.recorder.stream.rerun_program import rerun_binary
from services.recorder.transcoding.vp9 import VideoError, VideoFrame, encode

_PATH = f"/{CAMERA_ENTITY}"
_PICTURE = "EncodedImage:blob"


class _Pictures(NamedTuple):
    """The camera's pictures, by time."""

    times: dict[str, NDArray[np.generic]]
    """By timeline, (n,) durations, times or numbers."""
    encoded: list[bytes]
    others: list[Chunk]
    """What else is on that entity."""
    application_id: str
    recording_id: str


def transcode_rrd(recording: Path) -> bool:
    """Replace a whole recording by one with video, whatever happens either the old or the new one;
    False if it holds no pictures.

    Raises VideoError if that is not possible, OSError for a disk that is full or a file that is
    gone.
    """
    pictures = _read(recording)
    if not pictures.encoded:
        return False
    video, rest, whole = (recording.with_suffix(end) for end in (".video", ".rest", ".whole"))
    try:
        chunks = [*pictures.others, *_video_chunks(pictures, recording.with_suffix(".rrd.mp4"))]
        LazyChunkStream.from_iter(chunks).write_rrd(
            video,
            application_id=pictures.application_id,
            recording_id=pictures.recording_id,
        )
        _rerun("filter", recording, "--drop-entity", _PATH, "-o", rest)
        _rerun("optimize", rest, video, "-o", whole)
        _rerun("verify", whole)
        with whole.open("rb") as file:
            os.fsync(file.fileno())
        whole.replace(recording)
    except (RuntimeError, ValueError) as error:
        raise VideoError(" ".join(str(error).split())) from error
    finally:
        for made in (video, rest, whole):
            made.unlink(missing_ok=True)
    return True


def _read(recording: Path) -> _Pictures:
    try:
        reader = RrdReader(recording)
        entry = reader.recordings()[0]
        found = [chunk for chunk in reader.stream() if chunk.entity_path == _PATH]
    except (RuntimeError, ValueError, IndexError) as error:
        raise VideoError(f"{recording}: {' '.join(str(error).split())}") from error
    batches, others = [], []
    for chunk in found:
        batch = chunk.to_record_batch()
        if _PICTURE in batch.schema.names and TIMELINE in chunk.timeline_names:
            batches.append(batch)
        else:
            others.append(chunk)
    if not batches:
        return _Pictures({}, [], others, entry.application_id, entry.recording_id)
    names = [name for name in batches[0].schema.names if name in ("log_time", TIMELINE)]
    table = pa.Table.from_batches([batch.select([*names, _PICTURE]) for batch in batches])
    table = table.drop_null().sort_by(TIMELINE)
    return _Pictures(
        {name: table[name].to_numpy() for name in names},
        [_blob(row) for row in table[_PICTURE]],
        others,
        entry.application_id,
        entry.recording_id,
    )


def _blob(row: pa.ListScalar) -> bytes:
    return bytes(row.values[0].values.to_numpy())


def _video_chunks(pictures: _Pictures, scratch: Path) -> Iterator[Chunk]:
    """The codec, and a chunk for each key frame with those that follow it."""
    yield Chunk.from_columns(_PATH, [], rr.VideoStream.columns(codec=[rr.VideoCodec.VP9]))
    begin, frames = 0, list[VideoFrame]()
    for frame in encode(pictures.encoded, scratch):
        if frame.is_key and frames:
            yield _chunk(pictures.times, begin, frames)
            begin, frames = begin + len(frames), []
        frames.append(frame)
    yield _chunk(pictures.times, begin, frames)


def _chunk(times: dict[str, NDArray[np.generic]], begin: int, frames: list[VideoFrame]) -> Chunk:
    indexes = []
    for name, values in times.items():
        rows = values[begin : begin + len(frames)]
        kind = "duration" if rows.dtype.kind == "m" else "timestamp"
        indexes.append(rr.TimeColumn(name, **{kind: rows}))
    samples = rr.VideoStream.columns(sample=[frame.data for frame in frames])
    return Chunk.from_columns(_PATH, indexes, samples)


def _rerun(command: str, *arguments: Path | str) -> None:
    """Run `rerun rrd`; raises VideoError with its last line if it fails."""
    binary = rerun_binary()
    if binary is None:
        raise VideoError("the Rerun program is not installed")
    ended = subprocess.run(
        [str(binary), "rrd", command, *map(str, arguments)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        check=False,
    )
    if ended.returncode != 0:
        lines = ended.stderr.decode(errors="replace").strip().splitlines()
        raise VideoError(lines[-1] if lines else f"rerun rrd {command} fails")
