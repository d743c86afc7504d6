# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""How a recorder ends."""

import time

import pytest

rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed here: run `make test`')

from processes import wait_for  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.serialization import serialize_message  # noqa: E402
from std_msgs.msg import Header  # noqa: E402

from fuzzycnc_ros.bags.reader import BagReader  # noqa: E402
from fuzzycnc_ros.nodes import recorder  # noqa: E402
from fuzzycnc_ros.nodes.recorder import QUIET, RecorderNode  # noqa: E402

pytestmark = pytest.mark.ros


@pytest.fixture
def make(domain):
    """Make a node in a domain of its own."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    made = []

    def begin(name, **parameters):
        given = [Parameter(key, value=value) for key, value in parameters.items()]
        made.append(
            rclpy.create_node(name, namespace='/mill', context=context, parameter_overrides=given)
        )
        return made[-1]

    yield begin
    for node in made:
        node.destroy_node()
    rclpy.shutdown(context=context)


def test_what_the_middleware_brings_late_is_in_the_bag(make, tmp_path, monkeypatch):
    """Its threads may be later than the wish to end; what follows the wish is not awaited."""
    make('plc').create_publisher(Header, 'said', 10)
    output = str(tmp_path / 'bag')
    node = RecorderNode(make('recorder', output=output, topics='^/mill/said'))
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
