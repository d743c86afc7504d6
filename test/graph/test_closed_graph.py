# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a closed graph of a test leaves to others."""

import os
from pathlib import Path

import pytest
from live_graph import owned_segments

pytestmark = pytest.mark.ros


def test_shared_memory_of_its_nodes_is_removed_and_that_of_others_is_not(graph, observer):
    """Nodes map the segments of those whom they hear; who loses one is heard by no new node."""
    node = graph.start('compensator', {'use_sim_time': True})
    maps = Path(f'/proc/{node.process.pid}/maps')
    observer.until(
        lambda: any(path in maps.read_text() for path in owned_segments(os.getpid())),
        'the node hears the observer by shared memory',
    )
    own = owned_segments(os.getpid())
    others = owned_segments(node.process.pid)
    graph.kill(node)
    assert others
    assert all(Path(path).exists() for path in [*own, *others])
    graph.close()
    assert not any(Path(path).exists() for path in others)
    assert own
    assert all(Path(path).exists() for path in own)
