# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A displacement that a person has measured, as it is told to a machine's graph."""

import time
from collections.abc import Callable, Mapping

import numpy as np

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
    machine: str, values: Mapping[str, float], deviation: float, *, compensated: bool
) -> Displacement:
    """Return a probe of just now.

    Parameters
    ----------
    machine : str
        Name of the machine.
    values : mapping of str to float
        Displacement [m] by axis.
    deviation : float
        Standard deviation of the measurement [m]; NaN if unknown.
    compensated : bool
        Whether offsets are in force.
    """
    return Displacement(
        stamp=time.time_ns(),
        frame_id=f'{machine}/workpiece',
        axis=tuple(values),
        channel=tuple(values),
        displacement=np.array(list(values.values())),
        standard_deviation=np.full(len(values), deviation),
        includes_compensation=compensated,
    )
