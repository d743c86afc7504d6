# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Train a thermal model: sensors, candidates, choice on held-out runs, domain."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.remedies import Remedy
from fuzzycnc_ros.core.thermal.band import fitted_band
from fuzzycnc_ros.core.thermal.candidate import (
    DRIVES_SUFFIX,
    SPEED_SUFFIX,
    STANDARD,
    UNCOMPENSATED,
    drivers_read,
)
from fuzzycnc_ros.core.thermal.cold_start import ColdStart
from fuzzycnc_ros.core.thermal.domain import trained_domain
from fuzzycnc_ros.core.thermal.fingerprint import Fingerprint, copies
from fuzzycnc_ros.core.thermal.fit.candidates import (
    CONTENDERS,
    Contender,
    JudgedCandidate,
    fit_candidate,
    preferred,
    uncompensated,
    unseen_residual,
)
from fuzzycnc_ros.core.thermal.fit.folds import independent_folds, training_folds
from fuzzycnc_ros.core.thermal.fit.learning_prior import learning_prior
from fuzzycnc_ros.core.thermal.fit.refinement import Progress
from fuzzycnc_ros.core.thermal.fit.selection import (
    all_sensors,
    select_sensors,
)
from fuzzycnc_ros.core.thermal.fit.training_runs import check_training_runs
from fuzzycnc_ros.core.thermal.fit.training_set import TrainingSet
from fuzzycnc_ros.core.thermal.model import ThermalModel
from fuzzycnc_ros.core.thermal.recursions.base import bound_of, first_order_lags
from fuzzycnc_ros.core.thermal.run import (
    JITTER_MAX,
    SPINDLE_SPEED,
    ThermalDataError,
    ThermalRun,
    drivers_of,
    hidden,
)
from fuzzycnc_ros.core.thermal.sensor_watch import (
    VOTERS,
    Indices,
    InputSelection,
    Leverage,
    SensorWatchModel,
    agreed,
    moment_of,
    voter_weights,
)
from fuzzycnc_ros.core.threads import single_threaded

SENSORS_MAX = 24
"""Most sensors that 'auto' feeds to the models as they are.

Clusters exist to reduce a dense field such as the 76 sensors of [ding_zeng].  On its two
public recordings, with 16 and 22 sensors, ridge models on all sensors beat five chosen ones."""

PAIR = 2
"""Number of runs of which each fold sees one: its sensors say little of those of both.

Candidates are then judged with the sensors of all runs, and only the band without."""


@single_threaded
def train_model(
    runs: Sequence[ThermalRun],
    *,
    model: str = 'auto',
    interval: float | None = None,
    sensors: str = 'auto',
    n_clusters: int = 5,
    candidates: Sequence[str] = STANDARD,
    compared: Sequence[str] = (),
    contenders: Mapping[str, Contender] = CONTENDERS,
    spindle_speed: bool = True,
    random_state: int = 0,
    progress: Progress | None = None,
) -> ThermalModel:
    """Train on recorded runs and choose by what was held out.

    Parameters
    ----------
    runs : sequence of ThermalRun
        Runs of one machine, each from its thermal start, sampled at `interval` or faster.
    model : str
        Candidate to use for every channel, or 'auto' for the best on held-out samples: whole
        runs where there are several, contiguous stretches of three lengths of a single one.
    interval : float, optional
        Sampling interval of the model [s]; faster runs are averaged.  If absent, 60 s, or that of
        the slowest run.
    sensors : {'auto', 'clusters', 'all'}
        'clusters' chooses one sensor per cluster, 'all' takes every sensor that warms up,
        'auto' takes all up to 24 sensors and clusters above.
    n_clusters : int
        Number of clusters.
    candidates : sequence of str
        Candidates to fit, to judge on held-out samples and to choose from, beside `model`.
        Where the control told drives, `lag_ridge_drives` competes wherever `lag_ridge` does.
    compared : sequence of str
        Further candidates, which are only fitted: they are in the model for a comparison.
    contenders : mapping of str to Contender
        What all these names mean, in the order of tables.
    spindle_speed : bool
        Whether candidates may read the spindle speed, where all runs have it.
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
    names = _names(model, candidates, compared, contenders)
    interval = training_interval(runs, interval)
    even = [at_interval(run, interval) for run in runs]
    check_training_runs(even)
    fingerprints = tuple(Fingerprint.of(run) for run in runs)
    check_copies(fingerprints)
    selection = _selected(even, sensors, n_clusters, random_state, progress)
    drivers = drivers_of(even) if spindle_speed else ()
    if LAGGED in candidates and DRIVEN not in candidates and drivers_read(DRIVEN, drivers):
        candidates = (*candidates, DRIVEN)
        names = _names(model, candidates, compared, contenders)
    data = TrainingSet.of(even, selection.chosen, drivers)
    nested = None
    if selection.method != 'all':
        nested = _nested(data, even, selection.chosen, sensors, n_clusters, random_state, progress)
        if len(even) != PAIR:
            data, nested = nested, None
    judged = {UNCOMPENSATED: uncompensated(data)}
    omitted: dict[str, str] = {}
    for done, name in enumerate(names):
        if name.endswith((SPEED_SUFFIX, DRIVES_SUFFIX)) and not drivers_read(name, drivers):
            if name == model:
                told = name.endswith(DRIVES_SUFFIX)
                what = 'motion, load or coolant' if told else 'a spindle speed'
                topics = 'machine_state' if told else 'machine_state or spindle_speed'
                raise ThermalDataError(
                    f'model {name!r}: expected {what} that changes, in every sample '
                    f'of all runs, but found none; record {topics}, or use '
                    'a model without it'
                )
            continue
        try:
            judged[name] = fit_candidate(
                name,
                contenders[name],
                data,
                _step(progress, name, done, len(names)),
                held_out=name in candidates or name == model,
            )
        except ThermalDataError as error:
            if name == model:
                raise
            omitted[name] = str(error)
    if progress is not None:
        progress('fit', names[-1], len(names), len(names))
    sound = _sound(model, candidates, judged, omitted)
    default = preferred(sound, data) if model == 'auto' else (model,) * len(even[0].channel)
    residual = unseen_residual(sound, data, default, nested)
    domain, distance = trained_domain(data.rise, data.drive, data.trained, data.block, data.folds)
    return ThermalModel(
        inputs=selection.chosen,
        interval=data.interval,
        channel=even[0].channel,
        axis=even[0].axis,
        runs=tuple(run.name for run in even),
        candidates={name: item.candidate for name, item in judged.items()},
        default=default,
        selection=selection,
        domain=domain,
        drivers=drivers,
        bound=bound_of(data.displacement),
        band=fitted_band(
            np.concatenate(residual), np.concatenate(distance), independent_folds(data.folds)
        ),
        omitted=omitted,
        watch=learn_watch(even, selection, data.interval),
        cold_start=ColdStart.of(even, selection.chosen),
        fingerprints=fingerprints,
        prior=learning_prior(even, selection.chosen, SPINDLE_SPEED in drivers, data, residual),
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
            f'one every {step:g} s',
            Remedy('record faster', {}),
            Remedy(f'train with an interval of {step:g} s', {'interval': f'{step:g}'}),
        )
    return run.resample(interval)


LAGGED, DRIVEN = 'lag_ridge', 'lag_ridge_drives'
"""A candidate, and the one that competes beside it where the control told drives."""

INTERVAL = 60.0
"""Sampling interval of a model of runs that are sampled as fast, or faster [s]."""


def training_interval(runs: Sequence[ThermalRun], wanted: float | None = None) -> float:
    """Return the sampling interval of a model [s].

    Parameters
    ----------
    runs : sequence of ThermalRun
        Runs to train on.
    wanted : float, optional
        Interval that was asked for [s]; if absent, a minute, or that of the slowest run.
    """
    if wanted is not None:
        return wanted
    slowest = max(float(np.median(np.diff(run.time))) for run in runs)
    return INTERVAL if slowest <= INTERVAL * (1.0 + JITTER_MAX) else round(slowest, 3)


def _names(
    model: str,
    candidates: Sequence[str],
    compared: Sequence[str],
    contenders: Mapping[str, Contender],
) -> tuple[str, ...]:
    """Return the candidates to fit, in the order of tables."""
    known = ', '.join(contenders)
    if model not in ('auto', *contenders):
        raise ValueError(f'model: expected auto or one of {known}, but found {model!r}')
    for field, names in (('candidates', candidates), ('compared', compared)):
        for name in names:
            if name not in contenders:
                raise ValueError(f'{field}: expected some of {known}, but found {name!r}')
    if model == 'auto' and not candidates:
        raise ValueError(f'candidates: expected some of {known} to choose from, but found none')
    wanted = {model, *candidates, *compared}
    return tuple(name for name in contenders if name in wanted)


def _step(progress: Progress | None, name: str, done: int, total: int) -> Callable[[], None]:
    """Return what a candidate under training calls after each fit."""

    def step() -> None:
        if progress is not None:
            progress('fit', name, done, total)

    step()
    return step


def _selected(
    runs: Sequence[ThermalRun],
    sensors: str,
    n_clusters: int,
    random_state: int,
    progress: Progress | None,
) -> InputSelection:
    if sensors not in ('auto', 'clusters', 'all'):
        raise ValueError(f'sensors: expected auto, clusters or all, but found {sensors!r}')
    if sensors == 'all' or (sensors == 'auto' and len(runs[0].sensor) <= SENSORS_MAX):
        return all_sensors(runs)
    return select_sensors(
        runs, n_clusters=n_clusters, random_state=random_state, progress=progress
    )


def _nested(
    data: TrainingSet,
    runs: Sequence[ThermalRun],
    chosen: Sequence[str],
    sensors: str,
    n_clusters: int,
    random_state: int,
    progress: Progress | None,
) -> TrainingSet:
    """Choose the sensors of each fold without what it judges on."""
    rows = data.rows
    inputs = []
    for fold in data.folds:
        seen = np.isin(data.block, fold.train)
        part = [
            run if seen[own].all() else hidden(run, ~seen[own])
            for run, own in zip(runs, rows, strict=True)
            if seen[own].any()
        ]
        try:
            inputs.append(_selected(part, sensors, n_clusters, random_state, progress).chosen)
        except ThermalDataError:
            inputs.append(tuple(chosen))  # too little is left to choose anew
    return data.nested(runs, inputs)


def check_copies(fingerprints: Sequence[Fingerprint]) -> None:
    """Refuse a recording that is there twice.

    Raises
    ------
    ThermalDataError
        It names both runs.
    """
    for text in copies(fingerprints).values():
        raise ThermalDataError(text)


def _sound(
    model: str,
    candidates: Sequence[str],
    judged: dict[str, JudgedCandidate],
    omitted: dict[str, str],
) -> list[JudgedCandidate]:
    """Return the candidates that the choice may fall on.

    Raises
    ------
    ThermalDataError
        If there is none, or the requested one cannot be trusted.
    """
    if model != 'auto':
        if problems := judged[model].candidate.problems:
            raise ThermalDataError(f'model {model!r} is refused: {"; ".join(problems)}')
        return [judged[model]]
    able = [
        item
        for name, item in judged.items()
        if name in candidates and item.contender is not None and item.contender.chosen
    ]
    if not able:
        reasons = [f'{name}: for comparison only' for name in judged if name != UNCOMPENSATED]
        reasons += [f'{name}: {reason}' for name, reason in omitted.items()]
        raise ThermalDataError(
            'model: expected a candidate that can be chosen, but found none; '
            + ' | '.join(reasons)
        )
    sound = [item for item in able if not item.candidate.problems]
    return [*sound, judged[UNCOMPENSATED]]


SMOOTHING = 300.0
"""Time constant of the smoothing of held-out residuals [s]: noise is not what the mates miss."""

DECIMALS = 6
"""Decimals of the moments [K^2] in a model file; a reading's noise is 0.01 K^2."""

ROUNDING = 1e-9
"""Squared distance from the training [-] below which there is none."""


def learn_watch(
    runs: Sequence[ThermalRun], selection: InputSelection, interval: float
) -> SensorWatchModel:
    """Learn the sensors' common behaviour, and how well it tells of each chosen one.

    Parameters
    ----------
    runs : sequence of ThermalRun
        Training runs of one machine, checked and at one interval.
    selection : InputSelection
        The chosen sensors; those that never warmed are no mates.
    interval : float
        Sampling interval [s].

    Returns
    -------
    SensorWatchModel
        Moments of all runs; misses and distances of runs that were held out, or of stretches
        of a single run.

    Raises
    ------
    ThermalDataError
        If no fold has measured displacements, as in the choice of a model.
    """
    sensor = tuple(name for name in runs[0].sensor if name not in selection.dropped)
    rise = np.concatenate([run.rise()[:, run.columns(sensor)] for run in runs])
    targets = np.array([sensor.index(name) for name in selection.chosen], dtype=np.int64)
    block, folds = training_folds(runs)
    moments = [moment_of(rise[block == number]) for number in range(int(block.max()) + 1)]
    sizes = np.bincount(block)
    share = min(1.0, interval / SMOOTHING)
    missed, leverage = np.zeros(len(targets)), np.zeros(len(targets))
    for fold in folds:
        train = list(fold.train)
        moment = np.sum([moments[number] for number in train], axis=0) / sizes[train].sum()
        held_out = rise[np.isin(block, fold.test)]
        residual, distance = _judged(moment, targets, held_out)
        smooth = first_order_lags(np.array(1.0 - share), share * residual)
        missed = np.maximum(missed, np.abs(agreed(smooth)).max(axis=0))
        leverage = np.maximum(leverage, distance.max(axis=0))
    return SensorWatchModel(
        sensor=sensor,
        input=selection.chosen,
        moment=np.round(np.sum(moments, axis=0) / len(rise), DECIMALS),
        missed=missed,
        # Without mates nothing but the rounding of the last digit is left.
        leverage=np.where(leverage < ROUNDING, 0.0, leverage),
    )


def _judged(moment: Array, targets: Indices, rise: Array) -> tuple[Array, Array]:
    """Return what each voter misses of held-out rises, (n, voters, p) [K], and their leverage."""
    usable = np.arange(len(moment))
    weights = voter_weights(moment, targets, usable)
    expected = rise @ weights.reshape(VOTERS * len(targets), -1).T
    residual = rise[:, np.newaxis, targets] - expected.reshape(len(rise), VOTERS, -1)
    return np.nan_to_num(residual), Leverage(moment, targets, usable).of(rise)
