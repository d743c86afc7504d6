# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""What a process holds, and what of it grows."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

GROWTH_MAX = 0.05
"""Most growth after the warm-up of what a process holds [-]."""

LATENCY_GROWTH_MAX = 1.0
"""Most growth of a time [-]: on a host with other work smaller changes say nothing."""


class Held(NamedTuple):
    """What a process holds: resident memory [bytes], threads, open files."""

    memory: int
    threads: int
    files: int


def held_by(process: int | None = None) -> Held:
    """Return what a process holds, this one by default.

    Raises
    ------
    OSError
        If it is gone or about to be, or the system has no `/proc` as Linux has.
    """
    folder = Path('/proc', str(os.getpid() if process is None else process))
    pages = int((folder / 'statm').read_text(encoding='ascii').split()[1])
    if pages == 0:  # a process that ends gives its memory back before it leaves the list
        raise ProcessLookupError(f'process {process} is ending')
    # Looking at the files of a process opens one more in the process that looks.
    files = len(os.listdir(folder / 'fd')) - (process is None)
    return Held(pages * os.sysconf('SC_PAGE_SIZE'), len(os.listdir(folder / 'task')), files)


@dataclass(frozen=True)
class Growth:
    """How one figure changed from the first quarter after the warm-up to the last.

    Parameters
    ----------
    name : str
        What it is, with its unit.
    before, after : float
        Median over the first and over the last quarter.
    largest : float
        Largest of all after the warm-up.
    limit : float
        Most growth that is no fault [-].
    """

    name: str
    before: float
    after: float
    largest: float
    limit: float

    @property
    def growth(self) -> float:
        """Share by which it grew [-]."""
        return self.after / self.before - 1.0 if self.before > 0.0 else float(self.after > 0.0)

    @property
    def grows(self) -> bool:
        """Whether it grew too much."""
        return self.growth > self.limit


def growths(
    names: Sequence[str], samples: NDArray[np.float64], limits: Sequence[float]
) -> tuple[Growth, ...]:
    """Return how each column of samples changed.

    Parameters
    ----------
    names : sequence of str, length k
        What the columns are.
    samples : ndarray, shape (n, k)
        Samples after the warm-up, in their order, 4 at least.
    limits : sequence of float, length k
        Most growth of each that is no fault [-].

    Raises
    ------
    ValueError
        If there are fewer than 4 samples.
    """
    if len(samples) < 4:
        raise ValueError(f'samples: expected 4 or more after the warm-up but found {len(samples)}')
    quarter = len(samples) // 4
    return tuple(
        Growth(
            name,
            float(np.median(column[:quarter])),
            float(np.median(column[-quarter:])),
            float(column.max()),
            limit,
        )
        for name, column, limit in zip(names, samples.T, limits, strict=True)
    )
