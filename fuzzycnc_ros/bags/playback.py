# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Messages that a player sends, undecoded, in log order or by stamp.

Arrival order at a recorder carries no meaning, so that a lock-step run is played in the order of
the stamps.  A message without a header belongs to the newest stamp before it.
"""

import heapq
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from fuzzycnc_ros.bags.errors import BagError, BagTopicError, BagTypeError
from fuzzycnc_ros.bags.metadata import Profiles, TopicInfo
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.typestore import type_hash
from fuzzycnc_ros.runtime.records import SECOND

HELD = 20_000
"""Messages held back to be put in the order of their stamps: a recorder is read out every 500
ticks, and lags by no more than what a graph publishes in between."""

_HEADER = 'std_msgs/msg/Header'
_LATCHED = ('transient_local', 1)  # in words, and as rmw's number in older bags
_DEPTH_MAX = 2000


@dataclass(frozen=True)
class PlayedTopic:
    """A topic that is played.

    Parameters
    ----------
    topic, type : str
        Recorded topic and its type.
    depth : int
        Depth that was offered, 0 if the bag does not say.
    latched : bool
        Whether late readers got the newest message.
    stamped : bool
        Whether messages begin with a header.
    upgrade : callable or None
        Brings its messages to the current message set, where they are older.
    """

    topic: str
    type: str
    depth: int
    latched: bool
    stamped: bool
    upgrade: Callable[[bytes], bytes] | None = None

    def sent(self, payload: bytes) -> bytes:
        """Return a recorded message as it is sent."""
        return payload if self.upgrade is None else self.upgrade(payload)


class PlayedMessage(NamedTuple):
    """A message to be sent."""

    topic: str
    log_time: int
    """Log time [ns]."""
    stamp: int
    """Machine time to which it belongs [ns]."""
    payload: bytes


def played_topics(reader: BagReader, topics: Iterable[str]) -> dict[str, PlayedTopic]:
    """Describe topics of a bag.

    Raises
    ------
    BagTypeError
        If a type is unknown here, or was recorded with another definition: undecoded bytes
        would be misread.
    """
    return {topic: _describe(reader, reader.connections[topic]) for topic in topics}


def messages(
    reader: BagReader,
    topics: Mapping[str, PlayedTopic],
    start: int | None = None,
    stop: int | None = None,
) -> Iterator[PlayedMessage]:
    """Yield the messages of a bag in the order of their log time.

    Parameters
    ----------
    reader : BagReader
        The bag.
    topics : mapping
        What is played.
    start, stop : int, optional
        Log times [ns].  Of a latched topic, the newest message before `start` comes first.
    """
    if start is not None:
        yield from _latched_before(reader, topics, start)
    any_stamped = any(topic.stamped for topic in topics.values())
    newest: int | None = None
    early: list[PlayedMessage] = []
    for name, _, log_time, payload in reader.messages(set(topics), start, stop, raw=True):
        topic = topics[name]
        stamp = stamp_of(payload) if topic.stamped else None
        if not any_stamped:
            newest = log_time
        elif stamp is not None and not topic.latched:
            # A latched message may be an old fact told again: it says nothing about the time.
            newest = max(newest or 0, stamp)
        if stamp is None and newest is None:
            early.append(PlayedMessage(name, log_time, 0, topic.sent(payload)))
            continue
        if newest is not None:
            yield from (item._replace(stamp=newest) for item in early)
            early.clear()
        played_at = newest or 0 if stamp is None else stamp
        yield PlayedMessage(name, log_time, played_at, topic.sent(payload))
    yield from early


def by_stamp(source: Iterable[PlayedMessage], held: int = HELD) -> Iterator[PlayedMessage]:
    """Yield messages in the order of their stamps, equal ones as they came.

    Parameters
    ----------
    source : iterable of PlayedMessage
        Messages in log order.
    held : int
        How many are held back; a message later than that goes with the stamp being played.
    """
    queue: list[tuple[int, int, PlayedMessage]] = []
    reached = 0
    for number, message in enumerate(source):
        heapq.heappush(queue, (max(message.stamp, reached), number, message))
        if len(queue) > held:
            reached, _, first = heapq.heappop(queue)
            yield first._replace(stamp=reached)
    while queue:
        stamp, _, message = heapq.heappop(queue)
        yield message._replace(stamp=stamp)


def stamp_of(payload: bytes) -> int:
    r"""Return the stamp of the header with which a message begins [ns].

    Examples
    --------
    >>> stamp_of(b'\x00\x01\x00\x00' + (2).to_bytes(4, 'little') + (5).to_bytes(4, 'little'))
    2000000005
    """
    seconds, rest = struct.unpack_from(_time_layout(payload), payload, 4)
    return int(seconds) * 10**9 + int(rest)


def restamped(payload: bytes, shift: int) -> bytes:
    r"""Return a message that begins with a header, with its stamp moved by `shift` [ns].

    Examples
    --------
    >>> message = b'\x00\x01\x00\x00' + bytes(8) + b'rest'
    >>> stamp_of(restamped(message, 1_500_000_000))
    1500000000
    """
    moved = bytearray(payload)
    seconds, rest = divmod(stamp_of(payload) + shift, 10**9)
    struct.pack_into(_time_layout(payload), moved, 4, seconds, rest)
    return bytes(moved)


class Playback:
    """A bag as it is sent, message by message, once or again and again.

    Parameters
    ----------
    reader : BagReader
        The bag.
    topics : mapping of str to PlayedTopic
        What is played.
    start, stop : int or None
        Log times between which it is played [ns]; from the beginning and to the end if None.
    ordered : bool
        Whether messages come in the order of their stamps, not in that of their log times.
    loop : bool
        Whether the bag begins anew when it is over.
    restamp : bool
        Whether the stamps of a repetition go on where those before ended.
    told : callable
        Told of each repetition.

    Attributes
    ----------
    next : PlayedMessage or None
        The message to be sent next, as it is sent; None at the end.
    timing : set of str
        Topics whose stamps make time.
    first, last : int
        Log times between which it is played [ns].
    repetition : int
        How often it began anew.
    error : str
        Why the rest cannot be read; empty if it can.
    """

    def __init__(
        self,
        reader: BagReader,
        topics: Mapping[str, PlayedTopic],
        start: int | None = None,
        stop: int | None = None,
        *,
        ordered: bool = False,
        loop: bool = False,
        restamp: bool = False,
        told: Callable[[str], None] = lambda text: None,
    ) -> None:
        self._reader, self._topics = reader, topics
        self._start, self._stop = start, stop
        self._ordered, self._loop, self._restamp, self._told = ordered, loop, restamp, told
        self.first = reader.start if start is None else start
        self.last = reader.stop if stop is None else stop
        # A latched message may be an old fact told again: it makes no time if others do.
        self.timing = {name for name, topic in topics.items() if not topic.latched} or set(topics)
        self.repetition = 0
        self.error = ''
        self._log_shift = self._stamp_shift = 0
        self._first_stamp: int | None = None
        self._last_stamp = self._last_log_time = 0
        self._step = SECOND
        self._source = self._open()
        self.next = self._take()

    @property
    def position(self) -> int:
        """Log time in the bag of the next message [ns], the end if there is none."""
        return self.last if self.next is None else self.next.log_time - self._log_shift

    def advance(self) -> None:
        """Go on to the message after the next."""
        self.next = self._take()

    def _open(self) -> Iterator[PlayedMessage]:
        """Return the messages of one repetition."""
        source = messages(self._reader, self._topics, self._start, self._stop)
        return by_stamp(source) if self._ordered else source

    def _take(self) -> PlayedMessage | None:
        """Return the next message as it is sent, from the next repetition if need be."""
        try:
            message = next(self._source, None)
            if message is None and self._loop and self._last_log_time:
                self._repeat()
                message = next(self._source, None)
        except BagError as error:
            # What was played stands; the rest cannot be read.
            self.error = str(error)
            return None
        if message is None:
            return None
        topic = self._topics[message.topic]
        message = message._replace(
            log_time=message.log_time + self._log_shift, stamp=message.stamp + self._stamp_shift
        )
        if self._stamp_shift and topic.stamped:
            message = message._replace(payload=restamped(message.payload, self._stamp_shift))
        self._last_log_time = max(self._last_log_time, message.log_time)
        if message.topic in self.timing:
            if self._first_stamp is None:
                self._first_stamp = message.stamp
            elif message.stamp > self._last_stamp:
                self._step = message.stamp - self._last_stamp
            self._last_stamp = max(self._last_stamp, message.stamp)
        return message

    def _repeat(self) -> None:
        self.repetition += 1
        self._log_shift = self._last_log_time + self._step - self.first
        if self._restamp and self._first_stamp is not None:
            self._stamp_shift = self._last_stamp + self._step - self._first_stamp
            how = f'stamps moved on by {self._stamp_shift / SECOND:.3f} s'
        else:
            how = 'with the recorded stamps, which readers drop as not newer'
        self._told(f'repetition {self.repetition}, {how}')
        self._source = self._open()


def _time_layout(payload: bytes) -> str:
    # CDR: the second byte of the encapsulation says the byte order; the stamp stands first.
    return '<iI' if payload[1] & 1 else '>iI'


def _describe(reader: BagReader, connection: TopicInfo) -> PlayedTopic:
    known = type_hash(connection.type)
    upgrade = reader.decoder.current(connection.type)
    if upgrade is None and connection.type_hash and connection.type_hash != known:
        raise BagTypeError(
            f'{reader.path}: expected {connection.name} to be {connection.type} as installed '
            'here but it was recorded with another definition; play it with the fuzzycnc that '
            'recorded it, or leave the topic out'
        )
    _, fields = reader.decoder.store(connection.type).fielddefs[connection.type]
    depth, latched = _offered(connection.profiles)
    first = fields[0][1][1] if fields else ''
    return PlayedTopic(connection.name, connection.type, depth, latched, first == _HEADER, upgrade)


def _offered(profiles: Profiles) -> tuple[int, bool]:
    depths = [p['depth'] for p in profiles if isinstance(p.get('depth'), int)]
    latched = bool(profiles) and all(p.get('durability') in _LATCHED for p in profiles)
    return min(max(depths, default=0), _DEPTH_MAX), latched


def _latched_before(
    reader: BagReader, topics: Mapping[str, PlayedTopic], start: int
) -> Iterator[PlayedMessage]:
    latched = {name for name, topic in topics.items() if topic.latched}
    if not latched:
        return
    newest: dict[str, bytes] = {}
    for topic, _, _, payload in reader.messages(latched, None, start, raw=True):
        newest[topic] = payload
    for topic, payload in newest.items():
        yield PlayedMessage(topic, start, 0, topics[topic].sent(payload))


def require_topics(reader: BagReader, topics: Iterable[str], wanted: str) -> list[str]:
    """Return those of `topics` that hold messages.

    Raises
    ------
    BagTopicError
        If none does; the text says what was `wanted` and lists what is there.
    """
    kept = [topic for topic in topics if reader.connections[topic].message_count]
    if not kept:
        raise BagTopicError(
            f'{reader.path}: expected topics {wanted} but the bag has {reader.filled()}'
        )
    return kept
