# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""How much a node does and how long it takes, for `/diagnostics`."""

import time
from statistics import median

from fuzzycnc_ros.runtime.component import Health, Level

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
