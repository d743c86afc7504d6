# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a poller of devices has read, for tests that wait for it."""

import time
from collections.abc import Callable
from typing import Any

from fuzzycnc_ros.adapters.readings.link import Reading
from fuzzycnc_ros.adapters.readings.polling import Polled, Poller

TIMEOUT = 60.0


def wait(poller: Poller, wanted: Callable[[Polled], Any]) -> Polled:
    """Wait for a result that fulfils a condition; return it."""
    deadline = time.monotonic() + TIMEOUT
    polled = None
    while time.monotonic() < deadline:
        polled = poller.results.get(timeout=TIMEOUT)
        if wanted(polled):
            return polled
    raise AssertionError(f'the last result was {polled}')


def close(poller: Poller) -> None:
    """End a poller, however long its thread takes on a busy computer."""
    poller.close()
    poller._thread.join(TIMEOUT)
    assert not poller._thread.is_alive()


def good(polled: Polled) -> bool:
    return polled.readings is not None


def lost(polled: Polled) -> bool:
    return polled.readings is None


def is_text(reading: Reading, *parts: str) -> bool:
    """Whether a reading is none, and says why with all of these words."""
    return isinstance(reading, str) and all(part in reading for part in parts)
