# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Provenance: configuration and requests of a node, recorded so that a replay can repeat them."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from fuzzycnc_ros import __version__
from fuzzycnc_ros.core.names import text_hash
from fuzzycnc_ros.runtime.arithmetic import arithmetic
from fuzzycnc_ros.runtime.component import Component
from fuzzycnc_ros.runtime.host import NodeConfiguration, NodeEvent

MESSAGE_SET = 4
"""Version of the message set; bags carry it, and older ones are upgraded on reading."""


REFUSED = 'refused'
"""Name of the event that a host refused a message; arguments `input` and `stamp` [ns]."""

CLOCK_STEP = 'clock_step'
"""Name of the event that the clock of a node was set; argument `step` [ns]."""


def configuration_record(
    component: Component[Any], stamp: int, lifecycle_state: str = 'active'
) -> NodeConfiguration:
    """Return what a component runs with at machine time `stamp` [ns]."""
    model = component.model_text
    return NodeConfiguration(
        stamp=stamp,
        frame_id=component.frame('machine'),
        node=component.NAME,
        version=f'{__version__} {arithmetic()}',
        message_set=MESSAGE_SET,
        lifecycle_state=lifecycle_state,
        parameters=json.dumps(asdict(component.configuration), sort_keys=True),
        model=model,
        model_hash=text_hash(model) if model else '',
    )


def event_record(
    component: Component[Any], stamp: int, name: str, arguments: Mapping[str, Any]
) -> NodeEvent:
    """Return a request that changed a component at machine time `stamp` [ns]."""
    return machine_event(component.machine, component.NAME, stamp, name, arguments)


def machine_event(
    machine: str, node: str, stamp: int, name: str, arguments: Mapping[str, Any]
) -> NodeEvent:
    """Return what a node has done at a machine, or been told, at machine time `stamp` [ns]."""
    return NodeEvent(
        stamp=stamp,
        frame_id=f'{machine}/machine',
        node=node,
        name=name,
        request=json.dumps(dict(arguments), sort_keys=True),
    )
