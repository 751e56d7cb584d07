"""Replaces the camera's pictures in a Rerun recording by a video stream."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import rerun as rr
from numpy.typing import NDArray
from rerun.chunk import Chunk, LazyChunkStream

from mazebot.recorder.drawing.picture_drawing import CAMERA_ENTITY
from mazebot.recorder.stream.live_feed import TIMELINE
from mazebot.recorder.stream.rerun_program import rerun_binary
from mazebot.recorder.stream.rrd_reader import read_rrd
from mazebot.recorder.transcoding.vp9 import VideoError, VideoFrame, encode

_PATH = f"/{CAMERA_ENTITY}"
_PICTURE = "EncodedImage:blob"
Times = dict[str, NDArray[np.generic]]
"""By timeline, (n,) durations or times."""


class _Pictures(NamedTuple):
    """What there is of the camera's pictures."""

    times: Times
    others: list[Chunk]
    """What else is on that entity."""
    application_id: str
    recording_id: str


def transcode_rrd(recording: Path, video_by_ns: Mapping[int, VideoFrame]) -> bool:
    """Replace a whole recording by one with video, whatever happens either the old or the new one;
    False if it holds no pictures. `video_by_ns` is a video of all its pictures by their stamps, in
    order, where there is one already; otherwise it is made.

    Raises VideoError if that is not possible, OSError for a disk that is full or a file that is
    gone.
    """
    pictures = _read(recording)
    if not pictures.times:
        return False
    video, rest, whole = (recording.with_suffix(end) for end in (".video", ".rest", ".whole"))
    try:
        scratch = recording.with_suffix(".rrd.mp4")
        stamps_ns = pictures.times[TIMELINE].astype(np.int64)
        if video_by_ns and set(stamps_ns.tolist()) <= video_by_ns.keys():
            times = _times(pictures.times, list(video_by_ns))
            frames = iter(video_by_ns.values())
        else:
            order = np.argsort(stamps_ns, kind="stable")
            times = {name: values[order] for name, values in pictures.times.items()}
            frames = encode(_encoded(recording, pictures.times), scratch)
        chunks = [*pictures.others, *_video_chunks(times, frames)]
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
    """What there is, without the pictures themselves: they may be many."""
    try:
        entry = read_rrd(recording).recordings()[0]
        kept: dict[str, list[NDArray[np.generic]]] = {}
        others: list[Chunk] = []
        for chunk, batch in _chunks(recording):
            if batch is None:
                others.append(chunk)
                continue
            for name in batch.schema.names:
                if name in ("log_time", TIMELINE):
                    kept.setdefault(name, []).append(batch.column(name).to_numpy(False))
    except (RuntimeError, ValueError, IndexError) as error:
        raise VideoError(f"{recording}: {' '.join(str(error).split())}") from error
    times = {name: np.concatenate(values) for name, values in kept.items()}
    return _Pictures(times, others, entry.application_id, entry.recording_id)


def _encoded(recording: Path, times: Times) -> Iterator[bytes]:
    """The pictures in the order of their times."""
    order = np.argsort(times[TIMELINE], kind="stable")
    pictures = (
        bytes(row.values[0].values.to_numpy())
        for _, batch in _chunks(recording)
        if batch is not None
        for row in batch.column(_PICTURE)
    )
    if np.all(order[1:] > order[:-1]):
        yield from pictures
    else:
        known = list(pictures)
        yield from (known[number] for number in order)


def _chunks(recording: Path) -> Iterator[tuple[Chunk, pa.RecordBatch | None]]:
    """The chunks of the camera's entity, those with pictures as a table of them."""
    for chunk in read_rrd(recording).stream():
        if chunk.entity_path != _PATH:
            continue
        batch = chunk.to_record_batch()
        has_pictures = _PICTURE in batch.schema.names and TIMELINE in chunk.timeline_names
        # Rows without one are none of ours: the recorder logs them alone.
        whole = has_pictures and not batch.column(_PICTURE).null_count
        yield chunk, batch if whole else None


def _times(times: Times, stamps_ns: list[int]) -> Times:
    """The same timelines at other stamps: where they were recorded is that of the next picture."""
    stamps = np.array(stamps_ns, np.int64)
    recorded = times[TIMELINE].astype(np.int64)
    order = np.argsort(recorded, kind="stable")
    next_one = np.minimum(np.searchsorted(recorded[order], stamps), len(recorded) - 1)
    picked = {name: values[order][next_one] for name, values in times.items()}
    return {**picked, TIMELINE: stamps.astype("timedelta64[ns]")}


def _video_chunks(times: Times, video: Iterator[VideoFrame]) -> Iterator[Chunk]:
    """The codec, and a chunk for each key frame with those that follow it."""
    yield Chunk.from_columns(_PATH, [], rr.VideoStream.columns(codec=[rr.VideoCodec.VP9]))
    begin, frames = 0, list[VideoFrame]()
    for frame in video:
        if frame.is_key and frames:
            yield _chunk(times, begin, frames)
            begin, frames = begin + len(frames), []
        frames.append(frame)
    yield _chunk(times, begin, frames)


def _chunk(times: Times, begin: int, frames: list[VideoFrame]) -> Chunk:
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
        raise VideoError(lines[-1] if lines else f"rerun rrd {command} failed")
