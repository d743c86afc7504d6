# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""docs/how-to/add-a-node.md: what it shows is put into a copy of the package and run."""

from pathlib import Path

import pytest
from page_tree import page_tree, run_in, run_tests

ROOT = Path(__file__).parents[2]
PAGE = ROOT / 'docs' / 'how-to' / 'add-a-node.md'


@pytest.fixture(scope='module')
def tree(tmp_path_factory):
    """A copy of the package with everything that the page adds."""
    top = tmp_path_factory.mktemp('tree')
    return page_tree(top, PAGE.read_text(encoding='utf-8'), new_files_max=3)


def test_its_test_passes(tree):
    run_tests(tree)


def test_tables_know_it(tree):
    run_in(tree, 'tools/make_tables.py')
    assert 'humidity_max: 0.7' in (tree / 'params' / 'humidity_guard.yaml').read_text()
    assert '`guarded_error`' in (tree / 'docs' / 'reference' / 'topics.md').read_text()


@pytest.mark.ros
def test_the_node_runs(tree, graph, observer):
    pytest.importorskip('rclpy')
    from fuzzycnc_ros.runtime.component import LATCHED
    from fuzzycnc_ros.runtime.host import NodeConfiguration

    graph.tree = tree
    told = observer.records('node_configuration', NodeConfiguration, LATCHED)
    observer.watch_diagnostics()
    graph.start('humidity_guard', {'humidity_max': 0.5})
    observer.until(lambda: any(item.node == 'humidity_guard' for item in told), 'it is there')
    (mine,) = [item for item in told if item.node == 'humidity_guard']
    assert '"humidity_max": 0.5' in mine.parameters
    air = 'mill/humidity_guard: air'
    observer.until(lambda: observer.told(air, 'no thermal_error yet'), 'it tells of its health')
