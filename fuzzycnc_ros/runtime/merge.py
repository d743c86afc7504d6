# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""The one merge by stamp that live nodes, the in-process graph and the replay share.

Arrival order carries no meaning: two routes into one node overtake each other.  Records wait
here until the caller says up to which machine time nothing can arrive any more, and then reach
the component in the order of their stamps.  At equal stamps side inputs come first, in the
order of their declaration, then a deadline, then the driving input.
"""

import heapq
from dataclasses import dataclass, field
from typing import Any

from fuzzycnc_ros.runtime.component import LATCHED, Component, Emission
from fuzzycnc_ros.runtime.records import (
    MOTION_FIELDS,
    SECOND,
    AxisState,
    CompensationApplied,
    Displacement,
    MachineState,
    PredictorState,
    ProbeCycleState,
    ProbeEvidence,
    ProbeStatus,
    Record,
    SensorCluster,
    SensorSelection,
    ServoTrial,
    Temperatures,
    ThermalError,
    ThermalPosterior,
    ThermalReference,
)

STAMP_MAX = (2**31 - 86_400) * SECOND
"""Newest stamp that is taken [ns]: times up to a day after it still fit into a message."""

EPOCH_MAX = 2**62
"""Highest epoch of an owner that is taken: beyond every stamp, and the next owners still have
higher ones."""

PARALLEL: dict[type[Any], dict[str, tuple[str, ...]]] = {
    AxisState: {'axis': ('reference', 'position', 'velocity')},
    CompensationApplied: {'axis': ('offset', 'at_limit', 'slope', 'position')},
    Displacement: {'axis': ('channel', 'displacement', 'standard_deviation', 'position')},
    MachineState: {'axis': ('position', *MOTION_FIELDS)},
    PredictorState: {'input': ('last_rise',)},
    SensorCluster: {'member': ('score',), 'substitute': ('gain', 'correlation')},
    Temperatures: {'sensor': ('temperature', 'status')},
    ThermalError: {
        'axis': (
            *('channel', 'error', 'standard_deviation'),
            *('slope', 'slope_deviation', 'reference_position', 'line_deviation'),
        ),
        'substituted': ('substitute',),
    },
    ProbeCycleState: {'zero': ('size', 'noise')},
    ProbeEvidence: {'axis': ('channel', 'evidence')},
    ProbeStatus: {'axis': ('channel', 'band', 'change')},
    ServoTrial: {'setting': ('value',)},
    ThermalPosterior: {'axis': ('channel', 'probes', 'evidence')},
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


_DEADLINE_RANK = 1000
_DRIVING_RANK = 2000

FORGETTING, OUTAGE = 0.9, 3.0
"""Parts of the usual interval of an input: what is left of it after a record that came sooner, and
what it becomes at most by one that came later, since an outage is not usual."""


@dataclass
class InputCount:
    """Counts of the records of one input."""

    received: int = 0
    dropped: int = 0
    """Records whose stamp was not newer than the one before."""
    refused: int = 0
    """Records that mean nothing: arrays of unequal length, impossible stamps."""
    refusal: str = ''
    """Why the newest record was refused; empty if it was not."""
    late: int = 0
    """Records that came after the component had worked past their stamp; a driving one is lost."""
    amiss_at: int | None = None
    """Stamp of the newest dropped or late record [ns]."""
    newest: int | None = None
    """Newest stamp seen [ns]."""
    last: Record | None = None
    """Record of that stamp, worked or not."""
    interval: int = 0
    """Usual time between two stamps [ns]; 0 before the second.  The longest of the last dozen or
    so, without outages: bursts amid a slow stream do not make it look late."""


@dataclass
class Merger:
    """Order the inputs of one component by stamp and fire its deadlines in between."""

    component: Component[Any]
    time: int = 0
    """Machine time [ns] up to which the component has worked."""
    counts: dict[str, InputCount] = field(default_factory=dict)
    _queue: list[tuple[int, int, int, str, Record]] = field(default_factory=list)
    _serial: int = 0

    def __post_init__(self) -> None:
        """Rank the inputs in the order of their declaration."""
        self._ranks = {
            item.name: _DRIVING_RANK if item.driving else index
            for index, item in enumerate(self.component.INPUTS)
        }
        self._quiet = {i.name for i in self.component.INPUTS if i.quiet}
        self._latched = {i.name for i in self.component.INPUTS if i.durability is LATCHED}
        self.counts = {name: InputCount() for name in self._ranks}

    def push(self, name: str, record: Record) -> bool:
        """Take a record of input `name`; return whether it was accepted.

        A record that is not newer than the last of its input is dropped and counted; on a latched
        input one of the same age replaces it.  One that means nothing is refused.
        """
        refusal = misfit(record)
        if refusal:
            self.refuse(name, refusal)
            return False
        count = self.counts[name]
        count.received += 1
        count.refusal = ''
        if count.newest is not None and record.stamp <= count.newest:
            # A latched topic repeats its newest record to a reader that comes back, and may be
            # set anew before machine time moves.
            if name not in self._latched or record.stamp < count.newest:
                count.dropped += 1
                count.amiss_at = self.time
                return False
        if count.newest is not None:
            gap, usual = record.stamp - count.newest, count.interval
            count.interval = (
                max(min(gap, int(OUTAGE * usual)), int(FORGETTING * usual)) if usual else gap
            )
        count.newest, count.last = record.stamp, record
        if record.stamp < self.time and name not in self._latched:
            count.late += 1
            count.amiss_at = self.time
            if self._ranks[name] == _DRIVING_RANK:
                # What it would cause lies before what has been published already.
                return False
        self._serial += 1
        heapq.heappush(self._queue, (record.stamp, self._ranks[name], self._serial, name, record))
        return True

    def refuse(self, name: str, why: str) -> None:
        """Count a record of input `name` that is not taken."""
        count = self.counts[name]
        count.received += 1
        count.refused += 1
        count.refusal = why

    def advance(self, until: int) -> list[Emission]:
        """Work up to machine time `until` [ns]; return what was emitted, in order.

        Raises
        ------
        RuntimeError
            If the component emits because of an input that it declares as quiet, or asks for a
            deadline that has fired already.
        """
        emitted: list[Emission] = []
        while True:
            deadline = self.component.next_deadline
            head = self._queue[0][:2] if self._queue else None
            if deadline is not None and deadline <= until:
                if head is None or (deadline, _DEADLINE_RANK) < head:
                    emitted.extend(self.fire(deadline))
                    continue
            if head is None or head[0] > until:
                break
            stamp, _, _, name, record = heapq.heappop(self._queue)
            self.time = max(self.time, stamp)
            caused = list(self.component.receive(name, record))
            if caused and name in self._quiet:
                raise RuntimeError(
                    f'{self.component.NAME} declares its input {name} as quiet but emitted '
                    f'{caused[0].output} because of it'
                )
            emitted.extend(caused)
        self.time = max(self.time, until)
        return emitted

    def fire(self, deadline: int) -> list[Emission]:
        """Fire one deadline of the component.

        Raises
        ------
        RuntimeError
            If the component asks for the same deadline again, which would never end.
        """
        self.time = max(self.time, deadline)
        emitted = list(self.component.on_deadline(deadline))
        following = self.component.next_deadline
        if following is not None and following <= deadline:
            raise RuntimeError(
                f'{self.component.NAME} asked for a deadline at {following / SECOND} s '
                f'after the one at {deadline / SECOND} s had fired'
            )
        return emitted
