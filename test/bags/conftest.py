# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Messages and small bags for the tests of the bag machinery."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fuzzycnc_ros.bags.typestore import message_type, serialize
from fuzzycnc_ros.bags.writer import BagWriter

SECOND = 10**9
TEMPERATURES = 'fuzzycnc_msgs/msg/Temperatures'
DISPLACEMENT = 'fuzzycnc_msgs/msg/Displacement'


def header(stamp: int, frame_id: str = 'mill/machine') -> Any:
    time = message_type('builtin_interfaces/msg/Time')
    sec, nanosec = divmod(stamp, SECOND)
    return message_type('std_msgs/msg/Header')(
        stamp=time(sec=sec, nanosec=nanosec), frame_id=frame_id
    )


def temperatures(stamp: int, values: Any = (20.0, 21.0), names: Any = None, status: Any = None):
    values = np.asarray(values, dtype=np.float64)
    return message_type(TEMPERATURES)(
        header=header(stamp),
        sensor=list(names or [f'n{i}' for i in range(len(values))]),
        temperature=values,
        status=np.asarray(np.zeros(len(values)) if status is None else status, dtype=np.uint8),
        readings=5,
    )


def displacement(stamp: int, values: Any = (1e-6, 2e-6), axes: Any = 'YZ', channels: Any = None):
    values = np.asarray(values, dtype=np.float64)
    return message_type(DISPLACEMENT)(
        header=header(stamp, 'mill/workpiece'),
        axis=list(axes),
        channel=list(channels or axes),
        displacement=values,
        standard_deviation=np.full(len(values), np.nan),
        includes_compensation=False,
        position=np.full(len(values), np.nan),
    )


@pytest.fixture(scope='session')
def new() -> SimpleNamespace:
    """Constructors of messages."""
    return SimpleNamespace(header=header, temperatures=temperatures, displacement=displacement)


@pytest.fixture
def make_bag(tmp_path: Path) -> Callable[..., Path]:
    """Write messages given as (topic, message, log time) into a new bag."""

    def make(messages: Any, name: str = 'bag', **options: Any) -> Path:
        path = tmp_path / name
        with BagWriter(path, flush_interval=None, **options) as writer:
            for topic, message, log_time in messages:
                writer.add_topic(topic, message.__msgtype__)
                writer.write(topic, log_time, log_time, serialize(message))
        return path

    return make


@pytest.fixture
def small_bag(make_bag: Callable[..., Path]) -> Path:
    """A bag of 300 temperatures and 100 displacements, one and three seconds apart."""
    messages: list[Any] = []
    for k in range(300):
        stamp = (k + 1) * SECOND
        messages.append(('/mill/temperatures', temperatures(stamp, (20 + k * 0.01, 21.0)), stamp))
        if k % 3 == 0:
            messages.append(('/mill/displacement', displacement(stamp, (k * 1e-8, 0.0)), stamp))
    return make_bag(messages, chunk_size=2048)
