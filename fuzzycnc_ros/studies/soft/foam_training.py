# Copyright The fuzzycnc authors
# SPDX-License-Identifier: Apache-2.0
"""Models of feed compensation, judged on samples that they were not trained on."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fuzzycnc_ros.core.arrays import Array
from fuzzycnc_ros.core.deformation.features import direction_doubts, feature_set, load
from fuzzycnc_ros.core.deformation.model import DeformationModel
from fuzzycnc_ros.core.deformation.network import (
    TooFewSamplesError,
    TSFuzzyNetwork,
    samples_needed,
)
from fuzzycnc_ros.core.deformation.regression import (
    FEW,
    gaussian_process,
    no_correction,
    outlying,
    ridge_regression,
)
from fuzzycnc_ros.core.deformation.training import beyond_chance, grouped_folds
from fuzzycnc_ros.core.names import first_names
from fuzzycnc_ros.core.threads import single_threaded
from fuzzycnc_ros.studies.soft.foam_records import NAMED, Samples

Predictor = Callable[[Array], Array]
Trainer = Callable[[Array, Array, NDArray[np.int64]], Predictor]
Tell = Callable[[str, int, int], None]

FOLDS, FINE_FOLDS = 5, 10
"""Parts that are held out in turn, and those of few samples, twice what a network needs to `FEW`.

A fifth of few samples is a large loss: models that need many are judged worse than they are.  With
60 samples by direction the choice costs 3 % over the best by ten parts, 13 % by five (sheets of
`benchmarks/soft_choice.py`, seeds 2000 to 2015).
"""

LEAST = 10
"""Fewest samples that differ, to train a model and to judge it on others."""


@dataclass(frozen=True, eq=False)
class Coverage:
    """Samples of one thickness.

    Attributes
    ----------
    thickness : float
        Thickness [m].
    lines, arcs : int
        Samples of each kind.
    direction, depth, step : tuple of float
        Least and largest direction [rad], depth and step [m].
    """

    thickness: float
    lines: int
    arcs: int
    direction: tuple[float, float]
    depth: tuple[float, float]
    step: tuple[float, float]


@dataclass(frozen=True, eq=False)
class MethodErrors:
    """Errors of one kind of model on samples that were held out.

    Attributes
    ----------
    name : str
        What it is called.
    predicted : ndarray, shape (k, 2)
        Compensations of all samples, each held out in turn [mm per 50 mm].
    rms : float
        Root mean square of both axes over all samples [mm per 50 mm].
    by_thickness : mapping of float to float
        The same by thickness [m].
    """

    name: str
    predicted: Array
    rms: float
    by_thickness: Mapping[float, float]


@dataclass(frozen=True, eq=False)
class FoamTraining:
    """A training, judged.

    Attributes
    ----------
    coverage : sequence of Coverage
        Samples by thickness.
    needed : ndarray, shape (k, 2)
        Compensations that were needed [mm per 50 mm].
    errors : sequence of MethodErrors
        Held-out errors in the order of the rivals.
    folds, groups : int
        Parts that were held out in turn, and groups of samples that were kept together.
    used : int
        Place of the model in use among the errors.
    """

    coverage: Sequence[Coverage]
    needed: Array
    errors: Sequence[MethodErrors]
    folds: int
    groups: int
    used: int = 0


@dataclass(frozen=True)
class ComparedModel:
    """A model to compare.

    Parameters
    ----------
    label : str
        What it is called.
    train : callable
        From process values, compensations and groups to a predictor.
    """

    label: str
    train: Trainer


METHODS = {
    'none': 'no correction',
    'ridge': 'ridge regression',
    'gaussian_process': 'Gaussian process',
    'network': 'network',
}
"""Models that a machine can run, by name, the simplest first, and what they are called."""

AUTO = 'auto'
"""Stands for the method that held-out samples choose."""

CONSEQUENTS = {'nts': 'hidden layer (NTS)', 'sts': 'linear rules (STS)'}
"""Networks by the name of their consequents."""

AGAINST_NONE, AGAINST_SIMPLER = 0.01, 0.1
"""Chances at which a model without any merit is taken, over no correction and over a simpler one.

The first is paid by every sheet that does not give way, the second by none."""


@dataclass(frozen=True, eq=False)
class TrainedModel:
    """A model, how it was chosen, and what is to be said of it.

    Attributes
    ----------
    model : DeformationModel
        The model; it compensates nothing if no correction was the best.
    method : str
        Of `METHODS`.
    judged : FoamTraining
        Held-out errors of all.
    outliers : tuple of str
        Samples that were left out, where they are from.
    lines : tuple of str
        What is to be said.
    notes : tuple of str
        What of it is a doubt.
    """

    model: DeformationModel
    method: str
    judged: FoamTraining
    outliers: tuple[str, ...]
    lines: tuple[str, ...]
    notes: tuple[str, ...]


@single_threaded
def train_model(
    samples: Samples,
    settings: Mapping[str, Any],
    method: str = AUTO,
    *,
    others: Sequence[ComparedModel] = (),
    progress: Tell = lambda text, done, total: None,
) -> TrainedModel:
    """Find outliers, hold samples out in turn, choose a model, and train it on all that remain.

    A model is taken over a simpler one if it is better on held-out samples beyond chance: by a
    t test on the errors of the groups, and by the rms of all.

    Parameters
    ----------
    samples : Samples
        The samples.
    settings : mapping
        Settings of the network, as of `TSFuzzyNetwork`.
    method : str
        Of `METHODS`, or `AUTO`.
    others : sequence of ComparedModel
        Models that are judged beside them, and never chosen.
    progress : callable
        Told what is going on, steps done and in all.

    Raises
    ------
    ValueError
        If the method is unknown, or there are too few samples.
    """
    if method not in (AUTO, *METHODS):
        raise ValueError(
            f'method: expected {AUTO} or one of {", ".join(METHODS)} but found {method!r}'
        )
    needed = samples_needed(TSFuzzyNetwork(**settings).n_rules, FOLDS)
    check_enough(samples.x, samples.s, needed if method == 'network' else LEAST)
    out = outlying(samples.x, samples.s)
    x, s, groups = samples.x[~out], samples.s[~out], samples.groups[~out]
    trainers: dict[str, Callable[[Array, Array], DeformationModel]] = {
        'none': no_correction,
        'ridge': ridge_regression,
        'gaussian_process': gaussian_process,
    }
    named = METHODS | {'network': CONSEQUENTS[settings.get('consequent', 'nts')]}
    compared = list(METHODS) if method == AUTO else list(dict.fromkeys(('none', method)))

    def judge(names: Sequence[str], others: Sequence[ComparedModel], folds: int) -> FoamTraining:
        rivals = [
            ComparedModel(named[name], _fitted(trainers[name]))
            if name in trainers
            else network(named[name], **settings)
            for name in names
        ]
        seed = int(settings.get('random_state', 0))
        return judge_training(
            x, s, groups, [*rivals, *others], folds=folds, seed=seed, progress=progress
        )

    few = _different(x, s) < needed
    folds = FINE_FOLDS if 2 * needed <= len(x) <= FEW else FOLDS
    judged: FoamTraining | None = None
    if not few or method == 'network':
        try:
            # One by one, more of few samples are left for a rule with a sample of its own.
            judged = judge(compared, others, len(x) if few else folds)
        except TooFewSamplesError:
            if method == 'network':
                raise
    if without := judged is None:
        compared = [name for name in compared if name != 'network']
        judged = judge(compared, (), FOLDS)
    chosen = (
        _chosen(judged, s, groups, len(compared)) if method == AUTO else compared.index(method)
    )
    judged = replace(judged, used=chosen)
    name = compared[chosen]
    notes: tuple[str, ...]
    if name == 'network':
        fitted = TSFuzzyNetwork(**settings).fit(x, s, groups)
        model, notes = fitted.model_, fitted.problems_
    else:
        model, notes = trainers[name](x, s), direction_doubts(x, s)
    lines = [*_outlier_lines(samples, out), *(f'note: {note}' for note in notes)]
    if without and method == AUTO:
        lines.append(
            f'no network: it takes {needed} samples that differ, in as many groups, but found '
            f'{len(x)} in {judged.groups}'
        )
    if method == AUTO:
        lines.append(_choice_line(judged, name, len(compared)))
    doubts = tuple(lines[:-1] if method == AUTO and name != 'none' else lines)
    if model.corrects:
        lines.append(_gate_line(model))
    places = tuple(samples.where[at] for at in np.flatnonzero(out))
    return TrainedModel(model, name, judged, places, tuple(lines), doubts)


def _fitted(make: Callable[[Array, Array], DeformationModel]) -> Trainer:
    return lambda x, s, groups: make(x, s).predict


def _chosen(judged: FoamTraining, s: Array, groups: NDArray[np.int64], rivals: int) -> int:
    """Return the place of the model that held-out samples choose."""
    _, group = np.unique(groups, return_inverse=True)
    count = np.bincount(group)
    error = [
        np.bincount(group, np.hypot(*(item.predicted - s).T)) / count
        for item in judged.errors[:rivals]
    ]
    best = 0
    for place in range(1, len(error)):
        level = AGAINST_SIMPLER if best else AGAINST_NONE
        # By the rms too, in which samples that it misses by far weigh more.
        larger = judged.errors[place].rms > judged.errors[best].rms
        if not larger and beyond_chance(error[best] - error[place], level):
            best = place
    return best


def _choice_line(judged: FoamTraining, method: str, rivals: int) -> str:
    """Return which model was chosen and why."""
    none, used = judged.errors[0], judged.errors[judged.used]
    if method == 'none':
        least = min(judged.errors[1:rivals], key=lambda item: item.rms)
        return (
            'no correction: held-out samples show no deformation that a model predicts beyond '
            f'chance; {none.rms:.3f} mm per 50 mm without, {least.rms:.3f} with the best '
            f'({least.name}); the model compensates nothing'
        )
    return (
        f'chosen by held-out samples: {used.name}, {used.rms:.3f} mm per 50 mm, instead of '
        f'{none.rms:.3f} without correction'
    )


def _gate_line(model: DeformationModel) -> str:
    """Return what a model lets pass, in words."""
    gate = model.gate
    low, high = gate.low, gate.high
    directions = f'directions {low[0]:g} to {high[0]:g}° and their opposites'
    return (
        f'the model is for {"all directions" if gate.all_round else directions}, steps '
        f'{low[3]:g} to {high[3]:g} mm, thicknesses {low[4]:g} to {high[4]:g} mm, depths '
        f'{gate.ratio_low:.2f} to {gate.ratio_high:.2f} of the thickness'
    )


def _outlier_lines(samples: Samples, out: NDArray[np.bool_]) -> list[str]:
    """Return which samples contradict the others."""
    places = [samples.where[at] for at in np.flatnonzero(out)]
    if not places:
        return []
    return [
        f'left out: {len(places)} of {len(out)} samples that contradict the others: '
        f'{first_names(places, NAMED)}'
    ]


def network(label: str, **settings: Any) -> ComparedModel:
    """Return the T-S fuzzy neural network with settings of `TSFuzzyNetwork`."""

    def train(x: Array, s: Array, groups: NDArray[np.int64]) -> Predictor:
        return TSFuzzyNetwork(**settings).fit(x, s, groups).predict

    return ComparedModel(label, train)


def baselines(features: str, seed: int = 0) -> tuple[ComparedModel, ...]:
    """Return plain regressors on a feature set, scaled inputs and outputs.

    Parameters
    ----------
    features : str
        Name of the feature set; with 'load' they learn the compensation per load, too.
    seed : int
        Seed of those that draw.

    Raises
    ------
    ImportError
        If scikit-learn is not installed.
    """
    from sklearn.ensemble import GradientBoostingRegressor
    from sklearn.linear_model import RidgeCV
    from sklearn.multioutput import MultiOutputRegressor
    from sklearn.neural_network import MLPRegressor

    makers: dict[str, Callable[[int], Any]] = {
        'plain ridge regression': lambda inputs: RidgeCV(np.logspace(-3, 2, 11)),
        'MLP, 32 and 32 nodes': lambda inputs: MLPRegressor(
            hidden_layer_sizes=(32, 32),
            alpha=1.0,
            solver='lbfgs',
            max_iter=2000,
            max_fun=10**6,
            random_state=seed,
        ),
        'gradient boosting': lambda inputs: MultiOutputRegressor(
            GradientBoostingRegressor(n_estimators=300, random_state=seed)
        ),
    }
    return tuple(
        ComparedModel(label, plain_regressor(features, make)) for label, make in makers.items()
    )


def plain_regressor(features: str, make: Callable[[int], Any]) -> Trainer:
    """Return the training of a regressor of scikit-learn on scaled features.

    Parameters
    ----------
    features : str
        Name of the feature set; with 'load' it learns the compensation per load, too.
    make : callable
        Makes the regressor of a number of inputs.
    """
    chosen = feature_set(features)

    def weight(x: Array) -> Array:
        if not chosen.loaded:
            return np.ones((len(x), 1))
        return np.asarray(load(*x[:, [1, 3, 4]].T)[:, np.newaxis])

    def train(x: Array, s: Array, groups: NDArray[np.int64]) -> Predictor:
        from sklearn.preprocessing import StandardScaler

        target = s / weight(x)
        inputs, outputs = StandardScaler().fit(chosen.rows(x)), StandardScaler().fit(target)
        model = make(inputs.n_features_in_)
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # a model that stops early is judged like any other
            model.fit(inputs.transform(chosen.rows(x)), outputs.transform(target))

        def predict(rows: Array) -> Array:
            scaled = model.predict(inputs.transform(chosen.rows(rows)))
            return np.asarray(outputs.inverse_transform(scaled) * weight(rows))

        return predict

    return train


def check_enough(x: Array, s: Array, needed: int) -> None:
    """Refuse fewer samples than it takes to train a model and to judge it on others.

    Parameters
    ----------
    x : ndarray, shape (k, 5)
        Process values.
    s : ndarray, shape (k, 2)
        Compensations that were needed [mm per 50 mm].
    needed : int
        How many have to differ.

    Raises
    ------
    ValueError
        If there are; the text says how many are needed.
    """
    found = _different(x, s)
    if found < needed:
        raise ValueError(
            f'samples: expected at least {needed} that differ, to learn a model and to judge it '
            f'on others, but found {found}; record more'
        )


def _different(x: Array, s: Array) -> int:
    return len(np.unique(np.column_stack([x, s]), axis=0))


def judge_training(
    x: Array,
    s: Array,
    groups: NDArray[np.int64],
    rivals: Sequence[ComparedModel],
    *,
    folds: int = FOLDS,
    seed: int = 0,
    progress: Tell = lambda text, done, total: None,
) -> FoamTraining:
    """Hold samples out in whole groups, in turn, and judge models on them.

    Parameters
    ----------
    x : ndarray, shape (k, 5)
        Process values.
    s : ndarray, shape (k, 2)
        Compensations that were needed [mm per 50 mm].
    groups : ndarray of int, shape (k,)
        Groups that stay together.
    rivals : sequence of ComparedModel
        Models, that in use first.
    folds, seed : int
        Parts, and seed of their draw.
    progress : callable
        Told what is going on, steps done and in all.

    Returns
    -------
    FoamTraining
        Errors of each model, all from the same parts.

    Raises
    ------
    TooFewSamplesError
        If a network has too few samples beside those that are held out.
    ValueError
        If there are not three groups: training chooses its penalty on parts as well.
    """
    count = len(np.unique(groups))
    if count < 3:
        raise ValueError(
            f'samples: expected three different processes or sheets, to hold some out, but found '
            f'{count}; record more'
        )
    parts = grouped_folds(groups, folds, np.random.default_rng(seed))
    too_few = (
        f'samples: expected groups of one process or sheet of which some can be held out, but '
        f'found {len(x)} samples in {count} groups, too large a part of them in one; record more '
        'sheets or processes'
    )
    if min(int((~part).sum()) for part in parts) < LEAST // 2:
        raise ValueError(too_few)
    errors = []
    for number, rival in enumerate(rivals):
        predicted = np.empty_like(s)
        for done, part in enumerate(parts):
            progress(rival.label, number * len(parts) + done, len(rivals) * len(parts))
            try:
                predict = rival.train(x[~part], s[~part], groups[~part])
            except TooFewSamplesError as error:
                raise TooFewSamplesError(too_few) from error
            predicted[part] = predict(x[part])
        errors.append(_errors(rival.label, x, s, predicted))
    return FoamTraining(coverage(x), s, errors, len(parts), count)


def coverage(x: Array) -> tuple[Coverage, ...]:
    """Return what samples cover, by thickness."""
    found = []
    for thickness in np.unique(x[:, 4]):
        rows = x[x[:, 4] == thickness]
        low, high = rows.min(axis=0), rows.max(axis=0)
        found.append(
            Coverage(
                thickness=1e-3 * float(thickness),
                lines=int((rows[:, 2] == 2.0).sum()),
                arcs=int((rows[:, 2] == 1.0).sum()),
                direction=(float(np.radians(low[0])), float(np.radians(high[0]))),
                depth=(1e-3 * float(low[1]), 1e-3 * float(high[1])),
                step=(1e-3 * float(low[3]), 1e-3 * float(high[3])),
            )
        )
    return tuple(found)


def _errors(label: str, x: Array, s: Array, predicted: Array) -> MethodErrors:
    square = ((predicted - s) ** 2).mean(axis=1)
    return MethodErrors(
        label,
        predicted,
        float(np.sqrt(square.mean())),
        {
            1e-3 * float(thickness): float(np.sqrt(square[x[:, 4] == thickness].mean()))
            for thickness in np.unique(x[:, 4])
        },
    )
