# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Writing a rosbag2 directory with one MCAP file, such that a killed writer loses little."""

import os
import pickle
import re
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from fuzzycnc_ros.bags import metadata as rosbag2
from fuzzycnc_ros.bags.errors import (
    BagError,
    BagExistsError,
    BagTopicError,
    BagWriteError,
    MissingLibraryError,
)
from fuzzycnc_ros.bags.libraries import load
from fuzzycnc_ros.bags.metadata import Metadata, Profiles, Qos, TopicInfo
from fuzzycnc_ros.bags.os_errors import os_sentence
from fuzzycnc_ros.bags.typestore import (
    message_definition,
    serialize,
    type_hash,
)
from fuzzycnc_ros.bags.uninterrupted import uninterrupted
from fuzzycnc_ros.runtime.provenance import MESSAGE_SET

CHUNK_SIZE = 16384
"""Uncompressed size at which a chunk is closed [bytes]; what is in an open chunk dies with us."""

FLUSH_INTERVAL = 0.5
"""Longest time a message waits in an open chunk [s]; half of the second that may be lost."""

METADATA_RECORD = 'fuzzycnc'
"""Name of the MCAP metadata record that holds the message-set version."""

_TOPIC = re.compile(r'[!-~]{1,512}')
_TIME_MAX = 2**63 - 1
_INDEX = '_Writer__chunk_indices'  # the mcap library's own name of its index


class BagWriter:
    """A new bag: `<path>/<name>_0.mcap` and `<path>/metadata.yaml`, as `ros2 bag` reads them.

    Parameters
    ----------
    path : path
        Directory of the bag; it must not exist.
    chunk_size : int
        Uncompressed size at which a chunk is closed [bytes].
    flush_interval : float or None
        Longest time a message waits in an open chunk [s]; None closes chunks by size alone, so
        that equal messages give equal bytes.
    compression : {'zstd', 'none'}
        Compression of each chunk.
    custom : mapping, optional
        Further facts for `metadata.yaml`, text to text.
    message_set : int
        Version of the messages that will be written; only a copy of an old bag has another.
    clock : callable
        Monotonic time [s].

    Raises
    ------
    BagExistsError
        If `path` exists.
    MissingLibraryError
        If mcap or zstandard is not installed, or mcap is older than 1.5.
    BagWriteError
        If the directory cannot be made or written.

    Notes
    -----
    The mcap library buffers what it writes, and closes a chunk by its size alone; so it writes
    into a file without buffer here, and open chunks are closed by time as well.
    Messages are written in the order of the calls.  The object is not made for several threads.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        chunk_size: int = CHUNK_SIZE,
        flush_interval: float | None = FLUSH_INTERVAL,
        compression: str = 'zstd',
        custom: Mapping[str, str] | None = None,
        message_set: int = MESSAGE_SET,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if compression not in ('zstd', 'none'):
            raise ValueError(f'compression: expected zstd or none but found {compression!r}')
        self.path = Path(path)
        self._module = load('mcap.writer')
        if not hasattr(self._module.Writer, 'flush'):
            raise MissingLibraryError(
                'expected mcap 1.5 or newer, which can close a chunk by time, but found an older '
                "one; update it with: pip install 'fuzzycnc_ros[bags]'"
            )
        if compression == 'zstd':
            load('zstandard')
        load('yaml')
        self._clock = clock
        self._flush_interval = flush_interval
        self._custom = dict(custom or {})
        self._message_set = message_set
        self._topics: dict[str, tuple[int, TopicInfo]] = {}
        self._schemas: dict[str, int] = {}
        self._count = 0
        self._start = 0
        self._stop = 0
        self._waiting_since: float | None = None
        self._failure = ''
        try:
            with uninterrupted():
                self._begin(chunk_size, compression)
        except KeyboardInterrupt:
            self.close()  # nobody else could: an empty bag is whole
            raise

    def _begin(self, chunk_size: int, compression: str) -> None:
        """Make the folder and its files."""
        self._sink = Sink(_make_folder(self.path) / f'{self.path.absolute().name}_0.mcap')
        self._writer = self._module.Writer(
            self._sink,
            chunk_size=chunk_size,
            compression=self._module.CompressionType[compression.upper()],
        )
        with self._guard():
            self._index = _spill_index(self._writer, self.path)
            self._writer.start(profile='ros2', library='fuzzycnc_ros')
            self._writer.add_metadata(
                METADATA_RECORD, {'message_set': str(self._message_set), **self._custom}
            )
            self._metadata(rosbag2.STATE_RECORDING).write(self.path)

    def __enter__(self) -> 'BagWriter':
        """Return the writer."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the bag; what was written before an error stays readable."""
        self.close()

    @property
    def file(self) -> Path:
        """The MCAP file."""
        return self._sink.path

    @property
    def topics(self) -> dict[str, TopicInfo]:
        """All topics with the messages written so far."""
        return {name: info for name, (_, info) in self._topics.items()}

    @property
    def message_count(self) -> int:
        """Number of messages written so far."""
        return self._count

    def add_topic(
        self,
        name: str,
        type_name: str,
        qos: Qos | Profiles | None = None,
        *,
        definition: str | None = None,
        encoding: str = 'ros2msg',
        hash_text: str | None = None,
    ) -> None:
        """Announce a topic; announcing it again with the same type does nothing.

        Parameters
        ----------
        name : str
            Topic name.
        type_name : str
            Message type, `package/msg/Name`.
        qos : Qos or list of dict, optional
            What its publisher offers; a stream if absent.  A list is passed on as it is.
        definition, encoding, hash_text : str, optional
            Definition text, its MCAP encoding and the type's hash, for types that this machine
            does not know; looked up if absent.

        Raises
        ------
        BagTopicError
            If the topic exists with another type or its name is empty or malformed.
        BagTypeError
            If the type is unknown and no `definition` is given.
        BagWriteError
            If the bag was closed or cannot be written.
        """
        self._check_open()
        if name in self._topics:
            known = self._topics[name][1].type
            if known != type_name:
                raise BagTopicError(f'{name}: expected type {known} but found {type_name}')
            return
        if not _TOPIC.fullmatch(name):
            raise BagTopicError(f'expected a topic name but found {name!r}')
        if definition is None:
            definition, hash_text = message_definition(type_name), type_hash(type_name)
        profiles = [(qos or rosbag2.STREAM).profile()] if not isinstance(qos, list) else qos
        info = TopicInfo(name, type_name, profiles, hash_text or '')
        with self._guard():
            schema = self._schemas.get(type_name)
            if schema is None:
                schema = self._writer.register_schema(
                    name=type_name, encoding=encoding, data=definition.encode()
                )
                self._schemas[type_name] = schema
            channel = self._writer.register_channel(
                topic=name,
                message_encoding='cdr',
                schema_id=schema,
                metadata={
                    'offered_qos_profiles': rosbag2.qos_text(profiles),
                    'topic_type_hash': info.type_hash,
                },
            )
        self._topics[name] = (channel, info)

    def write(
        self, topic: str, log_time: int, publish_time: int, payload: bytes, sequence: int = 0
    ) -> None:
        """Append one undecoded message.

        Parameters
        ----------
        topic : str
            An announced topic.
        log_time, publish_time : int
            When it was received and sent [ns].
        payload : bytes
            The message in CDR.
        sequence : int
            Its publication sequence number, 0 if unknown.

        Raises
        ------
        BagTopicError
            If the topic was not announced.
        BagError
            If a time lies outside [0, 2^63) ns.
        BagWriteError
            If the bag was closed or cannot be written.
        """
        self._check_open()
        entry = self._topics.get(topic)
        if entry is None:
            raise not_announced(topic, self._topics)
        if not (0 <= log_time <= _TIME_MAX and 0 <= publish_time <= _TIME_MAX):
            raise BagError(
                f'{topic}: expected times within 0 and 2^63 - 1 ns '
                f'but found {log_time} and {publish_time}'
            )
        channel, info = entry
        with self._guard():
            self._writer.add_message(
                channel_id=channel,
                log_time=log_time,
                data=payload,
                publish_time=publish_time,
                sequence=sequence & 0xFFFFFFFF,
            )
        self._start = min(self._start, log_time) if self._count else log_time
        self._stop = max(self._stop, log_time)
        info.message_count += 1
        self._count += 1
        if self._flush_interval is not None:
            if self._waiting_since is None:
                self._waiting_since = self._clock()
            self.flush_if_due()

    def write_message(self, topic: str, message: Any, log_time: int) -> None:
        """Append one message made by `typestore.message_type`, as if sent when received."""
        self.write(topic, log_time, log_time, serialize(message))

    def flush_if_due(self) -> None:
        """Close the open chunk if a message has waited in it for `flush_interval`."""
        if self._waiting_since is None or self._flush_interval is None or self._failure:
            return
        if self._clock() - self._waiting_since >= self._flush_interval:
            self.flush()

    def flush(self) -> None:
        """Close the open chunk, so that all messages so far survive a kill of this process."""
        self._check_open()
        with self._guard():
            self._writer.flush()
        self._waiting_since = None

    def attach(
        self, name: str, content: str | bytes, media_type: str = 'text/plain', log_time: int = 0
    ) -> None:
        """Add an attachment, for example a model file.

        Parameters
        ----------
        name : str
            Name inside the bag.
        content : str or bytes
            Its content; text is stored in UTF-8.
        media_type : str
            Media type.
        log_time : int
            When it was attached [ns], 0 if that does not matter.
        """
        self._check_open()
        data = content.encode() if isinstance(content, str) else content
        with self._guard():
            self._writer.add_attachment(log_time, log_time, name, media_type, data)

    def close(self) -> None:
        """Finish the file and its `metadata.yaml`; closing twice does nothing.

        Raises
        ------
        BagWriteError
            If the end of the file cannot be written.
        """
        if self._sink.closed:
            return
        try:
            with uninterrupted():
                self._close()
        finally:
            if self._index is not None:
                self._index.close()

    def _close(self) -> None:
        if self._failure:  # already reported when it happened
            self._sink.close()
            return
        with self._guard():
            final = self._metadata(rosbag2.STATE_CLOSED)
            # `ros2 bag reindex` restores metadata.yaml from this record.
            self._writer.add_metadata('rosbag2', {'serialized_metadata': final.inner_text()})
            self._writer.finish()
            self._sink.close()
            final.write(self.path)

    def _metadata(self, state: str) -> Metadata:
        return Metadata(
            storage='mcap',
            files=[self.file.name],
            start=self._start,
            stop=self._stop,
            topics=[info for _, info in self._topics.values()],
            custom={
                rosbag2.MESSAGE_SET_KEY: str(self._message_set),
                rosbag2.STATE_KEY: state,
                **self._custom,
            },
        )

    def _check_open(self) -> None:
        if self._failure:
            raise BagWriteError(self._failure)
        if self._sink.closed:
            raise BagWriteError(f'{self.path}: expected an open bag but it was closed')

    @contextmanager
    def _guard(self) -> Iterator[None]:
        """Turn an error of the file system into a failed bag and one clear error."""
        try:
            yield
        except OSError as error:
            raise self._fail(error) from error

    def _fail(self, error: OSError) -> BagWriteError:
        self._sink.keep_whole_records()
        self._failure = (
            f'{os_sentence(error, self.file)}; what was recorded before stays readable after '
            '`fuzzycnc info --repair`; then start a new bag'
        )
        return BagWriteError(self._failure)


def not_announced(topic: str, known: Iterable[str]) -> BagTopicError:
    """Return the refusal of a message on a topic that is none of those known."""
    return BagTopicError(
        f'{topic}: expected an announced topic, one of {", ".join(known) or "none"}; call '
        'add_topic first'
    )


def _make_folder(path: Path) -> Path:
    try:
        path.mkdir(parents=True)
    except FileExistsError as error:
        raise BagExistsError(
            f'{path}: expected a new directory but it exists; choose another name or remove it'
        ) from error
    except OSError as error:
        raise BagWriteError(os_sentence(error, path)) from error
    return path


class Sink:
    """A file without buffer that knows how far it holds whole MCAP records.

    Parameters
    ----------
    path : Path
        The file; it must not exist.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = open(path, 'xb', buffering=0)
        self._whole = 0

    @property
    def closed(self) -> bool:
        """Whether the file was closed."""
        return self._file.closed

    def tell(self) -> int:
        """Return the number of bytes written."""
        return self._whole

    def write(self, data: bytes) -> int:
        """Write whole records.

        Raises
        ------
        OSError
            If the disk is full or fails; the last record may then be in the file in part.
        """
        # mcap hands over whole records in every call, so each call ends on a record's boundary.
        rest = memoryview(data)
        while len(rest):
            rest = rest[self._file.write(rest) :]
        self._whole += len(data)
        return len(data)

    def flush(self) -> None:
        """Do nothing: there is no buffer."""

    def keep_whole_records(self) -> None:
        """Cut off a record that was written in part."""
        with suppress(OSError):  # the cut is a courtesy: repair reads past a torn record as well
            self._file.truncate(self._whole)

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class _SpilledIndex:
    """Entries of the chunk index of an MCAP file, in the order in which they were added.

    Parameters
    ----------
    folder : Path
        Where a nameless file may grow; it is gone with the process, however that ends.
    """

    def __init__(self, folder: Path) -> None:
        self._file = tempfile.TemporaryFile(dir=folder)

    def append(self, entry: Any) -> None:
        """Add an entry.

        Raises
        ------
        OSError
            If the disk refuses it.
        """
        pickle.dump(entry, self._file)

    def __iter__(self) -> Iterator[Any]:
        """Yield the entries."""
        self._file.seek(0)
        with suppress(EOFError):
            while True:
                yield pickle.load(self._file)

    def close(self) -> None:
        """Give the space back."""
        self._file.close()


def _spill_index(writer: Any, folder: Path) -> _SpilledIndex | None:
    """Let a writer of the mcap library keep its chunk index on the disk; return that.

    The library keeps an entry of about 1 kB for every chunk until the file is closed. Chunks that
    are closed twice a second, so that a kill loses little, come to 170,000 a day. There is no
    public way to put the list elsewhere; where the library has changed it stays in memory.
    """
    if getattr(writer, _INDEX, None) != []:
        return None
    index = _SpilledIndex(folder)
    setattr(writer, _INDEX, index)
    return index
