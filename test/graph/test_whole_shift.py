# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Part of a shift live over DDS, with all nodes of the mill: the same as in one process."""

import pytest
from live_graph import ANSWER_TIMEOUT

from fuzzycnc_ros.bags.canonical import topic_hashes
from fuzzycnc_ros.cli.demo.shift import mill_specs
from fuzzycnc_ros.registry import COMPONENTS
from fuzzycnc_ros.studies.published_bag import PublishedBag
from fuzzycnc_ros.studies.shift.whole_shift import ShiftSettings, run_whole_shift

pytestmark = pytest.mark.ros

SETTINGS = ShiftSettings(jobs=('300:path:trident', '500:move:X:0.01'), duration=700.0)


@pytest.mark.slow
def test_live_equals_in_process(graph, model_file, tmp_path):
    *nodes, maker = mill_specs(model_file, SETTINGS)
    for spec in nodes:
        graph.start(spec.name, dict(spec.parameters))
    graph.start('recorder', {'lockstep': True, 'output': str(tmp_path / 'live')})
    machine = graph.start(
        maker.name,
        {
            **maker.parameters,
            'lockstep': True,
            'lockstep_nodes': [spec.name for spec in nodes],
            'lockstep_recorder': True,
            'answer_timeout': ANSWER_TIMEOUT,
        },
    )
    assert machine.wait() == 0
    assert machine.outcome['degraded'] is False
    graph.stop()
    with PublishedBag(tmp_path / 'alone') as bag:
        run_whole_shift(model_file.read_text(), SETTINGS, sink=bag)
    live, alone = (topic_hashes(tmp_path / name) for name in ('live', 'alone'))
    outputs = {item.name for component in COMPONENTS.values() for item in component.OUTPUTS}
    judged = [topic for topic in live if topic.rpartition('/')[2] in outputs]
    assert {'/mill/compensation', '/mill/axis_command', '/mill/trajectory'} <= set(judged)
    assert [topic for topic in judged if live[topic] != alone.get(topic)] == []
