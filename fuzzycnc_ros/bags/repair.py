# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Rewriting a torn or damaged bag into a valid one, and saying what was lost."""

import os
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from fuzzycnc_ros.bags.errors import BagFormatError, BagTopicError
from fuzzycnc_ros.bags.mcapfile import McapFile
from fuzzycnc_ros.bags.metadata import (
    METADATA_RECORD,
    PART,
    STATE_KEY,
    STATE_RECORDING,
    Metadata,
    bag_files,
    parse_qos,
    read_metadata,
    storage_files,
)
from fuzzycnc_ros.bags.storage import Channel, RawMessage
from fuzzycnc_ros.bags.writer import BagWriter
from fuzzycnc_ros.runtime.provenance import MESSAGE_SET


@dataclass(frozen=True)
class RepairedTopic:
    """Messages of one topic that were kept.

    Parameters
    ----------
    kept : int
        Messages in the new bag.
    lost : int or None
        Messages that are known to be lost; None if the bag does not say how many there were.
    last : int or None
        Log time of the last message kept [ns]; None if there is none.
    """

    kept: int
    lost: int | None
    last: int | None


@dataclass(frozen=True)
class RepairReport:
    """Result of a repair: what was kept, and what was lost.

    Parameters
    ----------
    source, path : Path
        The damaged bag and the new one.
    topics : dict of str to RepairedTopic
        Every topic.
    stop : int
        Log time of the last message kept on any topic [ns]; 0 if there is none.
    damage : tuple of str
        What was found wrong, one line each.
    """

    source: Path
    path: Path
    topics: dict[str, RepairedTopic]
    stop: int
    damage: tuple[str, ...]

    def __str__(self) -> str:
        """Return the report as lines of text."""
        return '\n'.join(self.lines)

    @property
    def lines(self) -> list[str]:
        """The report, a line for each topic."""
        lines = [f'{self.source} -> {self.path}', *(f'  damage: {d}' for d in self.damage)]
        for name, topic in self.topics.items():
            lost = 'whatever came later' if topic.lost is None else str(topic.lost)
            until = (
                ''
                if topic.last is None
                else f', up to {topic.last / 1e9:.3f} s ({(self.stop - topic.last) / 1e9:.3f} s '
                'before the last of all)'
            )
            lines.append(f'  {name}: {topic.kept} messages kept{until}; lost: {lost}')
        return lines


def repair(
    path: str | os.PathLike[str], out: str | os.PathLike[str] | None = None
) -> RepairReport:
    """Write what can be read of a bag into a new one.

    Parameters
    ----------
    path : path
        Bag directory or `.mcap` file; it is not changed.
    out : path, optional
        Directory of the new bag, which must not exist; `<name>_repaired` beside it if absent.

    Returns
    -------
    RepairReport
        What was kept, what was lost.

    Raises
    ------
    BagFormatError
        If nothing of the bag can be read, or it is a sqlite3 bag.
    BagExistsError
        If `out` exists.
    BagWriteError
        If the new bag cannot be written.

    Notes
    -----
    Whole chunks are kept if their checksum is right; of the chunk that a tear runs through, the
    whole messages that can be decompressed.  A chunk with a wrong checksum is left out, since
    nothing tells which of its messages are sound.
    """
    source = Path(path)
    target = Path(out) if out is not None else source.parent / f'{source.stem}_repaired'
    damage: list[str] = []
    metadata = _metadata(source, damage)
    files = _open(_files(source, metadata), damage)
    try:
        copy = _Copy(target, _facts(files), source, damage)
        with copy.writer:
            for place, file in enumerate(files):
                copy.take(file, first=place == 0)
        return copy.report(metadata)
    finally:
        for file in files:
            file.close()


class _Copy:
    """The new bag, and what did not make it there."""

    def __init__(
        self, target: Path, facts: dict[str, str], source: Path, damage: list[str]
    ) -> None:
        version = facts.pop('message_set', '')
        self._source = source
        self._target = target
        self._damage = damage
        self._lost: Counter[str] = Counter()
        self._last: dict[str, int] = {}
        self._known: dict[Channel, bool] = {}
        self._torn = False
        self._repeats = True
        self._promised: Counter[str] | None = Counter()
        self.writer = BagWriter(
            target,
            flush_interval=None,
            custom={**facts, 'repaired_from': source.name},
            message_set=int(version) if version.isdecimal() else MESSAGE_SET,
        )

    def take(self, file: McapFile, *, first: bool) -> None:
        """Copy all that can be read of a file; what it repeats only where it is the first."""
        self._repeats = first
        for chunk in file.chunks:
            try:
                self._write(file.read(chunk))
            except BagFormatError as error:
                self._damage.append(str(error).split('; run')[0])
                with suppress(BagFormatError):  # lost with its channels: the number is unknown
                    self._lost.update(file.topic_counts(chunk.counts))
        if file.tear:
            self._torn = True
            rest = file.size - file.tear.offset
            self._damage.append(
                f'{file.path.name} was cut off at byte {file.tear.offset}: {file.tear.reason}'
                + (f'; of {rest} bytes after it only whole messages are kept' if rest else '')
            )
            self._write(file.salvage())
        for channel in file.channels:
            self._announce(channel)
        for read in file.attachments:
            try:
                found = read()
            except BagFormatError as error:
                self._damage.append(str(error))
            else:
                self.writer.attach(found.name, found.data, found.media_type, found.log_time)
        self._damage.extend(file.problems)
        stated = None if file.statistics is None else file.topic_counts(file.statistics)
        if stated is not None and not first:
            stated.subtract(file.repeated_counts(file.statistics or {}))
        if stated is None or self._promised is None:
            self._promised = None
        else:
            self._promised.update(stated)

    def report(self, metadata: Metadata | None) -> RepairReport:
        """Return what was kept and lost."""
        promised = self._promised
        # Of a recording that goes on metadata.yaml promises nothing.
        closed = metadata and metadata.custom.get(STATE_KEY) != STATE_RECORDING
        if promised is None and metadata is not None and closed and metadata.message_count:
            promised = Counter({t.name: t.message_count for t in metadata.topics})
        topics = {
            name: RepairedTopic(
                kept=info.message_count,
                lost=self._lost_of(name, info.message_count, promised),
                last=self._last.get(name),
            )
            for name, info in self.writer.topics.items()
        }
        stop = max(self._last.values(), default=0)
        return RepairReport(self._source, self._target, topics, stop, tuple(self._damage))

    def _lost_of(self, name: str, kept: int, promised: Counter[str] | None) -> int | None:
        if promised is not None:
            return max(promised[name] - kept, 0)
        return None if self._torn else self._lost[name]

    def _announce(self, channel: Channel) -> bool:
        """Announce a channel and return whether its messages can be kept."""
        if channel not in self._known:
            self._known[channel] = True
            try:
                self.writer.add_topic(
                    channel.topic,
                    channel.type,
                    parse_qos(channel.qos),
                    definition=channel.definition,
                    encoding=channel.encoding,
                    hash_text=channel.type_hash,
                )
            except BagTopicError as error:
                self._damage.append(str(error))
                self._known[channel] = False
        return self._known[channel]

    def _write(self, messages: list[RawMessage]) -> None:
        for log_time, publish_time, sequence, channel, payload in messages:
            if self._announce(channel) and (self._repeats or not channel.repeated):
                self.writer.write(
                    *(channel.topic, log_time, publish_time, payload, sequence),
                    repeated=channel.repeated,
                )
                self._last[channel.topic] = max(self._last.get(channel.topic, 0), log_time)


def _metadata(source: Path, damage: list[str]) -> Metadata | None:
    if not source.is_dir():
        return None
    try:
        return read_metadata(source)
    except BagFormatError as error:
        damage.append(str(error).split('; run')[0])
        return None


def _files(source: Path, metadata: Metadata | None) -> list[Path]:
    if not source.exists():
        raise BagFormatError(f'{source}: expected a bag but nothing is there')
    if not source.is_dir():
        return [source]
    listed: list[Path] = []
    if metadata is not None:
        with suppress(BagFormatError):  # a list that is wrong gives way to what lies there
            listed = bag_files(source, metadata)
    there = storage_files(source)
    files = listed + [path for path in there if path not in listed]
    if not files:
        raise BagFormatError(f'{source}: expected a bag but found no storage files')
    return files


def _open(paths: list[Path], damage: list[str]) -> list[McapFile]:
    files: list[McapFile] = []
    problems = []
    for path in paths:
        if path.suffix == '.db3':
            raise BagFormatError(
                f'{path}: expected a .mcap file; a sqlite3 file is recovered with the command '
                '`sqlite3 FILE .recover`'
            )
        try:
            files.append(McapFile(path))
        except BagFormatError as error:
            problems.append(str(error))
    if not files:
        raise BagFormatError(f'nothing can be repaired: {"; ".join(problems)}')
    damage.extend(problems)
    return files


def _facts(files: list[McapFile]) -> dict[str, str]:
    """Return what the recorder noted in the files themselves, message-set version included."""
    found = {k: v for file in files for k, v in file.metadata.get(METADATA_RECORD, {}).items()}
    first = files[0].metadata.get(METADATA_RECORD, {}).get(PART)
    found.pop(PART, None)
    return {**found, **({} if first is None else {PART: first})}
