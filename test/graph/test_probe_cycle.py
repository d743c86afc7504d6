# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The probing cycle as a node: results from a file, the zero, what is due, and its replay."""

import time
from pathlib import Path

import numpy as np
import pytest
from benches.probe_rig import reference_at

from fuzzycnc_ros.adapters.probing.probe_file import read_plan
from fuzzycnc_ros.adapters.probing.programs import BEGIN, END
from fuzzycnc_ros.replay.replay import replay
from fuzzycnc_ros.ros.topics import RCLPY, message_class, publisher_qos
from fuzzycnc_ros.runtime.component import LATCHED
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.records import Displacement, ProbeCycleState, ThermalReference

pytestmark = pytest.mark.ros

FILE = Path(__file__).parents[2] / 'examples' / 'probing' / 'probe.yaml'


def test_results_in_a_file_become_a_displacement(graph, observer, tmp_path):
    results, plan = tmp_path / 'results.txt', read_plan(FILE)
    results.write_text('1 2.0\n')
    probes = observer.records('displacement', Displacement)
    states = observer.records('probe_cycle_state', ProbeCycleState, LATCHED)
    parameters = {'probe_file': str(FILE), 'result_file': str(results)}
    recorder = graph.start('recorder', {'output': str(tmp_path / 'bag')})
    node = graph.start('probe_cycle', parameters)
    observer.until(lambda: states, 'it tells what is due')
    count = observer.node.count_subscribers
    wanted = {'probe_touch': 2, 'displacement': 2, 'deadline_fired': 1}
    observer.until(
        lambda: all(count(f'/mill/{name}') >= least for name, least in wanted.items()),
        'the recorder hears all',
    )
    assert not states[-1].due
    publisher = observer.node.create_publisher(
        message_class(ThermalReference.TYPE), 'thermal_reference', publisher_qos(LATCHED)
    )
    publisher.publish(encode(reference_at(time.time_ns()), RCLPY))
    observer.until(lambda: states[-1].due, 'the zero is due')

    def write(moved):
        """Write the results of a cycle where the error has moved all by so much [mm]."""
        pairs = [(BEGIN, plan.signature)]
        for before, _, touch in plan.touches:
            for number in range(1, plan.repeats + 1):
                pairs.append((before + number, 1e3 * touch.surface - moved))
        with results.open('a') as stream:
            stream.writelines(f'{code} {value}\n' for code, value in [*pairs, (END, 0)])

    write(0.0)
    observer.until(lambda: probes, 'the zero')
    write(0.012)
    observer.until(lambda: len(probes) == 2, 'a probe')
    np.testing.assert_allclose(probes[0].displacement, 0.0, atol=1e-12)
    np.testing.assert_allclose(probes[1].displacement, 12e-6, atol=1e-9)
    assert probes[1].channel == ('X', 'Y', 'Z', 'Z setter')
    np.testing.assert_allclose(probes[1].position, [0.05, -0.04, -0.12, -0.13])
    assert not states[-1].due
    observer.settle('probe_cycle', 'recorder')
    assert node.interrupt() == 0
    assert recorder.interrupt() == 0
    report = replay(tmp_path / 'bag', given=['/mill/probe_touch'])
    assert report.equivalent, [topic for topic in report.topics if not topic.equivalent]
    compared = {topic.topic: topic.identical for topic in report.topics}
    assert compared['/mill/displacement'] == 2
