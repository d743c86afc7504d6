# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Choose few sensors that represent a temperature field.

References
----------
[ding_zeng]: fuzzy c-means clustering of the sensors, ranking inside the clusters by correlation or
grey relational grade; the refinement by held-out runs goes beyond the paper.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core import portable
from fuzzycnc_ros.core.arrays import Array, Seed
from fuzzycnc_ros.core.fuzzy.clustering import FuzzyCMeans
from fuzzycnc_ros.core.thermal.band import largest_of, mean_of_square
from fuzzycnc_ros.core.thermal.fit.folds import run_rows
from fuzzycnc_ros.core.thermal.fit.grey import GreyModel
from fuzzycnc_ros.core.thermal.fit.refinement import Progress, TemperatureField, refined
from fuzzycnc_ros.core.thermal.fit.training_runs import check_training_runs
from fuzzycnc_ros.core.thermal.ranking import correlation_of, grey_relational_grade
from fuzzycnc_ros.core.thermal.run import (
    RISE_MIN,
    ThermalDataError,
    ThermalRun,
)
from fuzzycnc_ros.core.thermal.sensor_watch import InputCluster, InputSelection

_METHODS = ('correlation', 'grey_grade')
"""Rankings of the members of a cluster."""

SUBSTITUTES_MAX = 4
"""Mates kept for a sensor that has the whole machine to choose from."""


@dataclass(frozen=True, eq=False)
class SensorCount:
    """Held-out residual for one number of sensors.

    Parameters
    ----------
    count : int
        Number of clusters asked for.
    chosen : tuple of str
        Sensors chosen.
    rms, largest : ndarray, shape (c,)
        Root mean square and largest absolute residual of each channel [m].
    """

    count: int
    chosen: tuple[str, ...]
    rms: Array
    largest: Array


def select_sensors(
    runs: Sequence[ThermalRun],
    *,
    n_clusters: int = 5,
    method: str = 'correlation',
    refine: bool = True,
    random_state: Seed = 0,
    m: float = 2.0,
    n_init: int = 5,
    progress: Progress | None = None,
) -> InputSelection:
    """Cluster the sensors and choose one per cluster [ding_zeng].

    Parameters
    ----------
    runs : sequence of ThermalRun
        Training runs of one machine.
    n_clusters : int
        Number of clusters, 1 to the number of sensors that warm up.
    method : {'correlation', 'grey_grade'}
        Ranking inside the clusters.
    refine : bool
        Whether better ranked members compete on held-out runs.
    random_state : int, numpy.random.Generator or None
        Seed of the clustering.
    m : float
        Fuzzifier of the clustering, above 1.
    n_init : int
        Random starts of the clustering.
    progress : callable, optional
        Told after each judged choice; an exception it raises ends the selection.

    Returns
    -------
    InputSelection
        Clusters with their chosen sensors, mates and gains.  A cluster without any sensor of
        highest membership is left out.

    Raises
    ------
    ThermalDataError
        If the runs cannot be used, or there are more clusters than sensors that warm up.
    ValueError
        If `method` is unknown or the clustering's parameters are out of range.

    Notes
    -----
    Rises are divided by their one common maximum.  Scaling each sensor by its own deviation, as
    one would first try, makes the distances concentrate and fuzzy c-means with m = 2 collapse
    on a single run: partition coefficient 0.20 instead of 0.76 for five clusters.
    """
    if method not in _METHODS:
        raise ValueError(f'method: expected one of {", ".join(_METHODS)}, but found {method!r}')
    field = _usable(runs)
    if not 1 <= n_clusters <= len(field.sensor):
        raise ThermalDataError(
            f'n_clusters: expected 1 to {len(field.sensor)} (the sensors that warm by '
            f'{RISE_MIN} K), but found {n_clusters}'
        )
    features = field.rise.T / np.abs(field.rise).max() / np.sqrt(len(field.rise))
    clustering = FuzzyCMeans(n_clusters, m=m, n_init=n_init, random_state=random_state)
    clustering.fit(features)
    score = _scores(field, method)
    ranked = []
    for label in range(n_clusters):
        members = np.flatnonzero(clustering.labels_ == label)
        if len(members):
            ranked.append(members[np.argsort(-score[members], kind='stable')])
    chosen = [int(members[0]) for members in ranked]
    if refine:
        chosen = refined(field, ranked, runs, progress)
    clusters = tuple(
        _cluster(field, members, score, first)
        for members, first in zip(ranked, chosen, strict=True)
    )
    return InputSelection(
        method=method,
        clusters=clusters,
        partition_coefficient=clustering.partition_coefficient_,
        xie_beni=clustering.xie_beni_,
        dropped=field.dropped,
        calibration=tuple(run.name for run in runs),
    )


def all_sensors(runs: Sequence[ThermalRun], method: str = 'correlation') -> InputSelection:
    """Return the selection that makes every sensor that warms up an input.

    Each input is a cluster of its own; its mates are the sensors that follow it best.

    Raises
    ------
    ThermalDataError
        If the runs cannot be used.
    """
    field = _usable(runs)
    score = _scores(field, method)
    everyone = np.arange(len(field.sensor))
    clusters = []
    for index in everyone:
        mates = _cluster(field, everyone, score, int(index))
        clusters.append(
            InputCluster(
                member=(field.sensor[index],),
                score=(float(score[index]),),
                chosen=field.sensor[index],
                substitute=mates.substitute[:SUBSTITUTES_MAX],
                gain=mates.gain[:SUBSTITUTES_MAX],
                correlation=mates.correlation[:SUBSTITUTES_MAX],
            )
        )
    return InputSelection(
        method='all',
        clusters=tuple(clusters),
        partition_coefficient=1.0,
        xie_beni=float('nan'),
        dropped=field.dropped,
        calibration=tuple(run.name for run in runs),
    )


def sensor_count_curve(
    runs: Sequence[ThermalRun],
    held_out: ThermalRun,
    *,
    counts: Sequence[int] = (1, 2, 3, 5, 8, 10, 15),
    method: str = 'grey_grade',
    refine: bool = False,
    random_state: Seed = 0,
    progress: Progress | None = None,
) -> tuple[SensorCount, ...]:
    """Return how the held-out residual falls with the number of sensors.

    Parameters
    ----------
    runs : sequence of ThermalRun
        Training runs.
    held_out : ThermalRun
        Run that was not trained on; the stable grey model is judged on it.
    counts : sequence of int
        Numbers of clusters to try.
    method, refine, random_state
        As in `select_sensors`.
    progress : callable, optional
        Told after each count.

    Returns
    -------
    tuple of SensorCount
        One entry per count.
    """
    points = []
    labels = np.repeat(np.arange(len(runs)), [len(run.time) for run in runs])
    target = np.concatenate([run.displacement for run in runs])
    for done, count in enumerate(counts, start=1):
        selection = select_sensors(
            runs, n_clusters=count, method=method, refine=refine, random_state=random_state
        )
        rise = np.concatenate([run.rise()[:, run.columns(selection.chosen)] for run in runs])
        unseen = held_out.rise()[:, held_out.columns(selection.chosen)]
        residual = np.empty_like(held_out.displacement)
        for channel in range(target.shape[1]):
            model = GreyModel('stable', interval=runs[0].interval)
            model.fit(rise, target[:, channel], runs=labels)
            residual[:, channel] = held_out.displacement[:, channel] - model.predict(unseen)
        points.append(
            SensorCount(
                count=count,
                chosen=selection.chosen,
                rms=np.sqrt(mean_of_square(residual)),
                largest=largest_of(residual),
            )
        )
        if progress is not None:
            progress('sensor_count', str(count), done, len(counts))
    return tuple(points)


def _usable(runs: Sequence[ThermalRun]) -> TemperatureField:
    runs = [run.bridged() for run in runs]
    check_training_runs(runs)
    rises = [run.rise() for run in runs]
    warm = np.max([np.ptp(rise, axis=0) for rise in rises], axis=0) >= RISE_MIN
    names = runs[0].sensor
    return TemperatureField(
        sensor=tuple(names[index] for index in np.flatnonzero(warm)),
        rise=np.concatenate(rises)[:, warm],
        displacement=np.concatenate([run.displacement for run in runs]),
        dropped=tuple(names[index] for index in np.flatnonzero(~warm)),
        rows=run_rows(runs),
    )


def _scores(field: TemperatureField, method: str) -> Array:
    """Return the score of each sensor, the mean over the channels, shape (s,)."""
    scores = []
    for target in field.displacement.T:
        measured = np.isfinite(target)
        rise = field.rise[measured]
        if method == 'grey_grade':
            scores.append(grey_relational_grade(rise, target[measured]))
        else:
            scores.append(np.abs(correlation_of(rise, target[measured, np.newaxis])[:, 0]))
    return np.asarray(np.mean(scores, axis=0))


def _cluster(
    field: TemperatureField, members: NDArray[np.int64], score: Array, chosen: int
) -> InputCluster:
    mates = members[members != chosen]
    rise, own = field.rise[:, mates], field.rise[:, chosen]
    correlation = correlation_of(rise, own[:, np.newaxis])[:, 0]
    # A mate that moves the other way follows something else; it must not stand in.
    order = [index for index in np.argsort(-correlation, kind='stable') if correlation[index] > 0]
    gain = portable.matmul(rise.T, own) / np.einsum('nm,nm->m', rise, rise)
    return InputCluster(
        member=tuple(field.sensor[index] for index in members),
        score=tuple(float(score[index]) for index in members),
        chosen=field.sensor[chosen],
        substitute=tuple(field.sensor[mates[index]] for index in order),
        gain=tuple(float(gain[index]) for index in order),
        correlation=tuple(float(correlation[index]) for index in order),
    )
