# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Patterns on soft material over DDS: the same as in one process, bad input, a node that dies."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from live_graph import AGAIN, ANSWER_TIMEOUT, KILL_TIMEOUT
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters

from fuzzycnc_ros.bags.canonical import topic_hashes
from fuzzycnc_ros.components.machine.simulated_machine import SimulatedMachineConfig
from fuzzycnc_ros.components.motion.feedrate_scheduler_config import FeedrateSchedulerConfig
from fuzzycnc_ros.components.soft.stitch_patterns import stitch_pattern
from fuzzycnc_ros.core.deformation.model import write_model
from fuzzycnc_ros.core.deformation.network import TSFuzzyNetwork
from fuzzycnc_ros.core.deformation.stitch_path import Primitive
from fuzzycnc_ros.core.names import text_hash
from fuzzycnc_ros.replay.replay import replay
from fuzzycnc_ros.ros.topics import RCLPY, message_class, publisher_qos
from fuzzycnc_ros.runtime.component import LATCHED
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.records import (
    CompensatedPath,
    Material,
    StitchedPath,
    StitchPattern,
    TrajectoryState,
)
from fuzzycnc_ros.simulation.soft.foam_samples import foam_samples
from fuzzycnc_ros.simulation.soft.foam_tracks import FoamTrack
from fuzzycnc_ros.studies.published_bag import PublishedBag
from fuzzycnc_ros.studies.soft.pattern import STITCH_BLEND, PatternLog, run_patterns

pytestmark = pytest.mark.ros

TRACK = 'parallelogram:45:base=0.03:side=0.024'
OUTPUTS = (
    'material',
    'stitch_pattern',
    'compensated_path',
    'tool_path',
    'trajectory',
    'trajectory_state',
    'axis_state',
    'stitched_path',
)
NODES = ('deformation_compensator', 'feedrate_scheduler')


@pytest.fixture(scope='module')
def foam_model():
    """Text of a model of simulated samples."""
    return write_model(TSFuzzyNetwork().fit(*foam_samples(1000)).model_)


@pytest.fixture
def foam_file(foam_model, tmp_path):
    """The model as a file."""
    path = tmp_path / 'foam.json'
    path.write_text(foam_model, encoding='utf-8')
    return path


def start(graph, file, *, bag=None, patterns=(TRACK,), **machine):
    """Start the nodes that stitch patterns, the machine last."""
    lockstep = {'lockstep': True, 'autostart': True}
    nodes = {
        'deformation_compensator': graph.start(
            'deformation_compensator', {**lockstep, 'model': str(file)}
        ),
        'feedrate_scheduler': graph.start(
            'feedrate_scheduler', {**lockstep, 'blend': STITCH_BLEND}
        ),
    }
    if bag is not None:
        nodes['recorder'] = graph.start('recorder', {'lockstep': True, 'output': str(bag)})
    values = {
        'duties': [''],
        'patterns': list(patterns),
        'lockstep': True,
        'lockstep_nodes': list(NODES),
        'lockstep_recorder': bag is not None,
        'answer_timeout': ANSWER_TIMEOUT,
        **machine,
    }
    nodes['simulated_machine'] = graph.start('simulated_machine', values)
    return nodes


@pytest.mark.slow
def test_live_and_replayed_equal_in_process(graph, tmp_path, foam_model, foam_file):
    """Two patterns on two sheets; every output is that of the run in one process."""
    patterns = (TRACK, f'{TRACK}:thickness=0.02')
    machine = start(graph, foam_file, bag=tmp_path / 'live', patterns=patterns)[
        'simulated_machine'
    ]
    assert machine.wait() == 0
    assert machine.outcome['degraded'] is False
    graph.stop()
    with PublishedBag(tmp_path / 'alone') as bag:
        alone = run_patterns(
            patterns,
            foam_model,
            scheduler=FeedrateSchedulerConfig(blend=STITCH_BLEND),
            machine=SimulatedMachineConfig(),
            sink=bag,
        )
    live, expected = (topic_hashes(tmp_path / name) for name in ('live', 'alone'))
    for topic in OUTPUTS:
        assert live[f'/mill/{topic}'] == expected[f'/mill/{topic}'], topic
    found = PatternLog.from_bag(tmp_path / 'live').patterns()
    assert [item.name for item in found] == list(patterns)
    for ours, theirs in zip(found, alone, strict=True):
        np.testing.assert_array_equal(ours.stitched, theirs.stitched)
        assert ours.path.model == text_hash(foam_model)
    for name in ('live', 'alone'):
        report = replay(tmp_path / name)
        assert report.identical, report.topics
        assert not report.notes


@pytest.mark.slow
def test_what_was_sent_is_stitched_when_the_compensator_dies(graph, observer, foam_file):
    """Killed in mid-path: the path goes on to its end, and the next pattern is never begun."""
    states = observer.records('trajectory_state', TrajectoryState)
    stitched = observer.records('stitched_path', StitchedPath)
    nodes = start(
        graph, foam_file, patterns=(TRACK, TRACK), answer_timeout=KILL_TIMEOUT, path_timeout=2.0
    )
    observer.until(lambda: states and states[-1].arc_length > 0.02, 'the path')
    graph.kill(nodes['deformation_compensator'])
    machine = nodes['simulated_machine']
    observer.until_ended(machine)
    assert machine.outcome['degraded'] is True
    assert [item.path_id for item in stitched] == [TRACK]
    assert f'{TRACK}_2 was not followed to its end' in machine.output
    assert 'are deformation_compensator and feedrate_scheduler active' in machine.output


class Operator:
    """Publishes sheets and patterns as a person's tool would."""

    def __init__(self, observer):
        self._observer = observer
        self._writers = {
            name: observer.node.create_publisher(
                message_class(kind.TYPE), name, publisher_qos(LATCHED)
            )
            for name, kind in (('material', Material), ('stitch_pattern', StitchPattern))
        }
        self.paths = observer.records('compensated_path', CompensatedPath, LATCHED)
        observer.watch_diagnostics()
        observer.until(
            lambda: (
                all(w.get_subscription_count() for w in self._writers.values())
                and observer.hears('compensated_path')
            ),
            'the compensator',
        )

    def say(self, topic, record):
        """Publish a record."""
        self._writers[topic].publish(encode(record, RCLPY))

    def until_told(self, text):
        """Wait for the compensator's diagnostics to say something."""
        found = self._observer.statuses

        def told():
            return any(
                text in message
                for name, heard in found.items()
                if name.endswith('state')
                for _, message in heard
            )

        self._observer.until(told, f'{text}; heard {found}')


def pattern(number, path_id='track', **changes):
    """Return the pattern of a track, stamped second by second."""
    track = FoamTrack.parallelogram(np.radians(45.0))
    corners = [tuple(place) for place in track.points[list(track.corners)].tolist()]
    sides = [Primitive(start, end, 6e-3, 3e-3) for start, end in pairwise(corners)]
    made = stitch_pattern(
        sides,
        path_id=path_id,
        feed=0.021,
        stamp=number * 1_000_000_000,
        frame_id='mill/workpiece',
    )
    return replace(made, **changes)


def test_bad_input_is_told_and_the_next_pattern_taken(graph, observer, foam_model, foam_file):
    """In real time: no sheet, a foot through it, a damaged model, and then a good pattern."""
    graph.start('deformation_compensator', {'autostart': True, 'model': str(foam_file)})
    operator = Operator(observer)
    operator.say('stitch_pattern', pattern(1, 'early'))
    operator.until_told('early refused: no material')
    sheet = Material(
        stamp=2_000_000_000,
        frame_id='mill/workpiece',
        name='foam',
        thickness=15e-3,
        size=np.array([0.15, 0.1]),
    )
    operator.say('material', sheet)
    observer.settle('deformation_compensator')
    operator.say('stitch_pattern', pattern(3, 'deep', depth=np.full(4, 13e-3)))
    operator.until_told('the foot would go through the sheet')
    damaged = foam_file.with_name('damaged.json')
    damaged.write_text(foam_model[:1000], encoding='utf-8')
    answer = set_model(observer, damaged)
    assert not answer.successful
    assert 'model file: expected JSON' in answer.reason
    assert not operator.paths
    operator.say('stitch_pattern', pattern(4))
    observer.until(lambda: operator.paths, 'the compensated path')
    assert operator.paths[0].path_id == 'track'
    assert operator.paths[0].model == text_hash(foam_model)
    assert np.abs(operator.paths[0].offset).max() > 1e-3
    # no model any more: the next pattern passes as it is
    assert set_model(observer, '').successful
    operator.say('stitch_pattern', pattern(5, 'plain'))
    observer.until(lambda: len(operator.paths) == 2, 'the path without compensation')
    assert (operator.paths[1].path_id, operator.paths[1].model) == ('plain', '')
    assert not operator.paths[1].offset.any()


def set_model(observer, file):
    """Set the parameter `model`; return the answer."""
    parameter = Parameter(name='model', value=ParameterValue(type=4, string_value=str(file)))
    request = SetParameters.Request(parameters=[parameter])
    service = '/mill/deformation_compensator/set_parameters'
    return observer.call(SetParameters, service, request, again=AGAIN).results[0]


@pytest.mark.parametrize(('name', 'text'), [('model', 'model file'), ('offsets', 'offsets file')])
def test_a_damaged_file_ends_the_start(graph, tmp_path, name, text):
    (tmp_path / 'file.json').write_text('{"schema": 3', encoding='utf-8')
    node = graph.start('deformation_compensator', {name: str(tmp_path / 'file.json')})
    assert node.wait() == 2
    assert f'error: parameter {name}: ' in node.output
    assert f'{text}: expected JSON' in node.output


def test_a_missing_file_ends_the_start(graph, tmp_path):
    node = graph.start('deformation_compensator', {'model': str(tmp_path / 'none.json')})
    assert node.wait() == 2
    assert 'none.json: No such file or directory' in node.output
