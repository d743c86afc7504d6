# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes that publish commands which are not theirs to give."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import rclpy

from fuzzycnc_ros.components.component import STREAM
from fuzzycnc_ros.components.records import SECOND, AxisCommand, Compensation, Record
from fuzzycnc_ros.convert import encode
from fuzzycnc_ros.faults.relay import record_types
from fuzzycnc_ros.nodes.messages import RCLPY, message_class
from fuzzycnc_ros.nodes.qos import publisher_qos

STRANGE_EPOCH = 10**6
"""Epoch of strangers' commands of axes: the highest rank."""
HIGHER = 5
"""By how much the epoch of strangers' offsets is above the compensator's: what may be believed."""
STRANGER = ('stranger',)
"""Source that strangers' offsets name."""
_LARGE = 1e-3
_VALID = 600 * SECOND


def highest_order(topic: str, stamp: int, told: Compensation | None) -> Record:
    """Return a command of the highest rank that moves by the most.

    Parameters
    ----------
    topic : str
        `axis_command` or `compensation`.
    stamp : int
        Its stamp [ns].
    told : Compensation, optional
        What the compensator has told last: its axes are those that are ordered.

    Raises
    ------
    ValueError
        If offsets are to be ordered before the compensator has told any.
    """
    if topic == 'axis_command':
        return AxisCommand(
            stamp=stamp,
            epoch=STRANGE_EPOCH,
            axis=('X',),
            duty=np.ones(1),
            valid_until=stamp + _VALID,
        )
    if told is None:
        raise ValueError('told: expected a command to imitate but the compensator told none')
    changed = {
        'stamp': stamp,
        'epoch': told.epoch + HIGHER,
        'source': STRANGER,
        'offset': np.full(len(told.axis), _LARGE),
        'valid_until': stamp + _VALID,
    }
    return Compensation(**{**vars(told), **changed})


class Strangers:
    """Some nodes with a publisher each.

    Parameters
    ----------
    context : rclpy.Context
        Context of the domain.
    namespace : str
        The machine.
    topic : str
        What they publish.
    names : sequence of str
        Names of the nodes.
    order : callable
        Makes what they publish.
    """

    def __init__(
        self,
        context: Any,
        namespace: str,
        topic: str,
        names: Sequence[str],
        order: Callable[[], Record],
    ) -> None:
        kind = message_class(record_types()[topic].TYPE)
        self._order = order
        self._nodes = [rclpy.create_node(n, namespace=namespace, context=context) for n in names]
        self._publishers = [
            node.create_publisher(kind, topic, publisher_qos(STREAM)) for node in self._nodes
        ]

    def order(self) -> None:
        """Publish, each once."""
        for publisher in self._publishers:
            publisher.publish(encode(self._order(), RCLPY))

    def leave(self) -> None:
        """Leave the graph."""
        for node in self._nodes:
            node.destroy_node()
