# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""History of a machine over the last 24 hours, in memory: ever coarser the longer ago it was."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.runtime.records import SECOND, Bools, Floats, Stamp

Single = NDArray[np.float32]

COLUMNS_MAX = 1500
"""Columns of a series; what else comes is not kept."""
POINTS_MAX = 2000
"""Rows of an answer."""


class Tier(NamedTuple):
    """One resolution: width of a row [s], 0 for each sample as it comes, and how many rows."""

    period: float
    rows: int


DAY = (Tier(0.0, 600), Tier(10.0, 720), Tier(60.0, 1440))
"""Ten minutes at 1 Hz as they come, two hours in rows of 10 s, a day in rows of a minute."""


class Rows(NamedTuple):
    """Part of a series.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Machine time of each row [s].
    low, high, mean : ndarray, shape (n, c)
        Least, largest and mean value of each column in each row; NaN where there is none.
    flag : ndarray, shape (n, c)
        Whether any sample in the row was flagged.
    """

    time: Floats
    low: Single
    high: Single
    mean: Single
    flag: Bools


class _Ring:
    """The rows of one tier; the oldest is overwritten."""

    def __init__(self, tier: Tier) -> None:
        self._tier = tier
        self._time = np.zeros(0)
        self._values: Single = np.zeros((0, 3, 0), np.float32)
        self._count = np.zeros(0, np.uint32)
        self._sum = np.zeros(0)
        self._flag: Bools = np.zeros((0, 0), bool)
        self._held = 0  # rows that are filled
        self._head = -1  # the newest of them
        self._bin = 0.0

    def widen(self, columns: int) -> None:
        """Make room for more columns; before, they were unknown."""
        more = columns - self._values.shape[2]
        self._values = np.pad(self._values, ((0, 0), (0, 0), (0, more)), constant_values=np.nan)
        self._flag = np.pad(self._flag, ((0, 0), (0, more)))
        self._count = np.pad(self._count, (0, more))
        self._sum = np.pad(self._sum, (0, more))

    def add(self, time: float, values: Floats, flag: Bools) -> None:
        """Take a sample of all columns."""
        number = time // self._tier.period if self._tier.period else time
        if self._head < 0 or number != self._bin:
            self._begin(time)
            self._bin = number
        row = self._values[self._head]
        row[0] = np.fmin(row[0], values)
        row[1] = np.fmax(row[1], values)
        known = ~np.isnan(values)
        self._count += known
        self._sum[known] += values[known]
        np.divide(self._sum, self._count, out=row[2], where=known, casting='same_kind')
        self._flag[self._head] |= flag

    def rows(self, begin: float, end: float) -> Rows:
        """Return the rows between two times [s], oldest first."""
        order = np.arange(self._head - self._held + 1, self._head + 1) % max(len(self._time), 1)
        time = self._time[order]
        order = order[(time >= begin) & (time <= end)]
        low, high, mean = np.moveaxis(self._values[order], 1, 0)
        return Rows(self._time[order], low, high, mean, self._flag[order])

    @property
    def oldest(self) -> float:
        """Time [s] from which on all is held; infinite without a row."""
        if self._held == 0:
            return np.inf
        return float(self._time[(self._head - self._held + 1) % len(self._time)])

    @property
    def full(self) -> bool:
        """True if older rows were dropped."""
        return self._held == self._tier.rows

    @property
    def nbytes(self) -> int:
        """Memory in use [bytes]."""
        parts = (self._time, self._values, self._flag, self._count, self._sum)
        return sum(part.nbytes for part in parts)

    def _begin(self, time: float) -> None:
        """Begin a row."""
        if self._held == len(self._time) < self._tier.rows:
            self._grow()
        self._head = (self._head + 1) % len(self._time)
        self._held = min(self._held + 1, len(self._time))
        self._time[self._head] = time
        self._values[self._head] = np.nan
        self._flag[self._head] = False
        self._count[:] = 0
        self._sum[:] = 0.0

    def _grow(self) -> None:
        """Double the rows: a machine that is seen for minutes takes no memory for a day."""
        more = min(max(len(self._time), 16), self._tier.rows - len(self._time))
        self._time = np.pad(self._time, (0, more))
        self._values = np.pad(self._values, ((0, more), (0, 0), (0, 0)), constant_values=np.nan)
        self._flag = np.pad(self._flag, ((0, more), (0, 0)))


class QuantityHistory:
    """Quantities that are told together, by name.

    Parameters
    ----------
    tiers : sequence of Tier
        Resolutions, the finest first.
    """

    def __init__(self, tiers: Sequence[Tier] = DAY) -> None:
        self._columns: dict[str, int] = {}
        self._tiers = tuple(tiers)
        self._newest: Stamp | None = None
        self._rings = [_Ring(tier) for tier in self._tiers]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return tuple(self._columns)

    @property
    def begin(self) -> float:
        """Machine time [s] of the oldest row; infinite without one."""
        return min(ring.oldest for ring in self._rings)

    @property
    def nbytes(self) -> int:
        """Memory in use [bytes]."""
        return sum(ring.nbytes for ring in self._rings)

    def add(
        self, stamp: Stamp, values: Mapping[str, float], flagged: frozenset[str] = frozenset()
    ) -> None:
        """Take a sample.

        Parameters
        ----------
        stamp : int
            Machine time [ns].  What comes late, from another topic, joins the newest sample.
        values : mapping of str to float
            Values by column; what is not finite counts as none.
        flagged : frozenset of str
            Columns whose value here is to be marked.
        """
        self._newest = stamp if self._newest is None else max(stamp, self._newest)
        fresh = [name for name in values if name not in self._columns]
        for name in fresh[: COLUMNS_MAX - len(self._columns)]:
            self._columns[name] = len(self._columns)
        if fresh:
            for ring in self._rings:
                ring.widen(len(self._columns))
        row = np.full(len(self._columns), np.nan)
        flag = np.zeros(len(self._columns), bool)
        for name, value in values.items():
            place = self._columns.get(name)
            if place is not None:
                row[place] = value
                flag[place] = name in flagged
        row[~np.isfinite(row) | (np.abs(row) > np.finfo(np.float32).max)] = np.nan
        for ring in self._rings:
            ring.add(self._newest / SECOND, row, flag)

    def rows(self, begin: float, end: float, points: int) -> Rows:
        """Return what happened between two times, each stretch as finely as it is known.

        Parameters
        ----------
        begin, end : float
            Machine time [s].
        points : int
            Most rows that are wanted; neighbours are merged until there are no more.
        """
        parts: list[Rows] = []
        until = end
        for ring in self._rings:
            part = ring.rows(begin, until)
            if len(part.time):
                parts.insert(0, part)
            if not ring.full:
                break  # nothing was dropped here: a coarser one knows no more
            until = min(until, np.nextafter(ring.oldest, -np.inf))
        if not parts:
            return self._rings[0].rows(begin, end)
        whole = Rows(*(np.concatenate(items) for items in zip(*parts, strict=True)))
        return _merged(whole, max(1, min(points, POINTS_MAX)))


def joined(
    before: tuple[Sequence[str], Rows], after: tuple[Sequence[str], Rows], points: int
) -> tuple[tuple[str, ...], Rows]:
    """Return two stretches of a series, one after the other, in at most so many rows.

    Parameters
    ----------
    before, after : (sequence of str, Rows)
        Columns and rows of each.
    points : int
        Most rows that are wanted.
    """
    columns = tuple(dict.fromkeys([*before[0], *after[0]]))
    parts = []
    for names, rows in (before, after):
        place = [columns.index(name) for name in names]
        shape = len(rows.time), len(columns)
        wide = np.full((3, *shape), np.nan, np.float32)
        wide[:, :, place] = (rows.low, rows.high, rows.mean)
        flag = np.zeros(shape, bool)
        flag[:, place] = rows.flag
        parts.append(Rows(rows.time, wide[0], wide[1], wide[2], flag))
    whole_rows = Rows(*(np.concatenate(items) for items in zip(*parts, strict=True)))
    return columns, _merged(whole_rows, max(1, min(points, POINTS_MAX)))


def _merged(rows: Rows, points: int) -> Rows:
    """Return at most so many rows, of stretches of equal duration."""
    if len(rows.time) <= points:
        return rows
    span = rows.time[-1] - rows.time[0]
    number = np.minimum(((rows.time - rows.time[0]) / span * points).astype(int), points - 1)
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    known = ~np.isnan(rows.mean)
    total = np.add.reduceat(np.where(known, rows.mean, 0.0), starts, axis=0)
    count = np.add.reduceat(known, starts, axis=0, dtype=np.int64)
    mean = np.full(total.shape, np.nan, np.float32)
    np.divide(total, count, out=mean, where=count > 0)
    return Rows(
        rows.time[starts],
        np.fmin.reduceat(rows.low, starts, axis=0),
        np.fmax.reduceat(rows.high, starts, axis=0),
        mean,
        np.logical_or.reduceat(rows.flag, starts, axis=0),
    )


SERIES = ('temperatures', 'error', 'compensation', 'axes')
"""Series kept of a machine."""


class History:
    """The series of one machine.

    Parameters
    ----------
    tiers : sequence of Tier
        Resolutions, the finest first.
    """

    def __init__(self, tiers: Sequence[Tier] = DAY) -> None:
        self._tiers = tiers
        self.clear()

    def clear(self) -> None:
        """Forget all: the clock began anew."""
        self._series = {name: QuantityHistory(self._tiers) for name in SERIES}

    def __getitem__(self, name: str) -> QuantityHistory:
        """Return a series by name."""
        return self._series[name]

    @property
    def begin(self) -> float:
        """Machine time [s] of the oldest row; infinite without one."""
        return min(series.begin for series in self._series.values())

    @property
    def nbytes(self) -> int:
        """Memory in use [bytes]."""
        return sum(series.nbytes for series in self._series.values())


def history_document(
    machine: str, name: str, columns: Sequence[str], rows: Rows
) -> dict[str, Any]:
    """Return rows of a series as a JSON document; unknown values are None."""
    flagged = np.atleast_1d(rows.flag.any(axis=0)).tolist()
    return {
        'machine': machine,
        'series': name,
        'time': rows.time.tolist(),
        'columns': {
            column: {
                'min': _listed(rows.low[:, place]),
                'max': _listed(rows.high[:, place]),
                'mean': _listed(rows.mean[:, place]),
            }
            for place, column in enumerate(columns)
        },
        'flags': {
            column: rows.flag[:, place].astype(int).tolist()
            for place, column in enumerate(columns)
            if flagged[place]
        },
    }


def _listed(values: Single) -> list[float | None]:
    """Return numbers with the digits that they hold, None where there is none."""
    return [None if value != value else float(f'{value:.7g}') for value in values.tolist()]
