# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Equivalence: one process without DDS, live over DDS, played back and replayed are alike."""

import sys

import pytest
from live_graph import ANSWER_TIMEOUT

from fuzzycnc_ros.replay.replay import replay

pytestmark = pytest.mark.ros

MACHINE = {'duties': ('T2',), 'tick_period': 60.0, 'seed': 3}
"""200 ticks."""
SOURCES = '/(sensor_readings|machine_state|compensation_applied|displacement)$'
"""What the machine publishes."""
NODES = ['temperature_acquisition', 'sensor_selector', 'thermal_predictor', 'compensator']


@pytest.fixture(scope='module')
def expected(in_process):
    """Hashes of the shift in one process."""
    return in_process.hashes(**MACHINE)


def finish(graph, machine):
    """Wait for the end of a lock-step run that proves something."""
    assert machine.wait() == 0
    assert machine.outcome['degraded'] is False
    assert machine.outcome['ticks'] == 200
    graph.stop()


def test_live_replayed_and_played_equal_in_process(
    graph, model_file, tmp_path, expected, bag_hashes
):
    """A live run, then its bag offline and on a fresh graph."""
    recorded = tmp_path / 'bag'
    nodes = graph.start_shift(model_file, bag=recorded, **MACHINE)
    finish(graph, nodes['simulated_machine'])
    assert bag_hashes(recorded) == expected
    report = replay(recorded)
    assert report.identical, report.topics

    played = tmp_path / 'played'
    graph.start_shift(model_file, bag=played, without=('simulated_machine',), **MACHINE)
    parameters = {
        'bag': str(recorded),
        'topics': SOURCES,
        'lockstep': True,
        'lockstep_nodes': NODES,
        'lockstep_recorder': True,
        'answer_timeout': ANSWER_TIMEOUT,
    }
    finish(graph, graph.start('player', parameters))
    assert bag_hashes(played) == expected


@pytest.mark.slow
def test_reordered_inputs_change_nothing(graph, model_file, tmp_path, expected, bag_hashes, root):
    """Two inputs of the compensator, and one of the acquisition, come late and out of order."""
    bag = tmp_path / 'bag'
    delayed = ('machine_state', 'compensation_applied', 'sensor_readings')
    folder = tmp_path / 'relay'
    folder.mkdir()
    command = [sys.executable, str(root / 'test' / 'support' / 'delaying_relay.py')]
    graph.launch('delaying_relay', [*command, *delayed], folder)
    renamed = ('-r', 'machine_state:=late/machine_state')
    common = {'lockstep': True}
    graph.start(
        'temperature_acquisition',
        common,
        arguments=(*renamed, '-r', 'sensor_readings:=late/sensor_readings'),
    )
    graph.start('sensor_selector', common)
    graph.start('thermal_predictor', {**common, 'model': str(model_file)})
    graph.start(
        'compensator',
        {**common, 'autostart': True},
        arguments=(*renamed, '-r', 'compensation_applied:=late/compensation_applied'),
    )
    graph.start('recorder', {**common, 'output': str(bag)})
    machine = graph.start(
        'simulated_machine',
        {
            **MACHINE,
            **common,
            'lockstep_nodes': ['delaying_relay', *NODES],
            'lockstep_recorder': True,
            'answer_timeout': ANSWER_TIMEOUT,
        },
    )
    finish(graph, machine)
    relay = next(node for node in graph.running if node.name == 'delaying_relay')
    assert relay.outcome['overtaken'] > 50
    assert bag_hashes(bag) == expected
