# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""How many hostile inputs a test tries, and the bounds that each of them must keep.

`FUZZYCNC_FUZZ=10000` tries so many of each kind; without it a small share of them is tried.
"""

import os
import resource
import signal
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st

CAMPAIGN = int(os.environ.get('FUZZYCNC_FUZZ', '0'))
"""Number of examples of a test in a full campaign; 0 in the usual run."""
COST_MAX = 500.0
"""Most that one input may cost, as a multiple of a fixed computation in the same run.

The most costly ones take some 50 of it, on a slow computer as on a fast one.
"""
GLANCE = 2.0
"""Processor time [s] between two looks at what an input costs; it decides nothing."""
MEMORY_MAX = 500_000_000
"""Memory that one input may take [bytes]."""

SEEDS = st.integers(0, 2**63)


@dataclass
class Worst:
    """What the inputs of a test took at most."""

    pieces: int = 0
    """Pieces of work that were bounded."""
    time: float = 0.0
    """Processor time [s]."""
    memory: int = 0
    """Memory on top of what was taken before [bytes]."""


WORST: dict[str, Worst] = {}
"""By test, in the order of the run; the summary of a campaign shows it."""


def fuzz(usual: int, share: float = 1.0):
    """Return the settings of a test with `usual` examples, a share of those of a campaign."""
    return settings(
        max_examples=max(usual, round(share * CAMPAIGN)),
        deadline=None,
        database=None,
        phases=[Phase.generate],  # a smaller seed is no simpler input
        print_blob=False,
        suppress_health_check=list(HealthCheck),
    )


class CostsTooMuch(BaseException):
    """An input costs without bound; no handler of the code under test takes it."""


def fixed_cost() -> float:
    """Return the processor time [s] of a computation that is always the same."""
    data, total, begun = bytes(8000), 0, time.process_time()
    for k in range(200_000):
        total += struct.unpack_from('<Q', data, 8 * (k % 1000))[0]
    return time.process_time() - begun


@contextmanager
def bounded() -> Iterator[None]:
    """Refuse more than `COST_MAX` of work and `MEMORY_MAX` of memory."""

    def look(signum, frame):
        # Measured now, under the load that the input has met too.
        cost = (time.process_time() - begun) / fixed_cost()
        if cost > COST_MAX:
            raise CostsTooMuch(
                f'expected at most {COST_MAX:g} times the cost of a fixed computation but found '
                f'{cost:.0f}'
            )

    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (_status('VmSize') + MEMORY_MAX, hard))
    before = signal.signal(signal.SIGPROF, look)
    _forget_peak()
    taken, begun = _status('VmRSS'), time.process_time()
    signal.setitimer(signal.ITIMER_PROF, GLANCE, GLANCE)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        _note(time.process_time() - begun, _status('VmHWM') - taken)


def refusal(kind: type[ValueError], work: Callable[[], object]) -> str:
    """Return why a piece of work was refused, '' if it was done; it always is bounded."""
    with bounded():
        try:
            work()
        except kind as error:
            reason = str(error)
        else:
            return ''
    assert reason, 'expected a refusal that says why'
    return reason


def refused_or_read(read: Callable[[Path], object], file: Path) -> None:
    """Assert that a reader returns, or says what is wrong with which file."""
    reason = refusal(ValueError, lambda: read(file))
    assert not reason or str(file) in reason


def _note(duration: float, memory: int) -> None:
    test = os.environ.get('PYTEST_CURRENT_TEST', '').split('::')[-1].removesuffix(' (call)')
    worst = WORST.setdefault(test, Worst())
    worst.pieces += 1
    worst.time = max(worst.time, duration)
    worst.memory = max(worst.memory, memory)


def _forget_peak() -> None:
    """Let the most memory that was taken count from now on."""
    Path('/proc/self/clear_refs').write_text('5')


def _status(name: str) -> int:
    """Return a figure of this process [bytes]."""
    text = Path('/proc/self/status').read_text()
    return 1024 * int(text.split(f'{name}:', 1)[1].split(maxsplit=1)[0])
