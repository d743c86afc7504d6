# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reading the sqlite3 storage of rosbag2; the database is opened read-only."""

import sqlite3
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

from fuzzycnc_ros.bags.errors import BagFormatError
from fuzzycnc_ros.bags.storage import (
    TOPICS_MAX,
    Channel,
    Contents,
    MessageBlock,
    RawMessage,
    check_regular,
)

MESSAGE_MAX = 64 * 1024 * 1024
"""Largest message, and any other entry [bytes]."""

_ROWS = 5000  # rows that are read in one go
_SIZE = 16 * 1024 * 1024  # bytes that are, unless one message is larger


class SqliteFile:
    """A `.db3` file of rosbag2.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    BagFormatError
        If it cannot be read or is no bag.
    """

    def __init__(self, path: Path) -> None:
        check_regular(path)
        self.path = path
        self.problems: list[str] = []
        self._channels: dict[int, Channel] = {}
        self._database = sqlite3.connect(
            f'file:{quote(str(path.absolute()))}?mode=ro', uri=True, isolation_level=None
        )
        self._database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MESSAGE_MAX)

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def contents(self) -> Contents:
        """Return channels, blocks and counts.

        Raises
        ------
        BagFormatError
            If the tables of rosbag2 are missing or damaged.
        """
        tables = self._tables()
        definitions = self._definitions() if 'message_definitions' in tables else {}
        columns = {row[1] for row in self._query('PRAGMA table_info(topics)')}
        ((topics,),) = self._query('SELECT count(*) FROM topics')
        if topics > TOPICS_MAX:
            raise BagFormatError(
                f'{self.path}: expected at most {TOPICS_MAX} topics but found {topics}'
            )
        optional = ('offered_qos_profiles', 'type_description_hash')
        wanted = ', '.join(name if name in columns else "''" for name in optional)
        for identifier, topic, kind, encoding, qos, type_hash in self._query(
            f'SELECT id, name, type, serialization_format, {wanted} FROM topics ORDER BY id'
        ):
            definition, definition_encoding = definitions.get(kind, ('', ''))
            self._channels[identifier] = Channel(
                topic=str(topic),
                type=str(kind),
                definition=definition,
                encoding=definition_encoding,
                qos=str(qos),
                type_hash=str(type_hash),
                message_encoding=str(encoding),
            )
        blocks = self._blocks()
        promised = {channel.topic: 0 for channel in self._channels.values()}
        for identifier, count in self._query(
            'SELECT topic_id, count(*) FROM messages GROUP BY topic_id'
        ):
            promised[self._channel(identifier).topic] += count
        return Contents(list(self._channels.values()), blocks, promised)

    def _blocks(self) -> list[MessageBlock]:
        """Return the messages in blocks, of as many rows as are read in one go."""
        blocks: list[MessageBlock] = []
        found: list[list[int]] = []
        total = 0
        # Sizes are looked up row by row: a GROUP BY would drag all messages through memory.
        for row in self._rows('SELECT id, timestamp, length(data) FROM messages ORDER BY id'):
            numbers = [value for value in row if isinstance(value, int)]
            if len(numbers) != len(row):
                raise BagFormatError(f'{self.path}: expected whole numbers but found {row}')
            if found and (len(found) == _ROWS or total + numbers[2] > _SIZE):
                blocks.append(self._block(found, total))
                found, total = [], 0
            found.append(numbers)
            total += numbers[2]
        return [*blocks, self._block(found, total)] if found else blocks

    def _block(self, rows: list[list[int]], size: int) -> MessageBlock:
        """Return a block of rows: number, time and size of each."""
        times = [time for _, time, _ in rows]
        read = partial(self._read, rows[0][0], rows[-1][0])
        return MessageBlock(min(times), max(times), size, read)

    def _tables(self) -> set[str]:
        """Return the names of the tables; a view could keep a query busy for ever."""
        tables = {
            str(name)
            for name, text in self._query("SELECT name, sql FROM sqlite_master WHERE type='table'")
            if str(text).upper().startswith('CREATE TABLE')
        }
        missing = {'topics', 'messages'} - tables
        if missing:
            raise BagFormatError(
                f'{self.path}: expected a sqlite3 bag of rosbag2 but found no table '
                f'{", ".join(sorted(missing))}'
            )
        for table in ('topics', 'messages', 'message_definitions'):
            # A column that is worked out takes what a file of a kilobyte likes.
            if any(row[6] for row in self._query(f'PRAGMA table_xinfo({table})')):
                raise BagFormatError(f'{self.path}: expected no generated columns in {table}')
        return tables

    def _definitions(self) -> dict[str, tuple[str, str]]:
        """Return definition and encoding of each type."""
        return {
            str(kind): (str(text), str(encoding))
            for kind, encoding, text in self._query(
                'SELECT topic_type, encoding, encoded_message_definition FROM message_definitions'
            )
        }

    def _read(self, first: int, last: int) -> list[RawMessage]:
        rows = self._query(
            'SELECT topic_id, timestamp, data FROM messages WHERE id BETWEEN ? AND ? ORDER BY id',
            first,
            last,
        )
        messages = []
        for topic, time, data in rows:
            if not (isinstance(time, int) and isinstance(data, bytes)):
                raise BagFormatError(f'{self.path}: expected time and bytes in every message')
            messages.append(RawMessage(time, time, 0, self._channel(topic), data))
        return messages

    def _channel(self, identifier: int) -> Channel:
        if identifier not in self._channels:
            raise BagFormatError(
                f'{self.path}: messages belong to topic number {identifier}, which is not listed'
            )
        return self._channels[identifier]

    def _query(self, text: str, *values: object) -> list[Any]:
        return list(self._rows(text, *values))

    def _rows(self, text: str, *values: object) -> Iterator[Any]:
        try:
            yield from self._database.execute(text, values)
        except (sqlite3.Error, OverflowError, UnicodeDecodeError) as error:
            raise BagFormatError(
                f'{self.path}: expected a sqlite3 bag of rosbag2 but found: {error}; '
                'try the recovery command of sqlite3'
            ) from error
