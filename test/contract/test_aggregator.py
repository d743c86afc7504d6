# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The example for diagnostic_aggregator knows every node; a graph test holds their names to it."""

import runpy
from pathlib import Path

from aggregator import analyzers, matching

from fuzzycnc_ros.graph.bring_up import THERMAL

NODES = runpy.run_path(str(Path(__file__).parents[2] / 'tools' / 'make_tables.py'))['nodes']()


def test_every_node_has_one_place():
    for node in NODES:
        name = node.name if node.name == 'dashboard' else f'mill/{node.name}'
        assert len(matching(f'{name}: anything')) == 1, name
    assert not matching('lathe/compensator: state')
    known = {node.name for node in NODES}
    for item in analyzers().values():
        assert {
            start.partition(':')[0].rpartition('/')[2] for start in item['startswith']
        } <= known


def test_nodes_of_thermal_compensation_are_expected_alive():
    alive = analyzers()['/Machines/mill/Alive']
    assert alive['expected'] == alive['startswith']
    assert alive['expected'] == [f'mill/{node}: activity' for node in THERMAL]
    assert 'discard_stale' not in alive, 'what is stale must be seen'


def test_parameters_are_what_the_aggregator_declares():
    """An unknown one would be ignored in silence, an integer in place of a double ends it."""
    known = {
        *('type', 'path', 'startswith', 'expected'),
        *('remove_prefix', 'timeout', 'discard_stale'),
    }
    for item in analyzers().values():
        assert {*item} <= known
        assert isinstance(item['timeout'], float)
