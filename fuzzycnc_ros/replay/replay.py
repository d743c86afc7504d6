# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Deterministic replay: recompute every component's outputs from the recorded inputs.

Each component is set up as its recorded `node_configuration` says, gets its recorded inputs,
turns and requests in the order of machine time, and must give the recorded outputs again, byte
for byte in canonical form.
"""

import json
import os
import struct
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import compress, zip_longest
from math import inf
from operator import attrgetter
from typing import Any

import numpy as np

from fuzzycnc_ros.bags.canonical import canonical_message, combined_hash, topic_hashes
from fuzzycnc_ros.bags.errors import BagDataError
from fuzzycnc_ros.bags.playback import stamp_of
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.recording_loss import publishers
from fuzzycnc_ros.bags.runs import read_run
from fuzzycnc_ros.bags.storage import RawMessage
from fuzzycnc_ros.bags.typestore import ROSBAGS, deserialize
from fuzzycnc_ros.components.thermal.temperature_acquisition import TemperatureAcquisition
from fuzzycnc_ros.components.thermal.thermal_predictor import ThermalPredictor
from fuzzycnc_ros.core.config import Config
from fuzzycnc_ros.registry import COMPONENTS
from fuzzycnc_ros.replay.origins import REPLAYABLE, Origins
from fuzzycnc_ros.runtime.arithmetic import apart, arithmetic
from fuzzycnc_ros.runtime.component import Component, Emission, Input
from fuzzycnc_ros.runtime.convert import decode, encode
from fuzzycnc_ros.runtime.host import (
    DeadlineFired,
    MachineTick,
    NodeConfiguration,
    NodeEvent,
)
from fuzzycnc_ros.runtime.merge import Merger
from fuzzycnc_ros.runtime.provenance import CLOCK_STEP, REFUSED
from fuzzycnc_ros.runtime.records import (
    SECOND,
    Record,
)

_TOLD_OF: Mapping[str, type[Any]] = {
    'node_configuration': NodeConfiguration,
    'node_event': NodeEvent,
    'deadline_fired': DeadlineFired,
}
"""Topics that all nodes share."""

_PLUMBING = (*_TOLD_OF, 'machine_tick')
"""Topics that a replay reads beside those of components; pictures of a camera fill no memory."""

LATE = 5 * SECOND
"""Log time [ns] within which the last messages before a step of the clock arrive."""

DEADLINES_MAX = 500
"""Deadlines that may fire without a trace; beside them, ten for each recorded message and turn."""

ROUNDING = 1e-9
"""Relative difference that linear algebra on another processor may cause [-]."""

SMALL = 1e-3
"""Share of the largest magnitude of a field in its topic [-] below which a number counts as that
share: next to a velocity of 0.1 m/s, 3e-16 and -3e-16 m/s are the same zero."""
_Output = tuple[str, str, int, Any]
"""Topic, type, stamp [ns] and message of rosbags."""

_Point = tuple[int, NodeEvent | NodeConfiguration | None]
"""Machine time [ns], and the request or the change that comes then; nothing in a turn."""

Progress = Callable[[str, int, int], None]
"""Told the node, components done and in all."""


@dataclass(frozen=True)
class TopicComparison:
    """Recorded against recomputed messages of one topic."""

    topic: str
    recorded: int
    recomputed: int
    identical: int
    first_difference: str = ''
    largest_difference: float = 0.0
    """Largest relative difference of a number [-]; infinite if anything else differs."""
    not_recomputed: str = ''
    """Why messages of it were not recomputed; empty if all were."""
    left_out: bool = False
    """True if the recorder was told not to record it, so that nothing can be compared."""

    @property
    def equal(self) -> bool:
        """True if nothing differs."""
        return self.left_out or self.recorded == self.recomputed == self.identical

    @property
    def equivalent(self) -> bool:
        """True if nothing differs but the rounding of another processor's arithmetic."""
        return self.equal or self.largest_difference <= ROUNDING


@dataclass(frozen=True)
class GivenTopic:
    """A recorded topic that a replay takes as it is, and whose it is."""

    topic: str
    recorded: int
    origin: str


@dataclass(frozen=True)
class ReplayReport:
    """Outcome of a replay.

    Attributes
    ----------
    topics : list of TopicComparison
        One entry per topic that was recomputed, or should have been.
    hashes : dict of str to str
        SHA-256 of the canonical form of each recomputed topic.
    notes : list of str
        What could not be repeated as recorded, and why.
    given : list of GivenTopic
        Recorded topics that were taken as they are.
    """

    topics: list[TopicComparison]
    hashes: dict[str, str]
    notes: list[str] = field(default_factory=list)
    given: list[GivenTopic] = field(default_factory=list)

    arithmetic: str | None = None
    """Differences of the recording's arithmetic; empty if there are none, None if unknown."""

    @property
    def identical(self) -> bool:
        """True if every recorded output was recomputed and came out as it was, byte for byte."""
        return self.compared and all(item.equal for item in self.topics)

    @property
    def equivalent(self) -> bool:
        """True if every recorded output was recomputed and came out as it was, up to rounding.

        Where the same arithmetic gives other digits there is no excuse for them.
        """
        if self.arithmetic == '':
            return self.identical
        return self.compared and all(item.equivalent for item in self.topics)

    @property
    def compared(self) -> bool:
        """True if there was anything to compare."""
        return any(item.recorded and item.recomputed for item in self.topics)

    @property
    def differing(self) -> bool:
        """True if any recomputed output came out otherwise."""
        alike = attrgetter('equal' if self.arithmetic == '' else 'equivalent')
        return any(not (alike(item) or item.not_recomputed) for item in self.topics)

    @property
    def hash(self) -> str:
        """One SHA-256 over all recomputed topics."""
        return combined_hash(self.hashes)


class ReplayError(ValueError):
    """A bag cannot be replayed; the text says what it lacks."""


def replay(
    path: str | os.PathLike[str],
    *,
    nodes: Sequence[str] = (),
    given: Sequence[str] = (),
    progress: Progress | None = None,
) -> ReplayReport:
    """Recompute the outputs of a bag's components and compare them with the recorded ones.

    Parameters
    ----------
    path : path
        Bag of a run, live or simulated.
    nodes : sequence of str
        Only these nodes; all that the bag describes if empty.
    given : sequence of str
        Topics that are to be taken as they are, since another node wrote them.
    progress : callable, optional
        Told before each component.

    Raises
    ------
    BagError
        If the bag cannot be read.
    ReplayError
        If it holds no configuration of a component, so that nothing can be set up, or no topic
        of a name that is given.

    Notes
    -----
    Every recorded topic that a component of this package may have written is in the report, also
    if no configuration of it is in the bag: `identical` is said of all of them or of none.
    """
    with BagReader(path) as reader:
        recording = _BagMessages(reader)
    recording.check_given(given)
    wanted = [name for name in recording.nodes if not nodes or name.split('/')[-1] in nodes]
    if not wanted:
        raise ReplayError(
            f'{path}: expected node_configuration messages of '
            f'{", ".join(nodes or REPLAYABLE)} but found '
            f'{", ".join(recording.nodes) or "none"}; record all topics of the machine'
        )
    outputs: dict[str, list[_Output]] = {}
    failed: dict[str, str] = {}
    notes = list(recording.notes)
    for done, name in enumerate(wanted):
        if progress is not None:
            progress(name, done, len(wanted))
        player = _ComponentReplay(recording, name)
        player.run()
        notes.extend(player.notes)
        failed.update(dict.fromkeys(player.outputs, player.failure) if player.failure else {})
        for topic, messages in player.outputs.items():
            outputs.setdefault(topic, []).extend(messages)
    for topic in failed:
        # What a request gave live still counts for those who read it; it is not recomputed.
        outputs[topic] = []
    topics = [
        recording.compared(topic, messages, failed.get(topic, ''))
        for topic, messages in outputs.items()
        if messages or recording.raw.get(topic)
    ]
    taken: list[GivenTopic] = []
    if not nodes:
        lost, taken = recording.not_recomputed(outputs, given)
        topics += lost
    hashes = topic_hashes(message for messages in outputs.values() for message in messages)
    return ReplayReport(topics, hashes, notes, taken, recording.arithmetic(wanted))


def _seen_to_publish(reader: BagReader) -> dict[str, tuple[str, ...]]:
    """Return the nodes that the recorder saw publish on each topic; empty if nothing tells."""
    try:
        return publishers(reader.attachments())
    except ValueError:
        return {}  # damaged: then nobody is believed to be foreign


def _stamp(payload: bytes) -> int:
    try:
        return stamp_of(payload)
    except (struct.error, IndexError) as error:
        raise BagDataError(
            f'expected a message that begins with a header but found {len(payload)} bytes'
        ) from error


def _order(message: RawMessage) -> tuple[int, int, int, int]:
    """Return by what the messages of a topic are in order.

    The order in which messages of one log time lie in a bag carries no meaning: tools that convert
    bags change it.
    """
    return message.log_time, _stamp(message.payload), message.publish_time, message.sequence


def _step_of(event: NodeEvent) -> int:
    try:
        return int(json.loads(event.request)['step'])
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
        return 0


@dataclass(frozen=True)
class _SeriesEnd:
    """Change of a clock: a new series of stamps begins.

    Topics reach a recorder each in its own order alone.  So some of the old series is logged after
    the event that tells of the step, and some of the new one before it.
    """

    stamp: int
    """Machine time up to which the node has worked in the old series [ns]."""
    step: int
    """By how much the clock was set [ns]."""
    logged: int
    """Log time of the event [ns]."""
    told: Mapping[str, int]
    """Messages of each topic before it."""

    def kept(self, topic: str, stamps: Iterable[tuple[str, int]]) -> list[bool]:
        """Return what of a topic is of the old series and stamped no later than its end.

        Parameters
        ----------
        topic : str
            Name of the topic.
        stamps : iterable of (str, int)
            Of each message who sent it and its stamp [ns]; each sender has an order of its own.
        """
        found, told = [], self.told.get(topic, 0)
        newest: dict[str, int] = {}
        ended: set[str] = set()
        # Halfway back: no message of the old series comes so late, none of the new one so early.
        back = min(self.step, 0) // 2
        for number, (sender, stamp) in enumerate(stamps):
            if back and stamp < newest.get(sender, stamp) + back:
                ended.add(sender)
            newest[sender] = max(newest.get(sender, stamp), stamp)
            late = number >= told and back and stamp < self.stamp + back
            found.append(stamp <= self.stamp and not late and sender not in ended)
        return found


class _BagMessages:
    """The messages of a bag, by topic."""

    def __init__(self, reader: BagReader) -> None:
        known = set(_PLUMBING)
        for component in COMPONENTS.values():
            known.update(item.name for item in component.INPUTS)
            known.update(item.name for item in component.OUTPUTS)
        kinds = {o.record.TYPE for item in COMPONENTS.values() for o in item.OUTPUTS}
        self._decoder = reader.decoder
        self._kinds = {topic: item.type for topic, item in reader.connections.items()}
        wanted = [
            topic
            for topic, kind in self._kinds.items()
            if kind in kinds or not known.isdisjoint(topic.split('/')[-2:])
        ]
        self._publishers = _seen_to_publish(reader)
        self.notes: list[str] = []
        self._after_step = ''
        self._counts: Counter[str] = Counter()
        self.begins_late = reader.missing_parts > 0
        """True if the bag begins in the middle of a recording."""
        if self.begins_late:
            self.notes.append(
                f'the bag begins in the middle of a recording, of which {reader.missing_parts} '
                'parts come before it: its nodes start from what is latched at its head'
            )
        found: dict[str, list[RawMessage]] = defaultdict(list)
        heads: dict[str, list[RawMessage]] = defaultdict(list)
        end: _SeriesEnd | None = None
        for message in reader.raw_messages(wanted):
            topic, payload, logged = message.channel.topic, message.payload, message.log_time
            if message.channel.repeated:
                heads[topic].append(message)
                continue
            if end is None and topic.endswith('/node_event') and CLOCK_STEP.encode() in payload:
                event = decode(NodeEvent, self._decoder.decode(message.channel.type)(payload))
                if event.name == CLOCK_STEP:
                    when = f'the clock of {event.node} was set at {event.stamp / SECOND:.3f} s'
                    self.notes.append(
                        f'{when}: what came after it is not replayed, as its stamps are a series '
                        'of their own'
                    )
                    self._after_step = when
                    told = {name: len(messages) for name, messages in found.items()}
                    end = _SeriesEnd(event.stamp, _step_of(event), logged, told)
                    continue
            self._counts[topic] += 1
            if end is None or logged <= end.logged + LATE + max(end.step, 0):
                found[topic].append(message)
        self.raw = {topic: self._series(sorted(found[topic], key=_order), end) for topic in found}
        self._heads = {topic: self._series(heads[topic], None) for topic in heads}
        self.nodes: dict[str, list[NodeConfiguration]] = defaultdict(list)
        """Configurations by namespace and node."""
        for topic in dict.fromkeys((*self._heads, *self.raw)):
            space, _, name = topic.rpartition('/')
            if name != 'node_configuration':
                continue
            configurations = self.head(topic, NodeConfiguration)
            configurations += self.records(topic, NodeConfiguration)
            for record in configurations:
                if record.node in REPLAYABLE:
                    self.nodes[f'{space}/{record.node}'].append(record)
        early = [] if self.begins_late else [name for name in self.nodes if self._early(name)]
        if early:
            self.begins_late = True
            self.notes.append(
                f'{", ".join(early)} had been at work when the recording began: its nodes start '
                'from what was latched then'
            )

    def _early(self, name: str) -> bool:
        """Return whether a node was active, or told what nothing in the bag can have caused."""
        space, _, node = name.rpartition('/')
        kind = COMPONENTS[node]
        events = [
            event for event in self.records(f'{space}/node_event', NodeEvent) if event.node == node
        ]
        told_first = self.nodes[name][0].stamp  # at which there may be several, in any order
        states = {r.lifecycle_state for r in self.nodes[name] if r.stamp == told_first}
        if kind.MANAGED and states == {'active'} and not any(e.name == 'activate' for e in events):
            return True
        began = self.driven_from(space, kind)
        by_itself = kind.next_deadline is not Component.next_deadline
        told = [
            _stamp(self.raw[topic][0][1])
            for topic, item in ((f'{space}/{item.name}', item) for item in kind.OUTPUTS)
            if self.raw.get(topic) and (item.persistent or not by_itself)
        ]
        asked = {event.stamp for event in events}
        if began is None:  # nothing drove it, so that only a request can have
            driven = any(item.driving for item in kind.INPUTS)
            return driven and any(stamp < min(asked, default=inf) for stamp in told)
        return any(stamp < began and stamp not in asked for stamp in told)

    def driven_from(self, space: str, kind: type[Component]) -> int | None:
        """Return the stamp of the first record that made a component act [ns]; None without."""
        drives = next((item.name for item in kind.INPUTS if item.driving), '')
        raw = self.raw.get(f'{space}/{drives}')
        return _stamp(raw[0][1]) if raw else None

    def _series(
        self, messages: list[RawMessage], end: _SeriesEnd | None
    ) -> list[tuple[str, bytes]]:
        """Return type and bytes of the messages of a topic before the clock was set."""
        raw = [(message.channel.type, message.payload) for message in messages]
        if end is None or not messages:
            return raw
        topic = messages[0].channel.topic
        senders = self._senders(topic, raw)
        stamps = (_stamp(payload) for _, payload in raw)
        return list(compress(raw, end.kept(topic, zip(senders, stamps, strict=True))))

    def _senders(self, topic: str, raw: list[tuple[str, bytes]]) -> list[str]:
        """Return the node that each message of a topic tells of; empty where one node has it."""
        told_of = _TOLD_OF.get(topic.rsplit('/', 1)[-1])
        if told_of is None:
            return [''] * len(raw)
        return [record.node for record in self._decoded(raw, told_of)]

    def records(self, topic: str, record_type: type[Any]) -> list[Any]:
        """Return the messages of a topic as records; none if it was not recorded."""
        return self._decoded(self.raw.get(topic, []), record_type)

    def head(self, topic: str, record_type: type[Any]) -> list[Any]:
        """Return what the head of the bag repeats on a topic from the recording before it."""
        return self._decoded(self._heads.get(topic, []), record_type)

    def _decoded(self, raw: list[tuple[str, bytes]], record_type: type[Any]) -> list[Any]:
        return [decode(record_type, self._decoder.decode(kind)(payload)) for kind, payload in raw]

    def compared(self, topic: str, messages: list[_Output], failure: str) -> TopicComparison:
        """Compare what was recorded on a topic with what was recomputed."""
        recorded = self.raw.get(topic, [])
        found, last = _compare_topic(topic, self._as_now(recorded), messages)
        if self.begins_late and not failure and not found.equivalent:
            return replace(found, not_recomputed=self._from_before(topic, messages, last))
        after = self._counts[topic] - len(recorded)
        why = failure if recorded else ''
        if after:
            # Recorded, and not compared with anything.
            found = replace(found, recorded=self._counts[topic], largest_difference=inf)
            why = why or f'{after} came after {self._after_step}'
            why = '' if found.identical < len(recorded) and not failure else why
        # What was not to be recorded has no publishers there; what has them was lost since.
        known = self._kinds.keys() | self._publishers.keys()
        left_out = bool(messages and self._publishers) and topic not in known
        return replace(found, not_recomputed=why, left_out=left_out)

    def _as_now(self, raw: list[tuple[str, bytes]]) -> list[tuple[str, bytes]]:
        """Return messages as the current message set has them; what it added is unknown there."""
        newer = {kind: self._decoder.current(kind) for kind, _ in raw}
        found = []
        for kind, payload in raw:
            upgrade = newer[kind]
            found.append((kind, payload if upgrade is None else upgrade(payload)))
        return found

    def _from_before(self, topic: str, messages: list[_Output], last: int) -> str:
        """Say how far a difference may come from a state that began before the bag; empty if not.

        Parameters
        ----------
        topic : str
            The topic.
        messages : list
            What was recomputed on it.
        last : int
            Stamp of the last difference [ns].
        """
        space, _, name = topic.rpartition('/')
        nodes = [
            node
            for node in REPLAYABLE
            if name in {o.name for o in COMPONENTS[node].OUTPUTS}
            and f'{space}/{node}' in self.nodes
        ]
        began = f'the state of {" or ".join(nodes)} began before the bag'
        firsts = [self.driven_from(space, COMPONENTS[node]) for node in nodes]
        if all(first is not None and last < first for first in firsts):
            return f'{began}, and so did what differs'
        after = [stamp for _, _, stamp, _ in messages if stamp > last]
        if len(after) > len(messages) // 2:
            return f'{began}; equal from {after[0] / SECOND:.3f} s on, {len(after)} messages'
        if nodes == [TemperatureAcquisition.NAME]:
            # Its verdict on a sensor follows from hours of readings; the reference alone is kept.
            return f'{began}, and nothing in it holds that state'
        if nodes == [ThermalPredictor.NAME] and self._learns(space):
            return f'{began}, and what is latched of its learning does not hold all of it'
        if any(o.persistent for node in nodes for o in COMPONENTS[node].OUTPUTS):
            return ''
        return f'{began}, and nothing in it holds that state'

    def _learns(self, space: str) -> bool:
        """Return whether the predictor of a machine learns from probes."""
        topic = f'{space}/thermal_posterior'
        return topic in self._heads or topic in self._counts

    def arithmetic(self, nodes: Iterable[str]) -> str | None:
        """Say how what some nodes computed with differs from here; None where one is unknown."""
        told = {item.version.partition(' ')[2] for node in nodes for item in self.nodes[node]}
        return None if '' in told else apart(told, arithmetic())

    def not_recomputed(
        self, outputs: Collection[str], given: Sequence[str]
    ) -> tuple[list[TopicComparison], list[GivenTopic]]:
        """Return recorded topics that should have been recomputed, and those taken as given."""
        origins = Origins(self._kinds, set(self.nodes), self._traces(), self._publishers, given)
        lost, taken = [], []
        for topic, count in self._counts.items():
            origin = origins.of(topic) if topic not in outputs else None
            if origin is None or not count:
                continue
            if origin.given:
                taken.append(GivenTopic(topic, count, origin.text))
            else:
                lost.append(
                    TopicComparison(
                        topic, count, 0, 0, largest_difference=inf, not_recomputed=origin.text
                    )
                )
        return lost, taken

    def check_given(self, given: Sequence[str]) -> None:
        """Refuse topics said to be given of which the bag has none."""
        there = {name for topic in self._kinds for name in (topic, topic.rpartition('/')[2])}
        if unknown := [topic for topic in given if topic not in there]:
            raise ReplayError(
                f'given topics: expected some of the bag but found {", ".join(unknown)}; '
                f'it has {", ".join(sorted(self._kinds))}'
            )

    def _traces(self) -> set[str]:
        """Return the nodes, each in its namespace, that events, turns and topics tell of."""
        found = set()
        for topic in self._kinds:
            parent, _, name = topic.rpartition('/')
            if name == 'transition_event':
                found.add(parent)
            elif parent.endswith('/machine_tick'):
                found.add(f'{parent.rpartition("/")[0]}/{name}')
            elif name in ('node_event', 'deadline_fired'):
                for record in self.records(topic, _TOLD_OF[name]):
                    found.add(f'{parent}/{record.node}')
        return found


class _BoundedMerger(Merger):
    """A merge that a bag whose stamps are wrong cannot keep busy for ever."""

    deadlines_left = 0
    """Number of deadlines that may still fire."""

    def fire(self, deadline: int) -> list[Emission]:
        """Fire one deadline of the component."""
        self.deadlines_left -= 1
        if self.deadlines_left < 0:
            raise ReplayError(
                f'{self.component.NAME}: expected stamps of one recording but up to '
                f'{deadline / SECOND:.0f} s there are far more deadlines than recorded messages; '
                'cut the bag where the stamps jump'
            )
        return super().fire(deadline)


class _ComponentReplay:
    """One component, set up and driven as recorded."""

    failure = ''
    """Why its outputs could not be recomputed."""

    def __init__(self, recording: _BagMessages, name: str) -> None:
        self._recording = recording
        self._space, node = name.rsplit('/', 1)
        configurations = recording.nodes[name]
        self.notes: list[str] = []
        kind = COMPONENTS[node]
        self._component: Component = kind(_config(kind, configurations[0]))
        self._component.machine = configurations[0].frame_id.split('/')[0]
        self._merger = _BoundedMerger(self._component)
        self.outputs: dict[str, list[_Output]] = {
            f'{self._space}/{item.name}': [] for item in kind.OUTPUTS
        }
        events = recording.records(f'{self._space}/node_event', NodeEvent)
        self._events = [item for item in events if item.node == node]
        self._refused = {
            (str(found.get('input')), str(found.get('stamp')))
            for found in (_arguments(item) for item in self._events if item.name == REFUSED)
        }
        self._inputs = {item.name: self._taken(item) for item in kind.INPUTS}
        self._points = self._collect_points(configurations)
        told = sum(len(recording.raw.get(topic, ())) for topic in self.outputs)
        self._merger.deadlines_left = DEADLINES_MAX + 10 * (told + len(self._points))
        self._begin(configurations[0])
        self._joint = self._find_joint()

    def _begin(self, first: NodeConfiguration) -> None:
        """Give the component what it had when the bag began, as far as the bag says."""
        component, late = self._component, self._recording.begins_late
        began = self._recording.driven_from(self._space, type(component)) if late else None
        for item in component.OUTPUTS:
            topic = f'{self._space}/{item.name}'
            known = self._recording.head(topic, item.record)
            if began is not None and item.persistent:
                # It follows from what came before the bag, but was told in it.
                told = self._recording.records(topic, item.record)
                known += [record for record in told if record.stamp < began]
            for record in known:
                component.restore(item.name, record)
        component.prepare(first.model, read_run)
        if late and first.model and component.model_text != first.model:
            component.on_request('use_model', {'model': first.model}, first.stamp)
        if late and component.MANAGED and first.lifecycle_state == 'active':
            component.on_request('activate', {}, first.stamp)

    def run(self) -> None:
        """Work through the recording in the order of machine time."""
        for name, records in self._inputs.items():
            for record in records:
                self._merger.push(name, record)
        for stamp, change in self._points:
            self._join(stamp)
            if isinstance(change, NodeEvent):
                self._request(change)
            elif change is not None:
                self._reconfigure(change)
            else:
                self._keep(self._merger.advance(stamp))

    def _join(self, stamp: int) -> None:
        """Take up the state that an output told, once machine time comes to it.

        What the component gave before rests on nothing.
        """
        if self._joint is not None and stamp >= self._joint[1].stamp:
            name, record = self._joint
            self._joint = None
            self._merger.advance(record.stamp)
            self._component.restore(name, record)
            for messages in self.outputs.values():
                messages.clear()

    def _find_joint(self) -> tuple[str, Record] | None:
        """Return the output that tells the state of a component whose beginning is missing.

        It is caused by a driving record, since then what it follows from is in the bag, too.  None
        for components that take up what is latched, or nothing.
        """
        kind = type(self._component)
        persistent = any(item.persistent for item in kind.OUTPUTS)
        if not self._recording.begins_late or persistent or kind.restore is Component.restore:
            return None
        drives = next((item.name for item in kind.INPUTS if item.driving), '')
        stamps = {record.stamp for record in self._inputs.get(drives, [])[1:]}
        for item in kind.OUTPUTS:
            for record in self._recording.records(f'{self._space}/{item.name}', item.record):
                if record.stamp in stamps:
                    return item.name, record
        return None

    def _taken(self, source: Input) -> list[Any]:
        """Return the records of an input but for those that the host refused."""
        topic = f'{self._space}/{source.name}'
        records = self._recording.head(topic, source.record)
        records += self._recording.records(topic, source.record)
        return [item for item in records if (source.name, str(item.stamp)) not in self._refused]

    def _collect_points(self, configurations: list[NodeConfiguration]) -> list[_Point]:
        """Return turns, fired deadlines, requests and changes, in the order of machine time."""
        node = self._component.NAME
        turns = self._recording.records(f'{self._space}/machine_tick/{node}', MachineTick)
        stamps = [turn.stamp for turn in turns if not turn.probe] or self._real_time_stamps()
        points: list[_Point] = [(stamp, None) for stamp in stamps]
        points += [(event.stamp, event) for event in self._events if event.name != REFUSED]
        points += [(change.stamp, change) for change in configurations[1:]]
        # At one stamp the node first works up to it, then hears requests: so it was live.
        return sorted(points, key=lambda point: (point[0], point[1] is not None))

    def _real_time_stamps(self) -> list[int]:
        fired = self._recording.records(f'{self._space}/deadline_fired', DeadlineFired)
        stamps = {item.stamp for item in fired if item.node == self._component.NAME}
        for item in self._component.INPUTS:
            if item.driving:
                stamps.update(record.stamp for record in self._inputs[item.name])
        return sorted(stamps)

    def _request(self, event: NodeEvent) -> None:
        arguments = _arguments(event)
        try:
            answer = self._component.on_request(event.name, arguments, event.stamp)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            # Live, the types of the service hold what the text of an event need not.
            raise ReplayError(
                f'{event.node}: request {event.name}: expected its arguments but found '
                f'{event.request[:60]!r}: {error}'
            ) from error
        if answer.success:
            self._keep(answer.emissions)
            return
        self.failure = f'{event.node}: {event.name} could not be repeated: {answer.message}'
        self.notes.append(self.failure)

    def _reconfigure(self, record: NodeConfiguration) -> None:
        config = _config(type(self._component), record)
        if config != self._component.configuration:
            self._component.reconfigure(config)

    def _keep(self, emissions: Sequence[Emission] | tuple[Emission, ...]) -> None:
        for emission in emissions:
            topic = f'{self._space}/{emission.output}'
            record: Record = emission.record
            message = encode(record, ROSBAGS)
            self.outputs[topic].append((topic, record.TYPE, record.stamp, message))


def _config(kind: type[Component], record: NodeConfiguration) -> Config:
    """Return the configuration that a node had.

    Raises
    ------
    ReplayError
        If it is none of this component.
    """
    values = _object(record.parameters, f'{record.node}: parameters')
    gone = kind.CONFIG.GONE
    try:
        return kind.CONFIG(**{k: v for k, v in values.items() if k not in gone or v != gone[k]})
    except (TypeError, ValueError) as error:
        raise ReplayError(f'{record.node}: parameters: {error}') from error


def _arguments(event: NodeEvent) -> dict[str, Any]:
    """Return what an event was requested with.

    Raises
    ------
    ReplayError
        If its text holds no arguments.
    """
    return _object(event.request, f'{event.node}: request {event.name}')


def _object(text: str, where: str) -> dict[str, Any]:
    """Return the JSON object that a message holds as text.

    Raises
    ------
    ReplayError
        If it holds none.
    """
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ReplayError(f'{where}: expected JSON but: {error}') from error
    if not isinstance(found, dict):
        raise ReplayError(f'{where}: expected a JSON object but found {text[:60]!r}')
    return found


def _compare_topic(
    topic: str, recorded: list[tuple[str, bytes]], recomputed: list[_Output]
) -> tuple[TopicComparison, int]:
    """Compare recorded messages of a topic, type and bytes, with recomputed ones.

    Also returns the stamp of the last difference [ns]; 0 without one.
    """
    before, after = _by_stamp(recorded), _by_stamp((k, m) for _, k, _, m in recomputed)
    identical, difference, largest, last = 0, '', 0.0, 0
    magnitudes: dict[str, float] = {}
    for stamp in sorted(before.keys() | after.keys()):
        old, new = Counter(before.get(stamp, ())), Counter(after.get(stamp, ()))
        identical += (old & new).total()
        # Of several messages of one stamp the order is chance.
        for was, now in zip_longest((old - new).elements(), (new - old).elements()):
            if was is None or now is None:
                apart, what = inf, 'not recomputed' if now is None else 'not recorded'
            else:
                what = 'differs'
                if not magnitudes:
                    for kind, payload in recorded:
                        _note_magnitudes(deserialize(payload, kind), magnitudes)
                first, second = (deserialize(m, kind) for kind, m in (was, now))
                apart = relative_difference(first, second, magnitudes)
            largest, last = max(largest, apart), stamp
            difference = difference or f'{what}, at machine time {stamp / SECOND:.3f} s'
    counts = len(recorded), len(recomputed), identical
    return TopicComparison(topic, *counts, difference, largest), last


def _by_stamp(messages: Iterable[tuple[str, Any]]) -> dict[int, list[tuple[str, bytes]]]:
    """Return type and canonical bytes by stamp [ns].

    One message that is missing must not make all that follow it look different.
    """
    found = defaultdict(list)
    for kind, message in messages:
        payload = canonical_message(message, kind)
        found[stamp_of(payload)].append((kind, payload))
    return found


def _note_magnitudes(value: Any, found: dict[str, float], name: str = '') -> None:
    """Raise the largest magnitude of each field of numbers to that in a message of rosbags."""
    if isinstance(value, (float, np.ndarray)):
        numbers = np.abs(np.asarray(value))
        largest = float(numbers[np.isfinite(numbers)].max(initial=0.0))
        found[name] = max(found.get(name, 0.0), largest)
    elif isinstance(value, (list, tuple)):
        for item in value:
            _note_magnitudes(item, found, name)
    elif not isinstance(value, (str, int, bool)):
        for item in fields(value):
            _note_magnitudes(getattr(value, item.name), found, f'{name}.{item.name}')


def relative_difference(
    first: Any, second: Any, magnitudes: Mapping[str, float] | None = None, name: str = ''
) -> float:
    """Return the largest relative difference [-] between two messages of rosbags.

    Infinite if a text, a count, a flag or a length differs; NaN and infinities are equal to
    themselves alone.

    Parameters
    ----------
    first, second : message
        Messages, or what a field of them holds.
    magnitudes : mapping, optional
        Largest magnitude of each field in the topic; by it numbers near zero are judged.
    name : str
        Name of the field.
    """
    if type(first) is not type(second):
        return inf
    if isinstance(first, (float, np.ndarray)):
        a, b = np.asarray(first), np.asarray(second)
        if a.shape != b.shape:
            return inf
        if a.dtype.kind != 'f':
            return 0.0 if np.array_equal(a, b) else inf
        finite = np.isfinite(a) & np.isfinite(b)
        if not np.array_equal(a[~finite], b[~finite], equal_nan=True):
            return inf
        a, b = a[finite], b[finite]
        least = SMALL * (magnitudes or {}).get(name, 0.0)
        size = np.maximum(np.maximum(np.abs(a), np.abs(b)), least)
        with np.errstate(over='ignore'):  # of the largest numbers, which then differ enough
            apart = np.divide(np.abs(a - b), size, out=np.zeros_like(size), where=size > 0.0)
        return float(np.max(apart, initial=0.0))
    if isinstance(first, (list, tuple)):
        if len(first) != len(second):
            return inf
        pairs = zip(first, second, strict=True)
        return max((relative_difference(a, b, magnitudes, name) for a, b in pairs), default=0.0)
    if isinstance(first, (str, int, bool)):
        return 0.0 if first == second else inf
    return max(
        (
            relative_difference(getattr(first, n), getattr(second, n), magnitudes, f'{name}.{n}')
            for n in (item.name for item in fields(first))
        ),
        default=0.0,
    )
