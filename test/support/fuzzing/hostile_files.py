# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Storage files made to do harm: small ones that stand for much, and ones that lie."""

import os
from pathlib import Path

import lz4.frame
import zstandard
from fuzzing import raw_bags as raw

from fuzzycnc_ros.bags.writer import BagWriter

SMALLEST = raw.message(1, 1, b'')
SEPARATOR = f'{"=" * 80}\n'


def announced(count: int = 1, definition: str = 'string data\n', kind: str = raw.STRING) -> bytes:
    """Return a type and topics of it."""
    topics = [raw.channel(number + 1, f'/topic{number}') for number in range(count)]
    return raw.schema(kind=kind, definition=definition) + b''.join(topics)


def with_definition(path: Path, definition: str) -> Path:
    """Write a bag with a message of a type that is defined somehow."""
    known = announced(definition=definition, kind='a/msg/T')
    return raw.mcap(path, [known, raw.message(1, 1, b'\x00\x01\x00\x00' + bytes(64))])


def compressed_zeros(size: int) -> bytes:
    """Return very many zeros as very few bytes that do not say how many they are."""
    compressor = zstandard.ZstdCompressor(write_content_size=False).compressobj()
    block = bytes(2**20)
    return b''.join(compressor.compress(block) for _ in range(size // 2**20)) + compressor.flush()


# Small files that stand for much


def chunk_of_nothing(path):
    return raw.mcap(path, [announced(), raw.chunk(b'\x01' + bytes(2**26 - 1))])


def chunk_of_the_smallest_messages(path):
    return raw.mcap(path, [announced(), raw.chunk(SMALLEST * 2_000_000)])


def chunks_that_overlap(path):
    return raw.mcap(path, [announced(), raw.chunk(SMALLEST * 300_000) * 12])


def chunk_that_hides_its_size(path):
    return raw.mcap(path, [announced(), compressed('zstd', compressed_zeros(2**29), 100)])


def chunk_of_lz4_that_hides_its_size(path):
    block = bytes(2**20)
    compressor = lz4.frame.LZ4FrameCompressor(block_size=lz4.frame.BLOCKSIZE_MAX4MB)
    data = compressor.begin() + b''.join(compressor.compress(block) for _ in range(2**9))
    return raw.mcap(path, [announced(), compressed('lz4', data + compressor.flush(), 100)])


def chunk_that_needs_a_window_of_a_gigabyte(path):
    large = zstandard.ZstdCompressionParameters.from_level(
        1, window_log=30, write_content_size=False
    )
    compressor = zstandard.ZstdCompressor(compression_params=large).compressobj()
    data = compressor.compress(bytes(2**20)) + compressor.flush()
    return raw.mcap(path, [announced(), compressed('zstd', data, 2**20)])


def compressed(method: str, data: bytes, size: int) -> bytes:
    """Return a chunk that says how many bytes it holds."""
    head = bytes(16) + size.to_bytes(8, 'little') + bytes(4) + raw.text(method)
    return raw.record(raw.CHUNK, head + len(data).to_bytes(8, 'little') + data)


def torn_chunk(path):
    data = compressed_zeros(2**29)
    head = bytes(16) + (2**40).to_bytes(8, 'little') + bytes(4) + raw.text('zstd')
    body = head + (2**50).to_bytes(8, 'little') + data
    return raw.mcap(path, [announced(), raw.record(raw.CHUNK, body)[:-8]], ended=False)


def type_of_types(path):
    definition = 'a/B0 x\na/C0 y\n'
    for level in range(25):
        body = f'a/B{level + 1} x\na/C{level + 1} y\n' if level < 24 else 'uint8 x\n'
        definition += ''.join(f'{SEPARATOR}MSG: a/{k}{level}\n{body}' for k in 'BC')
    return with_definition(path, definition)


def type_in_type(path):
    body = [f'{SEPARATOR}MSG: a/B{k}\na/B{k + 1} x\n' for k in range(1000)]
    return with_definition(path, 'a/B0 x\n' + ''.join(body) + f'{SEPARATOR}MSG: a/B1000\nbool x\n')


def type_through_the_types_of_this_machine(path):
    header = f'{SEPARATOR}MSG: std_msgs/Header\ngeometry_msgs/PoseStamped x\n'
    return with_definition(path, 'geometry_msgs/PoseStamped x\n' + header)


def arrays_of_texts(path):
    return with_definition(path, ''.join(f'string[4096] x{k}\n' for k in range(200)))


def arrays_of_arrays(path):
    body = ''.join(f'{SEPARATOR}MSG: a/B{k}\na/B{k + 1}[4000] x\n' for k in range(9))
    return with_definition(path, f'a/B0[4000] x\n{body}{SEPARATOR}MSG: a/B9\nuint8 x\n')


def array_of_billions(path):
    return with_definition(path, 'float64[4000000000] x\nuint8 y\n')


def text_for_a_type(path):
    return with_definition(path, '# nothing\n' * 5_000_000 + 'uint8 x\n')


def sequence_of_billions(path):
    known = announced(definition='string[] data\n', kind='a/msg/T')
    payload = b'\x00\x01\x00\x00\xff\xff\xff\xff' + bytes(40)
    return raw.mcap(path, [known, raw.message(1, 1, payload)])


def very_many_topics(path):
    return raw.mcap(path, [announced(65_535), raw.message(1, 1)])


def topics_announced_again_and_again(path):
    again = [raw.channel(1, f'/topic{k}') for k in range(100_000)]
    return raw.mcap(path, [announced(), *again, raw.message(1, 1)])


def one_topic_of_many_qos(path):
    some = [raw.channel(k, '/topic', qos=f'- depth: {k}') for k in range(1, 60_000)]
    return raw.mcap(path, [raw.schema(), *some, raw.message(1, 1)])


def laughs(name: str) -> str:
    """Return YAML of a few lines that stands for more values than any memory holds."""
    lines = ['a0: &a0 [lol, lol, lol, lol, lol, lol, lol, lol, lol]']
    lines += [f'a{k}: &a{k} [{", ".join([f"*a{k - 1}"] * 9)}]' for k in range(1, 20)]
    return '\n'.join([*lines, f'{name}: *a19', ''])


def qos_of_references(path):
    qos = '- ' + laughs('depth').replace('\n', '\n  ')
    return raw.mcap(path, [raw.schema(), raw.channel(1, '/topic', qos=qos), raw.message(1, 1)])


def metadata(path: Path, **changes: str) -> Path:
    """Write a bag with other entries in its metadata."""
    path = path.with_suffix('')
    with BagWriter(path, flush_interval=None) as writer:
        writer.add_topic('/topic', raw.STRING)
        writer.write('/topic', 1, 1, raw.HELLO)
    file = path / 'metadata.yaml'
    lines = file.read_text().splitlines()
    for name, value in changes.items():
        at = next(k for k, line in enumerate(lines) if line.strip().startswith(f'{name}:'))
        lines[at] = lines[at].split(':')[0] + f': {value}'
    file.write_text('\n'.join(lines))
    return path


def metadata_of_references(path):
    found = metadata(path, storage_identifier='*a19')
    file = found / 'metadata.yaml'
    file.write_text(laughs('x') + file.read_text())
    return found


def metadata_that_contains_itself(path):
    return metadata(path, storage_identifier='&a [*a]')


def metadata_of_an_infinite_version(path):
    return metadata(path, version='.inf')


def metadata_of_a_million_values(path):
    return metadata(path, storage_identifier=f'[{"1," * 1_000_000}]')


def database_of_very_many_topics(path):
    topics = f"INSERT INTO topics {raw.rows(100_000)} SELECT n, '/' || n, 'a/msg/T', '', '' "
    return raw.db3(path.with_suffix('.db3'), [f'{topics} FROM numbers'])


def database_of_generated_messages(path):
    data = 'CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id, timestamp, data AS {})'
    head = "INSERT INTO topics VALUES(1, '/t', 'std_msgs/msg/String', 'cdr', '')"
    rows = f'INSERT INTO messages {raw.rows(100_000)} SELECT n, 1, n FROM numbers'
    table = data.format('(zeroblob(100000000))')
    return raw.db3(path.with_suffix('.db3'), [table, head, rows])


def database_of_numbers_apart(path):
    head = "INSERT INTO topics VALUES(1, '/t', 'std_msgs/msg/String', 'cdr', '')"
    hello = raw.HELLO.hex()
    ids = (-(2**63), -1, 0, 4999, 2**62, 2**63 - 1)
    rows = [f"INSERT INTO messages VALUES({k}, 1, {k}, x'{hello}')" for k in ids]
    return raw.db3(path.with_suffix('.db3'), [head, *rows])


def database_of_large_messages(path):
    head = "INSERT INTO topics VALUES(1, '/t', 'std_msgs/msg/String', 'cdr', '')"
    rows = f'INSERT INTO messages {raw.rows(60)} SELECT n, 1, n, zeroblob(10000000) FROM numbers'
    return raw.db3(path.with_suffix('.db3'), [head, rows])


# Files that lie


def attachment_beyond_the_file(path):
    return raw.mcap(path, [announced(), raw.attachment('a', size=2**63), raw.message(1, 1)])


def attachments_of_other_places(path):
    names = ('../../etc/passwd', '/etc/passwd', '', 'a/../../b', '\x00', '..', 'A' * 100_000)
    return raw.mcap(path, [announced(), *map(raw.attachment, names), raw.message(1, 1)])


def hollow_attachment(path):
    file = raw.mcap(path, [announced()], ended=False)
    size = 2**34
    with file.open('ab') as stream:
        stream.write(bytes([raw.ATTACHMENT]) + (size).to_bytes(8, 'little'))
    os.truncate(file, file.stat().st_size + size)
    with file.open('ab') as stream:
        stream.write(raw.record(raw.DATA_END, bytes(4)) + raw.record(raw.FOOTER, bytes(20)))
        stream.write(raw.MAGIC)
    return file


def index_over_a_hollow_file(path):
    file = hollow_attachment(path)
    end = file.stat().st_size
    with file.open('r+b') as stream:
        stream.seek(end - len(raw.MAGIC) - 20)
        stream.write((2**34 // 2).to_bytes(8, 'little') + bytes(8) + b'\x01\x02\x03\x04')
    return file


def counts_of_billions(path):
    counts = (1).to_bytes(2, 'little') + b'\xff' * 8
    body = bytes(42) + len(counts).to_bytes(4, 'little') + counts
    return raw.mcap(path, [announced(), raw.message(1, 1), raw.record(raw.STATISTICS, body)])


def times_at_the_end_of_time(path):
    times = (2**64 - 1, 0, 2**63, 5, 2**64 - 1, 1)
    return raw.mcap(path, [announced(), *(raw.message(1, time) for time in times)])


def one_topic_of_two_types(path):
    other = raw.schema(2, 'std_msgs/msg/Int32', 'int32 data\n')
    topics = raw.channel(1, '/mill/temperatures') + raw.channel(2, '/mill/temperatures', 2)
    return raw.mcap(path, [raw.schema(), other, topics, raw.message(1, 1), raw.message(2, 2)])


def types_of_other_places(path):
    kinds = ('../../etc/passwd', 'a/msg/../../x', '', 'a' * 100_000, 'os/msg/system', 'a/b')
    known = [raw.schema(k + 1, kind) for k, kind in enumerate(kinds)]
    topics = [raw.channel(k + 1, f'/t{k}', k + 1) for k in range(len(kinds))]
    return raw.mcap(path, [*known, *topics, *(raw.message(k + 1, 1) for k in range(len(kinds)))])


CASES = (
    chunk_of_nothing,
    chunk_of_the_smallest_messages,
    chunks_that_overlap,
    chunk_that_hides_its_size,
    chunk_of_lz4_that_hides_its_size,
    chunk_that_needs_a_window_of_a_gigabyte,
    torn_chunk,
    type_of_types,
    type_in_type,
    type_through_the_types_of_this_machine,
    arrays_of_texts,
    arrays_of_arrays,
    array_of_billions,
    text_for_a_type,
    sequence_of_billions,
    very_many_topics,
    topics_announced_again_and_again,
    one_topic_of_many_qos,
    qos_of_references,
    metadata_of_references,
    metadata_that_contains_itself,
    metadata_of_an_infinite_version,
    metadata_of_a_million_values,
    database_of_very_many_topics,
    database_of_generated_messages,
    database_of_numbers_apart,
    database_of_large_messages,
    attachment_beyond_the_file,
    attachments_of_other_places,
    hollow_attachment,
    index_over_a_hollow_file,
    counts_of_billions,
    times_at_the_end_of_time,
    one_topic_of_two_types,
    types_of_other_places,
)
"""Each writes a bag to a path that ends in `.mcap`, or beside it."""
