"""Opens the files of a rosbag2 bag, also one that was not closed: without metadata.yaml, or cut."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import zstandard
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.rosbag2.storage_mcap import McapReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from mazebot.common.config import ConfigError
from mazebot.common.recordings.mcap import mcap_records as mcap

_STORAGES = {".mcap": McapReader, ".db3": Sqlite3Reader}
_PACKED = (".zstd", ".zst")
_ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


class Connection(NamedTuple):
    """A topic of a file that is cut."""

    id: int
    topic: str
    msgtype: str


@contextmanager
def opened(path: Path) -> Iterator[Sequence[Any]]:
    """The readers of a bag within a context: each has `connections` and `messages(connections)`.

    A folder without metadata.yaml, or whose metadata.yaml is of no use, is read file by file, and
    an MCAP file that is cut as far as it goes; both are told on standard error.

    Raises ConfigError, and what rosbags raises for files that are damaged otherwise.
    """
    with ExitStack() as stack:
        if not path.is_dir():
            yield [_open(path, stack)]
            return
        why = "has no metadata.yaml"
        if (path / "metadata.yaml").is_file():
            reader: Any = Reader(path)
            try:
                reader.open()
            except ReaderError as error:
                why = f"metadata.yaml is of no use ({' '.join(str(error).split()):.160})"
            else:
                stack.callback(reader.close)
                yield [reader]
                return
        files = sorted(file for file in path.iterdir() if file.is_file() and _storage(file))
        if not files:
            raise ConfigError(f"--log: {path}: {why}, and there is no .mcap or .db3 file")
        names = ", ".join(file.name for file in files)
        _warn(f"{path}: {why}: read file by file: {names}")
        yield [_open(file, stack) for file in files]


def plain(data: bytes) -> bytes:
    """A message; of a bag that packs each, unpacked. CDR does not begin as zstd does."""
    if not data.startswith(_ZSTD_MAGIC):
        return data
    return zstandard.ZstdDecompressor().decompressobj().decompress(data)


def _storage(file: Path) -> str:
    """The ending that says the file's format; "": none of a bag."""
    name = file.with_suffix("") if file.suffix in _PACKED else file
    return name.suffix if name.suffix in _STORAGES else ""


def _open(file: Path, stack: ExitStack) -> Any:
    inside = file
    if file.suffix in _PACKED:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="mazebot-bag-")))
        inside = folder / file.stem
        with file.open("rb") as packed, inside.open("wb") as unpacked:
            zstandard.ZstdDecompressor().copy_stream(packed, unpacked)
    if _storage(file) == ".db3":
        reader: Any = Sqlite3Reader(inside)
    else:
        reader = _CutMcap(file, inside) if _is_cut(inside) else McapReader(inside)
    reader.open()
    stack.callback(reader.close)
    return reader


def _is_cut(file: Path) -> bool:
    """Whether an MCAP file begins as one, and does not end as one."""
    with file.open("rb") as opened_file:
        begin = opened_file.read(len(mcap.MAGIC))
        opened_file.seek(0, 2)
        if begin != mcap.MAGIC or opened_file.tell() < 2 * len(mcap.MAGIC):
            return False
        opened_file.seek(-len(mcap.MAGIC), 2)
        return opened_file.read() != mcap.MAGIC


class _CutMcap:
    """Reads an MCAP file without its end, record by record."""

    def __init__(self, shown: Path, file: Path) -> None:
        self._shown = shown
        self._file = file
        self.connections: list[Connection] = []
        self._messages: list[tuple[int, int, bytes]] = []

    def open(self) -> None:
        """Read all that is whole."""
        schemas: dict[int, str] = {}
        for opcode, content in self._records():
            if opcode == mcap.SCHEMA:
                schema = mcap.read_schema(content)
                schemas[schema.id] = schema.name
            elif opcode == mcap.CHANNEL:
                channel = mcap.read_channel(content)
                if all(channel.id != known.id for known in self.connections):
                    name = schemas.get(channel.schema_id, "")
                    self.connections.append(Connection(channel.id, channel.topic, name))
            elif opcode == mcap.MESSAGE and len(content) >= mcap.MESSAGE_HEAD.size:
                channel_id, _, stamp_ns, _ = mcap.MESSAGE_HEAD.unpack_from(content)
                self._messages.append((channel_id, stamp_ns, content[mcap.MESSAGE_HEAD.size :]))
        _warn(
            f"{self._shown}: is cut: read as far as it goes, {len(self._messages)} messages on "
            f"{len(self.connections)} topics"
        )

    def close(self) -> None:
        """Nothing is open."""

    def messages(
        self, connections: Collection[Connection]
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """The messages of some topics, in the order of the file."""
        wanted = {connection.id: connection for connection in connections}
        for channel_id, stamp_ns, data in self._messages:
            if channel_id in wanted:
                yield wanted[channel_id], stamp_ns, data

    def _records(self) -> Iterator[tuple[int, bytes]]:
        """Opcode and content of each record, those in chunks as well."""
        with self._file.open("rb") as file:
            file.seek(len(mcap.MAGIC))
            while True:
                head = file.read(mcap.RECORD_HEAD.size)
                if len(head) < mcap.RECORD_HEAD.size:
                    return
                opcode, size = mcap.RECORD_HEAD.unpack(head)
                content = file.read(size)
                if opcode == mcap.CHUNK:
                    yield from _inside(content, whole=len(content) == size)
                elif len(content) == size:
                    yield opcode, content
                if len(content) < size:
                    return


def _inside(content: bytes, whole: bool) -> Iterator[tuple[int, bytes]]:
    """The records of a chunk, as far as they go."""
    try:
        records = mcap.records_of(mcap.read_chunk(content)) if whole else mcap.begun_chunk(content)
        for opcode, start, end in mcap.split(records):
            yield opcode, records[start:end]
    except mcap.McapError:
        # The rest of it is lost; what follows a chunk that is whole in length may be sound.
        return


def _warn(line: str) -> None:
    sys.stderr.write(f"warning: --log: {line}\n")
