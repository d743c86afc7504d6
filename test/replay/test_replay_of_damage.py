# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A bag that has lost, gained or mixed up messages is never called identical in vain."""

import itertools
import json
import random
import shutil
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from benches import predictor_bench
from fuzzing.campaign import SEEDS, fuzz
from fuzzing.file_mutations import mutated_bytes
from hypothesis import given
from recorded_scenarios import HOUR, PROBED, golden_model

from fuzzycnc_ros.bags.canonical import topic_hashes
from fuzzycnc_ros.bags.errors import BagError
from fuzzycnc_ros.bags.mcapfile import McapFile
from fuzzycnc_ros.bags.metadata import Profiles, is_latched
from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.bags.repair import repair
from fuzzycnc_ros.bags.typestore import deserialize, serialize
from fuzzycnc_ros.bags.writer import BagWriter
from fuzzycnc_ros.components.machine.simulated_machine import (
    SimulatedMachine,
    SimulatedMachineConfig,
)
from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.components.thermal.compensator import Compensator
from fuzzycnc_ros.components.thermal.sensor_selector import SensorSelector
from fuzzycnc_ros.components.thermal.temperature_acquisition import TemperatureAcquisition
from fuzzycnc_ros.components.thermal.thermal_predictor import ThermalPredictor
from fuzzycnc_ros.registry import COMPONENTS
from fuzzycnc_ros.replay.replay import ReplayError, ReplayReport, TopicComparison, replay
from fuzzycnc_ros.runtime.arithmetic import arithmetic
from fuzzycnc_ros.runtime.graph import InProcessGraph
from fuzzycnc_ros.runtime.host import NodeEvent
from fuzzycnc_ros.runtime.provenance import configuration_record
from fuzzycnc_ros.studies.contour.contouring import run_contouring
from fuzzycnc_ros.studies.published_bag import PublishedBag
from fuzzycnc_ros.studies.shift.thermal_shift import run_shift
from fuzzycnc_ros.studies.soft.pattern import run_patterns

pytestmark = [pytest.mark.replay, pytest.mark.filterwarnings('ignore::RuntimeWarning')]

NODES = ('temperature_acquisition', 'thermal_predictor', 'compensator')
"""Nodes of the thermal run that publish something."""


@dataclass(frozen=True)
class Logged:
    """A message as it lies in a bag."""

    topic: str
    log_time: int
    publish_time: int
    sequence: int
    payload: bytes


@dataclass(frozen=True)
class Bag:
    """A bag in memory: type and QoS of each topic, and the messages."""

    topics: dict[str, tuple[str, Profiles]]
    messages: tuple[Logged, ...]
    recording: dict[str, object] | None = None
    """What the recorder says."""

    @classmethod
    def read(cls, path: Path) -> 'Bag':
        """Read a bag."""
        with BagReader(path) as reader:
            topics = {k: (item.type, item.profiles) for k, item in reader.connections.items()}
            messages = tuple(
                Logged(m.channel.topic, m.log_time, m.publish_time, m.sequence, m.payload)
                for m in reader.raw_messages()
            )
        return cls(topics, messages)

    def write(self, path: Path) -> Path:
        """Write a bag anew."""
        shutil.rmtree(path, ignore_errors=True)
        with BagWriter(path, flush_interval=None, chunk_size=4096) as writer:
            for topic, (kind, profiles) in self.topics.items():
                writer.add_topic(topic, kind, profiles)
            for m in self.messages:
                writer.write(m.topic, m.log_time, m.publish_time, m.payload, m.sequence)
            if self.recording is not None:
                writer.attach('recording.json', json.dumps(self.recording), 'application/json')
        return path

    def without(self, drop: Callable[[Logged], bool]) -> 'Bag':
        """Return the bag without some messages."""
        return replace(self, messages=tuple(m for m in self.messages if not drop(m)))

    def renamed(self, old: str, new: str) -> 'Bag':
        """Return the bag with another name of a topic."""
        topics = {new if k == old else k: kind for k, kind in self.topics.items()}
        messages = tuple(replace(m, topic=new) if m.topic == old else m for m in self.messages)
        return replace(self, topics=topics, messages=messages)

    def reversed_ties(self, *, numbered: bool) -> 'Bag':
        """Return the bag with messages of equal log time in reverse."""
        found: list[Logged] = []
        for _, group in itertools.groupby(self.messages, lambda m: m.log_time):
            found += [
                m if numbered else replace(m, sequence=0, publish_time=m.log_time)
                for m in list(group)[::-1]
            ]
        return replace(self, messages=tuple(found))


RENAMED = '_renamed'
"""What is put behind the name of a topic."""


def configures(message: Logged, node: str) -> bool:
    """Whether a message is the configuration of a node."""
    return message.topic.endswith('node_configuration') and node.encode() in message.payload[:120]


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp('damage')


@pytest.fixture(scope='module')
def thermal(folder):
    """An hour of the thermal graph."""
    with PublishedBag(folder / 'thermal') as sink:
        graph = InProcessGraph(
            SimulatedMachine(SimulatedMachineConfig(duties=('D0',))),
            [TemperatureAcquisition(), SensorSelector(), ThermalPredictor(), Compensator()],
            sink=sink,
            provenance=True,
        )
        graph.request('thermal_predictor', 'use_model', model=predictor_bench.model_text())
        graph.request('compensator', 'activate')
        for _ in range(60):
            graph.step()
    return Bag.read(folder / 'thermal')


@pytest.fixture(scope='module')
def motion(folder):
    """A path that is followed and a pattern that is stitched."""
    with PublishedBag(folder / 'contour') as sink:
        run_contouring(('trident',), FeedrateSchedulerConfig(), sink=sink)
    machine = SimulatedMachineConfig(sheet_seed=-1, path_timeout=2.0)
    with PublishedBag(folder / 'pattern') as sink:
        run_patterns(('parallelogram:45:base=0.024:side=0.018',), '', machine=machine, sink=sink)
    return [Bag.read(folder / name) for name in ('contour', 'pattern')]


def test_what_was_recorded_is_identical(thermal, folder):
    report = replay(thermal.write(folder / 'a'))
    assert report.identical
    assert {item.topic for item in report.topics if item.recorded} == {
        '/mill/temperatures',
        '/mill/thermal_reference',
        '/mill/thermal_error',
        '/mill/predictor_state',
        '/mill/compensation',
    }
    given = {item.topic: (item.recorded, item.origin) for item in report.given}
    assert given['/mill/sensor_readings'] == (60, 'of the machine')


@pytest.mark.parametrize('node', NODES)
def test_outputs_of_a_node_whose_configuration_is_lost_are_named(thermal, folder, fuzzycnc, node):
    bag = thermal.without(lambda m: configures(m, node)).write(folder / 'a')
    report = replay(bag)
    assert not report.equivalent
    told = {message.topic for message in thermal.messages}
    outputs = [item for item in COMPONENTS[node].OUTPUTS if f'/mill/{item.name}' in told]
    assert outputs
    for output in outputs:
        (row,) = (item for item in report.topics if item.topic == f'/mill/{output.name}')
        assert row.recorded > 0
        assert row.recomputed == row.identical == 0
        assert row.not_recomputed == f'the bag has no node_configuration of /mill/{node}'
    outcome = fuzzycnc('replay', bag)
    assert outcome.code == 1
    last = outcome.out.splitlines()[-1]
    assert last.startswith('NOT ALL RECOMPUTED: /mill/')


def test_a_repaired_bag_that_has_lost_configurations_is_not_identical(thermal, folder):
    bag = thermal.write(folder / 'a')
    file = next(bag.glob('*.mcap'))
    data = bytearray(file.read_bytes())
    with McapFile(file) as opened:
        begin = opened.chunks[1].offset + 10  # configurations of most nodes
    data[begin : begin + 40] = bytes(40)
    file.write_bytes(data)
    shutil.rmtree(folder / 'b', ignore_errors=True)
    assert repair(bag, folder / 'b').damage
    assert not replay(folder / 'b').equivalent


@pytest.mark.parametrize('numbered', [True, False])
def test_messages_of_one_log_time_may_lie_in_reverse(thermal, folder, numbered):
    # All of a sample is logged late: several stamps of a topic have one log time.
    late = tuple(replace(m, log_time=-(-m.log_time // 10**12) * 10**12) for m in thermal.messages)
    bag = replace(thermal, messages=late)
    assert replay(bag.write(folder / 'a')).identical
    assert replay(bag.reversed_ties(numbered=numbered).write(folder / 'a')).identical


@pytest.mark.slow
@pytest.mark.parametrize('numbered', [True, False])
def test_motion_in_reverse(motion, folder, numbered):
    for bag in motion:
        assert replay(bag.reversed_ties(numbered=numbered).write(folder / 'a')).identical


def test_a_node_of_another_maker_is_believed_where_the_recorder_saw_it(thermal, folder):
    """A temperature source of one's own writes `temperatures`: nothing else of it is there."""
    own = ('/mill/machine_tick/temperature_acquisition', '/mill/sensor_readings')
    bag = thermal.without(lambda m: m.topic in own or configures(m, 'temperature_acquisition'))
    bag = replace(bag, topics={k: kind for k, kind in bag.topics.items() if k not in own})
    topics = ('/mill/temperatures', '/mill/thermal_reference')
    report = replay(bag.write(folder / 'a'))
    assert {item.topic for item in report.topics if item.not_recomputed} == set(topics)
    assert not report.equivalent
    assert 'name it as given' in report.topics[-1].not_recomputed
    assert replay(folder / 'a', given=('temperatures', '/mill/thermal_reference')).identical
    with pytest.raises(ReplayError, match='found temperature; it has /mill/axis'):
        replay(folder / 'a', given=('temperature', '/mill/thermal_reference'))

    said = {'topics': {}, 'publishers': {t: ['/mill/my_logger'] for t in topics}}
    report = replay(replace(bag, recording=said).write(folder / 'a'))
    assert report.identical
    assert {item.origin for item in report.given if item.topic in topics} == {'of /mill/my_logger'}
    said['publishers']['/mill/node_configuration'] = ['/mill/my_logger', '/mill/compensator']
    assert not replay(replace(bag, recording=said).write(folder / 'a')).equivalent


def test_a_topic_that_was_renamed_is_not_passed_over(thermal, folder):
    bag = thermal.renamed('/mill/compensation', '/mill/offsets')
    report = replay(bag.write(folder / 'a'))
    rows = {item.topic: item for item in report.topics}
    assert 'renamed' in rows['/mill/offsets'].not_recomputed
    assert rows['/mill/compensation'].first_difference.startswith('not recorded')
    said = {'topics': {}, 'publishers': {'/mill/offsets': ['/mill/compensator']}}
    report = replay(replace(bag, recording=said).write(folder / 'a'))
    assert not report.equivalent
    assert 'another name' in report.topics[-1].not_recomputed


def test_a_topic_that_was_not_to_be_recorded_is_said_to_be_left_out(thermal, folder):
    bag = thermal.without(lambda m: m.topic == '/mill/predictor_state')
    topics = {k: kind for k, kind in bag.topics.items() if k != '/mill/predictor_state'}
    assert not replay(replace(bag, topics=topics).write(folder / 'a')).equivalent
    said = {'topics': {}, 'publishers': {'/mill/temperatures': ['/mill/temperature_acquisition']}}
    report = replay(replace(bag, topics=topics, recording=said).write(folder / 'a'))
    assert report.identical
    (row,) = (item for item in report.topics if item.left_out)
    assert (row.topic, row.recorded) == ('/mill/predictor_state', 0)
    said['publishers']['/mill/predictor_state'] = ['/mill/thermal_predictor']  # lost since
    assert not replay(replace(bag, topics=topics, recording=said).write(folder / 'a')).equivalent
    # Announced, it was to be recorded: its messages are lost.
    assert not replay(replace(bag, recording=said).write(folder / 'a')).equivalent


def test_a_request_that_cannot_be_repeated_leaves_outputs_that_were_not_recomputed(
    thermal, folder
):
    event = NodeEvent(
        stamp=thermal.messages[-1].log_time,
        node='compensator',
        name='no_such_request',
        request='{}',
    )
    with PublishedBag(folder / 'event') as sink:
        sink('node_event', event)
    (added,) = Bag.read(folder / 'event').messages
    bag = replace(thermal, messages=(*thermal.messages, added)).write(folder / 'a')
    report = replay(bag)
    assert not report.equivalent
    (row,) = (item for item in report.topics if item.not_recomputed)
    assert row.topic == '/mill/compensation'
    assert 'no_such_request could not be repeated' in row.not_recomputed


def parts(bag: Bag, path: Path, *, split: float, deleted: int) -> Path:
    """Write a bag in parts, as the recorder does, and delete the oldest ones."""
    shutil.rmtree(path, ignore_errors=True)
    with BagWriter(path, flush_interval=None, split_duration=split) as writer:
        for topic, (kind, profiles) in bag.topics.items():
            writer.add_topic(topic, kind, profiles)
        for m in bag.messages:
            if writer.is_full(m.log_time):
                writer.split(m.log_time)
            sender = next((n for n in (*COMPONENTS, '') if configures(m, n)), None)
            writer.write(
                m.topic, m.log_time, m.publish_time, m.payload, m.sequence, publisher=sender
            )
        for _ in range(deleted):
            writer.delete_oldest()
    return path


def rows(report: ReplayReport) -> dict[str, TopicComparison]:
    """Return what was compared, by topic without its namespace."""
    return {item.topic.rpartition('/')[2]: item for item in report.topics}


@pytest.mark.parametrize('how', ['budget', 'part', 'repaired'])
def test_a_bag_that_begins_in_the_middle_is_replayed_from_its_head(thermal, folder, fuzzycnc, how):
    bag = parts(thermal, folder / 'parts', split=200.0, deleted=1)
    if how == 'part':
        bag = bag / 'parts_2.mcap'
    if how == 'repaired':
        shutil.rmtree(folder / 'whole', ignore_errors=True)
        assert not repair(bag, folder / 'whole').damage
        bag = folder / 'whole'
    report = replay(bag)
    found = rows(report)
    for name in ('thermal_error', 'predictor_state'):
        assert found[name].equal, name
        assert found[name].recorded > 2
    compensation = found['compensation']
    assert compensation.recorded > compensation.recomputed == compensation.identical > 1
    told = 'the state of compensator began before the bag; equal from'
    assert compensation.not_recomputed.startswith(told)
    assert found['temperatures'].identical >= found['temperatures'].recorded - 1
    assert 'begins in the middle of a recording' in report.notes[0]
    assert not report.differing
    assert not report.equivalent
    outcome = fuzzycnc('replay', bag)
    assert outcome.code == 1
    assert 'NOT ALL RECOMPUTED: /mill/' in outcome.out


def joined(bag: Bag, share: float) -> Bag:
    """Return what a recorder gets that comes to a running graph: what is latched, then all."""
    begin, end = bag.messages[0].log_time, bag.messages[-1].log_time
    at = begin + int(share * (end - begin))
    latched: dict[tuple[str, str], Logged] = {}
    for m in bag.messages:
        if m.log_time < at and is_latched(bag.topics[m.topic][1]):
            sender = next((n for n in (*COMPONENTS, '') if configures(m, n)), '')
            latched[m.topic, sender] = replace(m, log_time=at)
    later = tuple(m for m in bag.messages if m.log_time >= at)
    return replace(bag, messages=(*latched.values(), *later))


@pytest.mark.parametrize('share', [0.3, 0.52])
def test_a_recorder_that_comes_late_has_the_nodes_begin_with_what_was_latched(
    thermal, folder, fuzzycnc, share
):
    bag = joined(thermal, share).write(folder / 'joined')
    report = replay(bag)
    found = rows(report)
    assert found['thermal_error'].equal
    assert found['thermal_error'].recorded > 2
    for name in ('predictor_state', 'thermal_reference'):
        assert found[name].recorded == found[name].identical + 1, name
        assert 'began before the bag' in found[name].not_recomputed, name
    assert not report.differing
    assert not report.equivalent
    assert 'had been at work when the recording began' in report.notes[0]
    outcome = fuzzycnc('replay', bag)
    assert outcome.code == 1
    assert 'NOT ALL RECOMPUTED: /mill/' in outcome.out


def test_an_altered_output_in_the_middle_is_a_difference_all_the_same(thermal, folder):
    bag = parts(
        rounded(thermal, '/mill/thermal_error', 1e-3), folder / 'a', split=200.0, deleted=1
    )
    report = replay(bag)
    assert report.differing
    assert rows(report)['thermal_error'].first_difference.startswith('differs')


@pytest.mark.slow
def test_a_part_of_a_learner_is_no_other_result(folder):
    """What it has learnt, and the verdicts on sensors, are not latched whole."""
    faults, parameters = (
        ('T18:jump:900:3', 'T36:stuck:1200'),
        {**HOUR, 'thermal_predictor': PROBED},
    )
    with PublishedBag(folder / 'learner') as sink:
        run_shift(golden_model(), duties=('T3',), faults=faults, parameters=parameters, sink=sink)
    bag = parts(Bag.read(folder / 'learner'), folder / 'a', split=645.0, deleted=3)
    report = replay(bag)
    assert rows(report)['thermal_error'].recorded > 10
    assert not rows(report)['thermal_error'].equal
    assert 'does not hold all of it' in rows(report)['thermal_error'].not_recomputed
    assert not report.differing
    assert not report.equivalent


@pytest.mark.slow
def test_a_recorder_that_comes_late_to_a_pattern_has_it_replayed(motion, folder):
    report = replay(joined(motion[1], 0.37).write(folder / 'joined'))
    assert 'had been at work when the recording began' in report.notes[0]
    assert rows(report)['tool_path'].recomputed > 0
    assert not report.differing


@pytest.mark.slow
def test_motion_that_begins_in_the_middle_names_whose_state_is_not_there(motion, folder):
    bag = parts(motion[0], folder / 'a', split=2.0, deleted=1)
    report = replay(bag)
    assert not report.equivalent
    why = rows(report)['trajectory'].not_recomputed
    assert why == (
        'the state of feedrate_scheduler began before the bag, and nothing in it holds that state'
    )


def rounded(bag: Bag, topic: str = '/mill/compensation', share: float = 1e-12) -> Bag:
    """Return a bag with offsets or errors that are apart by what rounding is, or by more."""

    def changed(message: Logged) -> Logged:
        if message.topic != topic:
            return message
        found = deserialize(message.payload, bag.topics[topic][0])
        name = 'offset' if topic.endswith('compensation') else 'error'
        found = replace(found, **{name: getattr(found, name) * (1.0 + share)})
        return replace(message, payload=serialize(found))

    return replace(bag, messages=tuple(map(changed, bag.messages)))


@pytest.mark.parametrize(
    ('here', 'code', 'verdict'),
    [
        (arithmetic(), 1, 'DIFFERENT'),
        (f'{arithmetic()} AVX9', 0, 'recorded on another kind of processor (nothing of it, here'),
        (f'{arithmetic()} numpy=99', 0, 'recorded with other libraries (nothing of it, here'),
    ],
)
def test_rounding_is_excused_by_other_arithmetic_alone(
    thermal, folder, fuzzycnc, monkeypatch, here, code, verdict
):
    bag = rounded(thermal).write(folder / 'a')
    monkeypatch.setattr('fuzzycnc_ros.replay.replay.arithmetic', lambda: here)
    outcome = fuzzycnc('replay', bag)
    assert outcome.code == code
    assert verdict in ' '.join(outcome.out.split())
    assert fuzzycnc('replay', bag, '--exact').code == 1


def test_nothing_to_compare_is_not_identical(folder, fuzzycnc):
    with PublishedBag(folder / 'idle') as sink:
        sink('node_configuration', configuration_record(Compensator(), 10**9, 'active'))
    assert not replay(folder / 'idle').equivalent
    outcome = fuzzycnc('replay', folder / 'idle')
    assert outcome.code == 1
    assert 'NOTHING TO COMPARE' in outcome.out


def judged(path: Path, written: Collection[str]) -> bool:
    """Whether a replay says that a bag is as recorded; then it must be so.

    The hash of each topic that was recomputed is compared with that of what the bag holds, for all
    topics that nodes of the sound bag have `written`, under whatever name.
    """
    try:
        report = replay(path)
    except ValueError:
        return False
    if report.identical or (report.equivalent and report.arithmetic == ''):
        with BagReader(path) as reader:
            own = [k for k in reader.connections if k.removesuffix(RENAMED) in written]
            found = topic_hashes(reader.messages(own, raw=True))
        assert found
        assert found == {topic: report.hashes.get(topic) for topic in found}
    return report.equivalent


def outputs(bag: Bag, folder: Path) -> set[str]:
    """Return the topics that a replay of a sound bag gives again."""
    return {item.topic for item in replay(bag.write(folder / 'sound')).topics if item.recorded}


def damaged(bag: Bag, rng: random.Random) -> Bag:
    """Return a bag with messages dropped, said twice, put elsewhere or changed."""
    messages = list(bag.messages)
    topic = rng.choice(list(bag.topics))
    node = rng.choice(list(COMPONENTS))
    choice = rng.randrange(11)
    if choice == 0:
        share = rng.choice((0.001, 0.01, 0.3))
        messages = [m for m in messages if rng.random() > share]
    elif choice == 1:
        messages = [m for m in messages if m.topic != topic]
    elif choice == 2:
        messages = [m for m in messages if m.topic != topic or rng.random() < 0.5]
    elif choice == 3:
        messages = [m for m in messages if not configures(m, node)]
    elif choice == 4:
        place = rng.randrange(len(messages))
        messages = messages[:place] if rng.random() < 0.5 else messages[place:]
    elif choice == 5:
        for _ in range(rng.choice((1, 5))):
            messages.insert(rng.randrange(len(messages)), rng.choice(messages))
    elif choice == 6:
        # Log times stay in order; what lies at them is mixed up.
        start = rng.randrange(len(messages))
        part = messages[start : start + rng.choice((2, 20, len(messages)))]
        times = [m.log_time for m in part]
        rng.shuffle(part)
        messages[start : start + len(part)] = [
            replace(m, log_time=time) for m, time in zip(part, times, strict=True)
        ]
    elif choice == 7:
        return replace(bag, messages=tuple(messages)).reversed_ties(numbered=rng.random() < 0.5)
    elif choice == 8:
        return bag.renamed(topic, f'{topic}{RENAMED}')
    else:
        at = rng.randrange(len(messages))
        payload = bytearray(messages[at].payload)
        if choice == 9 and len(payload) > 4:
            payload[rng.randrange(4, len(payload))] ^= 1 << rng.randrange(8)
        else:
            payload = payload[: rng.randrange(len(payload) + 1)]
        messages[at] = replace(messages[at], payload=bytes(payload))
    return replace(bag, messages=tuple(messages))


def damage_and_judge(bag: Bag, written: Collection[str], folder: Path, seed: int) -> bool:
    """Damage a bag, its messages or its file, and return whether it counts as recorded."""
    rng = random.Random(seed)
    if rng.random() < 0.7:
        for _ in range(rng.choice((1, 1, 3))):
            bag = damaged(bag, rng)
        return judged(bag.write(folder / 'damaged'), written)
    path = bag.write(folder / 'damaged')
    file = next(path.glob('*.mcap'))
    file.write_bytes(mutated_bytes(file.read_bytes(), rng))
    if rng.random() < 0.2:
        return judged(path, written)
    shutil.rmtree(folder / 'repaired', ignore_errors=True)
    try:
        repair(path, folder / 'repaired')
    except BagError:
        return False
    return judged(folder / 'repaired', written)


@fuzz(8, share=0.1)
@given(seed=SEEDS)
def test_damaged_bags_are_not_called_identical(thermal, folder, seed):
    damage_and_judge(thermal, outputs(thermal, folder), folder, seed)


@pytest.mark.qualify
def test_many_damaged_bags_are_not_called_identical(thermal, motion, folder):
    for bag, count in zip((thermal, *motion), (400, 40, 40), strict=True):
        written = outputs(bag, folder)
        held = [damage_and_judge(bag, written, folder, seed) for seed in range(count)]
        assert 0 < sum(held) < count
