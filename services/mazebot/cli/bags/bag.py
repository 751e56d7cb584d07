"""Opens bags: an MCAP file, a `.db3` file of rosbag2, a `.bag` of ROS 1, or a folder of them, also
one that was not closed: without metadata.yaml, or cut.
"""

from __future__ import annotations

import heapq
import shutil
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import cast

import zstandard
from rosbags.interfaces import Connection, ConnectionExtRosbag2

from mazebot.cli.bags import ros1_bag
from mazebot.cli.bags.log_clock import Move, Place, may_go_back, moves_of
from mazebot.cli.bags.mcap_bag import McapBag
from mazebot.cli.bags.ros1_bag import Ros1Bag
from mazebot.cli.bags.ros1_messages import CDR, ROS_1
from mazebot.cli.bags.sqlite_bag import SqliteBag
from mazebot.common.config import ConfigError
from mazebot.common.files import bounded_yaml
from mazebot.common.files.limits import MAX_CHUNK_BYTES, MAX_TEXT_BYTES
from mazebot.common.files.reading import (
    NotReadableError,
    most_unpacked,
    open_regular,
    read_limited,
)
from mazebot.common.problems import words
from mazebot.common.recordings.mcap.mcap_records import McapError

METADATA = "metadata.yaml"
_STORAGES = (".mcap", ".db3", ".bag")
_PACKED = (".zstd", ".zst")
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
_MCAP_MAGIC = b"\x89MCAP"
_SQLITE_MAGIC = b"SQLite format 3\0"
_PIECE_BYTES = 65_536
_MANY = 6
"""Files that a line names."""
_Warn = Callable[[str, str], None]


_Storage = McapBag | SqliteBag | Ros1Bag


class Bag:
    """The topics of all files of a bag, and their messages by the time of logging."""

    def __init__(
        self, name: str, storages: Sequence[tuple[Path, _Storage]], is_one_series: bool = False
    ) -> None:
        """`name` begins the line of an error. `is_one_series`: one recorder wrote one file after
        the other, in this order.
        """
        self._name = name
        self._is_one_series = is_one_series
        self._storages = storages
        self.damaged: dict[str, str] = {}
        """Files of which a part is left out, with the reason; complete when all has been read."""
        self._moves: list[list[Move]] | None = None
        """Of each file; None: not looked for yet."""
        self.connections: list[Connection] = []
        """Each with an id of its own: a topic has one for each file, and for each publisher."""
        self._own: list[tuple[int, Connection]] = []
        for number, (_, storage) in enumerate(storages):
            for connection in storage.connections:
                self._own.append((number, connection))
                self.connections.append(connection._replace(id=len(self.connections)))

    def topics_of(self, type_name: str) -> set[str]:
        """The topics of a type."""
        return {one.topic for one in self.connections if one.msgtype == type_name}

    def messages(
        self, connections: Collection[Connection] | None = None
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Topic, time of logging in ns and content of each message, of all topics or some.

        Raises ConfigError where they cannot be read.
        """
        chosen = self.connections if connections is None else connections
        if self._moves is None:
            self._moves = self._moves_of_all()
        series = [self._of(number, chosen) for number in range(len(self._storages))]
        yield from heapq.merge(*series, key=lambda message: message[1])

    def _of(
        self, number: int, chosen: Collection[Connection]
    ) -> Iterator[tuple[Connection, int, bytes]]:
        path, storage = self._storages[number]
        wanted = {
            self._own[one.id][1].id: (one, self._own[one.id][1])
            for one in chosen
            if self._own[one.id][0] == number
        }
        try:
            owns, moves = [own for _, own in wanted.values()], (self._moves or {number: ()})[number]
            for own, log_ns, data in storage.messages(owns, moves):
                yield wanted[own.id][0], log_ns, _plain(bytes(data))
        except Exception as error:
            # Each storage has errors of its own.
            raise ConfigError(f"{self._name}: {path}: {_line(error)}") from error
        if not isinstance(storage, SqliteBag) and storage.damaged:
            damaged = storage.damaged
            many = "chunks" if damaged > 1 else "chunk"
            why = f", one of which {storage.too_large}" if storage.too_large else ""
            self.damaged[path.name] = f"{damaged} corrupt {many}{why}"

    @property
    def end_ns(self) -> int:
        """When the last message was logged; 0: there is none. It is known when messages have been
        read.
        """
        moved_ns = [move.end_ns for moves in self._moves or () for move in moves]
        return max((*moved_ns, *(storage.end_ns for _, storage in self._storages)), default=0)

    @property
    def moves_ns(self) -> list[int]:
        """By how much later log times are than the files say, in some of their parts: all that the
        recorder's clock was set back by until then. It is known when messages have been read.
        """
        return sorted({move.by_ns for moves in self._moves or () for move in moves})

    def _moves_of_all(self) -> list[list[Move]]:
        """How the log times of each file are moved. Raises ConfigError where it cannot be read."""
        numbers = range(len(self._storages))
        if self._is_one_series:
            return self._moves_of(numbers)
        return [moves for number in numbers for moves in self._moves_of([number])]

    def _moves_of(self, numbers: Sequence[int]) -> list[list[Move]]:
        if not may_go_back(span for one in numbers for span in self._storages[one][1].spans_ns):
            return [[] for _ in numbers]
        return moves_of([self._places(number) for number in numbers])

    def _places(self, number: int) -> Iterator[tuple[tuple[str, int], Place]]:
        """Each message of a file with its series: those of a topic by one publisher."""
        path, storage = self._storages[number]
        counts: Counter[str] = Counter()
        series = {}
        for connection in storage.connections:
            series[connection.id] = connection.topic, counts[connection.topic]
            counts[connection.topic] += 1
        try:
            for place in storage.places():
                if place.connection in series:
                    yield series[place.connection], place
        except Exception as error:
            # Each storage has errors of its own.
            raise ConfigError(f"{self._name}: {path}: {_line(error)}") from error


def problem_of(connection: Connection) -> str:
    """Why the messages of a topic cannot be read, whatever they are; empty: they can."""
    encoding = cast("ConnectionExtRosbag2", connection.ext).serialization_format
    if encoding == CDR:
        return ""
    if encoding == ROS_1:
        return f"is {connection.msgtype} as it was in ROS 1: must have the fields that it has today"
    return f"is encoded as {encoding}: must be {CDR}"


@contextmanager
def opened(path: Path, name: str, warns: bool = True) -> Iterator[Bag]:
    """A bag, within a context. `name` is the option or command to begin each line with.

    The files of a folder are those that its metadata.yaml names, else all there are; an MCAP file
    that is cut is read as far as it goes. Both, and files that metadata.yaml does not name, are
    told on standard error, with `warns`.

    Raises ConfigError, one line that names the file, where one cannot be read.
    """
    warn = _warn if warns else _say_nothing
    with ExitStack() as stack:
        files, are_listed = _files_of(path, name, warn) if path.is_dir() else ([path], True)
        yield Bag(name, [(file, _open(file, name, stack, warn)) for file in files], are_listed)


def is_bag(folder: Path) -> bool:
    """Whether a folder holds files of a bag."""
    return (folder / METADATA).is_file() or bool(_all_files(folder))


def _files_of(folder: Path, name: str, warn: _Warn) -> tuple[list[Path], bool]:
    """The files of a bag, and whether its metadata.yaml lists them in the order of writing."""
    why = f"has no {METADATA}"
    if (folder / METADATA).is_file():
        listed = _listed(folder)
        missing = [file.name for file in listed if not file.is_file()]
        if listed and not missing:
            names = {_plain_name(file) for file in listed}
            others = [one.name for one in _all_files(folder) if _plain_name(one) not in names]
            if others:
                warn(name, f"{folder}: not read: {_some(others)}: {METADATA} does not name it")
            return listed, True
        why = f"{METADATA} is of no use"
        if missing:
            why = f"{METADATA} names {_some(missing)}, missing here"
    files = _all_files(folder)
    if not files:
        raise ConfigError(f"{name}: {folder}: {why}, and there is no .mcap, .db3 or .bag file")
    warn(name, f"{folder}: {why}: read file by file: {_some([file.name for file in files])}")
    return files, False


def _listed(folder: Path) -> list[Path]:
    """The files that metadata.yaml names, none where it cannot be read."""
    try:
        text = read_limited(folder / METADATA, MAX_TEXT_BYTES).decode(errors="replace")
        names = bounded_yaml.load(text)["rosbag2_bagfile_information"]["relative_file_paths"]
        return [folder / Path(one).name for one in names]
    except (OSError, *bounded_yaml.ERRORS):
        return []


def _all_files(folder: Path) -> list[Path]:
    """The files of bags in a folder; of one that is there packed and unpacked, the latter."""
    files = {file for file in folder.iterdir() if file.is_file() and _storage(file)}
    return sorted(
        file for file in files if file.suffix not in _PACKED or file.with_suffix("") not in files
    )


def _plain_name(file: Path) -> str:
    """The name of a file unpacked."""
    return file.stem if file.suffix in _PACKED else file.name


def _some(names: Sequence[str]) -> str:
    rest = len(names) - _MANY
    return ", ".join(names[:_MANY]) + (f" and {rest} more" if rest > 0 else "")


def _storage(file: Path) -> str:
    """The ending that says the file's format; "": none of a bag."""
    inside = file.with_suffix("") if file.suffix in _PACKED else file
    return inside.suffix if inside.suffix in _STORAGES else ""


def _open(file: Path, name: str, stack: ExitStack, warn: _Warn) -> _Storage:
    try:
        inside = _unpacked(file, stack) if file.suffix in _PACKED else file
        with open_regular(inside) as begun:
            begin = begun.read(len(_SQLITE_MAGIC))
        if begin == _SQLITE_MAGIC:
            copy = _copied_with_wal(inside, stack)
            return SqliteBag(copy or inside, has_wal=copy is not None)
        bag: McapBag | Ros1Bag
        if begin.startswith(_MCAP_MAGIC):
            bag = McapBag(inside)
        elif begin.startswith(ros1_bag.MAGIC):
            bag = Ros1Bag(inside)
        else:
            what = "is empty" if not begin else "is neither MCAP nor SQLite nor a bag of ROS 1"
            raise ConfigError(f"{name}: {file}: {what}: must be a bag")
    except ConfigError:
        raise
    except Exception as error:
        # Each storage has errors of its own.
        raise ConfigError(f"{name}: {file}: is not a readable bag: {_line(error)}") from error
    if not bag.is_whole:
        warn(name, f"{file}: is cut: read as far as it goes")
    return bag


def _unpacked(file: Path, stack: ExitStack) -> Path:
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="mazebot-bag-")))
    inside = folder / file.stem
    with open_regular(file) as packed, inside.open("wb") as unpacked:
        most = most_unpacked(packed)
        for piece in zstandard.ZstdDecompressor().read_to_iter(packed):
            if unpacked.tell() + len(piece) > most:
                raise NotReadableError(f"grows to more than {most} bytes")
            unpacked.write(piece)
    return inside


def _copied_with_wal(file: Path, stack: ExitStack) -> Path | None:
    """A copy of a database whose last messages are still in a write-ahead log beside it, with that:
    whoever opens it, writes them into the database. None: there are none.
    """
    log = file.with_name(f"{file.name}-wal")
    if not log.exists() or not log.stat().st_size:
        return None
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="mazebot-bag-")))
    for source in (file, log):
        with open_regular(source) as found, (folder / source.name).open("wb") as written:
            shutil.copyfileobj(found, written)
    return folder / file.name


def _plain(data: bytes) -> bytes:
    """A message; of a bag that packs each, unpacked. CDR does not begin as zstd does."""
    if not data.startswith(_ZSTD_MAGIC):
        return data
    size = zstandard.frame_content_size(data)
    if size > MAX_CHUNK_BYTES:
        raise McapError(f"a message has {size} bytes unpacked, must have at most {MAX_CHUNK_BYTES}")
    if size >= 0:
        return zstandard.ZstdDecompressor().decompress(data)
    pieces, rest = [], MAX_CHUNK_BYTES
    with zstandard.ZstdDecompressor().stream_reader(data) as reader:
        while piece := reader.read(_PIECE_BYTES):
            pieces.append(piece)
            rest -= len(piece)
            if rest < 0:
                raise McapError(f"a message has more than {MAX_CHUNK_BYTES} bytes unpacked")
    return b"".join(pieces)


def _line(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    if isinstance(error, McapError):
        return str(error).rpartition(": ")[2]
    return " ".join(str(error).split())[:200] or type(error).__name__


def _warn(name: str, line: str) -> None:
    sys.stderr.write(f"warning: {name}: {words(line)}\n")


def _say_nothing(name: str, line: str) -> None:
    pass
