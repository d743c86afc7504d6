# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""How many hostile inputs a test tries, and the bounds that each of them must keep.

`FUZZYCNC_FUZZ=10000` tries so many of each kind; without it a small share of them is tried.
"""

import os
import resource
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st

CAMPAIGN = int(os.environ.get('FUZZYCNC_FUZZ', '0'))
"""Number of examples of a test in a full campaign; 0 in the usual run."""
TIME_MAX = 5.0
"""Processor time of one input [s]; unlike wall time it does not depend on the load."""
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


class TookTooLong(BaseException):
    """An input held the processor for too long; no handler of the code under test takes it."""


@contextmanager
def bounded() -> Iterator[None]:
    """Refuse more than `TIME_MAX` of processor time and `MEMORY_MAX` of memory."""

    def too_long(signum, frame):
        raise TookTooLong(f'expected at most {TIME_MAX} s of processor time')

    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (_status('VmSize') + MEMORY_MAX, hard))
    before = signal.signal(signal.SIGPROF, too_long)
    _forget_peak()
    taken, begun = _status('VmRSS'), time.process_time()
    signal.setitimer(signal.ITIMER_PROF, TIME_MAX)
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
