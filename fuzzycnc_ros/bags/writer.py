# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Writing a rosbag2 directory of MCAP files, such that a killed writer loses little."""

import errno
import os
import pickle
import re
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from fuzzycnc_ros.bags import metadata as rosbag2
from fuzzycnc_ros.bags.errors import (
    BagError,
    BagExistsError,
    BagTopicError,
    BagWriteError,
    MissingLibraryError,
)
from fuzzycnc_ros.bags.libraries import load
from fuzzycnc_ros.bags.mcapfile import REPEATED
from fuzzycnc_ros.bags.metadata import (
    METADATA_RECORD,
    PART,
    Metadata,
    Part,
    Profiles,
    Qos,
    TopicInfo,
)
from fuzzycnc_ros.bags.typestore import (
    message_definition,
    serialize,
    type_hash,
)
from fuzzycnc_ros.files.os_errors import os_sentence
from fuzzycnc_ros.files.uninterrupted import uninterrupted
from fuzzycnc_ros.runtime.provenance import MESSAGE_SET

CHUNK_SIZE = 16384
"""Uncompressed size at which a chunk is closed [bytes]; what is in an open chunk dies with us."""

FLUSH_INTERVAL = 0.5
"""Longest time a message waits in an open chunk [s]; half of the second that may be lost."""

LATCHED_MAX = 256
"""Most publishers of a topic whose latched messages are repeated in each part."""

_TOPIC = re.compile(r'[!-~]{1,512}')
_TIME_MAX = 2**63 - 1
_INDEX = '_Writer__chunk_indices'  # the mcap library's own name of its index


@dataclass(frozen=True)
class _Announced:
    """Announcement of a topic, as another part of the bag repeats it."""

    info: TopicInfo
    definition: str
    encoding: str
    latched: bool


class _Latched(NamedTuple):
    publish_time: int
    sequence: int
    payload: bytes


@dataclass(frozen=True)
class ClosedPart:
    """A part of the bag that is whole and will not change.

    Parameters
    ----------
    path : Path
        Its file.
    number : int
        Its place in the recording, from 0.
    size : int
        Its size [bytes].
    counts : Counter
        Its messages by topic, those that it repeats included.
    own : int
        Its messages without those.
    start, stop : int
        Log time of its first and last message [ns].
    """

    path: Path
    number: int
    size: int
    counts: Counter[str]
    own: int
    start: int
    stop: int


class _OpenPart:
    """The part that is being written."""

    def __init__(self, module: Any, path: Path, number: int, chunk_size: int, method: str) -> None:
        self.number = number
        self.sink = Sink(path)
        self.mcap = module.Writer(
            self.sink, chunk_size=chunk_size, compression=module.CompressionType[method.upper()]
        )
        self.index: _SpilledIndex | None = None
        self.channels: dict[tuple[str, bool], int] = {}
        self.schemas: dict[str, int] = {}
        self.counts: Counter[str] = Counter()
        self.own = 0
        self.begun = 0  # size before its own messages
        self.start = self.stop = 0

    @property
    def path(self) -> Path:
        """Its file."""
        return self.sink.path

    def channel(self, announced: _Announced, *, repeated: bool = False) -> int:
        """Return the channel of a topic, announced where it is new."""
        info = announced.info
        found = self.channels.get((info.name, repeated))
        if found is not None:
            return found
        schema = self.schemas.get(info.type)
        if schema is None:
            schema = self.mcap.register_schema(
                name=info.type, encoding=announced.encoding, data=announced.definition.encode()
            )
            self.schemas[info.type] = schema
        channel = self.mcap.register_channel(
            topic=info.name,
            message_encoding='cdr',
            schema_id=schema,
            metadata={
                'offered_qos_profiles': rosbag2.qos_text(info.profiles),
                'topic_type_hash': info.type_hash,
                **({REPEATED: 'true'} if repeated else {}),
            },
        )
        self.channels[info.name, repeated] = int(channel)
        return int(channel)

    def add(self, topic: str, channel: int, log_time: int, latched: _Latched) -> None:
        """Append a message."""
        self.mcap.add_message(
            channel_id=channel,
            log_time=log_time,
            data=latched.payload,
            publish_time=latched.publish_time,
            sequence=latched.sequence & 0xFFFFFFFF,
        )
        filled = bool(self.counts)
        self.start = min(self.start, log_time) if filled else log_time
        self.stop = max(self.stop, log_time) if filled else log_time
        self.counts[topic] += 1

    def closed(self) -> ClosedPart:
        """Return what is known of it once it is closed."""
        return ClosedPart(
            self.sink.path,
            self.number,
            self.sink.tell(),
            self.counts,
            self.own,
            self.start,
            self.stop,
        )


class BagWriter:
    """A new bag: `<path>/<name>_0.mcap` and so on, `<path>/metadata.yaml`, as of `ros2 bag`.

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
    split_size : int
        Bytes after which a part is full; 0 for never.
    split_duration : float
        Log time after which a part is full [s]; 0 for never.

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

    Who writes asks `is_full` and calls `split`.  A new part begins with the newest latched message
    of each publisher and the attachments that are to be repeated, so that it can be read alone.
    Such messages have channels of their own, by which readers of the whole bag pass them over, and
    the log time at which the part begins, so that the parts do not overlap.
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
        split_size: int = 0,
        split_duration: float = 0.0,
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
        self._chunk_size = chunk_size
        self._compression = compression
        self._flush_interval = flush_interval
        self._custom = dict(custom or {})
        self._message_set = message_set
        self._split_size = split_size
        self._split_duration = round(split_duration * 1e9)
        self._splits = bool(split_size or split_duration)
        self._topics: dict[str, _Announced] = {}
        self._latched: dict[str, dict[Hashable, _Latched]] = {}
        self._attached: dict[str, tuple[str, bytes, int]] = {}
        self._closed: list[ClosedPart] = []
        self._closed_size = 0
        self._count = 0
        self._waiting_since: float | None = None
        self._failure = ''
        try:
            with uninterrupted():
                _make_folder(self.path)
                self._begin(0)
        except KeyboardInterrupt:
            self.close()  # nobody else could: an empty bag is whole
            raise

    def _begin(self, number: int) -> None:
        """Begin a part."""
        file = self.path / f'{self.path.absolute().name}_{number}.mcap'
        self._part = _OpenPart(self._module, file, number, self._chunk_size, self._compression)
        facts = {'message_set': str(self._message_set), **self._custom}
        with self._guard():
            self._part.index = _spill_index(self._part.mcap, self.path)
            self._part.mcap.start(profile='ros2', library='fuzzycnc_ros')
            self._part.mcap.add_metadata(
                METADATA_RECORD, {**facts, **({PART: str(number)} if number else {})}
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
        """The MCAP file that is being written."""
        return self._part.sink.path

    @property
    def topics(self) -> dict[str, TopicInfo]:
        """All topics with the messages written so far."""
        return {name: announced.info for name, announced in self._topics.items()}

    @property
    def message_count(self) -> int:
        """Number of messages written so far."""
        return self._count

    @property
    def closed_parts(self) -> tuple[ClosedPart, ...]:
        """The parts that are whole and still there, oldest first."""
        return tuple(self._closed)

    @property
    def size(self) -> int:
        """Size of all parts that are there [bytes]."""
        return self._closed_size + (0 if self._part.sink.closed else self._part.sink.tell())

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
            known = self._topics[name].info.type
            if known != type_name:
                raise BagTopicError(f'{name}: expected type {known} but found {type_name}')
            return
        if not _TOPIC.fullmatch(name):
            raise BagTopicError(f'expected a topic name but found {name!r}')
        if definition is None:
            definition, hash_text = message_definition(type_name), type_hash(type_name)
        profiles = [(qos or rosbag2.STREAM).profile()] if not isinstance(qos, list) else qos
        info = TopicInfo(name, type_name, profiles, hash_text or '')
        latched = rosbag2.is_latched(profiles)
        announced = _Announced(info, definition, encoding, latched)
        with self._guard():
            self._part.channel(announced)
        self._topics[name] = announced

    def write(
        self,
        topic: str,
        log_time: int,
        publish_time: int,
        payload: bytes,
        sequence: int = 0,
        publisher: Hashable = None,
        *,
        repeated: bool = False,
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
        publisher : hashable, optional
            Who sent it: of a latched topic the newest message of each is repeated in each part.
        repeated : bool
            Whether it stands in a part before this bag, too.

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
        announced = self._topics.get(topic)
        if announced is None:
            raise not_announced(topic, self._topics)
        if not (0 <= log_time <= _TIME_MAX and 0 <= publish_time <= _TIME_MAX):
            raise BagError(
                f'{topic}: expected times within 0 and 2^63 - 1 ns '
                f'but found {log_time} and {publish_time}'
            )
        part = self._part
        message = _Latched(publish_time, sequence, payload)
        with self._guard():
            channel = part.channel(announced, repeated=repeated)
            part.add(topic, channel, log_time, message)
        if self._splits and announced.latched:
            kept = self._latched.setdefault(topic, {})
            kept.pop(publisher, None)  # the order is that of the messages
            kept[publisher] = message
            if len(kept) > LATCHED_MAX:
                del kept[next(iter(kept))]
        announced.info.message_count += 1
        part.own += 1
        self._count += 1
        if self._flush_interval is not None:
            if self._waiting_since is None:
                self._waiting_since = self._clock()
            self.flush_if_due()

    def write_message(self, topic: str, message: Any, log_time: int) -> None:
        """Append one message made by `typestore.message_type`, as if sent when received."""
        self.write(topic, log_time, log_time, serialize(message))

    def is_full(self, log_time: int) -> bool:
        """Return whether a message of some log time [ns] belongs into another part."""
        part = self._part
        if not part.own:
            return False
        if self._split_size and part.sink.tell() - part.begun >= self._split_size:
            return True
        return bool(self._split_duration) and log_time - part.start >= self._split_duration

    def split(self, log_time: int) -> None:
        """Close the part and begin the next one at some log time [ns].

        Raises
        ------
        BagWriteError
            If the bag was closed or cannot be written.
        """
        self._check_open()
        self._close_part()
        with self._guard():
            self._begin(self._part.number + 1)
        part = self._part
        with self._guard():
            for announced in self._topics.values():
                part.channel(announced)
            for topic, kept in self._latched.items():
                channel = part.channel(self._topics[topic], repeated=True)
                for message in kept.values():
                    part.add(topic, channel, log_time, message)
            part.mcap.flush()
            for name, (media_type, data, attached) in self._attached.items():
                part.mcap.add_attachment(attached, attached, name, media_type, data)
        self._waiting_since = None
        part.begun = part.sink.tell()

    def delete_oldest(self) -> ClosedPart | None:
        """Delete the oldest part that is closed and return it; None if there is none.

        Raises
        ------
        BagWriteError
            If the bag cannot be written.
        OSError
            If the file cannot be deleted; it is no part of the bag any more, which goes on.
        """
        self._check_open()
        if not self._closed:
            return None
        oldest = self._closed.pop(0)
        self._closed_size -= oldest.size
        facts = self._custom
        messages = int(facts.get(rosbag2.DELETED_MESSAGES_KEY, '0')) + oldest.own
        facts[rosbag2.DELETED_PARTS_KEY] = str(oldest.number + 1)
        facts[rosbag2.DELETED_MESSAGES_KEY] = str(messages)
        facts[rosbag2.DELETED_UNTIL_KEY] = str(oldest.stop)
        with self._guard():
            self._metadata(rosbag2.STATE_RECORDING).write(self.path)
        oldest.path.unlink(missing_ok=True)  # last: metadata.yaml never names what is not there
        return oldest

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
            self._part.mcap.flush()
        self._waiting_since = None

    def attach(
        self,
        name: str,
        content: str | bytes,
        media_type: str = 'text/plain',
        log_time: int = 0,
        *,
        repeat: bool = False,
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
        repeat : bool
            Whether the parts that follow have it too.
        """
        self._check_open()
        data = content.encode() if isinstance(content, str) else content
        with self._guard():
            self._part.mcap.add_attachment(log_time, log_time, name, media_type, data)
        if repeat and self._splits:
            self._attached[name] = (media_type, data, log_time)

    def close(self) -> None:
        """Finish the file and its `metadata.yaml`; closing twice does nothing.

        Raises
        ------
        BagWriteError
            If the end of the file cannot be written.
        """
        if self._part.sink.closed:
            return
        try:
            with uninterrupted():
                self._close()
        finally:
            if self._part.index is not None:
                self._part.index.close()

    def _close(self) -> None:
        if self._failure:  # already reported when it happened
            self._part.sink.close()
            return
        self._close_part()
        with self._guard():
            self._metadata(rosbag2.STATE_CLOSED).write(self.path)

    def _close_part(self) -> None:
        part = self._part
        with self._guard():
            final = self._metadata(rosbag2.STATE_CLOSED, [part])
            # `ros2 bag reindex` restores metadata.yaml from this record.
            part.mcap.add_metadata('rosbag2', {'serialized_metadata': final.inner_text()})
            part.mcap.finish()
            part.sink.close()
        if part.index is not None:
            part.index.close()
        self._closed.append(part.closed())
        self._closed_size += self._closed[-1].size

    def _metadata(
        self, state: str, parts: Sequence[_OpenPart | ClosedPart] | None = None
    ) -> Metadata:
        """Return what `metadata.yaml` says, of all parts or of some."""
        if parts is None:
            parts = [*self._closed, *(() if self._part.sink.closed else (self._part,))]
        filled = [part for part in parts if part.counts]
        counts: Counter[str] = Counter()
        for part in filled:
            counts.update(part.counts)
        return Metadata(
            storage='mcap',
            parts=[
                Part(part.path.name, part.start, part.stop, part.counts.total()) for part in parts
            ],
            start=min((part.start for part in filled), default=0),
            stop=max((part.stop for part in filled), default=0),
            topics=[
                replace(announced.info, message_count=counts[name])
                for name, announced in self._topics.items()
            ],
            custom={
                rosbag2.MESSAGE_SET_KEY: str(self._message_set),
                rosbag2.STATE_KEY: state,
                **self._custom,
            },
        )

    def _check_open(self) -> None:
        if self._failure:
            raise BagWriteError(self._failure)
        if self._part.sink.closed:
            raise BagWriteError(f'{self.path}: expected an open bag but it was closed')

    @contextmanager
    def _guard(self) -> Iterator[None]:
        """Turn an error of the file system into a failed bag and one clear error."""
        try:
            yield
        except OSError as error:
            raise self.fail(error) from error

    def fail(self, error: Exception) -> BagWriteError:
        """Write no more, whatever has happened; return the error that says so."""
        self._part.sink.keep_whole_records()
        if isinstance(error, MemoryError):
            error = OSError(errno.ENOMEM, '')
        if isinstance(error, OSError):
            reason = os_sentence(error, self.file)
        else:
            reason = f'{self.file}: expected to write on but found {error!r}'
        self._failure = (
            f'{reason}; what was recorded before stays readable after '
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
        """True if the file was closed."""
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
        if self._file.closed:
            return
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
        with suppress(OSError):  # a disk that is full takes no rest, which nobody reads any more
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
