# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A displacement that a person has measured, as it is told to a machine's graph."""

import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from fuzzycnc_ros.core.thermal.places import place_channels
from fuzzycnc_ros.ros.presence import GraphError
from fuzzycnc_ros.runtime.records import Displacement

_OTHERS = (
    ('/clock', 'it is a simulated machine'),
    ('clock', 'it is a simulated machine'),
    ('displacement', 'another node does'),
)


def check_unprobed(machine: str, published: Callable[[str], bool]) -> None:
    """Refuse to probe a machine that is probed already, or whose time nobody knows.

    Parameters
    ----------
    machine : str
        Its name.
    published : callable
        Whether a topic of the machine, or an absolute one, is published.

    Raises
    ------
    GraphError
        If it is; the text says by whom.
    """
    for topic, what in _OTHERS:
        if published(topic):
            raise GraphError(
                f'{machine}: expected a machine whose displacement nobody else publishes but '
                f'found that {what}'
            )


def probe_record(
    machine: str,
    values: Mapping[str, float] | Sequence[tuple[str, float, float]],
    deviation: float,
    *,
    compensated: bool,
) -> Displacement:
    """Return a probe of just now.

    Parameters
    ----------
    machine : str
        Name of the machine.
    values : mapping of str to float, or sequence of (str, float, float)
        Displacement [m] by axis; or axis, displacement [m] and the position of the axis at which
        it was measured [m].
    deviation : float
        Standard deviation of the measurement [m]; NaN if unknown.
    compensated : bool
        Whether offsets are in force.
    """
    if isinstance(values, Mapping):
        values = [(axis, error, np.nan) for axis, error in values.items()]
    axis = tuple(item[0] for item in values)
    position = np.array([item[2] for item in values])
    return Displacement(
        stamp=time.time_ns(),
        frame_id=f'{machine}/workpiece',
        axis=axis,
        channel=place_channels(axis, position),
        displacement=np.array([item[1] for item in values]),
        standard_deviation=np.full(len(values), deviation),
        includes_compensation=compensated,
        position=position,
    )
