"""Finds the recording that the user names."""

from __future__ import annotations

from pathlib import Path

from mazebot.cli.replay.reading.recording import Recording
from mazebot.common.config import ConfigError
from mazebot.common.files.reading import NotReadableError, open_regular, reason
from mazebot.common.recordings.catalog import LATEST, find_run, run_at
from mazebot.common.recordings.comparing.wholeness import ABOUT, faults_of_file, message_faults
from mazebot.common.recordings.mcap.mcap_records import McapError
from mazebot.common.recordings.mcap.mcap_scan import scan
from mazebot.common.recordings.run_folder import CONFIG, MESSAGES, SUMMARY, parts_of

_MCAP = b"\x89MCAP"
_UNENDED = {
    "running": "is being recorded: its last messages are yet to come",
    "interrupted": "was killed while it was recorded: `mazebot recordings repair` makes it whole",
}
"""By the state of a run that is not closed."""


def open_recording(directory: Path, name: str, slam: bool = False) -> Recording:
    """A run by its name in `directory`, by its folder, or `latest`, the newest one that holds its
    messages; an MCAP file, or a folder of rosbag2. With `slam`, the robot of a bag gets no map,
    though one was recorded.

    Raises ConfigError where there is none, or it cannot be read.
    """
    if name == LATEST:
        return _open_folder(find_run("replay", directory, name, MESSAGES).path, slam)
    for path in (Path(name), directory / name):
        if path.is_dir():
            return _open_folder(path, slam)
        if path.exists():
            return _open_file(path, slam)
    raise ConfigError(
        f"replay: {name!r}: must be a run in {directory}, its folder, an MCAP file, a folder of "
        "rosbag2, or a .bag of ROS 1"
    )


def _open_folder(folder: Path, slam: bool) -> Recording:
    # Reading a bag needs other libraries than reading a run.
    parts = parts_of(folder, MESSAGES)
    if parts:
        from mazebot.cli.replay.reading.run_messages import open_run  # noqa: PLC0415

        recording = open_run(folder.resolve().name, parts)
        _tell_state(recording, folder)
        recording.faults = message_faults(folder)
        return recording
    # Its libraries load only where there is a bag.
    from mazebot.cli.bags.bag import METADATA, is_bag  # noqa: PLC0415

    if is_bag(folder):
        from mazebot.cli.replay.reading.bag_messages import open_bag  # noqa: PLC0415

        return open_bag(folder, slam)
    if any((folder / file).is_file() for file in (SUMMARY, CONFIG)):
        raise ConfigError(
            f"replay: {folder} has no {MESSAGES}: it was run without recording its messages"
        )
    raise ConfigError(
        f"replay: {folder}: must contain {MESSAGES} of a run, or {METADATA}, .mcap or .db3 files "
        "of rosbag2, or .bag files of ROS 1"
    )


def _tell_state(recording: Recording, folder: Path) -> None:
    """Write into a run's recording what its folder tells of how it was recorded."""
    run = run_at(folder)
    if run is None:
        return
    recording.gap = run.gap
    if not run.closed:
        recording.unended = _UNENDED.get(run.state, "")


def _open_file(path: Path, slam: bool) -> Recording:
    try:
        with open_regular(path) as file:
            begin = file.read(16)
    except (OSError, NotReadableError) as error:
        raise ConfigError(f"replay: {path}: {reason(error)}") from error
    if begin.startswith(_MCAP) and _is_run(path):
        from mazebot.cli.replay.reading.run_messages import open_run  # noqa: PLC0415

        recording = open_run(path.stem, [path])
        if path == path.parent / MESSAGES:
            _tell_state(recording, path.parent)
        recording.faults = faults_of_file(path)
        return recording
    from mazebot.cli.replay.reading.bag_messages import open_bag  # noqa: PLC0415

    return open_bag(path, slam)


def _is_run(path: Path) -> bool:
    try:
        return ABOUT in scan(path).texts
    except McapError as error:
        raise ConfigError(f"replay: {path}: must be an MCAP file: {error}") from error
    except OSError as error:
        raise ConfigError(f"replay: {path}: {error.strerror}") from error
