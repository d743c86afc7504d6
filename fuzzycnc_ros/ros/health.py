# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""A component's health, and how much its node does and how long it takes, as `/diagnostics`."""

import time
from collections.abc import Iterable, Mapping
from statistics import median
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from fuzzycnc_ros.runtime.component import STREAM, Health, Level
from fuzzycnc_ros.runtime.merge import Merger
from fuzzycnc_ros.runtime.records import SECOND

LATE_FACTOR = 3.0
"""An input is late when it is silent for this many of its own intervals: slow is not late."""

RECOVERED = 10.0
"""An input whose messages were dropped or late is in order again after this many of its own
intervals in time."""
RECOVERED_MIN, RECOVERED_MAX = 60.0, 3600.0
"""Shortest and longest machine time [s] for that."""


OTHER_CLOCK = 365.0 * 86400.0
"""Age of the newest message from which its stamp is of another clock than the node's [s]."""


def input_health(merger: Merger, now: int) -> list[Health]:
    """Say which stream inputs are late or lose records, and which of all got nonsense.

    Parameters
    ----------
    merger : Merger
        The merge of the component's inputs.
    now : int
        Machine time [ns].
    """
    items = []
    for declared in merger.component.INPUTS:
        count = merger.counts[declared.name]
        if declared.durability is not STREAM and not count.refusal:
            continue
        values = {
            'received': str(count.received),
            'dropped': str(count.dropped),
            'late': str(count.late),
            'refused': str(count.refused),
        }
        if count.refusal:
            text = f'refused: {count.refusal}'
            items.append(Health(declared.name, Level.ERROR, text, values))
            continue
        if count.newest is None:
            level = Level.WARN if declared.driving else Level.OK
            items.append(Health(declared.name, level, 'nothing received yet', values))
            continue
        age = (now - count.newest) / SECOND
        usual = count.interval / SECOND
        expected = declared.paced and not (count.last is not None and count.last.final)
        recovery = min(max(RECOVERED * usual, RECOVERED_MIN), RECOVERED_MAX)
        if expected and usual > 0.0 and age > LATE_FACTOR * usual:
            assert count.last is not None, 'it has a stamp'
            meaning = merger.component.silence(declared.name, count.last)
            level = Level.ERROR if meaning else Level.WARN
            text = f'late: newest is {age:.1f} s old, usual interval {usual:.1f} s'
            if age > OTHER_CLOCK:
                text = (
                    'stamps are of another clock: the newest is at '
                    f'{count.newest / SECOND:.1f} s, long past; if a CSV file is played, set '
                    'csv_rate to 1'
                )
            text += f'; {meaning}' if meaning else ''
            items.append(Health(declared.name, level, text, values))
        elif count.amiss_at is not None and now - count.amiss_at < round(recovery * SECOND):
            kinds = {'out of order': count.dropped, 'late': count.late}
            parts = [f'{number} {kind}' for kind, number in kinds.items() if number]
            text = f'messages since the start: {", ".join(parts)}'
            items.append(Health(declared.name, Level.WARN, text, values))
        else:
            items.append(Health(declared.name, Level.OK, 'in time', values))
    return items


def diagnostic_array(
    node: str, hardware: str, health: Iterable[Health], troubles: Mapping[str, str], stamp: Any
) -> DiagnosticArray:
    """Return the message of a node's health."""
    array = DiagnosticArray()
    array.header.stamp = stamp
    items = [*health, *(Health(name, Level.ERROR, text) for name, text in troubles.items())]
    array.status = [
        DiagnosticStatus(
            level=bytes([item.level]),
            name=f'{node.strip("/")}: {item.name}',
            message=item.message,
            hardware_id=hardware,
            values=[KeyValue(key=key, value=value) for key, value in item.values.items()],
        )
        for item in items
    ]
    return array


_KEPT = 1000
"""Latencies kept between two reports: enough for a median, and bounded at a kilohertz."""


class Activity:
    """Count what a node publishes and how long its driving inputs took to be worked."""

    def __init__(self) -> None:
        self._published = 0
        self._latencies: list[float] = []
        self._since = time.monotonic()

    def published(self) -> None:
        """Count a message."""
        self._published += 1

    def worked(self, sent_at: int) -> None:
        """Note that a message sent at wall time `sent_at` [ns] has been worked."""
        if len(self._latencies) < _KEPT:
            self._latencies.append(1e-6 * (time.time_ns() - sent_at))

    def health(self) -> Health:
        """Return rate and latency since the last call."""
        now = time.monotonic()
        rate = self._published / max(now - self._since, 1e-3)
        values = {'rate [1/s]': f'{rate:.1f}'}
        if self._latencies:
            values['latency [ms]'] = f'{median(self._latencies):.2f}'
            values['latency max [ms]'] = f'{max(self._latencies):.2f}'
        self._published, self._since = 0, now
        self._latencies.clear()
        return Health(
            'activity', Level.OK, ', '.join(f'{k} {v}' for k, v in values.items()), values
        )
