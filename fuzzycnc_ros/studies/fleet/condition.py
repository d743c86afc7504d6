# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Condition of a shop from its judged bags: trends with confidence, sorted by urgency.

A trend is the slope of Theil and Sen, the median of the slopes between all pairs of bags, with
Sen's confidence interval: a few odd bags do not turn it.  All trends of one kind are tested
together, at 95 % for all of them (Bonferroni), so that a large shop does not raise false alarms.
The interval takes bags as independent; what repeats by the season reads as a drift while it rises.

References
----------
[sen1968]
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import ceil, inf, isfinite, nan
from typing import Any

import numpy as np
from scipy.stats import binom, theilslopes

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.names import in_counting_order
from fuzzycnc_ros.studies.fleet.results import Row

CONFIDENCE = 0.95
"""That all intervals of a kind hold together [-]."""

BAGS_MIN = 8
"""Fewest bags that a trend is told of."""

STRETCHES = 300
"""Points of a trend at most; of more bags, the medians of as many stretches of equal number."""

NEWEST = 0.25
"""Share of the bags that counts as the newest [-]."""

MONTH = 30.0
"""Time that slopes are told for [days]."""

STALE_RATIO = 1.5
"""Least ratio of the newest bags' residual to that of the training for a model to be stale."""

DOMAIN_MIN = 0.9
"""Share of samples in the domain below which a falling share makes a model stale [-]."""

FAILING = 0.01
"""Share of missing samples in the newest bags from which on a sensor fails [-]."""

_DAY = 86_400e9


@dataclass(frozen=True)
class SlopeEstimate:
    """A slope and its confidence interval, per 30 days in the unit of its values.

    NaN where there are too few bags.
    """

    slope: float = nan
    low: float = nan
    high: float = nan

    @property
    def rises(self) -> bool:
        """True if it rises beyond chance."""
        return self.low > 0.0

    @property
    def falls(self) -> bool:
        """True if it falls beyond chance."""
        return self.high < 0.0


@dataclass(frozen=True, eq=False)
class ResidualHistory:
    """Residuals of a model on a channel of a machine, bag by bag, oldest first.

    Parameters
    ----------
    machine, model, channel : str
        What it is of.
    begin : ndarray, shape (n,)
        Time of each bag [ns].
    rms, bare : ndarray, shape (n,)
        Root mean square with the model and without [um].
    in_domain : ndarray, shape (n,)
        Share of the samples in the domain of the training [-].
    held_out : float
        What training had promised [um].
    trend : SlopeEstimate
        Of `rms`.
    domain_trend : SlopeEstimate
        Of `in_domain`.
    ratio, ratio_low : float
        Median `rms` of the newest bags over `held_out`, and the lower end of its interval [-].
    trained, diverged : int
        Bags that were left out, since the model was trained on them, and those on which it
        diverged.
    """

    machine: str
    model: str
    channel: str
    begin: Array
    rms: Array
    bare: Array
    in_domain: Array
    held_out: float
    trend: SlopeEstimate
    domain_trend: SlopeEstimate
    ratio: float
    ratio_low: float
    trained: int
    diverged: int

    @property
    def days(self) -> float:
        """Time from the first bag to the last [days]."""
        return float(self.begin[-1] - self.begin[0]) / _DAY if len(self.begin) else 0.0

    @property
    def drift(self) -> float:
        """Certain growth of the residual from the first bag to the last, over `held_out` [-]."""
        if not self.trend.rises:
            return 0.0
        return self.trend.low * self.days / MONTH / max(self.held_out, 1e-9)

    @property
    def newest_rms(self) -> float:
        """Median `rms` of the newest bags [um]."""
        return _median(newest(self.rms))

    @property
    def newest_bare(self) -> float:
        """Median `bare` of the newest bags [um]."""
        return _median(newest(self.bare))

    @property
    def newest_in_domain(self) -> float:
        """Median share of the newest bags in the domain [-]."""
        return _median(newest(self.in_domain))

    @property
    def stale(self) -> bool:
        """True if the model no longer fits the machine."""
        return self.leaves_more or self.leaves_domain or bool(self.diverged)

    @property
    def leaves_more(self) -> bool:
        """True if the newest bags leave more than training had promised, beyond chance."""
        return self.ratio_low > STALE_RATIO

    @property
    def leaves_domain(self) -> bool:
        """True if the machine leaves the domain of the training."""
        return self.domain_trend.falls and self.newest_in_domain < DOMAIN_MIN


@dataclass(frozen=True, eq=False)
class MissingHistory:
    """Missing shares of a sensor, bag by bag, oldest first.

    Parameters
    ----------
    machine, sensor : str
        What it is of.
    begin : ndarray, shape (n,)
        Time of each bag [ns].
    missing, substituted, bridged : ndarray, shape (n,)
        Shares of samples that were missing, that others stood in for, that a straight line
        bridged [-].
    trend : SlopeEstimate
        Of `missing`.
    """

    machine: str
    sensor: str
    begin: Array
    missing: Array
    substituted: Array
    bridged: Array
    trend: SlopeEstimate

    @property
    def newest_missing(self) -> float:
        """Mean share of the newest bags that is missing [-]."""
        return float(newest(self.missing).mean())

    @property
    def fails(self) -> bool:
        """True if it is missing in the newest bags."""
        return self.newest_missing > FAILING


@dataclass(frozen=True)
class Unjudged:
    """A bag that could not be judged with a model, and why."""

    machine: str
    bag: str
    problem: str


@dataclass(frozen=True, eq=False)
class ShopCondition:
    """A shop, each list sorted by urgency.

    Parameters
    ----------
    machines : tuple of str
        All machines.
    bags : int
        Number of bags.
    first, last : int
        Time of the oldest and the newest bag [ns].
    drifts : tuple of ResidualHistory
        The course that drifts most of each channel of each machine first.
    stale : tuple of ResidualHistory
        The same courses, the model that fits least first.
    sensors : tuple of MissingHistory
        The sensor that is missing most first.
    unjudged : tuple of Unjudged
        Bags that could not be judged.
    versions : tuple of str
        What computed the table.
    """

    machines: tuple[str, ...]
    bags: int
    first: int
    last: int
    drifts: tuple[ResidualHistory, ...]
    stale: tuple[ResidualHistory, ...]
    sensors: tuple[MissingHistory, ...]
    unjudged: tuple[Unjudged, ...]
    versions: tuple[str, ...]


def shop_condition(rows: Sequence[Row]) -> ShopCondition:
    """Return what the rows of a table say of the machines, models and sensors.

    Raises
    ------
    ValueError
        If there is no row.
    """
    if not rows:
        raise ValueError('expected rows in the table but found none; evaluate some bags first')
    judged = [row for row in rows if row['channel'] is not None]
    groups = _by(judged, ('machine', 'model', 'model_hash', 'channel'))
    courses = [_course(own, len(groups)) for own in groups]
    sensors = list(_sensors(rows))
    dated = [row['begin'] for row in rows if row['begin'] is not None]
    return ShopCondition(
        machines=tuple(sorted({row['machine'] for row in rows})),
        bags=len({(row['path'], row['bag']) for row in rows}),
        first=min(dated, default=0),
        last=max(dated, default=0),
        drifts=tuple(sorted(courses, key=_by_drift)),
        stale=tuple(sorted(courses, key=_by_staleness)),
        sensors=tuple(sorted(sensors, key=_by_missing)),
        unjudged=tuple(
            Unjudged(row['machine'], row['bag'], row['problem']) for row in rows if row['problem']
        ),
        versions=tuple(sorted({row['version'] for row in rows})),
    )


def trend(begin: Array, values: Array, together: int = 1) -> SlopeEstimate:
    """Return the trend of values over time.

    Parameters
    ----------
    begin : ndarray, shape (n,)
        Times [ns], not falling.
    values : ndarray, shape (n,)
        Values; those that are not finite do not count.
    together : int
        Number of trends that are tested together.
    """
    known = np.isfinite(values)
    days, known_values = (begin[known] - begin[0]) / _DAY if len(begin) else begin, values[known]
    if len(known_values) < BAGS_MIN or np.ptp(days) <= 0.0:
        return SlopeEstimate()
    days, known_values = _stretches(days), _stretches(known_values)
    confidence = 1.0 - (1.0 - CONFIDENCE) / max(together, 1)
    slope, _, low, high = theilslopes(known_values, days, confidence)
    return SlopeEstimate(MONTH * float(slope), MONTH * float(low), MONTH * float(high))


def newest(values: Array) -> Array:
    """Return the newest quarter of values by bag, oldest first."""
    return values[len(values) - ceil(NEWEST * len(values)) :]


def _course(rows: Sequence[Row], together: int) -> ResidualHistory:
    rows = sorted(rows, key=_by_time)
    # What a model was trained on it leaves little of; that would look like a drift afterwards.
    unseen = [row for row in rows if not row['trained_on']]
    begin = np.array([row['begin'] for row in unseen], dtype=np.float64)
    rms, bare, inside = (
        np.array([row[name] for row in unseen], dtype=np.float64)
        for name in ('rms_um', 'uncompensated_rms_um', 'in_domain')
    )
    held_out = float(rows[-1]['held_out_rms_um'])
    low, middle = _median_bound(newest(rms), together)
    return ResidualHistory(
        machine=rows[0]['machine'],
        model=rows[0]['model'],
        channel=rows[0]['channel'],
        begin=begin,
        rms=rms,
        bare=bare,
        in_domain=inside,
        held_out=held_out,
        trend=trend(begin, rms, together),
        domain_trend=trend(begin, inside, together),
        ratio=middle / held_out if held_out > 0.0 else nan,
        ratio_low=low / held_out if held_out > 0.0 else nan,
        trained=len(rows) - len(unseen),
        diverged=int(np.isinf(rms).sum()),
    )


def _sensors(rows: Sequence[Row]) -> Iterator[MissingHistory]:
    """Yield the sensors of all machines; of several models that read a bag the most counts."""
    shares: dict[tuple[str, str], dict[tuple[float, str], list[float]]] = {}
    for row in rows:
        for item in row['sensors'] or ():
            bags = shares.setdefault((row['machine'], item['sensor']), {})
            found = [item[name] for name in ('missing', 'substituted', 'bridged')]
            bag = (row['begin'], row['path'])
            bags[bag] = list(map(max, bags.get(bag, found), found))
    for (machine, sensor), bags in shares.items():
        order = sorted(bags)
        begin = np.array([time for time, _ in order], dtype=np.float64)
        table = np.array([bags[key] for key in order])
        missing, substituted, bridged = table.T
        falls = trend(begin, missing, len(shares))
        yield MissingHistory(machine, sensor, begin, missing, substituted, bridged, falls)


def _median_bound(values: Array, together: int) -> tuple[float, float]:
    """Return the lower confidence bound of the median, from order statistics, and the median."""
    known = np.sort(values[~np.isnan(values)])
    if not len(known):
        return nan, nan
    level = (1.0 - CONFIDENCE) / (2.0 * max(together, 1))
    rank = int(binom.ppf(level, len(known), 0.5)) - 1
    # Too few bags for a bound: whatever they leave may be chance.
    return (float(known[rank]) if rank >= 0 else 0.0), _median(known)


def _median(values: Array) -> float:
    known = np.sort(values[~np.isnan(values)])
    return float(known[len(known) // 2]) if len(known) else nan


def _stretches(values: Array) -> Array:
    """Return values, or the medians of stretches where there are many."""
    if len(values) <= STRETCHES:
        return values
    return np.array([float(np.median(part)) for part in np.array_split(values, STRETCHES)])


def _by(rows: Iterable[Row], names: Sequence[str]) -> list[list[Row]]:
    groups: dict[tuple[str, ...], list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[name] for name in names), []).append(row)
    return [groups[key] for key in sorted(groups)]


def _by_time(row: Row) -> tuple[int, str]:
    return row['begin'], row['path']


def _by_drift(item: ResidualHistory) -> tuple[float, float, str, str, str]:
    slope = item.trend.slope if isfinite(item.trend.slope) else -inf
    return -item.drift, -slope, item.machine, item.channel, item.model


def _by_staleness(item: ResidualHistory) -> tuple[bool, bool, float, str, str, str]:
    ratio = item.ratio if not np.isnan(item.ratio) else 0.0
    return not item.stale, not item.diverged, -ratio, item.machine, item.channel, item.model


def _by_missing(item: MissingHistory) -> tuple[Any, ...]:
    missing = -item.newest_missing, -float(item.missing.mean())
    return *missing, item.machine, in_counting_order(item.sensor)
