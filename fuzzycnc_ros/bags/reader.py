# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Reading bags of rosbag2 without ever losing a message in silence."""

import os
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from fuzzycnc_ros.bags.decoder import UPGRADERS, Decoder, Upgraders
from fuzzycnc_ros.bags.errors import (
    BagCountError,
    BagFormatError,
    BagTopicError,
    BagTruncatedError,
    BagVersionError,
)
from fuzzycnc_ros.bags.mcapfile import McapFile
from fuzzycnc_ros.bags.metadata import (
    MESSAGE_SET_KEY,
    METADATA_RECORD,
    PART,
    STATE_KEY,
    STATE_RECORDING,
    Metadata,
    Profiles,
    TopicInfo,
    bag_files,
    parse_qos,
    read_metadata,
    storage_files,
)
from fuzzycnc_ros.bags.sqlitefile import SqliteFile
from fuzzycnc_ros.bags.storage import Attachment, Contents, MessageBlock, RawMessage
from fuzzycnc_ros.runtime.provenance import MESSAGE_SET

_QOS_MAX = 1000
"""Most different QoS texts that are read; a topic that has another counts as of unknown QoS."""

_INSTEAD = {
    '': 'where rosbag2 compressed whole files or single messages, convert the bag with '
    '`ros2 bag convert` first',
    '.csv': 'make a bag of the table with `fuzzycnc import-csv`',
    '.json': 'a model file is no bag: give it as the model',
}
"""Remedies by the ending of a file that is no bag."""

_OPEN_MAX = 64
"""Most storage files that are open at once; a bag of a year has more than a process may open."""

_LISTED = 30
"""Topics that a message lists."""

_OVERLAP_MAX = 128 * 1024 * 1024
"""Most bytes of chunks overlapping in time that are sorted together; more is no recording."""

_MESSAGES_MAX = 1_000_000
"""Most messages that are."""


class BagMessage(NamedTuple):
    """One message of a bag."""

    topic: str
    type: str
    log_time: int
    message: Any


class BagReader:
    """A bag: a directory of rosbag2, or a single `.mcap` or `.db3` file.

    Parameters
    ----------
    path : path
        The bag.
    strict : bool
        Whether a bag that contradicts itself is refused; otherwise what is wrong is collected
        in `problems` and all that can be read is read.
    upgraders : mapping
        Bring messages of older message sets to the current one.

    Attributes
    ----------
    connections : dict of str to TopicInfo
        The topics by name.
    message_count : int
        Messages that the bag promises.
    start, stop : int
        Log time of the first and last message [ns]; both 0 if there is none.
    metadata : Metadata or None
        Content of `metadata.yaml`.
    records : dict
        Named records inside the file, text to text.
    message_set : int
        Message-set version, the current one if the bag does not say.
    missing_parts : int
        Parts of the recording before the first one that is there: deleted, or not looked at.
    problems : list of str
        What is wrong with the bag, one line each.

    Raises
    ------
    BagFormatError
        If it is no bag, is damaged, or lies about its files.
    BagTruncatedError
        If a file was cut off.
    BagCountError
        If `metadata.yaml` and the files promise different numbers of messages.
    BagVersionError
        If it was recorded with a newer message set.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        *,
        strict: bool = True,
        upgraders: Upgraders = UPGRADERS,
    ) -> None:
        self.path = Path(path)
        self.problems: list[str] = []
        self._strict = strict
        self._files: list[McapFile | SqliteFile] = []
        self._used: dict[int, None] = {}  # parts that were read, the last one at the end
        try:
            self._open(upgraders)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> 'BagReader':
        """Return the reader."""
        return self

    def __exit__(self, *error: object) -> None:
        """Close the bag."""
        self.close()

    def close(self) -> None:
        """Close the files of the bag."""
        for file in self._files:
            file.close()

    @property
    def files(self) -> tuple[Path, ...]:
        """The storage files in the order in which they are read."""
        return tuple(file.path for file in self._files)

    def filled(self) -> str:
        """Return the topics that hold messages as text, each with how many."""
        found = ((topic, c.message_count) for topic, c in self.connections.items())
        there = (f'{topic} ({count})' for topic, count in found if count)
        return _listed(there, 'no messages at all')

    def require(self, topics: Iterable[str] | Mapping[str, str]) -> None:
        """Refuse a bag without certain topics.

        Parameters
        ----------
        topics : iterable of str or mapping
            Topics, or topics with their types.

        Raises
        ------
        BagTopicError
            If one is missing, has no message or another type; the message lists what is there.
        """
        types = topics if isinstance(topics, Mapping) else dict.fromkeys(topics)
        found = {topic: c for topic, c in self.connections.items() if c.message_count}
        missing = [topic for topic in types if topic not in found]
        if missing:
            raise BagTopicError(
                f'{self.path}: expected messages on {", ".join(missing)} but the bag has '
                f'{self.filled()}'
            )
        for topic, wanted in types.items():
            if wanted is not None and found[topic].type != wanted:
                raise BagTopicError(
                    f'{self.path}: expected {topic} to be {wanted} but found {found[topic].type}'
                )

    def attachments(self) -> dict[str, Attachment]:
        """Return the attachments by name; of several with one name, the last.

        Raises
        ------
        BagFormatError
            If one is damaged.
        """
        found = {}
        for part, contents in enumerate(self._contents):
            self._use(part)
            for read in contents.attachments:
                attachment = read()
                found[attachment.name] = attachment
        return found

    def messages(
        self,
        topics: Collection[str] | None = None,
        start: int | None = None,
        stop: int | None = None,
        *,
        raw: bool = False,
    ) -> Iterator[BagMessage]:
        """Yield the messages in the order of their log time, ties in file order.

        Parameters
        ----------
        topics : collection of str, optional
            Only these topics.
        start, stop : int, optional
            Only messages with `start` <= log time < `stop` [ns].
        raw : bool
            Whether to yield undecoded bytes.

        Raises
        ------
        BagTopicError
            If one of `topics` is not in the bag.
        BagCountError
            At the end, if fewer or more messages came than the bag promises.
        BagDataError, BagTypeError, BagVersionError
            If a message cannot be decoded.
        BagFormatError
            If a chunk is damaged.
        """
        wanted = self._wanted(topics)
        decodes = {} if raw else {t: self.decoder.decode(self.connections[t].type) for t in wanted}
        for found in self._chosen(wanted, start, stop):
            topic, payload = found.channel.topic, found.payload
            message = payload if raw else decodes[topic](payload)
            yield BagMessage(topic, found.channel.type, found.log_time, message)

    def raw_messages(self, topics: Collection[str] | None = None) -> Iterator[RawMessage]:
        """Yield undecoded messages with all that the bag says of each, as `messages` does."""
        yield from self._chosen(self._wanted(topics), None, None)

    def _wanted(self, topics: Collection[str] | None) -> set[str]:
        wanted = set(self.connections if topics is None else topics)
        unknown = wanted - set(self.connections)
        if unknown:
            raise BagTopicError(
                f'{self.path}: expected the topics {", ".join(sorted(unknown))} but the bag has '
                f'{_listed(self.connections, "none")}'
            )
        return wanted

    def _chosen(
        self, wanted: set[str], start: int | None, stop: int | None
    ) -> Iterator[RawMessage]:
        """Yield the messages of some topics and a span; count them where the span is all."""
        whole = start is None and stop is None
        yielded: Counter[str] = Counter()
        for found in self._in_log_order(start, stop):
            if found.channel.topic not in wanted:
                continue
            if not whole and not (
                (start is None or found.log_time >= start)
                and (stop is None or found.log_time < stop)
            ):
                continue
            yielded[found.channel.topic] += 1
            yield found
        if whole:
            self._check_yielded(wanted, yielded)

    # Opening

    def _open(self, upgraders: Upgraders) -> None:
        if not self.path.exists():
            raise BagFormatError(f'{self.path}: expected a bag but nothing is there')
        self.metadata = read_metadata(self.path) if self.path.is_dir() else None
        self._contents = [self._open_file(file) for file in self._storage_files()]
        self._counted = all(contents.promised is not None for contents in self._contents)
        topics = self.metadata.topics if self.metadata else []
        self._stated = Counter({topic.name: topic.message_count for topic in topics})
        first = self._contents[0].metadata.get(METADATA_RECORD, {}) if self._contents else {}
        part = first.get(PART, '0')
        self.missing_parts = int(part) if part.isdecimal() else 0
        self.records = {k: v for c in self._contents for k, v in c.metadata.items()}
        stated = self._stated_set()
        self.message_set = MESSAGE_SET if stated is None else stated
        if self.message_set > MESSAGE_SET:
            raise BagVersionError(
                f'{self.path}: expected message set {MESSAGE_SET} or older but found '
                f'{self.message_set}; install the fuzzycnc that recorded it, or a newer one'
            )
        channels = (channel for contents in self._contents for channel in contents.channels)
        self.decoder = Decoder(channels, stated, upgraders)
        self.connections = self._connect()
        self.message_count = sum(c.message_count for c in self.connections.values())
        blocks = [block for contents in self._contents for block in contents.blocks]
        self.start = min((block.start for block in blocks), default=0)
        self.stop = max((block.stop for block in blocks), default=0)
        if self.metadata:
            self._check_metadata(self.metadata)
        for file in self._files:
            for problem in file.problems:
                self._report(BagFormatError(f'{problem}; run `fuzzycnc info --repair`'))

    def _storage_files(self) -> list[Path]:
        if not self.path.is_dir():
            return [self.path]
        if self.metadata:
            files = bag_files(self.path, self.metadata)
            unlisted = {path.name for path in storage_files(self.path)} - {f.name for f in files}
            if unlisted:
                self._report(
                    BagCountError(
                        f'{self.path}: expected all storage files in metadata.yaml but found '
                        f'{", ".join(sorted(unlisted))} beside them; remove what does not '
                        'belong there, or run `fuzzycnc info --repair`'
                    )
                )
            return files
        files = storage_files(self.path)
        if not files:
            raise BagFormatError(
                f'{self.path}: expected a bag but found neither metadata.yaml nor storage files'
            )
        self.problems.append(f'{self.path}: metadata.yaml is missing')
        return files

    def _open_file(self, path: Path) -> Contents:
        if path.suffix not in ('.mcap', '.db3'):
            remedy = _INSTEAD.get(path.suffix, _INSTEAD[''])
            raise BagFormatError(f'{path}: expected a .mcap or .db3 file; {remedy}')
        file = SqliteFile(path) if path.suffix == '.db3' else McapFile(path)
        self._files.append(file)
        if isinstance(file, McapFile) and file.tear:
            recording = self.metadata and self.metadata.custom.get(STATE_KEY) == STATE_RECORDING
            cause = (
                'its recorder was killed, or still writes'
                if recording
                else 'it was cut off or damaged'
            )
            raise BagTruncatedError(
                f'{path}: truncated at byte {file.tear.offset} of {file.size} '
                f'({file.tear.reason}): {cause}; run `fuzzycnc info --repair` to keep what can '
                'be read and to see what was lost'
            )
        contents = file.contents()
        if len(self._files) > _OPEN_MAX and isinstance(file, McapFile):
            file.rest()
        return contents

    def _connect(self) -> dict[str, TopicInfo]:
        """Return the topics by name, from the channels of all files."""
        found: dict[str, TopicInfo] = {}
        promised: Counter[str] = Counter()
        for place, contents in enumerate(self._contents):
            promised.update(contents.promised or {})
            if place:
                promised.subtract(contents.repeated)
        known_qos: dict[str, Profiles] = {}
        offered: dict[str, dict[str, None]] = {}  # the texts of each topic, each once
        for channel in (c for contents in self._contents for c in contents.channels):
            name, kind = channel.topic, channel.type
            known = found.get(name)
            if known and known.type != kind:
                raise BagFormatError(
                    f'{self.path}: expected one type on {name} but found {known.type} and {kind}'
                )
            if channel.qos not in known_qos and len(known_qos) < _QOS_MAX:
                known_qos[channel.qos] = parse_qos(channel.qos)
            offered.setdefault(name, {})[channel.qos] = None
            found[name] = TopicInfo(
                name, kind, [], channel.type_hash, promised[name], channel.definition
            )
        for topic, texts in offered.items():
            profiles = found[topic].profiles
            for text in texts:
                profiles += [p for p in known_qos.get(text, []) if p not in profiles]
        return found

    def _stated_set(self) -> int | None:
        stated = [
            record['message_set'] for record in self.records.values() if 'message_set' in record
        ]
        if self.metadata and MESSAGE_SET_KEY in self.metadata.custom:
            stated.append(self.metadata.custom[MESSAGE_SET_KEY])
        try:
            return max((int(text) for text in stated), default=None)
        except ValueError as error:
            raise BagFormatError(
                f'{self.path}: expected a message-set version but found {stated}'
            ) from error

    def _check_metadata(self, metadata: Metadata) -> None:
        """Compare `metadata.yaml` with the files: neither may promise what the other lacks."""
        if metadata.custom.get(STATE_KEY) == STATE_RECORDING:
            self.problems.append(f'{self.path}: the recorder did not finish metadata.yaml')
            return
        self.problems += self._contradictions(metadata)
        if not self._counted:
            return  # what is read decides
        there: Counter[str] = Counter()
        for contents in self._contents:
            there.update(contents.promised or {})
        for topic in self._stated.keys() | self.connections.keys():
            found = there[topic]
            if self._stated[topic] != found:
                self._report(
                    BagCountError(
                        f'{self.path}: expected {self._stated[topic]} messages on {topic} as '
                        f'metadata.yaml says but the storage files hold {found}; run '
                        '`fuzzycnc info --repair`, or `ros2 bag reindex`'
                    )
                )

    def _contradictions(self, metadata: Metadata) -> list[str]:
        """Return where storage, types, totals and times of `metadata.yaml` are not the files' own.

        Nothing is lost by them, so that they are told and refused by nobody.
        """
        there = [sum((contents.promised or {}).values()) for contents in self._contents]
        kinds = {'mcap' if isinstance(file, McapFile) else 'sqlite3' for file in self._files}
        compared = [(f'{metadata.storage} as storage', kind) for kind in sorted(kinds)]
        if metadata.compression and 'message' not in metadata.compression.split():
            # Files that rosbag2 had compressed would not have been opened.
            compared.append((f'{metadata.compression} as compression of files', 'none'))
        compared += [
            (f'{topic.type} on {topic.name}', self.connections[topic.name].type)
            for topic in metadata.topics
            if topic.name in self.connections
        ]
        if self._counted and metadata.stated is not None:
            compared.append((f'{metadata.stated} messages in all', f'{sum(there)}'))
        if self.stop and metadata.stated:
            compared += _times('all', (metadata.start, metadata.stop), (self.start, self.stop))
        # Versions before 5 say nothing of each file.
        said = metadata.parts if any(part.message_count for part in metadata.parts) else []
        for part, contents, count in zip(said, self._contents, there, strict=False):
            if contents.promised is not None:
                compared.append((f'{part.message_count} messages in {part.path}', f'{count}'))
            if contents.blocks and part.message_count:
                span = (
                    min(block.start for block in contents.blocks),
                    max(block.stop for block in contents.blocks),
                )
                compared += _times(part.path, (part.start, part.stop), span)
        return [
            f'{self.path}: metadata.yaml says {stated} but the storage files hold {found}; '
            '`ros2 bag reindex` writes it anew'
            for stated, found in compared
            if stated.split()[0] != found
        ]

    def _report(self, error: Exception) -> None:
        if self._strict:
            raise error
        self.problems.append(str(error))

    # Reading

    def _in_log_order(self, start: int | None, stop: int | None) -> Iterator[RawMessage]:
        """Yield the messages of all blocks that touch a span, in the order of their log time.

        No more of them is in memory than overlaps in time.
        """
        every = (
            (part, block)
            for part, contents in enumerate(self._contents)
            for block in contents.blocks
        )
        blocks = [
            (place, part, block)
            for place, (part, block) in enumerate(every)
            if (start is None or block.stop >= start) and (stop is None or block.start < stop)
        ]
        group: list[tuple[int, int, MessageBlock]] = []
        group_stop = 0
        for entry in sorted(blocks, key=lambda entry: entry[2].start):
            block = entry[2]
            if group and block.start > group_stop:
                yield from self._merged(group)
                group = []
            group_stop = max(group_stop, block.stop) if group else block.stop
            group.append(entry)
        yield from self._merged(group)

    def _merged(self, group: list[tuple[int, int, MessageBlock]]) -> list[RawMessage]:
        """Return the messages of blocks that overlap in time, sorted together."""
        expected = (
            f'{self.path}: expected chunks one after the other in time but {len(group)} of them, '
            'more than'
        )
        if len(group) > 1 and sum(block.size for _, _, block in group) > _OVERLAP_MAX:
            raise BagFormatError(f'{expected} {_OVERLAP_MAX} bytes, overlap')
        messages: list[RawMessage] = []
        for _, part, block in sorted(
            group, key=lambda entry: entry[0]
        ):  # as they lie in the files
            self._use(part)
            try:
                found = block.read()
            except BagFormatError as error:
                self._report(error)
                continue
            # What a part repeats was read in the part before.
            messages += [m for m in found if not m.channel.repeated] if part else found
            if len(messages) > _MESSAGES_MAX:
                raise BagFormatError(f'{expected} {_MESSAGES_MAX} messages, overlap')
        messages.sort(key=lambda message: message.log_time)  # stable: ties stay in file order
        return messages

    def _use(self, part: int) -> None:
        """Let the file that was read longest ago rest, if many are open."""
        if len(self._files) <= _OPEN_MAX:
            return
        self._used.pop(part, None)
        self._used[part] = None
        if len(self._used) > _OPEN_MAX // 2:
            oldest = self._files[next(iter(self._used))]
            del self._used[next(iter(self._used))]
            if isinstance(oldest, McapFile):
                oldest.rest()

    def _check_yielded(self, wanted: set[str], yielded: Counter[str]) -> None:
        if not self._counted and self.metadata is None:
            return
        for topic in sorted(wanted):
            promised = (
                self.connections[topic].message_count if self._counted else self._stated[topic]
            )
            if yielded[topic] != promised:
                self._report(
                    BagCountError(
                        f'{self.path}: expected {promised} messages on {topic} as the bag '
                        f'promises but read {yielded[topic]}; run `fuzzycnc info --repair`'
                    )
                )


def _times(what: str, stated: tuple[int, int], found: tuple[int, int]) -> list[tuple[str, str]]:
    """Return beginning and duration as stated and as found, both from start to stop [ns]."""
    (start, stop), (begin, end) = stated, found
    return [
        (f'{_seconds(start)} s as the beginning of {what}', _seconds(begin)),
        (f'{_seconds(stop - start)} s as the duration of {what}', _seconds(end - begin)),
    ]


def _seconds(time: int) -> str:
    return f'{time // 10**9}.{time % 10**9:09d}'


def _listed(topics: Iterable[str], none: str) -> str:
    """Return topics as text, `none` if there are none; of very many, the first ones."""
    names = list(topics)
    more = f' and {len(names) - _LISTED} more' if len(names) > _LISTED else ''
    return ', '.join(names[:_LISTED]) + more or none
