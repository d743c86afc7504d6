# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Recording undecoded messages: cheap callbacks, a thread that writes, every loss counted."""

import json
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass, field
from itertools import chain, islice
from pathlib import Path
from typing import Any, NamedTuple

from fuzzycnc_ros.bags.errors import BagError, BagTopicError, BagTypeError, BagWriteError
from fuzzycnc_ros.bags.metadata import Profiles, Qos
from fuzzycnc_ros.bags.shipping import Shipper
from fuzzycnc_ros.bags.writer import BagWriter, ClosedPart, not_announced

PENDING_MAX = 256 * 1024 * 1024
"""Most bytes that wait for the disk; what comes on top is dropped and counted."""

DISK_FULL, TOO_SLOW = 'the disk was full', 'the disk was too slow'
NO_TIME = 'there was no machine time for too long'
"""Why messages that came were not written."""

REPORT_NAME = 'recording.json'
"""Attachment that states what was received, written and lost on each topic."""

MODULUS = 2**64
"""The numbers of rmw are 64 bits wide and then start anew."""

UNSUPPORTED = 2**64 - 1
"""Sequence number that rmw gives where a middleware has none."""

SILENT = 3
"""Publishers that are gone are those that were silent while each other spoke so often."""

AGAIN = 1.1
"""Share of the space to be kept free at which writing goes on; at 1 it would come and go."""

_LOOK = 1024 * 1024  # bytes written between looks at the disk
_GAPS_MAX = 1000
_NOTICES_MAX = 100
_MEGABYTE = 1e6
_WAKE = 0.1  # s between looks at the clock when nothing arrives
_BATCH = 256  # messages between looks at the queue


@dataclass(frozen=True)
class TopicProgress:
    """Messages of one topic.

    Parameters
    ----------
    received, written : int
        Messages taken from the topic, and handed to the bag.
    missing : int
        Messages that never came, by the gaps in the sequence numbers.
    dropped : int
        Messages that came but were not written: the disk was too slow, or writing failed.
    publishers : int
        Publishers that were told apart.
    """

    received: int
    written: int
    missing: int
    dropped: int
    publishers: int


@dataclass(frozen=True)
class Progress:
    """Progress of a recording.

    Parameters
    ----------
    topics : dict of str to TopicProgress
        Every topic.
    pending : int
        Messages that wait for the thread.
    untimed : int
        Messages that came before any time was known, and wait for one.
    pending_bytes : int
        Size of both [bytes].
    behind : float
        Wall time for which the oldest of them has waited [s].
    error : str
        Why nothing more is written; empty while all is well.
    paused : str
        Why nothing is written for now, and what helps; empty while messages are written.
    parts : int
        Parts of the bag that are there, the open one included.
    deleted : str
        Which parts were deleted to stay within the budget; empty if none.
    waiting : str
        Why the bag is larger than its budget, or parts are not shipped yet; empty if all is well.
    """

    topics: dict[str, TopicProgress] = field(default_factory=dict)
    pending: int = 0
    untimed: int = 0
    pending_bytes: int = 0
    behind: float = 0.0
    error: str = ''
    paused: str = ''
    parts: int = 1
    deleted: str = ''
    waiting: str = ''

    @property
    def received(self) -> int:
        """Messages taken from all topics."""
        return sum(topic.received for topic in self.topics.values())

    @property
    def written(self) -> int:
        """Messages handed to the bag."""
        return sum(topic.written for topic in self.topics.values())

    @property
    def lost(self) -> int:
        """Messages missing or dropped."""
        return sum(topic.missing + topic.dropped for topic in self.topics.values())


class Notice(NamedTuple):
    """Something that people are told when it happens.

    Parameters
    ----------
    urgent : bool
        Whether somebody has to do something.
    text : str
        What it is.
    """

    urgent: bool
    text: str


class _QueuedMessage(NamedTuple):
    topic: str
    payload: bytes
    log_time: int
    publish_time: int
    sequence: int
    publisher: Hashable
    taken: float
    """Monotonic time [s]."""


@dataclass
class _Gap:
    """Messages in a row that came but were not written; log times in ns."""

    start: int
    stop: int
    cause: str
    messages: int = 0


class SequenceCounter:
    """Gaps in the sequence numbers of one topic.

    Parameters
    ----------
    publishers : callable, optional
        Says how many publishers the topic has now; 0 where that is not known yet.

    Attributes
    ----------
    missing : int
        Messages whose numbers were jumped over.
    streams : int
        Publishers that were told apart, those that are gone included.

    Notes
    -----
    Every publisher counts its own messages, from any start.  Where the caller can tell the
    publishers apart it names them.  rclpy cannot: it hands on numbers without the publisher that
    they are of.  Then a number is taken to continue the publisher whose last number lies closest
    below it, of two alike the one that spoke last; and one that lies below all of them, or is 0
    or 1, begins another publisher (or is one that restarted).

    Where it is known how many publishers there are, a jump while one of them has not been heard
    yet is its beginning, not a gap: a reader that comes late hears the first of each with a high
    number.  Without that a publisher that joins with a high number is counted as a gap, since a
    loss reported in vain is better than one passed over.  Where more were heard than there are,
    those that have been silent for long while the others spoke are gone, and nothing continues
    them.

    Examples
    --------
    >>> counter = SequenceCounter()
    >>> for number in (1, 2, 5, 6):
    ...     publisher = counter.update(number)
    >>> counter.missing
    2

    Two publishers that a late reader hears:

    >>> counter = SequenceCounter(lambda: 2)
    >>> for number in (41, 57, 42, 58):
    ...     publisher = counter.update(number)
    >>> counter.missing
    0
    """

    def __init__(self, publishers: Callable[[], int] | None = None) -> None:
        self.missing = 0
        self.streams = 0
        self._publishers = publishers
        self._last: dict[Hashable, int] = {}  # by publisher, the one that spoke last at the end
        self._count = 0  # numbers taken
        self._spoke: dict[Hashable, int] = {}  # count at the newest number of each

    def update(self, number: int | None, publisher: Hashable = None) -> Hashable:
        """Take the sequence number of one message; return the publisher that it is put down to.

        Parameters
        ----------
        number : int or None
            Publication sequence number; None or 2^64 - 1 if there is none.
        publisher : hashable, optional
            Who sent it, where that is known.
        """
        if number is None or number == UNSUPPORTED:
            return publisher
        key = publisher if publisher is not None else self._closest(number)
        last = self._last.pop(key, None)
        if last is None:
            self.streams += 1
        else:
            gap = (number - last - 1) % MODULUS
            if gap < MODULUS // 2:  # else the publisher restarted or repeated itself
                self.missing += gap
        self._last[key] = number
        self._count += 1
        self._spoke[key] = self._count
        return key

    def _closest(self, number: int) -> Hashable:
        """Return the anonymous publisher that a number continues, or a new one."""
        another = ('anonymous', self.streams)
        known = self._known(number)
        best: Hashable = another
        best_gap = MODULUS // 2
        for key, last in reversed(self._last.items()):
            gap = (number - last - 1) % MODULUS
            if gap < best_gap:
                best, best_gap = key, gap
        if best_gap and (number <= 1 or 0 < len(self._last) < known):
            return another
        return best

    def _known(self, number: int) -> int:
        """Forget publishers that are gone; return how many there are, 0 if that is not known."""
        heard = len(self._last)
        if self._publishers is None or not heard:
            return 0
        if heard == 1 and number - next(iter(self._last.values())) == 1:
            return heard  # the usual case needs no look at the graph
        known = self._publishers()
        for key in list(self._last)[: max(0, heard - known) if known else 0]:
            if self._count - self._spoke[key] > SILENT * heard:
                del self._last[key], self._spoke[key]
        return known


@dataclass
class _Counts:
    sequence: SequenceCounter
    received: int = 0
    written: int = 0
    dropped: int = 0

    def snapshot(self) -> TopicProgress:
        return TopicProgress(
            self.received,
            self.written,
            self.sequence.missing,
            self.dropped,
            self.sequence.streams,
        )


class RecordingThread:
    """Writes messages into a bag from a thread of its own.

    Parameters
    ----------
    writer : BagWriter
        The bag; the thread owns it from now on and closes it.
    pending_max : int
        Most bytes that wait for the disk.
    on_error : callable, optional
        Called once, in the thread, with the error that ended the writing.
    free_min : int
        Space on the disk below which nothing is written [bytes]; 0 to write as long as it goes.
    budget : int
        Size beyond which the oldest parts are deleted [bytes], all but the part that was closed
        last; 0 for never.
    shipper : Shipper, optional
        Takes the closed parts elsewhere; they are deleted after that only.  The thread owns it.
    facts : callable, optional
        What else each part is to say of the recording so far; called in the thread.
    free : callable
        Returns the free space of the disk that a path lies on [bytes].

    Notes
    -----
    `put` is meant for the callbacks of an executor: it appends to a queue and returns.  A
    message that does not fit in `pending_max` is dropped and counted, never queued: memory
    stays bounded, and what was lost is written into the bag.

    While the disk has too little space messages wait in that queue.  A pause that it spans costs
    nothing; after a longer one the bag says from when to when messages are missing.

    What comes before machine time is known waits there too, and gets the first time that is.
    """

    def __init__(
        self,
        writer: BagWriter,
        *,
        pending_max: int = PENDING_MAX,
        on_error: Callable[[BagError], None] | None = None,
        free_min: int = 0,
        budget: int = 0,
        shipper: Shipper | None = None,
        facts: Callable[[], Mapping[str, Any]] = dict,
        free: Callable[[Path], int] | None = None,
    ) -> None:
        self._writer = writer
        self._free_min = free_min
        self._budget = budget
        self._shipper = shipper
        self._facts = facts
        self._free = free or free_space
        self._unseen = 0  # bytes written since the last look at the disk
        self._paused = ''
        self._gaps: list[_Gap] = []
        self._gap: _Gap | None = None
        self._gap_told = True
        self._deleted = ''
        self._over = ''
        self._parts = 1
        self._notices: deque[Notice] = deque(maxlen=_NOTICES_MAX)
        self._pending_max = pending_max
        self._on_error = on_error
        self._queue: deque[_QueuedMessage] = deque()
        self._untimed: list[_QueuedMessage] = []  # not in the queue yet
        self._jobs: deque[Callable[[], None]] = deque()
        self._types: dict[str, str] = {}
        self._pending_bytes = 0
        self._counts: dict[str, _Counts] = {}
        self._unknown_types: dict[str, str] = {}
        self._error: BagError | None = None
        self._stopping = False
        self._closed = False
        self._lock = threading.Lock()  # guards the queue and all counts
        self._ready = threading.Condition(self._lock)
        self._thread = threading.Thread(target=self._run, name='bag-writer', daemon=True)
        self._thread.start()

    def add_topic(
        self,
        name: str,
        type_name: str,
        qos: Qos | Profiles | None = None,
        *,
        publishers: Callable[[], int] | None = None,
    ) -> None:
        """Announce a topic; a type that this machine does not know is recorded undefined.

        Parameters
        ----------
        name, type_name : str
            Topic and type.
        qos : Qos or list of dict, optional
            What its publishers offer.
        publishers : callable, optional
            Says how many publishers it has now, for the count of what is missing where `put` is
            not told who sent a message; called by `put`.

        Raises
        ------
        BagTopicError
            If the topic exists with another type.
        BagWriteError
            If the bag cannot be written.
        """

        def announce() -> None:
            try:
                self._writer.add_topic(name, type_name, qos)
            except BagTypeError as error:
                self._writer.add_topic(name, type_name, qos, definition='', encoding='')
                self._unknown_types[type_name] = str(error)

        known = self._types.setdefault(name, type_name)
        if known != type_name:
            raise BagTopicError(f'{name}: expected type {known} but found {type_name}')
        self._do_soon(announce)
        with self._lock:
            self._counts.setdefault(name, _Counts(SequenceCounter(publishers)))

    def put(
        self,
        topic: str,
        payload: bytes,
        log_time: int | None,
        publish_time: int | None = None,
        sequence: int | None = None,
        publisher: Hashable = None,
    ) -> bool:
        """Queue one undecoded message.

        Parameters
        ----------
        topic : str
            An announced topic.
        payload : bytes
            The message in CDR.
        log_time : int, optional
            When it was received [ns]; None where no time is known yet: it waits for that of the
            next message that has one.
        publish_time : int, optional
            When it was sent [ns]; when it was received if absent.
        sequence : int, optional
            Its publication sequence number.
        publisher : hashable, optional
            Who sent it, where that is known.

        Returns
        -------
        bool
            Whether it will be written; False if it was dropped and counted.

        Raises
        ------
        BagTopicError
            If the topic was not announced.
        """
        with self._lock:
            counts = self._counts.get(topic)
            if counts is None:
                raise not_announced(topic, self._counts)
            counts.received += 1
            sender = counts.sequence.update(sequence, publisher)
            full = self._pending_bytes + len(payload) > self._pending_max
            if self._untimed and log_time is not None:
                self._begin(log_time)
            stamp = log_time or 0
            if full or self._error or self._stopping:
                counts.dropped += 1
                self._miss(stamp)
                return False
            if self._gap is not None:
                self._gap.stop, self._gap, self._gap_told = stamp, None, False
            sent = stamp if publish_time is None else publish_time
            item = _QueuedMessage(
                topic, payload, stamp, sent, sequence or 0, sender, time.monotonic()
            )
            self._pending_bytes += len(payload)
            if log_time is None:
                self._untimed.append(item)
                return True
            self._queue.append(item)
            if len(self._queue) == 1:
                self._ready.notify()
        return True

    def _begin(self, stamp: int) -> None:
        """Queue what came before any time was known, at the first that is [ns]."""
        for item in self._untimed:
            self._queue.append(item._replace(log_time=stamp, publish_time=stamp))
        self._untimed.clear()
        self._ready.notify()

    def attach(self, name: str, content: str | bytes, media_type: str = 'text/plain') -> None:
        """Add an attachment, for example a model file.

        Raises
        ------
        BagWriteError
            If the bag cannot be written.
        """
        self._do_soon(lambda: self._writer.attach(name, content, media_type, repeat=True))

    def _do_soon(self, job: Callable[[], None]) -> None:
        """Have the thread do something to the bag, before it writes what is put later.

        Who calls it takes messages: it must not wait for a slow disk.
        """
        self.check()
        with self._lock:
            if self._stopping:
                raise BagWriteError(f'{self._writer.path}: expected an open bag but it was closed')
            self._jobs.append(job)
            self._ready.notify()

    def progress(self) -> Progress:
        """Return how far the recording has come."""
        with self._lock:
            oldest = next(chain(self._untimed, self._queue), None)
            return Progress(
                topics={name: counts.snapshot() for name, counts in self._counts.items()},
                pending=len(self._queue),
                untimed=len(self._untimed),
                pending_bytes=self._pending_bytes,
                behind=time.monotonic() - oldest.taken if oldest else 0.0,
                error=str(self._error or ''),
                paused=self._paused,
                parts=self._parts,
                deleted=self._deleted,
                waiting=self._over or (self._shipper.trouble if self._shipper else ''),
            )

    def notices(self) -> list[Notice]:
        """Return what happened since the last call."""
        found = []
        while self._notices:
            found.append(self._notices.popleft())
        return found

    @property
    def failed(self) -> bool:
        """True if the bag could not be written any further; costs less than `progress`."""
        return self._error is not None

    def check(self) -> None:
        """Raise the error that ended the writing, if there is one.

        Raises
        ------
        BagWriteError
            If the bag could not be written any further.
        """
        if self._error is not None:
            raise self._error

    def close(self, facts: Mapping[str, Any] | None = None) -> Progress:
        """Write what is queued, put the counts into the bag, and close it.

        Parameters
        ----------
        facts : mapping, optional
            What else the bag is to say of its recording.

        Returns
        -------
        Progress
            The final counts.

        Raises
        ------
        BagWriteError
            If the bag could not be written to its end.
        """
        with self._lock:
            self._stopping = True
            self._begin(0)
        self._thread.join()
        progress = self.progress()
        if not self._closed:
            self._closed = True
            try:
                if self._error is None:
                    self._attach_report(facts or {})
                self._writer.close()
                self._hand_on()
            finally:
                if self._shipper is not None:
                    self._notices.extend(Notice(True, text) for text in self._shipper.close())
        self.check()
        return progress

    def _attach_report(self, facts: Mapping[str, Any]) -> None:
        progress = self.progress()
        with self._lock:
            gaps = [
                {
                    'from_s': gap.start / 1e9,
                    'to_s': gap.stop / 1e9,
                    'messages': gap.messages,
                    'cause': gap.cause,
                }
                for gap in self._gaps
            ]
            self._gap_told = True
        content = {
            **facts,
            'topics': {name: vars(topic) for name, topic in progress.topics.items()},
            'unknown_types': self._unknown_types,
            'gaps': gaps,
        }
        text = json.dumps(content, indent=2, sort_keys=True)
        self._writer.attach(REPORT_NAME, text, 'application/json')

    def _miss(self, log_time: int) -> None:
        """Note that a message is not written."""
        if self._gap is None:
            cause = NO_TIME if self._untimed else TOO_SLOW
            cause = DISK_FULL if self._paused or self._error else cause
            self._gap = _Gap(log_time, log_time, cause)
            if len(self._gaps) < _GAPS_MAX:
                self._gaps.append(self._gap)
        self._gap.messages += 1
        self._gap.stop = max(self._gap.stop, log_time)

    def _run(self) -> None:
        try:
            error = self._work()
        except Exception as fault:  # else nobody would write, and nobody would know
            error = self._writer.fail(fault)
        if error is None:
            return
        with self._lock:
            self._error = error
            self._drop_queue()
        if self._on_error is not None:
            self._on_error(error)

    def _work(self) -> BagError | None:
        """Write what comes until all is written; return why no more can be."""
        while True:
            with self._lock:
                waits = self._paused or not self._queue
                if waits and not self._jobs and not self._stopping:
                    self._ready.wait(_WAKE)
                stopping = self._stopping
            error = self._do_jobs() or self._keep_house()
            if error is None and self._paused and not stopping:
                continue
            with self._lock:
                size = 0 if self._paused else min(_BATCH, len(self._queue))
                # What was announced in the meantime may have messages that wait.
                batch = [] if self._jobs else list(islice(self._queue, size))
                if error is None and stopping and not batch and not self._jobs:
                    self._drop_queue()  # empty, unless the disk has no room
                    return None
            written = 0
            if error is None:
                written, error = self._write(batch)
            with self._lock:
                for _ in range(written):
                    item = self._queue.popleft()
                    self._counts[item.topic].written += 1
                    self._pending_bytes -= len(item.payload)
            if error is not None:
                return error

    def _do_jobs(self) -> BagError | None:
        """Do to the bag what was asked for; return why no more can be written."""
        try:
            while self._jobs:
                self._jobs[0]()
                self._jobs.popleft()
        except BagError as error:
            return error
        return None

    def _write(self, batch: list[_QueuedMessage]) -> tuple[int, BagError | None]:
        """Write a batch; return how many messages were written and why no more."""
        written = 0
        try:
            for topic, payload, log_time, publish_time, sequence, publisher, _ in batch:
                if self._unseen >= _LOOK and not self._has_room():
                    break
                if self._writer.is_full(log_time):
                    self._attach_report(self._facts())
                    self._writer.split(log_time)
                    self._parts = len(self._writer.closed_parts) + 1
                    self._hand_on()
                self._writer.write(topic, log_time, publish_time, payload, sequence, publisher)
                self._unseen += len(payload)
                written += 1
            self._writer.flush_if_due()
        except BagError as error:
            return written, error
        return written, None

    def _keep_house(self) -> BagError | None:
        """Look at the disk and at the budget; return why no more can be written."""
        try:
            if self._has_room() and not self._gap_told:
                self._attach_report(self._facts())
            if self._budget:
                self._keep_budget()
            self._writer.flush_if_due()
        except BagError as error:
            return error
        return None

    def _has_room(self) -> bool:
        """Pause where the disk has too little space, and go on where it has enough again."""
        self._unseen = 0
        if not self._free_min:
            return True
        try:
            free = self._free(self._writer.path)
        except OSError:
            return not self._paused  # nothing is known of it: writing will tell
        if self._paused and free >= AGAIN * self._free_min:
            self._paused = ''
            text = f'{_megabytes(free)} are free: the recording to {self._writer.path} goes on'
            self._notices.append(Notice(False, text))
        elif not self._paused and free < self._free_min:
            self._writer.flush()  # what came so far is safe
            self._paused = (
                f'the recording to {self._writer.path} waits: {_megabytes(free)} of its disk are '
                f'free, less than free_min, {_megabytes(self._free_min)}; make room, it then goes '
                f'on by itself; {_megabytes(self._pending_max)} of messages are kept in memory, '
                'what comes after them is lost'
            )
            self._notices.append(Notice(True, self._paused))
        return not self._paused

    def _keep_budget(self) -> None:
        """Delete the oldest parts while the bag is larger than its budget.

        The part that was closed last stays: the newest one may hold nothing yet that would
        survive a crash.
        """
        over = ''
        while self._writer.size > self._budget and len(self._writer.closed_parts) > 1:
            oldest = self._writer.closed_parts[0]
            if self._shipper is not None and not self._shipper.has(oldest.path.name):
                over = (
                    f'{self._writer.path} has {_megabytes(self._writer.size)}, more than its '
                    f'budget, {_megabytes(self._budget)}: {oldest.path.name} is not shipped yet'
                    f', and stays until it is; {self._shipper.trouble or "it is on its way"}'
                )
                break
            self._delete(oldest)
        if over and not self._over:
            self._notices.append(Notice(True, over))
        self._over = over

    def _delete(self, oldest: ClosedPart) -> None:
        try:
            self._writer.delete_oldest()
        except OSError as error:
            text = f'{oldest.path}: cannot be deleted: {error.strerror}; delete it yourself'
            self._notices.append(Notice(True, text))
        self._parts = len(self._writer.closed_parts) + 1
        self._deleted = (
            f'{oldest.number + 1} parts, all before {oldest.stop / 1e9:.3f} s, to stay within '
            f'{_megabytes(self._budget)}'
        )
        text = f'deleted {oldest.path.name}, to stay within {_megabytes(self._budget)}'
        self._notices.append(Notice(False, text))

    def _hand_on(self) -> None:
        """Have the part that was closed last shipped."""
        closed = self._writer.closed_parts
        if self._shipper is not None and closed:
            self._shipper.submit(closed[-1].path)

    def _drop_queue(self) -> None:
        """Count everything that waits as dropped."""
        self._begin(0)
        for item in self._queue:
            self._counts[item.topic].dropped += 1
            self._miss(item.log_time)
        self._queue.clear()
        self._pending_bytes = 0


def free_space(path: Path) -> int:
    """Return the free space of the disk that a path lies on [bytes]."""
    status = os.statvfs(path)
    return status.f_bavail * status.f_frsize


def _megabytes(size: float) -> str:
    return f'{size / _MEGABYTE:.4g} MB'
