# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What every record must be before a component sees it, whoever sent it.

A publisher may send whatever fits into the message.  Components rely on arrays that belong
together having one length, on stamps to which times can be added, and on owners that can have a
successor of a higher epoch; all of it is checked here, once.  Paths, trajectories and commands of
axes are checked by those who take them, who say in the message that answers them what is wrong.
"""

from typing import Any

from fuzzycnc_ros.runtime.records import (
    SECOND,
    AxisState,
    CompensationApplied,
    Displacement,
    MachineState,
    PredictorState,
    Record,
    SensorCluster,
    SensorSelection,
    Temperatures,
    ThermalError,
    ThermalReference,
)

STAMP_MAX = (2**31 - 86_400) * SECOND
"""Newest stamp that is taken [ns]: times up to a day after it still fit into a message."""

EPOCH_MAX = 2**62
"""Highest epoch of an owner that is taken: beyond every stamp, and the next owners still have
higher ones."""

PARALLEL: dict[type[Any], dict[str, tuple[str, ...]]] = {
    AxisState: {'axis': ('reference', 'position', 'velocity')},
    CompensationApplied: {'axis': ('offset', 'at_limit')},
    Displacement: {'axis': ('channel', 'displacement', 'standard_deviation')},
    MachineState: {'axis': ('position',)},
    PredictorState: {'input': ('last_rise',)},
    SensorCluster: {'member': ('score',), 'substitute': ('gain', 'correlation')},
    Temperatures: {'sensor': ('temperature', 'status')},
    ThermalError: {
        'axis': ('channel', 'error', 'standard_deviation'),
        'substituted': ('substitute',),
    },
    ThermalReference: {'sensor': ('temperature',)},
}
"""Array of each record to those that are parallel to it."""


def misfit(record: Record) -> str:
    """Say why a record means nothing; empty if it may be taken.

    Examples
    --------
    >>> import numpy as np
    >>> misfit(
    ...     Temperatures(
    ...         stamp=0,
    ...         sensor=('T1', 'T2'),
    ...         temperature=np.zeros(3),
    ...         status=np.zeros(2, np.uint8),
    ...     )
    ... )
    'temperature: expected 2 values, parallel to sensor, but found 3'
    """
    if not 0 <= record.stamp <= STAMP_MAX:
        return (
            f'stamp: expected 0 to {STAMP_MAX // SECOND} s of machine time but found '
            f'{record.stamp / SECOND:.9g} s'
        )
    epoch = getattr(record, 'epoch', 0)
    if epoch > EPOCH_MAX:
        return f'epoch: expected at most {EPOCH_MAX} but found {epoch}: no owner could follow'
    if isinstance(record, SensorSelection):
        for cluster in record.cluster:
            found = _uneven(cluster)
            if found:
                return f'cluster of {cluster.chosen[:40]!r}: {found}'
    return _uneven(record)


def _uneven(record: Any) -> str:
    for first, others in PARALLEL.get(type(record), {}).items():
        wanted = len(getattr(record, first))
        for name in others:
            found = len(getattr(record, name))
            if found != wanted:
                return f'{name}: expected {wanted} values, parallel to {first}, but found {found}'
    return ''
