# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Storage files written byte by byte, so that they can say what no library would write."""

import sqlite3
import struct
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path

import zstandard

MAGIC = b'\x89MCAP0\r\n'
SCHEMA, CHANNEL, MESSAGE, CHUNK, ATTACHMENT, STATISTICS, DATA_END, FOOTER = (
    3,
    4,
    5,
    6,
    9,
    11,
    15,
    2,
)
STRING = 'std_msgs/msg/String'
HELLO = b'\x00\x01\x00\x00\x03\x00\x00\x00hi\x00'
"""A message of that type."""


def text(value: str | bytes) -> bytes:
    """Return a text with its length in front."""
    data = value.encode() if isinstance(value, str) else value
    return struct.pack('<I', len(data)) + data


def record(opcode: int, body: bytes) -> bytes:
    """Return a record of MCAP."""
    return struct.pack('<BQ', opcode, len(body)) + body


def schema(number: int = 1, kind: str = STRING, definition: str = 'string data\n') -> bytes:
    """Return the definition of a type."""
    body = struct.pack('<H', number) + text(kind) + text('ros2msg') + text(definition)
    return record(SCHEMA, body)


def channel(number: int, topic: str, kind: int = 1, qos: str = '') -> bytes:
    """Return a topic of a type."""
    facts = text('offered_qos_profiles') + text(qos) if qos else b''
    body = struct.pack('<HH', number, kind) + text(topic) + text('cdr') + text(facts)
    return record(CHANNEL, body)


def message(number: int, time: int, payload: bytes = HELLO) -> bytes:
    """Return a message on a topic."""
    return record(MESSAGE, struct.pack('<HIQQ', number, 0, time, time) + payload)


def chunk(data: bytes, start: int = 0, stop: int = 2**63, *, size: int | None = None) -> bytes:
    """Return a compressed chunk that states any times and size."""
    stored = zstandard.compress(data)
    head = struct.pack('<QQQI', start, stop, len(data) if size is None else size, 0)
    return record(CHUNK, head + text('zstd') + struct.pack('<Q', len(stored)) + stored)


def attachment(name: str, data: bytes = b'{}', *, size: int | None = None) -> bytes:
    """Return a file inside a bag that states any size."""
    length = len(data) if size is None else size
    body = bytes(16) + text(name) + text('application/json') + struct.pack('<Q', length) + data
    return record(ATTACHMENT, body + bytes(4))


def mcap(path: Path, records: Iterable[bytes], *, ended: bool = True) -> Path:
    """Write an MCAP file of records, with its end unless it is to be torn."""
    end = record(DATA_END, bytes(4)) + record(FOOTER, bytes(20)) + MAGIC if ended else b''
    path.write_bytes(MAGIC + b''.join(records) + end)
    return path


def db3(path: Path, statements: Iterable[str]) -> Path:
    """Write a sqlite3 file by SQL; tables of rosbag2 are there unless it makes them itself."""
    tables = {
        'topics': 'id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT, '
        'offered_qos_profiles TEXT',
        'messages': 'id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB',
    }
    with closing(sqlite3.connect(path)) as database, database:
        statements = list(statements)
        for name, columns in tables.items():
            if not any(f'CREATE TABLE {name}' in item for item in statements):
                database.execute(f'CREATE TABLE {name}({columns})')
        for statement in statements:
            database.execute(statement)
    return path


def rows(count: int) -> str:
    """Return the head of a statement that counts n from 1 to `count`."""
    return (
        'WITH RECURSIVE numbers(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM numbers '
        f'WHERE n < {count}) '
    )
