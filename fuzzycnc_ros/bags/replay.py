# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Deterministic replay: recompute every component's outputs from the recorded inputs.

Each component is set up as its recorded `node_configuration` says, gets its recorded inputs,
turns and requests in the order of machine time, and must give the recorded outputs again, byte
for byte in canonical form.
"""

import json
import os
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from itertools import compress
from math import inf
from typing import Any

import numpy as np

from fuzzycnc_ros.bags.canonical import canonical_message, combined_hash, topic_hashes
from fuzzycnc_ros.bags.playback import stamp_of
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.runs import read_run
from fuzzycnc_ros.bags.typestore import ROSBAGS, deserialize
from fuzzycnc_ros.components.thermal.sensor_selector import SensorSelector
from fuzzycnc_ros.components.thermal.thermal_predictor import ThermalPredictor
from fuzzycnc_ros.core.config import Config
from fuzzycnc_ros.registry import COMPONENTS, MACHINES
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
"""What a replay reads beside the topics of components; pictures of a camera fill no memory."""

LATE = 5 * SECOND
"""Log time [ns] within which the last messages before a step of the clock arrive."""

DEADLINES_MAX = 500
"""Deadlines that may fire without a trace; beside them, ten for each recorded message and turn."""

ROUNDING = 1e-9
"""Relative difference that linear algebra on another processor may cause [-]."""

SMALL = 1e-3
"""Share of the largest magnitude of a field in its topic [-] below which a number counts as that
share: next to a velocity of 0.1 m/s, 3e-16 and -3e-16 m/s are the same zero."""

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

    @property
    def equal(self) -> bool:
        """Whether nothing differs."""
        return self.recorded == self.recomputed == self.identical

    @property
    def equivalent(self) -> bool:
        """Whether nothing differs but the rounding of another processor's arithmetic."""
        return self.equal or self.largest_difference <= ROUNDING


@dataclass(frozen=True)
class ReplayReport:
    """Outcome of a replay.

    Attributes
    ----------
    topics : list of TopicComparison
        One entry per recomputed topic.
    hashes : dict of str to str
        SHA-256 of the canonical form of each recomputed topic.
    notes : list of str
        What could not be repeated as recorded, and why.
    """

    topics: list[TopicComparison]
    hashes: dict[str, str]
    notes: list[str] = field(default_factory=list)

    @property
    def identical(self) -> bool:
        """Whether every output came out as recorded, byte for byte."""
        return bool(self.topics) and all(item.equal for item in self.topics)

    @property
    def equivalent(self) -> bool:
        """Whether every output came out as recorded, up to rounding."""
        return bool(self.topics) and all(item.equivalent for item in self.topics)

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
    progress: Progress | None = None,
) -> ReplayReport:
    """Recompute the outputs of a bag's components and compare them with the recorded ones.

    Parameters
    ----------
    path : path
        Bag of a run, live or simulated.
    nodes : sequence of str
        Only these nodes; all that the bag describes if empty.
    progress : callable, optional
        Told before each component.

    Raises
    ------
    BagError
        If the bag cannot be read.
    ReplayError
        If it holds no configuration of a component, so that nothing can be set up.
    """
    with BagReader(path) as reader:
        recording = _Recording(reader)
    wanted = [name for name in recording.nodes if not nodes or name.split('/')[-1] in nodes]
    if not wanted:
        raise ReplayError(
            f'{path}: expected node_configuration messages of '
            f'{", ".join(nodes) or ", ".join(_replayable())} but found '
            f'{", ".join(recording.nodes) or "none"}; record all topics of the machine'
        )
    topics, outputs, notes = [], [], list(recording.notes)
    for done, name in enumerate(wanted):
        if progress is not None:
            progress(name, done, len(wanted))
        player = _ComponentReplay(recording, name)
        player.run()
        notes.extend(player.notes)
        for topic, messages in player.outputs.items():
            outputs.extend(messages)
            topics.append(_compare_topic(topic, recording.raw.get(topic, []), messages))
    return ReplayReport(topics, topic_hashes(outputs), notes)


def _replayable() -> list[str]:
    return [name for name in COMPONENTS if name not in MACHINES]


def _stamp(message: tuple[str, bytes]) -> int:
    return stamp_of(message[1])


def _step_of(event: NodeEvent) -> int:
    try:
        return int(json.loads(event.request)['step'])
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
        return 0


@dataclass(frozen=True)
class _SeriesEnd:
    """Where a clock was set: a new series of stamps begins.

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


class _Recording:
    """The messages of a bag, by topic."""

    def __init__(self, reader: BagReader) -> None:
        self.raw: dict[str, list[tuple[str, bytes]]] = defaultdict(list)
        known = set(_PLUMBING)
        for component in COMPONENTS.values():
            known.update(item.name for item in component.INPUTS)
            known.update(item.name for item in component.OUTPUTS)
        wanted = [
            topic for topic in reader.connections if not known.isdisjoint(topic.split('/')[-2:])
        ]
        self._decoder = reader.decoder
        self.notes: list[str] = []
        end: _SeriesEnd | None = None
        for topic, kind, logged, payload in reader.messages(wanted, raw=True):
            if end is None and topic.endswith('/node_event') and CLOCK_STEP.encode() in payload:
                event = decode(NodeEvent, self._decoder.decode(kind)(payload))
                if event.name == CLOCK_STEP:
                    self.notes.append(
                        f'the clock of {event.node} was set at {event.stamp / SECOND:.3f} s: what '
                        'came after it is not replayed, as its stamps are a series of their own'
                    )
                    told = {name: len(messages) for name, messages in self.raw.items()}
                    end = _SeriesEnd(event.stamp, _step_of(event), logged, told)
                    continue
            if end is not None and logged > end.logged + LATE + max(end.step, 0):
                break
            self.raw[topic].append((kind, payload))
        if end is not None:
            for topic, messages in self.raw.items():
                kept = end.kept(
                    topic, zip(self._senders(topic), map(_stamp, messages), strict=True)
                )
                self.raw[topic] = list(compress(messages, kept))
        self.nodes: dict[str, list[NodeConfiguration]] = defaultdict(list)
        """Configurations by namespace and node."""
        for topic in list(self.raw):
            if topic.rsplit('/', 1)[-1] != 'node_configuration':
                continue
            space = topic.rsplit('/', 1)[0]
            for record in self.records(topic, NodeConfiguration):
                if record.node in _replayable():
                    self.nodes[f'{space}/{record.node}'].append(record)

    def _senders(self, topic: str) -> list[str]:
        """Return the node that each message of a topic tells of; empty where one node has it."""
        told_of = _TOLD_OF.get(topic.rsplit('/', 1)[-1])
        if told_of is None:
            return [''] * len(self.raw[topic])
        return [record.node for record in self.records(topic, told_of)]

    def records(self, topic: str, record_type: type[Any]) -> list[Any]:
        """Return the messages of a topic as records; none if it was not recorded."""
        return [
            decode(record_type, self._decoder.decode(kind)(payload))
            for kind, payload in self.raw.get(topic, [])
        ]


class _BoundedMerger(Merger):
    """A merge that a bag whose stamps are wrong cannot keep busy for ever."""

    deadlines_left = 0
    """How many deadlines may still fire."""

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

    def __init__(self, recording: _Recording, name: str) -> None:
        self._recording = recording
        self._space, node = name.rsplit('/', 1)
        configurations = recording.nodes[name]
        self.notes: list[str] = []
        kind = COMPONENTS[node]
        self._component: Component = kind(_config(kind, configurations[0]))
        self._component.machine = configurations[0].frame_id.split('/')[0]
        if isinstance(self._component, SensorSelector):
            self._component.run_reader = read_run
        self._merger = _BoundedMerger(self._component)
        self.outputs: dict[str, list[tuple[str, str, int, Any]]] = {
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
        first = configurations[0]
        if isinstance(self._component, ThermalPredictor) and first.model:
            self._component.use_model(first.model)

    def run(self) -> None:
        """Work through the recording in the order of machine time."""
        for name, records in self._inputs.items():
            for record in records:
                self._merger.push(name, record)
        for stamp, change in self._points:
            if isinstance(change, NodeEvent):
                self._request(change)
            elif change is not None:
                self._reconfigure(change)
            else:
                self._keep(self._merger.advance(stamp))

    def _taken(self, source: Input) -> list[Any]:
        """Return the records of an input but for those that the host refused."""
        records = self._recording.records(f'{self._space}/{source.name}', source.record)
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
        self.notes.append(f'{event.node}: {event.name} could not be repeated: {answer.message}')
        for item in self._component.OUTPUTS:
            # What the request gave live still counts for those who read it; it is not recomputed.
            self.outputs.pop(f'{self._space}/{item.name}', None)

    def _reconfigure(self, record: NodeConfiguration) -> None:
        config = _config(type(self._component), record)
        if config != self._component.configuration:
            self._component.reconfigure(config)

    def _keep(self, emissions: Sequence[Emission] | tuple[Emission, ...]) -> None:
        for emission in emissions:
            topic = f'{self._space}/{emission.output}'
            if topic in self.outputs:
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
    topic: str, recorded: list[tuple[str, bytes]], recomputed: list[tuple[str, str, int, Any]]
) -> TopicComparison:
    """Compare recorded messages of a topic, type and bytes, with recomputed ones.

    Parameters
    ----------
    topic : str
        The topic.
    recorded : list
        Type and bytes of each message.
    recomputed : list
        Topic, type, stamp [ns] and message of each.
    """
    before, after = _by_stamp(recorded), _by_stamp((k, m) for _, k, _, m in recomputed)
    identical, difference, largest = 0, '', 0.0
    magnitudes: dict[str, float] = {}
    for key in sorted(set(before) | set(after)):
        if key not in before or key not in after:
            apart, what = inf, 'not recomputed' if key in before else 'not recorded'
        else:
            (kind, old), (_, new) = before[key], after[key]
            if old == new:
                identical += 1
                continue
            what = 'differs'
            if not magnitudes:
                for each_kind, payload in before.values():
                    _note_magnitudes(deserialize(payload, each_kind), magnitudes)
            messages = deserialize(old, kind), deserialize(new, kind)
            apart = relative_difference(*messages, magnitudes)
        largest = max(largest, apart)
        difference = difference or f'{what}, at machine time {key[0] / SECOND:.3f} s'
    return TopicComparison(topic, len(recorded), len(recomputed), identical, difference, largest)


def _by_stamp(messages: Iterable[tuple[str, Any]]) -> dict[tuple[int, int], tuple[str, bytes]]:
    """Return type and canonical bytes by stamp [ns] and number among those of the stamp.

    One message that is missing must not make all that follow it look different.
    """
    seen: Counter[int] = Counter()
    found = {}
    for kind, message in messages:
        payload = canonical_message(message, kind)
        stamp = stamp_of(payload)
        found[stamp, seen[stamp]] = (kind, payload)
        seen[stamp] += 1
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

    Infinite if a text, a count, a flag or a length differs, or a NaN stands against a number.

    Parameters
    ----------
    first, second : message
        Messages, or what a field of them holds.
    magnitudes : mapping, optional
        Largest magnitude of each field in the topic; by it numbers near zero are judged.
    name : str
        Name of the field.
    """
    if isinstance(first, (float, np.ndarray)):
        a, b = np.asarray(first), np.asarray(second)
        if a.shape != b.shape:
            return inf
        if a.dtype.kind != 'f':
            return 0.0 if np.array_equal(a, b) else inf
        if not np.array_equal(np.isnan(a), np.isnan(b)):
            return inf
        least = SMALL * (magnitudes or {}).get(name, 0.0)
        size = np.maximum(np.maximum(np.abs(a), np.abs(b)), least)
        apart = np.divide(np.abs(a - b), size, out=np.zeros_like(size), where=size > 0.0)
        return float(np.nanmax(apart, initial=0.0))
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
