# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a recording shows of one scenario."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

MICRO = 1e-6


@dataclass
class Measured:
    """Figures of a scenario; what they mean depends on what the machine does.

    Attributes
    ----------
    told : str
        States that the machine was told or told itself, in their order.
    worst_offset_um : float
        Largest offset, or distance from where the machine should be [um].
    worst_step_um : float
        Largest change from one sample to the next [um].
    time_to_safe_s : float
        Longest time out of a safe state [s of machine time].
    why : list of str
        What is wrong; empty if it is safe.
    """

    told: str = 'nothing'
    worst_offset_um: float = 0.0
    worst_step_um: float = 0.0
    time_to_safe_s: float = 0.0
    why: list[str] = field(default_factory=list)


def largest(sizes: Iterable[Any]) -> float:
    """Return the largest number in some arrays of lengths [m], as um."""
    return round(max((float(size.max(initial=0.0)) for size in sizes), default=0.0) / MICRO, 3)


def changes(names: Iterable[str]) -> str:
    """Return names in their order, each run of one name once."""
    states = [name.lower() for name in names]
    kept = [s for n, s in enumerate(states) if n == 0 or s != states[n - 1]]
    return ' > '.join(kept) or 'nothing'
