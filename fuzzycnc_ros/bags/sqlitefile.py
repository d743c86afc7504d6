# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reading the sqlite3 storage of rosbag2; the database is opened read-only."""

import sqlite3
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

from fuzzycnc_ros.bags.errors import BagFormatError
from fuzzycnc_ros.bags.storage import Block, Channel, Contents, RawMessage, check_regular

_ROWS = 5000  # rows that are read in one go


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
        definitions = self._definitions()
        columns = {row[1] for row in self._query('PRAGMA table_info(topics)')}
        optional = [name for name in ('offered_qos_profiles', 'type_description_hash')]
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
        blocks = [
            Block(int(start), int(stop), int(size), partial(self._read, number))
            for number, start, stop, size in self._query(
                f'SELECT id / {_ROWS}, min(timestamp), max(timestamp), sum(length(data)) '
                f'FROM messages GROUP BY id / {_ROWS} ORDER BY 1'
            )
        ]
        promised = {channel.topic: 0 for channel in self._channels.values()}
        for identifier, count in self._query(
            'SELECT topic_id, count(*) FROM messages GROUP BY topic_id'
        ):
            promised[self._channel(identifier).topic] += count
        return Contents(list(self._channels.values()), blocks, promised)

    def _definitions(self) -> dict[str, tuple[str, str]]:
        """Return definition and encoding of each type; bags before Jazzy's format have none."""
        tables = {row[0] for row in self._query('SELECT name FROM sqlite_master')}
        if 'message_definitions' not in tables:
            return {}
        return {
            str(kind): (str(text), str(encoding))
            for kind, encoding, text in self._query(
                'SELECT topic_type, encoding, encoded_message_definition FROM message_definitions'
            )
        }

    def _read(self, number: int) -> list[RawMessage]:
        rows = self._query(
            f'SELECT topic_id, timestamp, data FROM messages WHERE id / {_ROWS} = ? ORDER BY id',
            number,
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
        try:
            return self._database.execute(text, values).fetchall()
        except (sqlite3.Error, OverflowError) as error:
            raise BagFormatError(
                f'{self.path}: expected a sqlite3 bag of rosbag2 but found: {error}; '
                'try the recovery command of sqlite3'
            ) from error
