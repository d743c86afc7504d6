# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Every thermal model on the simulated grinder, judged on runs it has not seen: tables, page."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any

import numpy as np

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.thermal.candidate import UNCOMPENSATED
from fuzzycnc_ros.core.thermal.fit.refinement import Progress
from fuzzycnc_ros.core.thermal.run import ThermalRun
from fuzzycnc_ros.simulation.thermal.grinder import GRINDER_AXES
from fuzzycnc_ros.simulation.thermal.grinder_runs import record_flux_case, record_grinder
from fuzzycnc_ros.studies.grinder.grinder_rivals import RIVALS, Rival
from fuzzycnc_ros.studies.page.document import shown_as, to_document
from fuzzycnc_ros.studies.page.html import Page, Section
from fuzzycnc_ros.studies.page.table import Column, Table, tied
from fuzzycnc_ros.studies.thermal.comparison import (
    BARS_MEAN,
    MARK,
    best_of,
    refusal_line,
    rms_bars,
)
from fuzzycnc_ros.studies.thermal.summary import candidate_label, has_diverged, micrometres

NOISES = (0.0, 0.02, 0.05, 0.10)
"""Noise of the rises in the flux cases, as a fraction of each rise [-]."""

TRAINING_NOISE = 0.02
"""Noise of the rises in the training of `noisy_flux` [-]; enough to make a recursion run away."""


@dataclass(frozen=True, eq=False)
class Trial:
    """Runs to train on and runs to judge on.

    Parameters
    ----------
    name : str
        Short name, as the JSON document has it.
    title : str
        What is tried, for people.
    train : tuple of ThermalRun
        Training runs.
    judged : mapping of str to ThermalRun
        Runs to judge on, by the heading of their columns.
    """

    name: str
    title: str
    train: tuple[ThermalRun, ...]
    judged: Mapping[str, ThermalRun]


@dataclass(frozen=True)
class ResidualSize:
    """Remaining thermal error: root mean square and largest absolute value [m]."""

    rms: float = field(metadata=shown_as('rms_um', 1e6))
    largest: float = field(metadata=shown_as('max_um', 1e6))


@dataclass(frozen=True)
class TrialResult:
    """Scores of one trial.

    Parameters
    ----------
    name, title : str
        Those of the trial.
    trained_on : tuple of str
        Names of the training runs.
    sensors : int
        Number of sensors.
    scores : mapping of str to mapping of str to ResidualSize
        Model -> column, such as 'E2 Y' -> score; infinite where a prediction diverged.
    problems : mapping of str to tuple of str
        What a model's own checks found wrong, or why it could not be fitted at all; models
        without problems are left out.
    """

    name: str = field(metadata=shown_as(None))
    title: str
    trained_on: tuple[str, ...]
    sensors: int
    scores: Mapping[str, Mapping[str, ResidualSize]] = field(metadata=shown_as('models'))
    problems: Mapping[str, tuple[str, ...]]


@dataclass(frozen=True)
class GrinderComparison:
    """Scores of all trials.

    Parameters
    ----------
    seed : int
        Seed of noise and models.
    trials : tuple of TrialResult
        The trials.
    """

    seed: int
    trials: tuple[TrialResult, ...]

    def score(self, trial: str, model: str, column: str) -> ResidualSize:
        """Return one score, such as `score('two_runs', 'hybrid_network', 'E2 Y')`.

        Raises
        ------
        KeyError
            If there is none of that name.
        """
        return {result.name: result for result in self.trials}[trial].scores[model][column]

    def document(self) -> dict[str, Any]:
        """Return all figures for a JSON file, lengths in micrometres.

        Returns
        -------
        dict
            `seed`, and `trials` by name with `title`, `trained_on`, `sensors`, `models` (model
            -> column -> `rms_um` and `max_um`; None where it diverged) and `problems`.
        """
        trials = {result.name: to_document(result) for result in self.trials}
        return {'seed': self.seed, 'trials': trials}

    def tables(self) -> tuple[Table, ...]:
        """Return one table per trial: rms and largest residual [um] of every model.

        A model with problems is marked and never the best of a column.
        """
        return tuple(_table(result) for result in self.trials)


def grinder_trials(seed: int = 0) -> tuple[Trial, ...]:
    """Return what the models are tried on.

    Parameters
    ----------
    seed : int
        Seed of the noise.

    Returns
    -------
    tuple of Trial
        Trained on experiment 1, with all sensors and with those on the machine; trained on 1
        and 3; trained on regular flux, clean and with noise, and judged on random flux under
        growing noise; trained on a constant flux and judged on one about twice as large.
    """
    every, machine = record_grinder(seed=seed), record_grinder(seed=seed, sensors=28)
    unseen = {'E2': every['E2']}
    return (
        Trial('one_run', 'trained on E1, all 38 sensors', (every['E1'],), every),
        Trial(
            'one_run_machine_sensors',
            'trained on E1, the 28 sensors on the machine',
            (machine['E1'],),
            machine,
        ),
        Trial(
            'two_runs', 'trained on E1 and E3, all 38 sensors', (every['E1'], every['E3']), unseen
        ),
        _flux_trial('varying_flux', 'regular', 0.0, 'random', seed),
        _flux_trial('noisy_flux', 'regular', TRAINING_NOISE, 'random', seed),
        _flux_trial('constant_flux', 'constant1', 0.0, 'constant2', seed),
    )


def compare_on_grinder(
    *,
    seed: int = 0,
    rivals: Sequence[Rival] = RIVALS,
    trials: Sequence[Trial] | None = None,
    progress: Progress | None = None,
) -> GrinderComparison:
    """Train every model in every trial and judge it beside the uncompensated grinder.

    Parameters
    ----------
    seed : int
        Seed of noise and models.
    rivals : sequence of Rival
        Models to compare.
    trials : sequence of Trial, optional
        What they are tried on; `grinder_trials(seed)` if left out.
    progress : callable, optional
        Told trial, model, fits done and fits in all before each fit and at the end; an
        exception that it raises ends the comparison and comes through.

    Returns
    -------
    GrinderComparison
        All scores.

    Notes
    -----
    Rises are those over a run's first reading and residuals those against the noisy
    displacement, as the published figures have them.

    The matrices are small.  With one thread in the numerical library (`OMP_NUM_THREADS=1`) all
    models took 25 s of a core; with two on a busy machine of two cores they took 398 s.
    """
    chosen = grinder_trials(seed) if trials is None else tuple(trials)
    total = len(chosen) * len(rivals)
    results = []
    for number, trial in enumerate(chosen):
        scores = {UNCOMPENSATED: _scores(trial, _uncompensated)}
        problems: dict[str, tuple[str, ...]] = {}
        for place, rival in enumerate(rivals):
            if progress is not None:
                progress(trial.name, rival.name, number * len(rivals) + place, total)
            try:
                models = _fitted(trial, rival, seed)
            except ValueError as error:
                problems[rival.name] = (str(error),)
                continue
            scores[rival.name] = _scores(trial, _predictor(models))
            found = [text for model in models for text in getattr(model, 'problems_', ())]
            if found:
                problems[rival.name] = tuple(dict.fromkeys(found))
        results.append(
            TrialResult(
                name=trial.name,
                title=trial.title,
                trained_on=tuple(run.name for run in trial.train),
                sensors=len(trial.train[0].sensor),
                scores=scores,
                problems=problems,
            )
        )
    if progress is not None:
        progress('done', '', total, total)
    return GrinderComparison(seed, tuple(results))


def _flux_trial(name: str, train: str, training_noise: float, test: str, seed: int) -> Trial:
    """Return a trial whose columns are named by the noise of the rises."""
    learnt_with = f'{100.0 * training_noise:g} % noise' if training_noise else 'no noise'
    return Trial(
        name,
        f'trained on {train} flux with {learnt_with}, judged on {test} flux, noise as headed',
        (record_flux_case(train, training_noise, seed),),
        {f'{100.0 * noise:g} %': record_flux_case(test, noise, seed) for noise in NOISES},
    )


def _rise(run: ThermalRun) -> Array:
    return run.rise(run.temperature[0])


def _fitted(trial: Trial, rival: Rival, seed: int) -> list[Any]:
    """Return one fitted model per axis."""
    rise = np.concatenate([_rise(run) for run in trial.train])
    displacement = np.concatenate([run.displacement for run in trial.train])
    label = np.repeat(np.arange(len(trial.train)), [len(run.time) for run in trial.train])
    return [rival.make(seed).fit(rise, target, runs=label) for target in displacement.T]


def _predictor(models: Sequence[Any]) -> Any:
    return lambda rise: np.column_stack([model.predict(rise) for model in models])


def _uncompensated(rise: Array) -> Array:
    return np.zeros((len(rise), len(GRINDER_AXES)))


def _scores(trial: Trial, predict: Any) -> dict[str, ResidualSize]:
    """Return the score of each column: every judged run, every axis."""
    scores = {}
    for heading, run in trial.judged.items():
        predicted = predict(_rise(run))
        # A prediction that left the numbers counts as infinitely wrong.
        residual = np.where(np.isfinite(predicted), predicted, inf) - run.displacement
        with np.errstate(over='ignore'):
            rms = np.sqrt(np.square(residual).mean(axis=0))
        for axis, value, largest in zip(run.axis, rms, np.abs(residual).max(axis=0), strict=True):
            scores[f'{heading} {axis}'] = ResidualSize(float(value), float(largest))
    return scores


def _table(result: TrialResult) -> Table:
    """Return the table of a trial, the best sound model of each unseen column strong."""
    labels = {rival.name: rival.label for rival in RIVALS}
    headings = list(next(iter(result.scores.values())))
    seen = {f'{run} {axis}' for run in result.trained_on for axis in GRINDER_AXES}
    models, rows = list(result.scores), []
    for model, scores in result.scores.items():
        label = labels.get(model) or candidate_label(model)
        mark = MARK if model in result.problems else ''
        rows.append((label + mark, *(_figures(scores[heading]) for heading in headings)))
    strong = set()
    for column, heading in enumerate(headings, start=1):
        rms = {model: scores[heading].rms for model, scores in result.scores.items()}
        if heading not in seen:
            texts = {
                model: f'{1e6 * value:.2f}'
                for model, value in rms.items()
                if model not in result.problems
            }
            strong |= {
                (models.index(best), column) for best in tied(texts, best_of(rms, result.problems))
            }
    return Table(
        title=f'Grinder, {result.title}: residual rms/max [µm]',
        columns=(
            Column('Model', numeric=False),
            *(Column(name, 'training' if name in seen else 'unseen') for name in headings),
        ),
        rows=tuple(rows),
        strong=frozenset(strong),
        bars=rms_bars(
            {
                model: [scores[heading].rms for heading in headings]
                for model, scores in result.scores.items()
            },
            result.problems,
            range(1, 1 + len(headings)),
        ),
        bars_mean=BARS_MEAN,
    )


def _figures(score: ResidualSize) -> str:
    """Return rms/max of a cell in micrometres."""
    if has_diverged(score.largest):
        return micrometres(score.largest)
    return f'{1e6 * score.rms:.2f}/{micrometres(score.largest)}'


def grinder_page(comparison: GrinderComparison) -> Page:
    """Return the page of the comparison, a section per trial."""
    tables = comparison.tables()
    return Page(
        title='Thermal models compared on a simulated grinder',
        summary='Every model is trained on some runs and judged on others. The grinder is a '
        'simulation: the comparison is fair between the models, but need not hold for a real '
        'machine.',
        sections=[
            Section(
                heading=f'Grinder, {result.title}',
                tables=[table],
                remarks=grinder_remarks(result),
            )
            for table, result in zip(tables, comparison.trials, strict=True)
        ],
        facts={
            'Machine': 'simulated grinder',
            'Judged': 'whole runs, each from a cold start',
            'Noise seed': str(comparison.seed),
        },
    )


def grinder_remarks(result: TrialResult) -> list[str]:
    """Return what is wrong with models in a trial, a line each."""
    return [
        refusal_line(name, '; '.join(problems), in_table=name in result.scores)
        for name, problems in result.problems.items()
    ]
