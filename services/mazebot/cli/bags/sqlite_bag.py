"""Reads `.db3` files of rosbag2."""

from __future__ import annotations

import heapq
import sqlite3
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from urllib.parse import quote

from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
)

from mazebot.cli.bags.log_clock import Move, Place, Span
from mazebot.common.files.limits import MAX_CHUNK_BYTES

_READ = {"topics", "messages", "message_definitions"}
_FORMATS = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}
_FIRST, _LAST = -(2**63), 2**63 - 1
"""Of SQLite's integers."""


class SqliteBag:
    """The topics of a file, and its messages by their time.

    Raises sqlite3.Error where it is damaged, or no such file.
    """

    def __init__(self, path: Path, has_wal: bool = False) -> None:
        """`has_wal`: beside it is a write-ahead log, which is written into the file."""
        # Nobody else writes, so neither locks nor a journal are needed.
        how = "mode=rw" if has_wal else "immutable=1"
        self._uri = f"file:{quote(str(path.resolve()))}?{how}"
        with closing(self._connected()) as database:
            tables = _tables(database)
            definitions: dict[str, MessageDefinition] = {}
            # Since Iron.
            if "message_definitions" in tables:
                for kind, encoding, text in database.execute(
                    "SELECT topic_type, encoding, encoded_message_definition "
                    "FROM message_definitions"
                ):
                    if encoding in _FORMATS and isinstance(text, str):
                        definitions[kind] = MessageDefinition(_FORMATS[encoding], text)
            none = MessageDefinition(MessageDefinitionFormat.NONE, "")
            self.connections = [
                Connection(
                    number, topic, kind, definitions.get(kind, none), "", 0,
                    ConnectionExtRosbag2(encoding, []), self,
                )
                for number, topic, kind, encoding in database.execute(
                    "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
                )
                if _are(int, number) and _are(str, topic, kind, encoding)
            ]  # fmt: skip
            (*ends_ns,) = database.execute(
                "SELECT MIN(timestamp), MAX(timestamp) FROM messages"
            ).fetchone()
        for end_ns in ends_ns:
            if end_ns is not None and not _are(int, end_ns):
                raise sqlite3.DatabaseError(f"timestamp {end_ns!r:.40} must be an integer")
        self.spans_ns: list[Span] = [] if None in ends_ns else [(ends_ns[0], ends_ns[1])]
        """Of the whole file."""

    @property
    def end_ns(self) -> int:
        """When the last message was logged; 0: there is none."""
        return max((end_ns for _, end_ns in self.spans_ns), default=0)

    def places(self) -> Iterator[Place]:
        """All messages in the order of writing."""
        with closing(self._connected()) as database:
            for row in database.execute("SELECT id, topic_id, timestamp FROM messages ORDER BY id"):
                if _are(int, *row):
                    yield Place(*row)

    def messages(
        self, connections: Collection[Connection], moves: Sequence[Move] = ()
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """The messages of some topics by the time of logging."""
        wanted = {connection.id: connection for connection in connections}
        parts = ((_FIRST, 0), *((move.at, move.by_ns) for move in moves))
        ends = (*(move.at - 1 for move in moves), _LAST)
        with closing(self._connected()) as database:
            yield from heapq.merge(
                *(
                    self._between(database, wanted, begin, end, by_ns)
                    for (begin, by_ns), end in zip(parts, ends, strict=True)
                ),
                key=lambda message: message[1],
            )

    def _between(
        self,
        database: sqlite3.Connection,
        wanted: Mapping[int, Connection],
        begin: int,
        end: int,
        by_ns: int,
    ) -> Iterator[tuple[Connection, int, bytes]]:
        marks = ",".join("?" * len(wanted))
        # By the index of the times, whatever the ids.
        for number, log_ns, data in database.execute(
            f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) "
            "AND +id BETWEEN ? AND ? ORDER BY timestamp, id",
            (*wanted, begin, end),
        ):
            if not (_are(int, log_ns) and _are(bytes, data)):
                raise sqlite3.DatabaseError("a message must have an integer time and bytes")
            yield wanted[number], log_ns + by_ns, data

    def _connected(self) -> sqlite3.Connection:
        database = sqlite3.connect(self._uri, uri=True, check_same_thread=False)
        # No functions in the file's own definitions; limits for what they may yield.
        database.execute("PRAGMA trusted_schema = OFF")
        database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_CHUNK_BYTES)
        return database


def _tables(database: sqlite3.Connection) -> set[str]:
    """The names of the tables. Raises sqlite3.Error where one that is read is computed: a view,
    for example, may have rows without end.
    """
    found = set()
    for kind, name, definition in database.execute("SELECT type, name, sql FROM sqlite_master"):
        if not (_are(str, name, kind) and name.lower() in _READ):
            continue
        columns = database.execute("SELECT hidden FROM pragma_table_xinfo(?)", (name,))
        is_plain = kind == "table" and not str(definition).upper().startswith("CREATE VIRTUAL")
        if not is_plain or any(hidden for (hidden,) in columns):
            raise sqlite3.DatabaseError(f"{name} is computed, must be a table of values")
        found.add(name)
    return found


def _are(kind: type, *values: object) -> bool:
    return all(isinstance(value, kind) for value in values)
