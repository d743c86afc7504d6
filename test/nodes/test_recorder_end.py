# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""How a recorder ends."""

import time
from types import SimpleNamespace

import pytest

pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')

from processes import wait_for
from rclpy.serialization import serialize_message
from std_msgs.msg import Header

from fuzzycnc_ros.bags.reader import BagReader
from fuzzycnc_ros.nodes import recorder
from fuzzycnc_ros.nodes.recorder import QUIET, RecorderNode

pytestmark = pytest.mark.ros


def test_what_the_middleware_brings_late_is_in_the_bag(make_node, tmp_path, monkeypatch):
    """Its threads may be later than the wish to end; what follows the wish is not awaited."""
    make_node('plc').create_publisher(Header, 'said', 10)
    output = str(tmp_path / 'bag')
    node = RecorderNode(make_node('recorder', output=output, topics='^/mill/said'))
    wait_for(lambda: node._discover() or node._subscriptions, 'the topic')
    looks = []

    def brings(subscription, most):
        looks.append(time.time_ns())
        published = looks[0] - 10**9 if len(looks) == 2 else looks[-1]
        info = {'publication_sequence_number': len(looks), 'source_timestamp': published}
        if len(looks) > 1:
            subscription.callback(serialize_message(Header()), info)

    monkeypatch.setattr(recorder, 'hand_over', brings)
    node.stop()
    with BagReader(output) as reader:
        assert reader.message_count == len(looks) - 1
    assert len(looks) == 2 + QUIET


def test_a_part_is_shipped_while_the_next_one_is_written(make_node, tmp_path):
    """The end waits a few seconds only for what is on its way: parts are shipped before it."""
    output, archive = tmp_path / 'bag', tmp_path / 'archive'
    ship = {'ship': archive.as_uri(), 'split_duration': 1.0}
    node = RecorderNode(make_node('recorder', output=str(output), topics='^/mill/said', **ship))
    try:
        make_node('plc').create_publisher(Header, 'said', 10)
        wait_for(lambda: node._discover() or node._subscriptions, 'the topic')
        (subscription,) = node._subscriptions.values()
        start = time.time_ns()
        for second in range(3):
            stamp = start + second * 10**9
            node._clock = SimpleNamespace(now=lambda stamp=stamp: stamp)
            info = {'publication_sequence_number': second + 1, 'source_timestamp': stamp}
            subscription.callback(serialize_message(Header()), info)
        wait_for(lambda: len(list(archive.rglob('*.mcap'))) == 2, 'the first two parts')
    finally:
        node.stop()
    names = {path.name for path in output.glob('*.mcap')}
    assert {path.name for path in archive.rglob('*.mcap')} == names
    assert len(names) == 3
