# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Train a thermal model: sensors, candidates, choice on held-out runs, domain."""

from collections.abc import Sequence

import numpy as np

from fuzzycnc_ros.core.thermal.candidate import CANDIDATES
from fuzzycnc_ros.core.thermal.candidates import (
    ELIGIBLE,
    JudgedCandidate,
    TrainingSet,
    fit_candidate,
    preferred,
)
from fuzzycnc_ros.core.thermal.domain import Domain
from fuzzycnc_ros.core.thermal.model import ThermalModel
from fuzzycnc_ros.core.thermal.refinement import Progress
from fuzzycnc_ros.core.thermal.run import (
    JITTER_MAX,
    ThermalDataError,
    ThermalRun,
    check_training_runs,
)
from fuzzycnc_ros.core.thermal.selected import SensorSelection
from fuzzycnc_ros.core.thermal.selection import (
    all_sensors,
    select_sensors,
)

SENSORS_MAX = 24
"""Most sensors that 'auto' feeds to the models as they are.

Clusters exist to reduce a dense field such as the 76 sensors of method sheet 001.  On its two
public recordings, with 16 and 22 sensors, ridge models on all sensors beat five chosen ones."""


def train_model(
    runs: Sequence[ThermalRun],
    *,
    model: str = 'auto',
    interval: float = 60.0,
    sensors: str = 'auto',
    n_clusters: int = 5,
    random_state: int = 0,
    progress: Progress | None = None,
) -> ThermalModel:
    """Train on recorded runs and choose by what was held out, method sheet 001 section 5.

    Parameters
    ----------
    runs : sequence of ThermalRun
        Runs of one machine, each from its thermal start, sampled at `interval` or faster.
    model : str
        Candidate to use for every channel, or 'auto' for the best on held-out samples: whole
        runs where there are several, contiguous stretches of three lengths of a single one.
    interval : float
        Sampling interval of the model [s]; faster runs are averaged.
    sensors : {'auto', 'clusters', 'all'}
        'clusters' chooses one sensor per cluster, 'all' takes every sensor that warms up,
        'auto' takes all up to 24 sensors and clusters above.
    n_clusters : int
        Number of clusters.
    random_state : int
        Seed of the clustering.
    progress : callable, optional
        Told stage, candidate, steps done and steps in all; an exception that it raises ends
        the training and comes through.

    Returns
    -------
    ThermalModel
        All candidates that could be fitted, and which of them each channel uses.

    Raises
    ------
    ThermalDataError
        If the runs cannot be used, or the requested model cannot be fitted or trusted.
    ValueError
        If `model` or `sensors` is unknown.
    """
    if model != 'auto' and model not in CANDIDATES:
        raise ValueError(
            f'model: expected auto or one of {", ".join(CANDIDATES)}, but found {model!r}'
        )
    even = [at_interval(run, interval) for run in runs]
    check_training_runs(even)
    selection = _selected(even, sensors, n_clusters, random_state, progress)
    data = TrainingSet.of(even, selection.chosen)
    judged: dict[str, JudgedCandidate] = {}
    omitted: dict[str, str] = {}
    for done, name in enumerate(CANDIDATES, start=1):
        try:
            judged[name] = fit_candidate(name, data)
        except ThermalDataError as error:
            if name == model:
                raise
            omitted[name] = str(error)
        if progress is not None:
            progress('fit', name, done, len(CANDIDATES))
    default = _default(model, judged, data)
    rms = np.array(
        [judged[name].candidate.held_out_rms[column] for column, name in enumerate(default)]
    )
    return ThermalModel(
        inputs=selection.chosen,
        interval=data.interval,
        channel=even[0].channel,
        axis=even[0].axis,
        runs=tuple(run.name for run in even),
        candidates={name: item.candidate for name, item in judged.items()},
        default=default,
        selection=selection,
        domain=Domain.of(data.rise),
        residual_deviation=rms,
        omitted=omitted,
    )


def at_interval(run: ThermalRun, interval: float) -> ThermalRun:
    """Return a run at a model's interval, averaged if it is sampled faster.

    Raises
    ------
    ThermalDataError
        If the run is sampled more slowly than `interval`.
    """
    step = float(np.median(np.diff(run.time)))
    if step > interval * (1.0 + JITTER_MAX):
        raise ThermalDataError(
            f'run {run.name!r}: expected a sample every {interval:g} s or more often, but found '
            f'one every {step:g} s; record faster or train with interval={step:g}'
        )
    return run.resample(interval)


def _selected(
    runs: Sequence[ThermalRun],
    sensors: str,
    n_clusters: int,
    random_state: int,
    progress: Progress | None,
) -> SensorSelection:
    if sensors not in ('auto', 'clusters', 'all'):
        raise ValueError(f'sensors: expected auto, clusters or all, but found {sensors!r}')
    if sensors == 'all' or (sensors == 'auto' and len(runs[0].sensor) <= SENSORS_MAX):
        return all_sensors(runs)
    return select_sensors(
        runs, n_clusters=n_clusters, random_state=random_state, progress=progress
    )


def _default(model: str, judged: dict[str, JudgedCandidate], data: TrainingSet) -> tuple[str, ...]:
    """Return the candidate of each channel."""
    channels = int(data.displacement.shape[1])
    if model == 'auto':
        sound = [
            judged[name]
            for name in ELIGIBLE
            if name in judged and not judged[name].candidate.problems
        ]
        return preferred(sound, data.scaled_target()[1])
    problems = judged[model].candidate.problems
    if problems:
        raise ThermalDataError(f'model {model!r} is refused: {"; ".join(problems)}')
    return (model,) * channels
