# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Nodes that publish commands which are not theirs to give."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import rclpy

from campaign.relay import record_types
from fuzzycnc_ros.core.inputs.offset_input import OffsetStatus
from fuzzycnc_ros.ros.topics import RCLPY, message_class, publisher_qos
from fuzzycnc_ros.runtime.component import STREAM
from fuzzycnc_ros.runtime.convert import encode
from fuzzycnc_ros.runtime.records import SECOND, AxisCommand, Compensation, Record

STRANGE_EPOCH = 10**6
"""Epoch of strangers' commands of axes: the highest rank."""
HIGHER = 5
"""By how much the epoch of strangers' offsets is above the compensator's: what may be believed."""
STRANGER = ('stranger',)
"""Source that strangers' offsets name."""
_LARGE = 1e-3
_VALID = 600 * SECOND


FORGED = 2**61
"""Epoch of a read-back that no machine gives: who believed it could command nothing any more."""
FALSE: Mapping[str, Mapping[str, Any]] = {
    'thermal_error': {'error': 45e-6},
    'machine_state': {'offsets_allowed': False},
    'compensation_applied': {'epoch': FORGED, 'status': int(OffsetStatus.FOLLOWING)},
}
"""What strangers say where they do not command: to be followed, to stop it, to end it for ever."""


def strange_word(topic: str, stamp: int, told: Record | None) -> Record:
    """Return what does most harm on a topic if it is believed.

    Parameters
    ----------
    topic : str
        `axis_command`, `compensation` or one of `FALSE`.
    stamp : int
        Its stamp [ns].
    told : Record, optional
        What was told on the topic last, which is imitated; needed but for `axis_command`.

    Raises
    ------
    ValueError
        If nothing was told yet that could be imitated.
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
        raise ValueError(f'told: expected a record of {topic} to imitate but found none')
    if topic in FALSE:
        changed = {
            name: np.full_like(getattr(told, name), value)
            if isinstance(getattr(told, name), np.ndarray)
            else value
            for name, value in FALSE[topic].items()
        }
        return type(told)(**{**vars(told), 'stamp': stamp, **changed})
    assert isinstance(told, Compensation), 'the other topics are said above'
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

    def heard(self) -> bool:
        """Whether somebody would hear each of them."""
        return all(item.get_subscription_count() for item in self._publishers)

    def order(self) -> None:
        """Publish, each once."""
        for publisher in self._publishers:
            publisher.publish(encode(self._order(), RCLPY))

    def leave(self) -> None:
        """Leave the graph."""
        for node in self._nodes:
            node.destroy_node()
